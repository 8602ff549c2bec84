"""Geometry as design: every target is the limit of differences of the very call that a user makes.

Bodies follow the design by rigid motions (docs/theory/04-start.md).
"""

import functools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    DesignVariable,
    DirectDifferentiation,
    Distance,
    DistributedForce,
    FollowerForce,
    InitialVelocity,
    Material,
    MotorTorque,
    MovingSupport,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Revolute,
    RigidBody,
    RigidBox,
    RotationDriver,
    Scene,
    SpringDamper,
    Terminal,
    TorsionalSpringDamper,
    Weld,
    assemble,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.assembly.geometry import Reference
from ancfdae.errors import InconsistentStartError, InvalidInputError, UnknownNameError
from ancfdae.extend import MaterialPoint
from ancfdae.laws import ConstantAcceleration, Harmonic, Spline
from ancfdae.observables import position
from ancfdae.sections import Rectangle

STRIP = Rectangle(0.04, 0.03)
SOFT = Material(2000.0, 1e8, 0.3, damping_time=1e-2)
STEP, END = 2.0**-8, 2.0**-6


def pendulum():
    """Open, in the plane, with every kind of load, and spinning."""
    rod = Beam("rod", (0.2, 0.1), (1.1, 0.4), 2, STRIP, SOFT)
    loads = [
        PointForce(rod.at(0.8, y=0.01), (3.0, 2.0), name="push"),
        FollowerForce(rod.at(0.3), (1.0, 4.0), name="jet"),
        DistributedForce("rod", (0.5, -2.0), name="snow"),
        SpringDamper(rod.at(0.6), 50.0, 2.0, 0.3, ground=(1.0, 0.9), name="spring"),
    ]
    base = Pin(rod.at(0.1, y=0.005), ground=(0.29 - 0.005 * 0.3 / 0.9**0.5, 0.13), name="base")
    spin = InitialVelocity("rod", 0.7, (0.2, 0.1), velocity=(0.1, -0.2))
    return Scene([rod], [base], (0.3, -9.81), [spin], loads, assemble=True)


def slider_crank():
    """A closed loop in the plane, driven."""
    crank = Beam("crank", (0.0, 0.0), (0.3, 0.4), 1, STRIP, SOFT)
    rod = Beam("rod", (0.3, 0.4), (1.4, -0.1), 2, STRIP, SOFT)
    joints = [
        Pin(crank.at_start, ground=(0.0, 0.0), name="bearing"),
        RotationDriver(crank.at(0.4), Harmonic(0.2, 3.0, 0.1, -0.02), name="motor"),
        Pin(crank.at(0.9, y=0.01), rod.at(0.05), name="elbow"),
        PointOnLine(rod.at(0.9), (1.0, 0.1), (0.0, -0.2), name="slot"),
    ]
    return Scene([crank, rod], joints, (0.0, -9.81), assemble=True)


def four_bar():
    """A closed loop in the plane: coupler placed by the crank, a link, a bent rocker."""
    crank = Beam("crank", (0.0, 0.0), (0.1, 0.4), 1, STRIP, SOFT, turn=0.05)
    coupler = Beam("coupler", crank.at_end, (0.8, 0.2), 2, STRIP, SOFT)
    angles = np.array([0.3, 0.1, -0.2]) + 0.5 * np.pi
    frames = np.array([[[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]] for a in angles])
    places = np.array([[1.2, -0.1], [1.15, 0.15], [1.17, 0.42]])
    rocker = CurvedBeam("rocker", places, frames, STRIP, SOFT)
    joints = [
        Pin(crank.at_start, ground=(0.0, 0.0), name="left"),
        Pin(crank.at_end, coupler.at_start, name="elbow"),
        Distance(coupler.at(0.9), 0.4, rocker.at(0.95, y=0.004), name="link"),
        Pin(rocker.at_start, ground=(1.2, -0.1), name="right"),
        PointOnLine(coupler.at(0.6, y=-0.004), (0.3, 1.0), (0.41, 0.02), name="rail"),
    ]
    return Scene([crank, coupler, rocker], joints, (0.0, -9.81), assemble=True)


