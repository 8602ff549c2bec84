"""Ropes over pulleys: closed forms, balances, winches, friction, derivatives and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    FiniteDifference,
    InitialVelocity,
    Integral,
    Pin,
    PointForce,
    PointOnLine,
    Pulley,
    Radau,
    Revolute,
    RigidBody,
    Rope,
    Scene,
    Terminal,
    TorsionalSpringDamper,
    TranslationDriver,
    assemble,
    check_system,
    equilibrium,
    gradient,
    simulate,
)
from ancfdae.equations import StateDirection
from ancfdae.errors import InvalidInputError
from ancfdae.laws import BSpline, ConstantAcceleration
from ancfdae.observables import (
    angular_momentum,
    driver_force,
    gravitational_energy,
    kinetic_energy,
    linear_momentum,
    observe,
    position,
    rope_tension,
    velocity,
)
from ancfdae.results import Verdict

G = 9.81


def body(name, place, mass, inertia=0.01):
    d = len(place)
    return RigidBody(name, place, mass=mass, inertia=inertia if d == 2 else (inertia,) * 3)


def tensions(run, scene, count, rope="rope"):
    system = assemble(scene)
    return np.array([observe(rope_tension(rope, k), run, system) for k in range(count)])


# -- closed forms ------------------------------------------------------------------------------


def atwood(d=2, friction=0.5, inertia=0.02, where=(0.0, 0.0, 0.0), unit=1.0):
    """Masses of 3 and 2 kg over a wheel of 0.2 m; lengths in `unit` per metre."""
    at = lambda x, y: tuple(unit * (np.array(where) + np.array([x, y, 0.0]))[:d])  # noqa: E731
    wheel = body("wheel", at(0, 0), 1.0, inertia * unit**2)
    a, b = (
        body(x, at(side, -1), m, 0.01 * unit**2)
        for x, side, m in (("a", -0.2, 3.0), ("b", 0.2, 2.0))
    )
    up, axis = (0, 1, 0)[:d], None if d == 2 else (0, 0, 1)
    pulley = Pulley(wheel.origin, 0.2 * unit, clockwise=True, axis=axis, friction=friction)
    rope = Rope(
        a.origin,
        b.origin,
        [pulley],
        stiffness=1e5 * unit,
        damping=200.0 * unit,
        slip_speed=None if friction is None else 1e-3 * unit,
        name="rope",
    )
    bearing = Pin(wheel.origin) if d == 2 else Revolute(wheel.origin, axis)
    rails = [PointOnLine(x.origin, up) for x in (a, b)]
    gravity = tuple(-G * unit * x for x in up)
    return Scene([], [bearing, *rails], gravity, loads=[rope], bodies=[wheel, a, b])


@pytest.mark.parametrize(
    ("d", "integrator"),
    [
        (2, HHT(2.0**-9)),
        (3, HHT(2.0**-9)),
        (3, Radau(rtol=1e-7)),
        (2, IDA(1e-8)),
        (2, DOP853(1e-8)),
    ],
    ids=repr,
)
def test_masses_over_a_wheel_with_inertia_accelerate_as_in_the_closed_form(d, integrator):
    scene = atwood(d)
    run = simulate(scene, 0.5, integrator)
    a = G / (5 + 0.02 / 0.2**2)
    # The rope stretches by 24 N / 1e5 N of 2.6 m in the first hundredth of a second.
    assert run.velocity(scene.bodies[1].origin)[-1, 1] == pytest.approx(-0.5 * a, rel=2e-5)
    assert tensions(run, scene, 2)[:, -1] == pytest.approx([3 * (G - a), 2 * (G + a)], rel=3e-5)


def test_the_acceleration_has_the_derivative_of_its_closed_form():
    scene = atwood()
    speed = Terminal(velocity(scene.bodies[1].origin, 1))
    found = gradient(scene, speed, 0.5, HHT(2.0**-9), design=["wheel.inertia", "a.mass"])
    whole = 5 + 0.02 / 0.2**2
    expected = 0.5 * G / whole**2 / 0.2**2, -0.5 * G * (whole - 1) / whole**2
    assert found.gradient == pytest.approx(expected, rel=1e-4)


def test_a_wheel_without_friction_does_not_turn():
    scene = atwood(friction=None)
    run = simulate(scene, 0.5, Radau(rtol=1e-8))
    assert run.velocity(scene.bodies[1].origin)[-1, 1] == pytest.approx(-0.5 * G / 5, rel=2e-5)
    assert np.all(run.velocity(scene.bodies[0].at(0.1, 0.0)) == 0)


@pytest.mark.parametrize("d", [2, 3])
def test_digits_do_not_depend_on_place_or_units(d):
    found = [
        simulate(scene, 0.25, HHT(2.0**-7)).position(scene.bodies[1].origin)[-1, 1] / unit - y
        for y, unit, scene in (
            (0.0, 1.0, atwood(d)),
            (0.0, 1e3, atwood(d, unit=1e3)),
            (-1e3, 1.0, atwood(d, where=(2e3, -1e3, 5e2))),
        )
    ]
    # A strain of 2e-4 of a rope at 2,000 m has a round-off of 1e-9 of itself.
    assert found[1] == pytest.approx(found[0], rel=1e-12)
    assert found[2] == pytest.approx(found[0], rel=1e-8)


@pytest.mark.parametrize("d", [2, 3])
def test_a_tackle_of_three_falls_carries_a_third_of_the_load_in_each(d):
    R, z, axis = 0.2, (0.0,) * (d - 2), None if d == 2 else (0, 0, 1)
    block = body("block", (0, 0, *z), 30.0)
    pulleys = [
        Pulley(block.origin, R, axis=axis),
        Pulley((R / 2, 5, *z), R / 2, axis=axis),
    ]
    rope = Rope((-R, 5, *z), block.origin, pulleys, stiffness=1e5, name="rope")
    held = TorsionalSpringDamper(block.origin, 10.0)
    joints = (
        [PointOnLine(block.origin, (0, 1, *z))]
        if d == 2
        else [
            TranslationDriver(block.origin, x, ConstantAcceleration(0.0), name=n)
            for n, x in (("x", (1, 0, 0)), ("z", (0, 0, 1)))
        ]
    )
    turning = (
        [held]
        if d == 2
        else [
            TorsionalSpringDamper(block.origin, 10.0, axis=x, name=n)
            for n, x in (("tx", (1, 0, 0)), ("ty", (0, 1, 0)), ("tz", (0, 0, 1)))
        ]
    )
    scene = Scene([], joints, (0, -G, *z), loads=[rope, *turning], bodies=[block])
    found = equilibrium(scene)
    assert tensions(found.solution, scene, 3)[:, -1] == pytest.approx(np.full(3, 10 * G), rel=1e-9)
    # Three falls share the stretch of the rope.
    length = 15 + np.pi * R + np.pi * R / 2
    sunk = 10 * G / 1e5 * length / 3
    assert found.solution.position(block.origin)[-1, 1] == pytest.approx(-sunk, rel=1e-9)


def capstan(mu, turns, d=2):
    """A mass of 5 kg on a rope that is hauled over a drum at 0.3 m/s."""
    R, z, axis = 0.1, (0.0,) * (d - 2), None if d == 2 else (0, 0, 1)
    load, hand = body("load", (-R, -1, *z), 5.0), body("hand", (R, -1, *z), 1.0)
    pull = TranslationDriver(hand.origin, (0, -1, *z), ConstantAcceleration(0.3), name="pull")
    drum = Pulley((0, 0, *z), R, clockwise=True, axis=axis, friction=mu, turns=turns)
    rope = Rope(
        load.origin, hand.origin, [drum], stiffness=1e5, damping=2e3, slip_speed=0.01, name="rope"
    )
    rails = [PointOnLine(load.origin, (0, 1, *z)), *([PointOnLine(hand.origin, (0, 1, *z))])]
    scene = Scene([], [*rails, pull], (0, -G, *z), loads=[rope], bodies=[load, hand])
    start = [InitialVelocity(hand.name, *_still(d), velocity=(0, -0.3, *z))]
    return replace(scene, start=start)


def _still(d):
    return (0.0, (0, 0)) if d == 2 else ((0, 0, 0), (0, 0, 0))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("mu", "turns"), [(0.2, 0), (0.6, 0), (0.25, 1)])
def test_tensions_at_a_capstan_have_its_ratio_and_derivative(mu, turns, d):
    scene, phi = capstan(mu, turns, d), np.pi * (1 + 2 * turns)
    design = ["rope.friction[0]"]
    call = scene, Terminal(driver_force("pull")), 1.5, HHT(2.0**-9)
    found = gradient(*call, design=design)
    # The driver holds back the weight of the hand, and pulls the rope.
    pull = found.value + 1.0 * G
    hold = 5.0 * G
    assert pull / hold == pytest.approx(np.exp(mu * phi), rel=1e-6)
    assert found.gradient[0] == pytest.approx(phi * np.exp(mu * phi) * hold, rel=1e-5)


def hoist(law):
    load = body("load", (0.1, -3), 4.0)
    rope = Rope(
        (-0.5, 0), load.origin, [Pulley((0, 0), 0.1, clockwise=True)], stiffness=1e5, damping=3e3,
        payout=law, name="rope",
    )  # fmt: skip
    scene = Scene([], [PointOnLine(load.origin, (0, 1))], (0, -G), loads=[rope], bodies=[load])
    return scene, load


def test_a_winch_lifts_with_the_force_of_weight_and_acceleration():
    scene, load = hoist(ConstantAcceleration(0.0, acceleration=-1.5))
    design = ["rope.acceleration", "load.mass"]
    found = gradient(scene, Terminal(rope_tension("rope", 1)), 1.0, HHT(2.0**-9), design=design)
    # Damping is critical at 0.02 s: the start has died away; the rope shortens by a third.
    assert found.value == pytest.approx(4 * (G + 1.5), rel=1e-3)
    assert found.gradient == pytest.approx([-4.0, G + 1.5], rel=2e-3)
    height = gradient(scene, Terminal(position(load.origin, 1)), 1.0, HHT(2.0**-9), design=design)
    assert height.value == pytest.approx(-3 + 0.75, abs=2e-3)


def hauled(held):
    """A winch that hauls at 0.2 m/s over a bollard of 0.1 m, 1 m ahead of it and 2 m behind."""
    load = body("load", (0.1, -2), 5.0)
    bollard = Pulley((0, 0), 0.1, clockwise=True, friction=0.3)
    rope = Rope(
        (-0.1, -1), load.origin, [bollard], stiffness=1e4, damping=5e2, slip_speed=0.05,
        payout=ConstantAcceleration(-0.2), name="rope",
    )  # fmt: skip
    joint = Pin(load.origin) if held else PointOnLine(load.origin, (0, 1))
    start = [] if held else [InitialVelocity("load", *_still(2), velocity=(0, 0.2))]
    return Scene([], [joint], (0, -G), start, [rope], bodies=[load])


def test_a_winch_that_lifts_over_a_bollard_pulls_against_its_friction():
    scene = hauled(held=False)
    near, far = tensions(simulate(scene, 1.0, HHT(2.0**-9)), scene, 2)[:, -1]
    assert far == pytest.approx(5 * G, rel=1e-4)
    # All of the rope moves with the winch.
    assert near / far == pytest.approx(np.exp(0.3 * np.pi * np.tanh(0.2 / 0.05)), rel=1e-4)


def test_a_rope_that_a_winch_stretches_slips_by_the_share_of_the_length_behind():
    scene = hauled(held=True)
    near, far = tensions(simulate(scene, 0.1, HHT(2.0**-9)), scene, 2)[:, -1]
    share = (2 + 0.05 * np.pi) / (3 + 0.1 * np.pi)
    assert near / far == pytest.approx(np.exp(0.3 * np.pi * np.tanh(0.2 * share / 0.05)), rel=1e-9)


def test_lengths_are_those_of_open_and_crossed_belts():
    """Straight parts of 2 m, a tangent and arcs, by elementary geometry."""
    R, r, c = 0.3, 0.1, 1.0
    lever = body("lever", (0, 5), 1.0)
    for clockwise, rise in ((True, R - r), (False, R + r)):
        # Up at the left of the big wheel and over it, then over or under the other one.
        pulleys = [Pulley((0, 0), R, clockwise=True), Pulley((c, 0), r, clockwise=clockwise)]
        ends = lever.at(-R, -7.0), (c + r, -2.0 if clockwise else 2.0)
        rope = Rope(*ends, pulleys, stiffness=1.0, length=1.0, name="rope")
        scene = Scene([], [], loads=[rope], bodies=[lever])
        run = simulate(scene, 1e-9, HHT(1e-9))
        tilt = np.arcsin(rise / c)
        arcs = R * (np.pi / 2 + tilt) + r * (np.pi / 2 - tilt if clockwise else np.pi / 2 + tilt)
        length = 4.0 + np.sqrt(c**2 - rise**2) + arcs
        assert tensions(run, scene, 1)[0, 0] == pytest.approx(length - 1.0, rel=1e-12)


# -- balances ----------------------------------------------------------------------------------


def pendulum(d=2, out=0.0):
    """A load that swings on a rope over a wide pulley, drawn up by a weight."""
    z, axis = (0.0,) * (d - 2), None if d == 2 else (0, 0, 1)
    load, weight = (
        body("load", (1.0, -1.5, *(out for _ in z)), 2.0),
        body("weight", (-0.3, -1, *z), 3.0),
    )
    pulley = Pulley((0, 0, *z), 0.3, clockwise=True, axis=axis)
    rope = Rope(weight.origin, load.origin, [pulley], stiffness=2e4, name="rope")
    rail = PointOnLine(weight.origin, (0, 1, *z))
    return Scene([], [rail], (0, -G, *z), loads=[rope], bodies=[load, weight])


def energy_drift(scene):
    run, system = simulate(scene, 1.5, Radau(rtol=1e-9)), assemble(scene)
    moving = observe(kinetic_energy() + gravitational_energy(), run, system)
    T = tensions(run, scene, 1)[0]
    length = np.linalg.norm(np.subtract((1.0, -1.5), (0, 0)))
    # The stiffness EA/l with the length of the reference, by hand.
    tangent = np.sqrt(length**2 - 0.09)
    direction = np.arctan2(-1.5, 1.0) + np.arctan2(-0.3, tangent)
    l = 1.0 + tangent + 0.3 * (np.pi / 2 - direction)
    total = moving + T**2 * l / 4e4
    return np.max(np.abs(total - total[0])) / np.max(observe(kinetic_energy(), run, system))


@pytest.mark.parametrize("d", [2, 3])
def test_a_load_that_swings_on_a_rope_keeps_its_energy(d):
    assert energy_drift(pendulum(d)) < 2e-6


@pytest.mark.parametrize("d", [2, 3])
def test_free_bodies_keep_their_momenta_under_a_rope(d):
    """A wheel with friction and two masses that fly in space, off the plane of the wheel."""
    z = (0.0,) * (d - 2)
    wheel = body("wheel", (0, 0, *z), 1.0, 0.02)
    a, b = (
        body("a", (-0.4, -1, *(0.1 for _ in z)), 3.0),
        body("b", (0.3, -1.2, *(0.2 for _ in z)), 2.0),
    )
    axis = None if d == 2 else (0.1, 0.0, 1.0)
    pulley = Pulley(wheel.at(*(0.02,) * d), 0.2, clockwise=True, axis=axis, friction=0.4)
    rope = Rope(
        a.at(*(0.03,) * d),
        b.origin,
        [pulley],
        stiffness=500.0,
        damping=5.0,
        length=2.2,
        slip_speed=0.1,
    )
    spin = InitialVelocity("wheel", 2.0 if d == 2 else (0.3, 0.1, 2.0), (0, 0, 0)[:d])
    scene = Scene([], [], start=[spin], loads=[rope], bodies=[wheel, a, b])
    run, system = simulate(scene, 0.5, Radau(rtol=1e-9)), assemble(scene)
    parts = [linear_momentum(axis=k) for k in range(d)]
    parts += [angular_momentum(axis=k) for k in (range(3) if d == 3 else (2,))]
    assert np.max(np.abs(run.velocity(a.origin))) > 0.5
    for part in parts:
        values = observe(part, run, system)
        assert np.max(np.abs(values - values[0])) < 1e-7


def test_friction_takes_energy_and_a_slack_rope_does_not_push():
    scene = atwood()
    loose = [InitialVelocity(x, 0.0, (0, 0), velocity=(0, 1.0)) for x in ("a", "b")]
    run = simulate(replace(scene, start=loose), 0.1, HHT(2.0**-10))
    # Both masses fly up: they fall freely, and the wheel stands still.
    assert np.all(tensions(run, scene, 2) >= 0)
    assert run.position(scene.bodies[1].origin)[-1, 1] == pytest.approx(
        -1 + 0.1 - G * 5e-3, abs=1e-6
    )


# -- derivatives -------------------------------------------------------------------------------


def crane(d=2):
    """A load on a rope from a winch over a wheel with friction and a ring, in the plane or not."""
    z, axis = (0.0,) * (d - 2), None if d == 2 else (0, 0, 1)
    wheel, load = (
        body("wheel", (0.5, 2, *z), 2.0, 0.02),
        body("load", (1.9, 0.5, *(0.1 for _ in z)), 4.0),
    )
    pulleys = [
        Pulley(wheel.origin, 0.2, clockwise=True, axis=axis, friction=0.3),
        Pulley((1.5, 2.1, *z), 0.1, clockwise=True, axis=axis),
    ]
    law = BSpline(0.0, 0.25, [0.0, 0.0, -0.02, 0.02, 0.02])
    rope = Rope(
        (-0.2, 0.1, *z), load.origin, pulleys, stiffness=5e3, damping=50.0, length=5.03, payout=law,
        slip_speed=0.05, name="rope",
    )  # fmt: skip
    bearing = Pin(wheel.origin) if d == 2 else Revolute(wheel.origin, axis)
    return Scene([], [bearing], (0, -G, *z), loads=[rope], bodies=[wheel, load]), load


DESIGN = [
    *("rope.stiffness", "rope.damping", "rope.length", "rope.slip_speed", "rope.friction[0]"),
    *("rope.radius[0]", "rope.radius[1]", "rope.pulley_1_x", "rope.start_y", "rope.value[2]"),
    *("wheel.inertia_z", "load.mass"),
]


def design_of(d):
    return [x.replace("_z", "" if d == 2 and "inertia" in x else "_z") for x in DESIGN]


@pytest.mark.parametrize("d", [2, 3])
def test_every_derivative_of_the_force_is_that_of_its_values(d):
    scene, _ = crane(d)
    # Taut, and slipping at speeds at which friction is not constant yet: its derivatives are seen.
    rope = replace(scene.loads[0], length=4.5, damping=2.0, slip_speed=4.0)
    report = check_system(assemble(replace(scene, loads=[rope]), design_of(d)), samples=1)
    assert report.passed, report


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("integrator", [HHT(2.0**-7), Radau(2.0**-6)], ids=repr)
def test_gradients_are_exact(d, integrator):
    scene, load = crane(d)
    objective = Integral(position(load.origin, 0) * rope_tension("rope", 2))
    call, design = (scene, objective, 0.25, integrator), design_of(d)
    direct, adjoint, stepped = (
        gradient(*call, design=design, method=method()).gradient
        for method in (DirectDifferentiation, Adjoint, ComplexStep)
    )
    size = np.maximum(np.abs(stepped), 1e-4 * np.max(np.abs(stepped)))
    assert np.max(np.abs(direct - stepped) / size) < 1e-10
    assert np.max(np.abs(adjoint - stepped) / size) < 1e-10
    method = FiniteDifference(1e-5, central=True)
    differences = gradient(*call, design=design, method=method).gradient
    assert differences == pytest.approx(stepped, rel=1e-5, abs=1e-7 * np.max(np.abs(stepped)))


# -- ends and refusals -------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", [HHT(2.0**-7), DOP853(1e-6)], ids=repr)
def test_a_run_ends_in_words_where_the_rope_leaves_a_pulley(integrator):
    load = body("load", (1.0, -0.2), 1.0)
    rope = Rope(
        (-1, -0.2), load.origin, [Pulley((0, 0), 0.1, clockwise=True)], stiffness=1e3, name="rope"
    )
    lift = PointForce(load.origin, (0.0, 3.0))
    run = simulate(Scene([], [], loads=[rope, lift], bodies=[load]), 2.0, integrator)
    assert not run.outcome.success
    assert "leaves pulley 0 of load 'rope'" in str(run.outcome)
    assert run.position(load.origin)[-1, 1] < 0.5


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    "integrator",
    [HHT(0.01), HHT(0.4), HHT(rtol=1e-5), Radau(0.03), Radau(rtol=1e-6), IDA(1e-6), DOP853(1e-6)],
    ids=repr,
)
def test_a_run_ends_in_words_where_an_end_of_a_slack_rope_flies_into_its_pulley(integrator, d):
    """The load flies past the centre at 0.01 m, from 1 m at 1 m/s, and would enter after 0.9005 s.

    Long steps pass the pulley altogether.
    """
    load = body("load", (1.0, 0.01, 0.0)[:d], 1.0)
    axis = {} if d == 2 else {"axis": (0.0, 0.0, 1.0)}
    pulley = Pulley((0.0,) * d, 0.1, clockwise=True, **axis)
    start = (-1.0, -0.2, 0.0)[:d]
    rope = Rope(start, load.origin, [pulley], stiffness=1e3, length=5.0, name="rope")
    spin, velocity = (0.0 if d == 2 else (0.0, 0.0, 0.0)), (-1.0, 0.0, 0.0)[:d]
    flight = [InitialVelocity("load", spin, about=(0.0,) * d, velocity=velocity)]
    run = simulate(Scene([], [], loads=[rope], bodies=[load], start=flight), 2.0, integrator)
    assert run.outcome.verdict is Verdict.OFF_ROUTE
    assert "takes pulley_0 and end of load 'rope' so near to each other" in str(run.outcome)
    assert run.t[-1] < 1 - np.sqrt(0.1**2 - 0.01**2)


@pytest.mark.parametrize("integrator", [HHT(rtol=1e-3), Radau(rtol=1e-3)], ids=repr)
@pytest.mark.parametrize("speed", [1.0, 500.0])
def test_controlled_steps_are_shortened_until_an_end_of_a_rope_enters_its_pulley(integrator, speed):
    """The slack end at 1 m flies past the centre at 0.01 m: it enters the circle of 0.1 m there.

    The first step, a twentieth of the run, would pass the pulley.
    """
    load, pulley = body("load", (1.0, 0.01), 1.0), Pulley((0.0, 0.0), 0.1, clockwise=True)
    rope = Rope((-1.0, -0.2), load.origin, [pulley], stiffness=1e3, length=5.0, name="rope")
    flight = [InitialVelocity("load", 0.0, about=(0.0, 0.0), velocity=(-speed, 0.0))]
    scene = Scene([], [], loads=[rope], bodies=[load], start=flight)
    run = simulate(scene, 40.0 / speed, integrator)
    assert run.outcome.verdict is Verdict.OFF_ROUTE
    assert "takes pulley_0 and end of load 'rope' so near to each other" in str(run.outcome)
    assert run.t[-1] * speed == pytest.approx(1 - np.sqrt(0.1**2 - 0.01**2), rel=1e-6)


@pytest.mark.parametrize(("rise", "enters"), [(0.15, False), (0.25, True)])
@pytest.mark.parametrize("integrator", [HHT, Radau])
def test_a_place_that_enters_a_pulley_and_returns_within_a_step_is_seen(integrator, rise, enters):
    """A load is thrown up from 0.2 m below the pulley and is back after one step."""
    load = body("load", (0.0, -0.3), 1.0)
    pulley = Pulley((0, 0), 0.1, clockwise=True)
    rope = Rope((-1, -0.2), load.origin, [pulley], stiffness=1e3, length=5.0)
    speed = np.sqrt(2 * G * rise)
    up = [InitialVelocity("load", 0.0, about=(0.0, 0.0), velocity=(0.0, speed))]
    scene = Scene([], [], (0, -G), loads=[rope], bodies=[load], start=up)
    run = simulate(scene, 2 * speed / G, integrator(2 * speed / G))
    assert run.outcome.verdict is (Verdict.OFF_ROUTE if enters else Verdict.FINISHED)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"stiffness": 0.0}, "positive"),
        ({"damping": -1.0}, "negative"),
        ({"length": np.nan}, "finite"),
        ({"payout": 3.0}, "payout"),
        ({"slip_speed": 0.1}, "friction"),
        ({"start": (0.0,), "end": None}, "components"),
        ({"start": (0.0, 0.0), "end": (1.0, 0.0)}, "touch a body"),
        ({"law": ConstantAcceleration(1.0)}, "no factor"),
        ({"pulleys": [3]}, "Pulley"),
    ],
)
def test_a_rope_refuses_what_does_not_fit(given, words):
    good = {"start": (0.0, 0.0), "end": body("a", (1, 0), 1.0).origin, "stiffness": 1e3}
    with pytest.raises(InvalidInputError, match=words):
        Rope(**(good | given))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"radius": -0.1}, "negative"),
        ({"radius": 0.1, "friction": -0.1}, "negative"),
        ({"radius": 0.1, "turns": 0.5}, "integer"),
        ({"radius": 0.1, "clockwise": 1}, "True or False"),
        ({"radius": 0.1, "axis": (0, 0, 0)}, "not zero"),
    ],
)
def test_a_pulley_refuses_what_does_not_fit(given, words):
    with pytest.raises(InvalidInputError, match=words):
        Pulley((0.0, 0.0), **given)


def test_a_scene_refuses_pulleys_that_the_rope_does_not_touch():
    a = body("a", (1, -1), 1.0)
    good = {"stiffness": 1e3, "name": "rope"}
    with pytest.raises(InvalidInputError, match="length"):
        Scene(bodies=[a], loads=[Rope(a.origin, (1, -1), **good)])
    for pulley, words in (
        (Pulley((0, 0), 0.1), "leaves pulley 0"),
        (Pulley((0, 0), 5.0, clockwise=True), "no tangent"),
        (Pulley((0, 0, 0), 0.1, clockwise=True), "components"),
        (Pulley((0, 0), 0.1, clockwise=True, axis=(0, 0, 1)), "axis"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            Scene(bodies=[a], loads=[Rope((-1, -1), a.origin, [pulley], **good)])


def test_an_end_that_crosses_its_pulley_within_a_part_of_a_step_is_seen():
    """At 500 m/s and steps of 0.02 s it moves by 10 m, and a chord of the pulley is 0.05 to 0.2 m.

    A straight flight at the height y enters the pulley of radius 0.1 m exactly if |y| < 0.1 m.
    """
    for x in np.linspace(1.0, 1.3, 5):
        for y in (0.02, -0.09, -0.097):
            load = body("load", (x, y), 1.0)
            pulley = Pulley((0, 0), 0.1, clockwise=True)
            rope = Rope((-1, -0.2), load.origin, [pulley], stiffness=1e-3, length=1e3, name="rope")
            start = [InitialVelocity("load", 0.0, about=(0, 0), velocity=(-500.0, 0.0))]
            scene = Scene([], [], loads=[rope], bodies=[load], start=start)
            assert simulate(scene, 0.04, HHT(0.02)).outcome.verdict is Verdict.OFF_ROUTE


def test_a_rope_that_is_just_taut_is_taut_in_every_derivative():
    """Round-off of its length decided on the side of the kink, in transposes on the other one."""
    load = body("load", (0.2, -0.7), 1.3)
    pulley = Pulley((0.0, 0.0), 0.2, clockwise=True)
    rope = Rope((-2.0, -0.5), load.origin, [pulley], stiffness=1e5, damping=1.0)
    swing = [InitialVelocity("load", 0.0, about=(0.0, 0.0), velocity=(0.7, 0.0))]
    scene = Scene([], [], (0, -G), loads=[rope], bodies=[load], start=swing)
    system, rng = assemble(scene, ["load.mass"]), np.random.default_rng(0)
    q, v = system.start()
    a, mu, dq, dv = rng.normal(size=(4, system.n_q))
    states, ahead, n = (q, v, a, np.zeros(system.n_lam)), StateDirection(0.0, dq, dv), system.n_q
    on_q, on_v, _ = system.along_pull_back(0.0, states, ahead, mu)
    still = np.zeros((n, 1))
    for k in range(2):
        unit = np.eye(n)[:, k : k + 1]
        for moved, on in (((unit, still), on_q), ((still, unit), on_v)):
            along = (*moved, still, np.zeros((system.n_lam, 1)))
            total = system.along_total(0.0, states, ahead, along, (still, still))[:, 0]
            assert mu @ total == pytest.approx(on[k], rel=1e-12)
    cost, (direct, adjoint) = (
        Terminal(position(load.origin, 1)),
        (DirectDifferentiation(), Adjoint()),
    )
    found = [
        gradient(scene, cost, 0.01, HHT(0.01), design=["load.mass"], method=method).gradient
        for method in (direct, adjoint)
    ]
    assert found[1] == pytest.approx(found[0], rel=1e-10)
