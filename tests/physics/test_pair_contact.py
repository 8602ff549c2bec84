"""Contact of bodies with each other: momenta, closed forms, meshes, derivatives, neighbours."""

import warnings

import numpy as np
import pytest

from ancfdae import (
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    HHT,
    Beam,
    BeamContact,
    BeamPairContact,
    Bushing,
    Cylinder,
    InitialVelocity,
    Material,
    Pin,
    PointForce,
    PointMass,
    Radau,
    RigidBody,
    Scene,
    SphereContacts,
    Terminal,
    assemble,
    equilibrium,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError, UnlikelyValueWarning
from ancfdae.observables import (
    angular_momentum,
    kinetic_energy,
    linear_momentum,
    observe,
    position,
    strain_energy,
)
from ancfdae.sections import Circle
from tests.support.contacts import UNITS, agree

SOFT = Material(1000.0, 1e7, 0.3)
LAW = {"restitution": 0.7, "impact_speed": 1.0}
RUBS = {"friction": 0.3, "slip_speed": 0.05}


def heap(unit="m", d=3, **law):
    """Four balls: the first one flies into the row, oblique and with a spin."""
    length, mass, away = UNITS[unit]
    inertia = 0.004 * mass * length**2
    bodies = [
        RigidBody(
            f"b{k}",
            tuple(away + length * x for x in (0.25 * k, 0.01 * k**2, 0.0)[:d]),
            mass=mass,
            inertia=(inertia,) * 3 if d == 3 else inertia,
        )
        for k in range(4)
    ]
    names, radii = [x.name for x in bodies], [length * x for x in (0.1, 0.11, 0.12, 0.1)]
    speed = {x: length * y if x in ("impact_speed", "slip_speed") else y for x, y in law.items()}
    k = 1e5 * mass / length**0.5
    touch = SphereContacts(names, radii, stiffness=k, name="touch", **speed)
    spin = (1.0, 2.0, 3.0) if d == 3 else 3.0
    first = tuple(length * x for x in (2.0, 0.1, 0.2)[:d])
    start = [InitialVelocity("b0", spin, bodies[0].position, first)]
    return Scene([], [], bodies=bodies, loads=[touch], start=start), bodies


@pytest.mark.parametrize(("unit", "d"), list(zip(UNITS, (3, 2), strict=True)))
def test_balls_that_collide_keep_both_momenta(unit, d):
    length, mass, away = UNITS[unit]
    scene, bodies = heap(unit, d, **LAW, **RUBS)
    run, system = simulate(scene, 0.4, Radau(rtol=1e-8)), assemble(scene)
    assert run.outcome.success
    for axis in range(d):
        assert np.ptp(observe(linear_momentum(axis), run, system)) < 1e-9 * mass * length
    about = [angular_momentum(axis) for axis in range(3)] if d == 3 else [angular_momentum()]
    for momentum in about:
        # Of 2 kg m/s at the distance from the origin, to round-off.
        size = mass * length * (length + 1e-4 * abs(away))
        assert np.ptp(observe(momentum, run, system)) < 1e-7 * size
    energy = observe(kinetic_energy(), run, system)
    assert energy[-1] < 0.7 * energy[0]
    if unit == "m":
        return
    # The same motion in other units, far from the origin.
    here = simulate(heap("m", d, **LAW, **RUBS)[0], 0.4, Radau(rtol=1e-8))
    there = bodies[3].at(*[0.0] * d)
    ends = run.position(there)[-1] - away
    np.testing.assert_allclose(ends / length, here.position(there)[-1], rtol=1e-5, atol=1e-6)


def test_two_balls_of_different_mass_part_as_newton_says():
    first, second = (
        RigidBody(name, (x, 0.0), mass=m, inertia=0.004)
        for name, x, m in (("a", 0.0, 1.0), ("b", 0.25, 3.0))
    )
    touch = SphereContacts(["a", "b"], [0.1, 0.1], stiffness=1e5, restitution=0.6, impact_speed=2.0)
    start = [InitialVelocity("a", 0.0, (0, 0), (2.0, 0.0))]
    run = simulate(
        Scene([], [], bodies=[first, second], loads=[touch], start=start), 0.2, Radau(rtol=1e-8)
    )
    speeds = run.v.reshape(len(run.t), 2, 3, 2)[-1, :, 0, 0]
    # v_1 = (m_1 - e m_2)/(m_1 + m_2) v, v_2 = (1 + e) m_1/(m_1 + m_2) v.
    np.testing.assert_allclose(speeds, [(1 - 1.8) / 4 * 2, 1.6 / 4 * 2], rtol=1e-5)


@pytest.mark.parametrize("rubs", [{}, RUBS], ids=["smooth", "rough"])
def test_gradients_of_balls_that_collide_are_exact(rubs):
    scene, bodies = heap(**LAW, **rubs)
    design = [f"touch.{name}" for name in scene.loads[0].parameters()]
    objective = Terminal(
        position(bodies[2].at(0, 0, 0.1), 0) + position(bodies[1].at(0.1, 0, 0), 1)
    )
    agree(scene, objective, 0.2, [*design, "b1.mass", "b2.position_y"], [HHT(5e-4)], not rubs)


# ---------------------------------------------------------------- beams


def crossing(n=8, at=0.5, element=CABLE_3D, points=16, **law):
    """A beam that falls across another one, at a fraction of it."""
    x = at - 0.5
    a = Beam("a", (-0.5, x, 0.03), (0.5, x + 0.02, 0.03), n, Circle(0.01), SOFT, element=element)
    b = Beam("b", (0, -0.5, 0), (0.0, 0.5, 0.0), n, Circle(0.01), SOFT, element=element)
    touch = BeamPairContact(
        "a", "b", stiffness=1e6, radius=0.01, other_radius=0.01, points_per_element=points,
        name="touch", **law,
    )  # fmt: skip
    start = [InitialVelocity("a", (0, 0, 0), (0, 0, 0), (0.2, 0.0, -1.0))]
    return Scene([a, b], [], loads=[touch], start=start), b


@pytest.mark.parametrize("element", [CABLE_3D, BEAM_3D])
def test_beams_that_cross_keep_their_momenta(element):
    rubs = RUBS if element is BEAM_3D else {}
    scene, _ = crossing(4, element=element, points=32, **LAW, **rubs)
    run, system = simulate(scene, 0.04, Radau(rtol=1e-6)), assemble(scene)
    assert run.outcome.success
    for axis in range(3):
        assert np.ptp(observe(linear_momentum(axis), run, system)) < 1e-12
        assert np.ptp(observe(angular_momentum(axis), run, system)) < 5e-6  # of 0.03 kg m2/s
    energy = observe(kinetic_energy() + strain_energy(), run, system)
    assert 0.9 < energy[-1] / energy[0] < 0.99


def pressed(n, at, points=64):
    """The force of a beam on another one that it crosses 1 mm deep, at a fraction of it."""
    kind = Circle(0.01), SOFT
    y, z = at - 0.5, 0.019
    a = Beam("a", (-0.1, y, z), (0.1, y, z), 1, *kind, element=CABLE_3D)
    b = Beam("b", (0, -0.5, 0), (0.0, 0.5, 0.0), n, *kind, element=CABLE_3D)
    touch = BeamPairContact(
        "a", "b", stiffness=1e6, radius=0.01, other_radius=0.01, points_per_element=points
    )
    system = assemble(Scene([a, b], loads=[touch]))
    force = system.force(0.0, *system.start()).reshape(-1, 2, 3)[:, 0]
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12)
    return force[:2].sum(axis=0)