def arm():
    """Open, in space, driven about an oblique axis; one beam is placed by the other."""
    upper = Beam("upper", (0, 0, 0), (0.4, 0.5, 0.1), 1, STRIP, SOFT, height_axis=(1, 0, 1))
    lower = Beam("lower", upper.at_end, (0.5, -0.2, 0.3), 1, STRIP, SOFT, turn=(0.1, -0.2, 0.05))
    joints = [
        Revolute(upper.at_start, (0.1, 0.3, 1.0), ground=(0.0, 0.0, 0.0), name="shoulder"),
        RotationDriver(
            upper.at(0.3), ConstantAcceleration(0.5, 0.1), axis=(0.1, 0.3, 1.0), name="motor"
        ),
        Revolute(upper.at_end, (0.2, -0.1, 1.0), lower.at_start, name="elbow"),
    ]
    loads = [PointForce(lower.at(0.7, y=0.01, z=0.005), (3.0, 2.0, 1.0), name="push")]
    start = [InitialVelocity("lower", (0.3, 0.2, 0.5), (0.1, 0.0, 0.0), (0.2, 0.1, -0.1))]
    return Scene([upper, lower], joints, (0.5, -9.81, 1.0), start, loads, assemble=True)


def tripod():
    """A closed loop in space: two beams and a link on a beam that hangs from the ground."""
    mast = Beam("mast", (0, 0, 0), (0.1, 0.9, 0.2), 1, STRIP, SOFT)
    boom = Beam("boom", (0.1, 0.9, 0.2), (1.0, 1.1, 0.4), 1, STRIP, SOFT)
    joints = [
        Pin(mast.at_start, ground=(0.0, 0.0, 0.0), name="foot"),
        Pin(mast.at_end, boom.at_start, name="top"),
        Distance(boom.at(0.9, y=0.01), 1.35, ground=(1.2, -0.2, 0.3), name="stay"),
        Distance(mast.at(0.6, z=0.005), 0.8, ground=(-0.4, 0.0, 0.5), name="guy"),
        PointOnLine(boom.at(0.7), (0.3, 1.0, 0.2), (0.7, 1.0, 0.3), name="slot"),
    ]
    return Scene([mast, boom], joints, (0.0, -9.81, 0.5), assemble=True)


def robot():
    """A rigid base, a motor between two sections, welds, and loads with laws, in the plane."""
    base = RigidBody("base", (0.1, 0.0), shape=RigidBox(0.2, 0.1, 0.1), density=500.0, turn=0.05)
    at = np.array([0.1, 0.0]) + 0.05 * np.array([-np.sin(0.05), np.cos(0.05)])
    upper = Beam("upper", tuple(at), tuple(np.add(at, (0.3, 0.4))), 1, STRIP, SOFT)
    lower = Beam("lower", upper.at_end, (0.5, -0.1), 1, STRIP, SOFT)
    hand = Beam("hand", lower.at_end, (0.05, 0.1), 1, STRIP, SOFT, rigid=True)
    knots = [0.0, 0.05, 0.1, 0.2]
    joints = [
        Pin(base.at(0.0, 0.0), ground=(0.1, 0.0), name="floor"),
        Weld(base.at(0.0, 0.05), upper.at_start, name="shoulder"),
        Pin(upper.at_end, lower.at_start, name="elbow"),
        RotationDriver(
            lower.at(0.1), Spline(knots, [0.0, 0.1, -0.1, 0.2]), other=upper.at(0.9), name="motor"
        ),
        Weld(lower.at_end, hand.at_start, name="wrist"),
    ]
    loads = [
        MotorTorque(base.at(0.0, 0.0), 2.0, law=Harmonic(1.0, 5.0, 0.3), name="torque"),
        TorsionalSpringDamper(upper.at(0.2), 3.0, 0.1, 0.05, name="coil"),
    ]
    bodies = [base, PointMass(hand.at(0.8, y=0.01), 0.3, name="payload")]
    start = [InitialVelocity("base", 0.4, (0.1, 0.0))]
    return Scene(
        [upper, lower, hand], joints, (0.2, -9.81), start, loads, bodies=bodies, assemble=True
    )


