"""Geometry as design: every target is the limit of differences of the very call that a user makes.

Bodies follow the design by rigid motions (docs/theory.md, section 4).
"""

import functools

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    ComplexStep,
    CurvedBeam,
    DesignVariable,
    Direct,
    Distance,
    DistributedForce,
    Drive,
    FollowerForce,
    Harmonic,
    InvalidInput,
    Material,
    Pin,
    PointForce,
    PointOnLine,
    Rectangle,
    Revolute,
    RigidMotion,
    Scene,
    SpringDamper,
    Terminal,
    Uniform,
    UnknownName,
    gradient,
    position,
    simulate,
)

STRIP = Rectangle(0.04, 0.03)
SOFT = Material(2000.0, 1e8, 0.3, damping_time=1e-2)
STEP, END = 2.0**-9, 2.0**-6


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
    spin = RigidMotion("rod", 0.7, (0.2, 0.1), velocity=(0.1, -0.2))
    return Scene([rod], [base], (0.3, -9.81), [spin], loads, assemble=True)


def slider_crank():
    """A closed loop in the plane, driven."""
    crank = Beam("crank", (0.0, 0.0), (0.3, 0.4), 1, STRIP, SOFT)
    rod = Beam("rod", (0.3, 0.4), (1.4, -0.1), 2, STRIP, SOFT)
    joints = [
        Pin(crank.at_start, ground=(0.0, 0.0), name="bearing"),
        Drive(crank.at(0.4), Harmonic(0.2, 3.0, 0.1, -0.02), name="motor"),
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
        Drive(upper.at(0.3), Uniform(0.5, 0.1), axis=(0.1, 0.3, 1.0), name="motor"),
        Revolute(upper.at_end, (0.2, -0.1, 1.0), lower.at_start, name="elbow"),
    ]
    loads = [PointForce(lower.at(0.7, y=0.01, z=0.005), (3.0, 2.0, 1.0), name="push")]
    start = [RigidMotion("lower", (0.3, 0.2, 0.5), (0.1, 0.0, 0.0), (0.2, 0.1, -0.1))]
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


SCENES = {f.__name__: f for f in (pendulum, slider_crank, four_bar, arm, tripod)}


def all_targets(scene):
    """Every target of whole beams, joints, loads, starts and the scene that is not refused."""
    names = [f"{beam.name}.{name}" for beam in scene.beams for name in beam.parameter_names()]
    names += [f"{owner}.{name}" for owner in scene.owners() for name in scene.numbers(owner)]
    found = []
    for name in names:
        try:
            scene.resolve(name)
        except (InvalidInput, UnknownName):
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
    found = gradient(scene, Terminal(tip(scene)), END, HHT(STEP), design=targets, method=Direct())
    return scene, targets, found


def objective(scene):
    return observed(simulate(scene, END, HHT(STEP)), scene)


def observed(solution, scene):
    place = solution.position(scene.beams[-1].at(0.95))[-1]
    return place[0] + sum((k + 2) * x for k, x in enumerate(place[1:]))


def central(f, x, h):
    """Central difference of fourth order."""
    return (8 * (f(x + h) - f(x - h)) - (f(x + 2 * h) - f(x - 2 * h))) / (12 * h)


@pytest.mark.parametrize("displaced", [False, True], ids=["declared", "displaced"])
@pytest.mark.parametrize("name", SCENES)
def test_every_target_is_the_limit_of_differences_of_the_call(name, displaced):
    scene, targets, found = gradients(name, displaced)
    size = np.max(np.abs(found.gradient * units(scene, targets)))
    for target, slope in zip(targets, found.gradient, strict=True):
        held = scene.value(DesignVariable("x", [target]))
        size_b = unit(target, held)
        # Newton's method leaves 1e-12 of 1 m: over h = 2e-3, and the error of the difference,
        # (2e-3)^4 over the next derivatives.
        h = size_b * (2e-4 if "point" in target else 2e-3)
        expected = central(lambda x, t=target: objective(scene.with_values({t: x})), held, h)
        assert abs(slope - expected) * size_b <= 1e-7 * max(abs(slope) * size_b, size), target


@pytest.mark.parametrize("name", SCENES)
def test_adjoint_and_complex_step_agree(name):
    scene, targets, found = gradients(name, True)
    sizes = units(scene, targets)
    for method in (Adjoint(), ComplexStep()):
        other = gradient(scene, Terminal(tip(scene)), END, HHT(STEP), design=targets, method=method)
        np.testing.assert_allclose(
            other.gradient * sizes,
            found.gradient * sizes,
            rtol=0,
            atol=1e-9 * np.max(np.abs(found.gradient * sizes)),
        )