@pytest.mark.parametrize("n", [1, 4, 32])
@pytest.mark.parametrize("at", [0.5, 0.5 + 1e-9, 0.498, 0.47, 0.25])
def test_force_at_a_crossing_is_that_on_a_cylinder_wherever_nodes_are(n, at):
    line = Beam("a", (-0.1, 0, 0.019), (0.1, 0, 0.019), 1, Circle(0.01), SOFT, element=CABLE_3D)
    post = Cylinder((0, 0, 0), (0, 1, 0), 0.01)
    touch = BeamContact("a", post, stiffness=1e6, radius=0.01, points_per_element=64)
    alone = assemble(Scene([line], loads=[touch]))
    expected = alone.force(0.0, *alone.start()).reshape(-1, 2, 3)[:, 0].sum(axis=0)
    np.testing.assert_allclose(pressed(n, at), expected, rtol=1e-9, atol=1e-9 * expected[2])


def test_beams_side_by_side_press_by_their_depth():
    a, b = (
        Beam(x, (0, 0, z), (1, 0, z), n, Circle(0.01), SOFT, element=CABLE_3D)
        for x, z, n in (("a", 0.018, 3), ("b", 0.0, 7))
    )
    touch = BeamPairContact("a", "b", stiffness=1e6, radius=0.01, other_radius=0.01)
    system = assemble(Scene([a, b], loads=[touch]))
    force = system.force(0.0, *system.start()).reshape(-1, 2, 3)[:4, 0].sum(axis=0)
    np.testing.assert_allclose(force, [0, 0, 1e6 * 0.002**1.5], rtol=1e-9, atol=1e-9)


def test_gradients_of_beams_that_cross_are_exact():
    scene, b = crossing(2, at=0.52, points=32, **LAW, **RUBS)
    design = [f"touch.{name}" for name in scene.loads[0].parameters()]
    design += ["a.length", "b.length", "b.youngs_modulus"]
    agree(scene, Terminal(position(b.at(0.5), 2)), 0.03, design, [HHT(5e-4)], difference=False)


def test_neighbours_are_found_without_trying_all_pairs():
    # A row of 600 balls: 599 pairs instead of 179,700.
    count = 600
    bodies = [RigidBody(f"b{k}", (0.21 * k, 0.0), mass=1.0, inertia=0.004) for k in range(count)]
    names = [x.name for x in bodies]
    touch = SphereContacts(names, [0.1] * count, stiffness=1e5, reach=0.1, **LAW)
    scene = Scene([], [], bodies=bodies, loads=[touch])
    pairs = touch.pairs(scene.elements)
    assert len(pairs) == count - 1
    assert np.all(np.diff(pairs, axis=1) == 1)


