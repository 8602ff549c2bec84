"""A cable that slides over a drum: Euler's ratio of tensions, and its derivatives."""

import numpy as np
import pytest
import scipy.integrate

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
    HHT,
    Beam,
    BeamContact,
    Cylinder,
    Material,
    NodalState,
    Plane,
    PointForce,
    Radau,
    Scene,
    Sphere,
    Terminal,
    TranslationDriver,
    assemble,
    gradient,
    simulate,
)
from ancfdae.laws import UserLaw
from ancfdae.observables import (
    driver_force,
    gravitational_energy,
    kinetic_energy,
    load_power,
    observe,
    strain_energy,
)
from ancfdae.sections import Circle

LENGTH, DRUM, THICK = 0.6, 0.1, 2e-4


def wrapped(n, d):
    """Places and tangents of the nodes of a cable that hangs over half the drum."""
    a = DRUM + THICK
    hang = (LENGTH - np.pi * a) / 2
    s = np.linspace(0, LENGTH, n + 1)
    turn = np.clip(s - hang, 0, np.pi * a) / a
    place = a * np.stack([-np.cos(turn), np.sin(turn)], axis=1)
    place[:, 1] -= np.clip(hang - s, 0, None) + np.clip(s - LENGTH + hang, 0, None)
    tangent = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    # In space the axis of the drum is y.
    rows = [np.column_stack([x[:, 0], *[0 * x[:, 0]] * (d - 2), x[:, 1]]) for x in (place, tangent)]
    return np.stack(rows, axis=1), hang + a


def capstan(mu, n=48, d=2):
    """A cable with a weight of 1 N at one end, pulled at 0.2 m/s at the other one."""
    coordinates, lifted = wrapped(n, d)
    down, element = [0.0] * (d - 1) + [-1.0], CABLE_2D if d == 2 else CABLE_3D
    ends = [[x, *[0.0] * (d - 2), DRUM + THICK] for x in (-LENGTH / 2, LENGTH / 2)]
    soft = Material(1000.0, 1e9, 0.3, damping_time=1e-4)
    rope = Beam("rope", *ends, n, Circle(THICK), soft, element=element)
    drum = Sphere((0, 0), DRUM) if d == 2 else Cylinder((0, 0, 0), (0, 1, 0), DRUM)
    touch = BeamContact(
        "rope", drum, stiffness=2.5e7, radius=THICK, restitution=0.3, impact_speed=0.05,
        friction=mu, slip_speed=0.01, name="drum",
    )  # fmt: skip
    soft_start = UserLaw(lambda t: lifted + 0.2 * (t - 5e-3 * (1 - np.exp(-t / 5e-3))))
    pull = TranslationDriver(rope.at_end, down, soft_start, name="pull")
    weight = PointForce(
        rope.at_start, down, name="weight", law=UserLaw(lambda t: 1 - np.exp(-200 * t))
    )
    return Scene([rope], [pull], loads=[touch, weight], start=[NodalState("rope", coordinates)])


@pytest.mark.parametrize(("mu", "d"), [(0.1, 2), (0.3, 2), (0.3, 3)])
def test_tensions_grow_by_the_exponential_of_friction_times_angle(mu, d):
    axis = "y" if d == 2 else "z"
    design = ["drum.friction", f"weight.force_{axis}"]
    call = capstan(mu, d=d), Terminal(driver_force("pull")), 0.12, HHT(5e-4)
    found = gradient(*call, design=design)
    ratio = np.exp(mu * np.pi)
    # Bending takes E I/(T R^2) = 1e-4, friction below its limit (slip/speed)^4/4 = 2e-6.
    assert found.value == pytest.approx(ratio, rel=1e-3)
    assert found.gradient[0] == pytest.approx(np.pi * ratio, rel=2e-3)
    # The force of -1 N makes the tension 1; waves that are still there are a part of 0.5 %.
    assert found.gradient[1] == pytest.approx(-ratio, rel=1e-2)


def test_ratio_of_tensions_does_not_depend_on_the_mesh():
    run = simulate(capstan(0.3, 24), 0.12, HHT(5e-4))
    force = observe(driver_force("pull"), run, assemble(capstan(0.3, 24)))
    assert force[-1] == pytest.approx(np.exp(0.3 * np.pi), rel=1e-3)


@pytest.mark.parametrize("law", [{}, {"restitution": 0.5, "impact_speed": 0.5}])
def test_energy_of_a_cable_that_falls_on_a_plane_is_balanced(law):
    soft = Material(1000.0, 1e6, 0.3)
    rope = Beam("rope", (0, 0, 0.02), (1, 0.1, 0.06), 8, Circle(0.01), soft, element=CABLE_3D)
    touch = BeamContact(
        "rope", Plane((0, 0, 0), (0.05, 0, 1)), stiffness=3e5, radius=0.01, friction=0.3,
        slip_speed=0.05, name="floor", **law,
    )  # fmt: skip
    scene = Scene([rope], [], (0, 0, -9.81), loads=[touch])
    run, system = simulate(scene, 0.2, Radau(rtol=1e-7)), assemble(scene)
    assert run.outcome.success
    energy = observe(kinetic_energy() + strain_energy() + gravitational_energy(), run, system)
    power = observe(load_power("floor"), run, system)
    work = scipy.integrate.cumulative_trapezoid(power, run.t, initial=0)
    largest = observe(kinetic_energy(), run, system).max()
    assert np.ptp(work) > 0.2 * largest
    np.testing.assert_allclose(energy - energy[0], work, atol=2e-3 * largest)