SCENES = {f.__name__: f for f in (pendulum, slider_crank, four_bar, arm, tripod, robot)}


def all_targets(scene):
    """Every target of whole beams, joints, loads, starts and the scene that is not refused."""
    names = [f"{beam.name}.{name}" for beam in scene.beams for name in beam.parameter_names()]
    names += [f"{owner}.{name}" for owner in scene.owners() for name in scene.numbers(owner)]
    found = []
    for name in names:
        try:
            scene.resolve(name)
        except (InvalidInputError, UnknownNameError):
            continue
        found.append(name)
    return found


def units(scene, targets):
    """Sizes of the changes that matter."""
    held = np.array([scene.value(DesignVariable("x", [target])) for target in targets])
    return np.array([unit(target, value) for target, value in zip(targets, held, strict=True)])


def unit(target, held):
    return abs(held) if "damping" in target else max(abs(held), 0.1)


def tip(scene):
    beam = scene.beams[-1]
    x, *others = (position(beam.at(0.95), axis) for axis in range(scene.dimension))
    return sum(((k + 2) * other for k, other in enumerate(others)), x)


@functools.cache
def gradients(name, displaced):
    """Scene, targets, and their gradient by direct differentiation."""
    scene = SCENES[name]()
    targets = all_targets(scene)
    if displaced:
        shifts = np.random.default_rng(3).uniform(-1, 1, len(targets))
        values = {
            target: held + 0.03 * unit(target, held) * shift
            for target, shift in zip(targets, shifts, strict=True)
            for held in [scene.value(DesignVariable("x", [target]))]
            # What may not stand beside round-off of its limit stays.
            if not target.endswith(("_y", "_z")) or "point" not in target
        }
        scene = scene.with_values(values)
    found = gradient(
        scene, Terminal(tip(scene)), END, HHT(STEP), design=targets, method=DirectDifferentiation()
    )
    return scene, targets, found


def objective(scene):
    return observed(simulate(scene, END, HHT(STEP)), scene)


def observed(solution, scene):
    place = solution.position(scene.beams[-1].at(0.95))[-1]
    return place[0] + sum((k + 2) * x for k, x in enumerate(place[1:]))


def central(f, x, h):
    """Central difference of fourth order."""
    return (8 * (f(x + h) - f(x - h)) - (f(x + 2 * h) - f(x - 2 * h))) / (12 * h)