def test_a_load_between_bodies_is_refused_in_words():
    bodies = [RigidBody(x, (y, 0.0), mass=1.0, inertia=0.1) for x, y in (("a", 0.0), ("b", 1.0))]
    for names, radii, why in (
        (["a"], [0.1], "two bodies or more"),
        (["a", "b"], [0.1], "a radius for each"),
        (["a", "a"], [0.1, 0.1], "must differ"),
    ):
        with pytest.raises(InvalidInputError, match=why):
            SphereContacts(names, radii, stiffness=1.0)
    lost = SphereContacts(["a", "c"], [0.1, 0.1], stiffness=1.0)
    with pytest.raises(UnknownNameError, match="'c'"):
        Scene([], [], bodies=bodies, loads=[lost])
    # A pair out of reach stays one, because lists of pairs are not empty.
    far = SphereContacts(["a", "b"], [0.1, 0.1], stiffness=1.0, reach=0.01)
    assert far.pairs(Scene([], [], bodies=bodies, loads=[far]).elements).tolist() == [[0, 1]]
    rope = Beam("rope", (0, 0), (1, 0), 2, Circle(0.01), SOFT, element=CABLE_2D)
    pair = BeamPairContact("rope", "line", stiffness=1.0, radius=0.1, other_radius=0.1)
    with pytest.raises(UnknownNameError, match="'line'"):
        Scene([rope], loads=[pair])


def test_an_equilibrium_on_the_other_side_of_a_body_warns_of_the_way():
    """Two ropes that cross 14 mm above each other; a load of 5 N takes the upper one below.

    Its own weight alone leaves it above the other one, and nothing is between start and end.
    """
    kind = 4, Circle(0.002), Material(1000.0, 1e6, 0.3)
    a = Beam("a", (-0.5, 0, 0), (0.5, 0, 0), *kind, element=CABLE_3D)
    b = Beam("b", (-0.02, -0.5, 0.014), (0.02, 0.5, 0.014), *kind, element=CABLE_3D)
    touch = BeamPairContact(
        "a", "b", stiffness=1e6, radius=0.002, other_radius=0.002, points_per_element=16
    )
    pins = [Pin(x) for rope in (a, b) for x in (rope.at_start, rope.at_end)]
    for mass, side in ((0.0, 1), (0.5, -1)):
        bodies = [PointMass(b.at(0.5), mass)] if mass else []
        scene = Scene([a, b], pins, (0, 0, -9.81), loads=[touch], bodies=bodies)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = equilibrium(scene)
        assert found.outcome.success
        heights = [found.solution.position(x.at(0.5))[0, 2] for x in (a, b)]
        assert np.sign(heights[1] - heights[0]) == side
        passed = [x for x in told if x.category is UnlikelyValueWarning]
        assert len(passed) == (side < 0)
        assert all("between the start and this state" in str(x.message) for x in passed)
        assert all(x.filename == __file__ for x in passed)


def row_of_balls(place, push, count):
    """Balls of 0.1 m in a row, 5 cm apart, on bushings of 100 N/m; both ends are pushed inward."""
    balls = [
        RigidBody(f"ball {k}", (place + 0.25 * k, 0.0), mass=1.0, inertia=0.01)
        for k in range(count)
    ]
    points = [ball.at(0.0, 0.0) for ball in balls]
    loads = [Bushing(x, (100.0, 100.0), None, 10.0, name=f"hold {k}") for k, x in enumerate(points)]
    names = [ball.name for ball in balls]
    loads.append(SphereContacts(names, [0.1] * count, stiffness=1e5, name="touch"))
    loads += [PointForce(points[0], (push, 0.0)), PointForce(points[-1], (-push, 0.0))]
    return Scene([], [], bodies=balls, loads=loads), points


@pytest.mark.parametrize("place", [0.0, 1.0, 7.3, 1e3])
@pytest.mark.parametrize("count", [3, 5])
def test_a_ball_between_two_others_that_balance_is_not_passed_through(count, place):
    """The contact forces on the middle ball add up to zero or to round-off, by symmetry."""
    for push in (6.0, 10.0, 20.0):
        scene, points = row_of_balls(place, push, count)
        with warnings.catch_warnings():
            warnings.simplefilter("error", UnlikelyValueWarning)
            found = equilibrium(scene)
        x = [found.solution.position(point)[0, 0] for point in points]
        assert np.all(np.diff(x) > 0.1)
        assert np.min(np.diff(x)) < 0.2


def test_balls_that_end_on_the_other_side_of_each_other_warn():
    scene, points = row_of_balls(0.0, 80.0, 3)
    with pytest.warns(UnlikelyValueWarning, match="between the start and this state"):
        found = equilibrium(scene)
    x = [found.solution.position(point)[0, 0] for point in points]
    assert np.all(np.diff(x) < 0)
