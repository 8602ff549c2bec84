"""Contact with obstacles: closed forms of impacts, sliding and rolling, momentum, derivatives."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.special

from ancfdae import (
    BEAM_3D,
    CABLE_2D,
    CABLE_3D,
    DOP853,
    HHT,
    IDA,
    Beam,
    BeamContact,
    Contact,
    Cylinder,
    EquilibriumStart,
    InitialVelocity,
    Integral,
    Material,
    Pin,
    Plane,
    Radau,
    RigidBody,
    Scene,
    Sphere,
    Terminal,
    assemble,
    simulate,
)
from ancfdae.model.loads.contact_law import damping_of
from ancfdae.observables import (
    angular_momentum,
    kinetic_energy,
    linear_momentum,
    load_power,
    observe,
    position,
)
from ancfdae.sections import Circle
from tests.support.contacts import MASS, UNITS, G, R, agree, ball, falling, moving


@pytest.mark.parametrize("restitution", [0.05, 0.3, 0.8, 0.999])
@pytest.mark.parametrize(("unit", "exponent"), [("m", 1.0), ("m", 1.5), ("m", 2.0), ("mm", 1.5)])
def test_a_ball_leaves_at_the_restitution_of_its_impact(unit, restitution, exponent):
    scene, _ = falling(2.0, unit, restitution=restitution, impact_speed=2.0, exponent=exponent)
    run = simulate(scene, 0.06, Radau(rtol=1e-9))
    assert run.outcome.success
    # With little restitution the last part of the speed comes when 1e-4 of the force is left.
    np.testing.assert_allclose(
        run.v[-1, 2] / UNITS[unit][0], 2.0 * restitution, rtol=1e-6 if restitution > 0.1 else 1e-2
    )


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
def test_contact_lasts_and_is_as_deep_as_its_energy_says(exponent):
    v, deepest, n = 1.0, 2e-3, exponent
    scene, body = falling(v, exponent=exponent)
    run = simulate(scene, 0.02, DOP853(1e-11))
    # m v^2 / 2 = k d^(n+1) / (n+1); time 2 d/v times the integral of 1/sqrt(1 - x^(n+1)).
    beta = scipy.special.beta(1 / (n + 1), 0.5) / (n + 1)
    lasts = 2 * deepest / v * beta
    # It comes back to the height h = 0.01 R at 0.01 R/v + lasts; then it flies.
    t = 0.01 * R / v + lasts
    height = run.position(body.at(0, 0, 0))[:, 2]
    assert height[-1] == pytest.approx(R + v * (0.02 - t), abs=1e-9 * R)
    middle = run.at([0.01 * R / v + lasts / 2]).position(body.at(0, 0, 0))[0, 2]
    assert R - middle == pytest.approx(deepest, rel=1e-6)


def test_the_damping_follows_from_the_restitution():
    # The phase curve without time: dv/dx = -(k x^n)(1 + chi v)/(m v), integrated by itself.
    scene, _ = falling(1.0, restitution=0.4, impact_speed=1.0)
    load = scene.loads[0]
    chi = damping_of(0.4, 1.0)

    def rate(t, y):
        x, v = y
        return [v, -load.stiffness * max(x, 0.0) ** 1.5 * (1 + chi * v) / MASS]

    found = scipy.integrate.solve_ivp(rate, (0, 0.05), [0.0, 1.0], rtol=1e-10, atol=1e-14)
    assert found.y[1, -1] == pytest.approx(-0.4, rel=1e-4)
    slope = (damping_of(0.4 + 1e-6, 1.0) - damping_of(0.4 - 1e-6, 1.0)) / 2e-6
    assert damping_of(0.4 + 1e-30j, 1.0).imag / 1e-30 == pytest.approx(slope, rel=1e-8)
    assert damping_of(1.0, 1.0) == 0.0
    assert damping_of(1.0 + 1e-30j, 1.0).imag / 1e-30 == pytest.approx(-1.5)  # 3/2 (1 - e) near 1


# ---------------------------------------------------------------- friction


def on_floor(body, normal=(0.0, 0.0, 1.0), radius=R, **law):
    """Contact of a body whose weight its floor carries at its place in the reference."""
    return Contact(
        body.at(*[0.0] * len(body.position)),
        Plane([0.0] * len(normal), normal),
        radius=radius,
        **{"friction": 0.3, "slip_speed": 1e-3, "exponent": 1.0, "name": "floor"} | law,
    )


@pytest.mark.parametrize("integrator", [HHT(1e-3), Radau(rtol=1e-6), IDA(1e-8)])
def test_a_sliding_block_stops_by_friction(integrator):
    k = 1e5
    block = RigidBody("block", (0.0, -MASS * G / k), mass=MASS, inertia=1.0)
    floor = on_floor(block, (0.0, 1.0), radius=None, stiffness=k)
    start = [InitialVelocity("block", 0.0, (0.0, 0.0), (1.0, 0.0))]
    scene = Scene([], [], (0, -G), bodies=[block], loads=[floor], start=start)
    run = simulate(scene, 0.6, integrator)
    place = run.position(block.at(0, 0))
    # It stops at v/(mu g) = 0.34 s after v^2/(2 mu g); below w_s it creeps, for another w_s/(mu g).
    assert place[-1, 0] == pytest.approx(1 / (2 * 0.3 * G), rel=1e-5)
    at = run.at([0.2]).v[0, 0]
    assert at == pytest.approx(1 - 0.3 * G * 0.2, rel=1e-6)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("element", ["plane", "space"])
def test_a_sliding_ball_rolls_at_five_sevenths(unit, element):
    length, mass, away = UNITS[unit]
    k, mu, v = 1e5 * mass, 0.3, 1.0 * length
    down = MASS * mass * G * length / k
    if element == "plane":
        disc = MASS * mass * (R * length) ** 2 / 2
        body = RigidBody("ball", (away, away + R * length - down), mass=MASS * mass, inertia=disc)
        place, normal, share, spin = (away, away), (0.0, 1.0), 2 / 3, 0.0
    else:
        at = (away, away, away + R * length - down)
        body = ball(at, mass=MASS * mass, radius=R * length)
        place, normal, share, spin = (away,) * 3, (0.0, 0.0, 1.0), 5 / 7, (0.0, 0.0, 0.0)
    touch = Contact(
        body.at(*[0.0] * len(place)),
        Plane(place, normal),
        stiffness=k,
        radius=R * length,
        exponent=1.0,
        friction=mu,
        slip_speed=1e-4 * length,
    )
    first = (v, *[0.0] * (len(place) - 1))
    start = [InitialVelocity("ball", spin, body.position, first)]
    gravity = tuple(-G * length * x for x in normal)
    scene = Scene([], [], gravity, bodies=[body], loads=[touch], start=start)
    run = simulate(scene, 0.4, Radau(rtol=1e-7))
    assert run.outcome.success
    ends = (1 - share) * v / (mu * G * length)  # when it begins to roll
    assert run.at([ends / 2]).v[0, 0] == pytest.approx(v - mu * G * length * ends / 2, rel=1e-5)
    assert run.v[-1, 0] == pytest.approx(share * v, rel=1e-4)


def test_a_ball_rolls_down_a_slope():
    slope = 0.3
    normal = (np.sin(slope), 0.0, np.cos(slope))
    k = 1e5
    depth = MASS * G * np.cos(slope) / k
    body = ball(tuple((R - depth) * np.array(normal)))
    floor = on_floor(body, normal, stiffness=k, friction=0.5, slip_speed=1e-4)
    scene = Scene([], [], (0, 0, -G), bodies=[body], loads=[floor])
    run = simulate(scene, 0.5, Radau(rtol=1e-7))
    along = run.position(body.at(0, 0, 0))[-1] @ (np.cos(slope), 0.0, -np.sin(slope))
    # 5/7 g sin, less the creep at a fifth of the limit of friction.
    assert along == pytest.approx(5 / 14 * G * np.sin(slope) * 0.25, rel=2e-4)


# ---------------------------------------------------------------- obstacles on bodies


def struck(kind, friction):
    """Two bodies in space without gravity, of which one carries an obstacle that the other hits."""
    first = ball((0.0, 0.02, 0.25), "first", mass=1.0)
    box = RigidBody("box", (0.05, 0.0, 0.0), mass=3.0, inertia=(0.02, 0.03, 0.04))
    obstacle = {
        "plane": Plane((0.05, 0.0, 0.1), (0.1, 0.2, 1.0)),
        "sphere": Sphere((0.05, 0.0, 0.0), 0.1),
        "cylinder": Cylinder((0.05, 0.0, 0.0), (1.0, 0.3, 0.2), 0.1),
        "inside": Sphere((0.0, 0.0, 0.2), 0.2, inside=True),
    }[kind]
    law = {"friction": 0.4, "slip_speed": 0.01} if friction else {}
    touch = Contact(
        first.at(0.01, 0.0, 0.0),
        obstacle,
        stiffness=2e5,
        radius=R,
        restitution=0.7,
        impact_speed=1.0,
        other=box.at(0.0, 0.01, 0.0),
        name="touch",
        **law,
    )
    start = [moving(first, (0.1, 0.0, -1.0), (1.0, 3.0, -2.0)), moving(box, (0.0, 0.1, 0.1))]
    return Scene([], [], bodies=[first, box], loads=[touch], start=start), first, box


KINDS = ("plane", "sphere", "cylinder", "inside")


@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_contact_of_two_bodies_keeps_both_momenta(kind, friction):
    scene, _, _ = struck(kind, friction)
    run, system = simulate(scene, 0.25, Radau(rtol=1e-9)), assemble(scene)
    assert run.outcome.success
    moved = [
        observe(of(axis), run, system)
        for of in (linear_momentum, angular_momentum)
        for axis in range(3)
    ]
    for momentum in moved:
        assert np.ptp(momentum) < 1e-8
    energy = observe(kinetic_energy(), run, system)
    power = observe(load_power("touch"), run, system)
    lost = scipy.integrate.cumulative_trapezoid(power, run.t, initial=0)
    assert energy[-1] < 0.9 * energy[0]  # there was an impact
    np.testing.assert_allclose(energy - energy[0], lost, atol=3e-3 * energy[0])


# ---------------------------------------------------------------- derivatives


@pytest.mark.parametrize(
    ("kind", "friction"),
    [("plane", False), ("plane", True), ("sphere", True), ("cylinder", True), ("inside", True)],
)
def test_gradients_through_an_impact_of_two_bodies_are_exact(kind, friction):
    scene, first, _ = struck(kind, friction)
    parameters = [f"touch.{name}" for name in scene.loads[0].parameters()]
    design = [*parameters, "first.mass", "box.mass", "first.velocity_z", "box.inertia_y"]
    objective = Terminal(position(first.at(0.02, 0.0, 0.0), 0) + position(first.at(0, 0, 0.1), 2))
    whole = friction and kind == "sphere"
    agree(scene, objective, 0.12, design, [*[Radau(5e-4)] * whole, HHT(5e-4)], whole)


def rope(n=12, element=CABLE_3D, **law):
    """A rope that falls on a plane, inclined to it by a few degrees."""
    soft = Material(1000.0, 1e6, 0.3)
    line = Beam("rope", (0, 0, 0.02), (1, 0.1, 0.06), n, Circle(0.01), soft, element=element)
    touch = BeamContact("rope", Plane((0, 0, 0), (0.05, 0, 1)), radius=0.01, name="floor", **law)
    return Scene([line], [], (0, 0, -G), loads=[touch]), line


@pytest.mark.parametrize("element", [CABLE_3D, BEAM_3D])
def test_gradients_of_a_rope_that_falls_on_a_plane_are_exact(element):
    law = {"restitution": 0.5, "impact_speed": 0.5, "friction": 0.4, "slip_speed": 0.1}
    scene, line = rope(3, element, stiffness=3e5, **law)
    parameters = [f"floor.{name}" for name in scene.loads[0].parameters()]
    design = [*parameters, "rope.length", "rope.youngs_modulus", "rope.radius", "rope.density"]
    objective = Integral(position(line.at_end, 2) + position(line.at_end, 0))
    agree(scene, objective, 0.12, design, [HHT(2e-3), Radau(2e-3)], difference=False)


@pytest.mark.parametrize("n", [1, 7, 32])
def test_the_force_per_length_does_not_depend_on_the_mesh(n):
    # A straight rope that dips into the floor: k d^1.5 with d = s sin(slope) over half its length.
    soft, slope, k = Material(1000.0, 1e6, 0.3), 0.1, 3e5
    half = np.array([np.cos(slope), -np.sin(slope)])
    line = Beam("rope", -0.5 * half, 0.5 * half, n, Circle(0.01), soft, element=CABLE_2D)
    touch = BeamContact("rope", Plane((0, 0), (0, 1)), stiffness=k, points_per_element=32)
    system = assemble(Scene([line], loads=[touch]))
    q, v = system.start()
    total = system.force(0.0, q, v).reshape(-1, 2, 2)[:, 0].sum(axis=0)
    exact = k * np.sin(slope) ** 1.5 * 0.5**2.5 / 2.5
    # An element in the middle has the beginning of contact between its points.
    np.testing.assert_allclose(total, [0.0, exact], rtol=2e-4, atol=1e-9 * exact)


@pytest.mark.parametrize("unit", UNITS)
def test_a_rope_lies_as_deep_as_its_weight_presses(unit):
    length, mass, away = UNITS[unit]
    material = Material(1000.0 * mass / length**3, 1e6 * mass / length, 0.3)
    line = Beam(
        "rope", (away, away), (away + length, away), 4, Circle(0.01 * length), material,
        element=CABLE_2D,
    )  # fmt: skip
    weight, k = 1000 * np.pi * 0.01**2 * G * mass, 3e5 * mass / length**1.5
    floor = Plane((away, away - 0.01 * length), (0, 1))
    touch = BeamContact("rope", floor, stiffness=k, radius=0.01 * length)
    held = Scene([line], [], (0, -G * length), [EquilibriumStart()], loads=[touch, *[]])
    held = replace(held, joints=[Pin(line.at_start, ground=(away, away - (weight / k) ** (2 / 3)))])
    run = simulate(held, 0.01, HHT(1e-3))
    depth = away - run.position(line.at_end)[0, 1]
    assert depth == pytest.approx((weight / k) ** (2 / 3), rel=1e-6)