def weights(scene, targets, seed):
    """Random signs of the changes that matter, for all targets at once."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], len(targets))
    return signs * units(scene, targets) / len(targets) ** 0.5


def slope_of_the_call(scene, targets, along, h):
    """Central difference of the call with all targets moved at once."""
    held = np.array([scene.value(DesignVariable("x", [target])) for target in targets])

    def moved(x):
        return objective(scene.with_values(dict(zip(targets, held + x * along, strict=True))))

    return central(moved, 0.0, h)


@pytest.mark.parametrize("displaced", [False, True], ids=["declared", "displaced"])
@pytest.mark.parametrize("name", SCENES)
def test_every_target_is_the_limit_of_differences_of_the_call(name, displaced):
    # Along random signs of all targets: an error of one of them is missed by each with a
    # probability of a half at most, whatever the others' are.
    scene, targets, found = gradients(name, displaced)
    size = np.max(np.abs(found.gradient * units(scene, targets)))
    slopes = dict(zip(targets, found.gradient, strict=True))
    # Newton's method leaves 1e-12 of 1 m: over h = 2e-3, and the error of the difference,
    # (2e-3)^4 over the next derivatives.
    for points, h in ((True, 2e-4), (False, 2e-3)):
        chosen = [target for target in targets if ("point" in target) == points]
        # Declared and displaced: two directions of each make four.
        for seed in range(2):
            along = weights(scene, chosen, seed + 2 * displaced)
            slope = np.array([slopes[target] for target in chosen]) @ along
            expected = slope_of_the_call(scene, chosen, along, h)
            assert abs(slope - expected) <= 1e-7 * size, wrong_targets(scene, slopes, chosen, h)


def wrong_targets(scene, slopes, targets, h):
    """Each target by itself, where all of them are wrong: differences and derivatives."""
    sizes = zip(targets, units(scene, targets), strict=True)
    return {
        target: (slope_of_the_call(scene, [target], np.array([size]), h), slopes[target] * size)
        for target, size in sizes
    }


@pytest.mark.parametrize("name", SCENES)
def test_adjoint_and_complex_step_agree(name):
    scene, targets, found = gradients(name, True)
    sizes = units(scene, targets)
    call = Terminal(tip(scene)), END, HHT(STEP)
    scaled = found.gradient * sizes
    adjoint = gradient(scene, *call, design=targets, method=Adjoint()).gradient * sizes
    np.testing.assert_allclose(adjoint, scaled, rtol=0, atol=1e-9 * np.max(np.abs(scaled)))
    for seed in range(2):  # As above, all targets at once.
        along = weights(scene, targets, seed)
        every = DesignVariable("every", dict(zip(targets, along, strict=True)))
        steps = gradient(scene, *call, design=[every], method=ComplexStep()).gradient
        assert abs(steps[0] - found.gradient @ along) <= 1e-9 * np.max(np.abs(scaled))


# ---------------------------------------------------------------- identities of whole mechanisms


def moving_all(scene, name, factors):
    """A variable that moves targets by factors; those that do not move are left out."""
    return DesignVariable(name, {target: f for target, f in factors.items() if f != 0})


def motion_and_slope(scene, variable):
    """Positions, multipliers and their derivatives in one variable."""
    run = differentiate(scene, END, HHT(STEP), design=[variable])
    d, naming = scene.dimension, assemble(scene).naming
    vectors = np.concatenate([body.positions for body in naming.layout.bodies])
    rows = run.q.reshape(len(run.t), -1, d)[:, vectors]
    slopes = run.sensitivities.q_b[..., 0].reshape(len(run.t), -1, d)[:, vectors]
    return rows, slopes, run.lam, run.sensitivities.lam_b[..., 0]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mechanism_is_carried_along_by_its_ground(axis):
    scene = slider_crank()
    own = "xy"[axis]
    variable = moving_all(
        scene, "carry", {f"bearing.ground_{own}": 1.0, f"slot.through_{own}": 1.0}
    )
    _, slopes, lam, lam_b = motion_and_slope(scene, variable)
    expected = np.zeros_like(slopes)
    expected[..., axis] = 1.0
    # Round-off of Newton's method over the size of the mechanism.
    np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-10)
    assert np.max(np.abs(lam_b)) <= 1e-10 * np.max(np.abs(lam)) / 1e-2


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_spatial_arm_is_carried_along_unturned(axis):
    scene, own = arm(), "xyz"[axis]
    factors = {f"shoulder.ground_{own}": 1.0, f"lower.about_{own}": 1.0}
    _, slopes, _, _ = motion_and_slope(scene, moving_all(scene, "carry", factors))
    expected = np.zeros_like(slopes)
    expected[..., axis] = 1.0
    np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-9)


def test_a_mechanism_turns_with_all_that_has_a_direction():
    scene = slider_crank()
    numbers = {owner: scene.numbers(owner) for owner in ("bearing", "slot", "scene")}
    factors = {"crank.turn": 1.0, "rod.turn": 1.0}
    for owner, prefix in (
        ("bearing", "ground"),
        ("slot", "through"),
        ("slot", "direction"),
        ("scene", "gravity"),
    ):
        x, y = (numbers[owner][f"{prefix}_{axis}"] for axis in "xy")
        factors |= {f"{owner}.{prefix}_x": -y, f"{owner}.{prefix}_y": x}
    places, slopes, _, _ = motion_and_slope(scene, moving_all(scene, "turn", factors))
    expected = np.stack([-places[..., 1], places[..., 0]], axis=-1)
    np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-9)


def test_a_mechanism_scales_with_its_lengths():
    # x to s x, g to s g, E to s^2 E at the same density: the same motion, s times as large.
    scene = slider_crank()
    factors = {}
    for beam in ("crank", "rod"):
        own = scene.beam(beam)
        lengths = {"length": own.length, "height": own.section.height, "width": own.section.width}
        factors |= {f"{beam}.{name}": x for name, x in lengths.items()}
        factors |= {f"{beam}.youngs_modulus": 2 * own.material.youngs_modulus}
        factors |= {f"{beam}.start_{axis}": x for axis, x in zip("xy", own.start, strict=True)}
    for owner, name in (
        ("bearing", "ground"),
        ("slot", "through"),
        ("scene", "gravity"),
        ("elbow", "point"),
        ("motor", "point"),
    ):
        numbers = scene.numbers(owner)
        factors |= {
            f"{owner}.{name}_{axis}": numbers[f"{name}_{axis}"]
            for axis in "xy"
            if f"{name}_{axis}" in numbers
        }
    places, slopes, _, _ = motion_and_slope(scene, moving_all(scene, "size", factors))
    np.testing.assert_allclose(slopes, places, rtol=0, atol=1e-8 * np.max(np.abs(places)))


# ---------------------------------------------------------------- who leads, and what is refused


def rebuilt(length):
    """A slider-crank put together by hand: the crank keeps its angle of 0.7 rad."""
    end = np.array([np.cos(0.7), np.sin(0.7)]) * length
    crank = Beam("crank", (0.0, 0.0), tuple(end), 2, STRIP, SOFT)
    slider = (end[0] + np.sqrt(1.0 - end[1] ** 2), 0.0)
    rod = Beam("rod", tuple(end), slider, 2, STRIP, SOFT)
    joints = [
        Pin(crank.at_start, ground=(0.0, 0.0), name="bearing"),
        Pin(crank.at_end, rod.at_start, name="elbow"),
        PointOnLine(rod.at_end, (1.0, 0.0), (0.0, 0.0), name="slot"),
    ]
    return Scene([crank, rod], joints, (0.0, -9.81), lead=["crank"])


def test_the_body_that_leads_keeps_its_angle():
    scene = rebuilt(0.4)
    found = gradient(scene, Terminal(tip(scene)), END, HHT(STEP), design=["crank.length"])
    expected = central(lambda length: objective(rebuilt(length)), 0.4, 1e-3)
    assert found.gradient[0] == pytest.approx(expected, rel=1e-8)
    # Without a leader both turn: another derivative, of another mechanism.
    free = gradient(
        replace(scene, lead=()), Terminal(tip(scene)), END, HHT(STEP), design=["crank.length"]
    )
    assert abs(free.gradient[0] - expected) > 1e-2


def test_a_moved_base_is_the_pendulum_moved():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 3, STRIP, SOFT)
    scene = Scene([rod], [Pin(rod.at_start, ground=(0.0, 0.0), name="base")], (0.0, -9.81))
    found = gradient(
        scene,
        Terminal(position(rod.at_end, 0)),
        0.25,
        HHT(2.0**-7),
        design=["base.ground_x", "base.ground_y"],
    )
    np.testing.assert_allclose(found.gradient, [1.0, 0.0], rtol=0, atol=1e-12)
    shifted = simulate(scene.with_values({"base.ground_x": 0.3}), 0.25, HHT(2.0**-7))
    still = simulate(scene, 0.25, HHT(2.0**-7))
    np.testing.assert_allclose(
        shifted.position(rod.at_end) - still.position(rod.at_end),
        [[0.3, 0.0]] * len(still.t),
        atol=1e-11,
    )


def test_a_base_may_move_far():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, STRIP, SOFT)
    scene = Scene([rod], [Pin(rod.at_start, ground=(0.0, 0.0), name="base")])
    moved = assemble(scene.with_values({"base.ground_x": 100.0})).start()[0]
    # Round-off of coordinates of 100 m.
    expected = assemble(scene).start()[0] + [100.0, 0, 0, 0, 0, 0] * 3
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-12)


def test_at_the_declared_design_a_start_off_its_joints_is_refused():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, STRIP, SOFT)
    scene = Scene([rod], [Pin(rod.at_start, ground=(0.1, 0.0), name="base")])
    with pytest.raises(InconsistentStartError, match="joint 'base'"):
        simulate(scene, STEP, HHT(STEP))
    assembled = simulate(replace(scene, assemble=True), STEP, HHT(STEP))
    np.testing.assert_allclose(
        assembled.q[0], assemble(scene).start()[0] + [0.1, 0, 0, 0, 0, 0] * 3, atol=1e-12
    )


def test_what_does_not_close_is_refused_in_words():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, STRIP, SOFT)
    joints = [
        Pin(rod.at_start, ground=(0.0, 0.0), name="left"),
        Pin(rod.at_end, ground=(1.0, 0.0), name="right"),
    ]
    scene = Scene([rod], joints)
    with pytest.raises(
        InconsistentStartError, match="rigid motions of the bodies must close all joints"
    ):
        simulate(scene.with_values({"right.ground_x": 1.1}), STEP, HHT(STEP))
    for method in (DirectDifferentiation(), ComplexStep()):
        with pytest.raises(
            InconsistentStartError, match=r"design variable 'right.ground_x'.*joint '(left|right)'"
        ):
            differentiate(scene, STEP, HHT(STEP), design=["right.ground_x"], method=method)
    strained = replace(scene, project_start=True).with_values({"right.ground_x": 1.001})
    assert simulate(strained, STEP, HHT(STEP)).outcome.success


def test_a_search_that_does_not_converge_names_the_joint_that_is_open(monkeypatch):
    monkeypatch.setattr("ancfdae.assembly.assembly._ITERATIONS", 1)
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, STRIP, SOFT)
    far = Pin(rod.at_end, ground=(0.0, 1.5), name="far")
    scene = Scene([rod], [Pin(rod.at_start), far], project_start=True)
    with pytest.raises(InconsistentStartError, match=r"joint 'far' is open by 0\.75 of"):
        simulate(scene, STEP, HHT(STEP))


def clamped_crank(base_speed, crank_speed):
    """A turning crank, and a rocker on a moving base: rates that no rigid motion has."""
    crank = Beam("crank", (0.0, 0.0), (0.3, 0.0), 1, STRIP, SOFT, rigid=True)
    coupler = Beam("coupler", (0.3, 0.0), (1.0, 0.6), 2, STRIP, SOFT)
    rocker = Beam("rocker", (1.0, 0.6), (0.9, 0.0), 2, STRIP, SOFT)
    joints = [
        Pin(crank.at_start),
        RotationDriver(crank.at_start, ConstantAcceleration(crank_speed)),
        Pin(crank.at_end, coupler.at_start),
        Pin(coupler.at_end, rocker.at_start),
        MovingSupport(rocker.at_end, (0, 1), ConstantAcceleration(base_speed)),
    ]
    return Scene([crank, coupler, rocker], joints, project_start=True)


def shaken_strut():
    """A rod between two points of a table that moves: rates that a rigid motion has."""
    table = RigidBody("table", (0.0, 0.0), mass=3.0, inertia=1.0)
    rod = Beam("rod", (-0.5, 0.1), (0.5, 0.3), 2, STRIP, SOFT)
    joints = [
        MovingSupport(table.at(0.0, 0.0), (0, 1), ConstantAcceleration(0.2)),
        Pin(rod.at_start, table.at(-0.5, 0.1)),
        Pin(rod.at_end, table.at(0.5, 0.3)),
    ]
    return Scene([rod], joints, bodies=[table], project_start=True)


@pytest.mark.parametrize(
    ("scene", "design"),
    [
        (clamped_crank(0.3, 0.0), ["crank.length", "coupler.length"]),
        (clamped_crank(0.0, 2.0), ["crank.length", "coupler.length"]),
        (shaken_strut(), ["rod.length", "rod.turn"]),
    ],
    ids=["base", "crank", "strut"],
)
def test_a_start_that_strains_at_neighbouring_designs_is_continuous_and_differentiable(
    scene, design
):
    system = assemble(scene, design)
    start, start_b = system.start(), system.start_b()
    step = 1e-6
    for i, along in enumerate(np.eye(len(design))):
        ahead, behind = (system.with_values(system.b + x * along).start() for x in (step, -step))
        complex_step = system.with_values(system.b + 1e-40j * along).start()
        for k in (0, 1):
            # Slopes of starts are below 2, curvatures below 100, round-off of 1e-15/step.
            assert np.max(np.abs(ahead[k] - start[k])) < 2 * step
            slope = (ahead[k] - behind[k]) / (2 * step)
            np.testing.assert_allclose(slope, start_b[k][:, i], rtol=0, atol=1e-8)
            np.testing.assert_allclose(complex_step[k].imag / 1e-40, start_b[k][:, i], atol=1e-13)


def test_a_mechanism_at_a_point_where_it_branches_is_refused():
    # Both cranks and the coupler on one line: the loop can fold either way.
    cranks = [
        Beam(n, (x, 0.0), (x, 1.0), 1, STRIP, SOFT, turn=-0.5 * np.pi)
        for n, x in (("a", 0.0), ("b", 3.0))
    ]
    coupler = Beam("c", (1.0, 0.0), (4.0, 0.0), 1, STRIP, SOFT)
    joints = [
        Pin(cranks[0].at_start, ground=(0.0, 0.0), name="left"),
        Pin(cranks[1].at_start, ground=(3.0, 0.0), name="right"),
        Pin(cranks[0].at_end, coupler.at_start, name="one"),
        Pin(cranks[1].at_end, coupler.at_end, name="two"),
    ]
    scene = Scene([*cranks, coupler], joints)
    with pytest.raises(
        InvalidInputError, match=r"rigid motions of the bodies must follow it|branches|redundant"
    ):
        differentiate(scene, STEP, HHT(STEP), design=["right.ground_x"])


def test_targets_that_cannot_move_both_ways_are_refused():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, STRIP, SOFT)
    scene = Scene([rod], [Pin(rod.at_end, name="end"), Clamp(rod.at(0.5), name="middle")])
    for target, words in (
        ("end.point_fraction", "inside an element"),
        ("middle.point_fraction", "kink at a node"),
        ("end.point_z", "points of 'rod' move along y only"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            assemble(scene, [target])


def test_beams_may_not_start_at_one_another():
    a = Beam("a", MaterialPoint("b", 1.0), (1.0, 0.0), 1, STRIP, SOFT)
    b = Beam("b", a.at_end, (1.0, 0.0), 1, STRIP, SOFT)
    with pytest.raises(InvalidInputError, match="may not start at one another"):
        Scene([a, b])


def test_a_variable_moves_targets_by_its_factors():
    scene = slider_crank()
    variable = DesignVariable("L", {"rod.length": 2.0, "slot.through_y": -0.5})
    half = scene.value(variable)
    assert half == pytest.approx(scene.beam("rod").length / 2)
    moved = scene.with_values({variable: half + 0.1})
    assert moved.beam("rod").length == pytest.approx(scene.beam("rod").length + 0.2)
    assert moved.numbers("slot")["through_y"] == pytest.approx(-0.25)
    assert moved.value(variable) == pytest.approx(half + 0.1)
    parts = gradient(scene, Terminal(tip(scene)), END, HHT(STEP), design=list(variable.targets))
    whole = gradient(scene, Terminal(tip(scene)), END, HHT(STEP), design=[variable])
    assert whole.gradient[0] == pytest.approx(parts.gradient @ [2.0, -0.5], rel=1e-12)
    with pytest.raises(InvalidInputError, match="factor must not be zero"):
        DesignVariable("L", {"rod.length": 0.0})


def test_scenes_that_do_not_use_geometry_start_as_declared_to_the_last_digit():
    rod = Beam("rod", (0.2, 0.1), (1.1, 0.4), 2, STRIP, SOFT)
    system = assemble(Scene([rod], [Pin(rod.at_start)]), ["rod.height"])
    assert np.array_equal(system.start()[0], system._reference.q)
    assert not system._start.along


def test_a_variable_that_strains_the_bodies_has_the_derivative_of_the_call():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, STRIP, SOFT)
    joints = [
        Pin(rod.at_start, ground=(0.0, 0.0), name="left"),
        Pin(rod.at_end, ground=(1.0, 0.0), name="right"),
    ]
    scene = Scene([rod], joints, (0.0, -9.81), project_start=True)
    design = ["right.ground_x", "right.ground_y"]
    found = gradient(scene, Terminal(tip(scene)), END, HHT(STEP), design=design)
    for target, slope in zip(design, found.gradient, strict=True):
        held = scene.numbers("right")[target.removeprefix("right.")]
        expected = central(lambda x, t=target: objective(scene.with_values({t: x})), held, 1e-4)
        # The upright move closes to first order only: its neighbours are off by delta = 1e-3.
        assert slope == pytest.approx(expected, rel=2e-3), target


def test_a_body_that_leads_may_turn_by_its_drive():
    scene = rebuilt(0.4)
    crank = scene.beams[0]
    motor = RotationDriver(crank.at_start, ConstantAcceleration(20.0), name="motor")
    driven = replace(scene, joints=(*scene.joints, motor), assemble=True)
    run = simulate(driven, END, HHT(STEP))
    assert run.velocity(crank.at_end)[0] @ run.velocity(crank.at_end)[0] == pytest.approx(64.0)


def chain(count, turned=False, attached=True):
    """Beams of length one, each steeper by 0.02 rad than the one before, joined by pins."""
    beams, place = list[Beam](), np.zeros(2)
    for k in range(count):
        angle = 0.02 * k
        span = np.array([np.cos(angle), np.sin(angle)])
        start = beams[-1].at_end if attached and beams else tuple(place)
        end = span if attached and beams else place + span
        beams.append(Beam(f"b{k}", start, tuple(end), 1, STRIP, SOFT))
        place = place + span
    joints = [Pin(b.at_start, a.at_end) for a, b in pairwise(beams)]
    return Scene(beams[::-1] if turned else beams, [Pin(beams[0].at_start), *joints])


@pytest.mark.parametrize("turned", [False, True], ids=["in order", "declared from the end"])
def test_a_long_chain_of_attached_bodies_stands_where_numbers_place_it(turned):
    # More than Python's recursion limit; the sums of 1,200 places of size 60 at most (the chain is
    # a circle of radius 50) err by 1,200 eps each.
    far = 1_200
    q, expected = (assemble(chain(far, turned, attached)).start()[0] for attached in (True, False))
    assert np.max(np.abs(q - expected)) <= far * 60 * np.finfo(float).eps


def test_every_body_is_placed_once(monkeypatch):
    placed, unturned = [], Reference._unturned

    def counted(self, body):
        placed.append(body.name)
        return unturned(self, body)

    monkeypatch.setattr(Reference, "_unturned", counted)
    system = assemble(chain(30), ["b0.start_x", "b3.turn"])
    system.start()
    system.start_b()
    # Once as declared, and once for each design variable that moves places.
    assert sorted(placed) == sorted(3 * [f"b{k}" for k in range(30)])
