"""Energy of springs, and the potential energy of a scene."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    Adjoint,
    Beam,
    Bushing,
    ComplexStep,
    DirectDifferentiation,
    InitialVelocity,
    Integral,
    Material,
    Pin,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    Terminal,
    TorsionalSpringDamper,
    assemble,
    gradient,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.laws import SmoothStep
from ancfdae.observables import (
    kinetic_energy,
    load_power,
    observe,
    potential_energy,
    rotation_angle,
    spring_energy,
    strain_energy,
)
from ancfdae.sections import Rectangle

SOFT = Material(1000, 1e6, 0.3)


def space():
    """A body on a bushing, a spring to a beam that swings, and a torsional spring between them."""
    box = RigidBody("box", (0.5, 0, 0), mass=1.0, inertia=(0.02, 0.02, 0.03, 0, 0, 0))
    rod = Beam("rod", (0, 0, 0), (0.4, 0.1, 0), 2, Rectangle(0.02, 0.03), SOFT, rigid=True)
    loads = [
        Bushing(box.origin, (300, 200, 100), None, (3, 2, 1), name="bearing"),
        SpringDamper(rod.at_end, 50.0, 0.0, 0.2, box.at(0.1, 0, 0), name="rope"),
        TorsionalSpringDamper(
            rod.at_start, 0.5, free_angle=0.3, axis=(0, 0, 1), other=box.origin, name="hinge"
        ),
    ]
    start = [InitialVelocity("box", (1.0, -2.0, 0.5), (0.2, 0, 0))]
    return Scene([rod], [Pin(rod.at_start)], (0, -9.81, 1), start, loads=loads, bodies=[box])


def test_energy_is_kept_in_space_by_all_kinds_of_springs_together():
    scene = space()
    run, system = simulate(scene, 0.3, DOP853(1e-9)), assemble(scene)
    kinetic, potential = (observe(x, run, system) for x in (kinetic_energy(), potential_energy()))
    total = kinetic + potential
    assert np.ptp(potential) > 0.1
    np.testing.assert_allclose(total, total[0], atol=1e-6 * np.ptp(kinetic))


def test_the_power_of_each_spring_is_minus_the_rate_of_its_energy():
    scene = space()
    run, system = simulate(scene, 0.1, DOP853(1e-9)), assemble(scene)
    for name in ("bearing", "rope", "hinge"):
        energy = observe(spring_energy(name), run, system)
        power = observe(load_power(name), run, system)
        assert np.ptp(energy) > 1e-4
        work = np.trapezoid(power, run.t)
        assert energy[-1] - energy[0] == pytest.approx(-work, abs=1e-3 * np.ptp(energy))


def test_closed_forms():
    """k (l - l_0)^2/2 and k (theta - theta_0)^2/2, and nothing without a spring."""
    rod = Beam("rod", (0, 0), (1, 0), 1, Rectangle(0.02, 0.02), SOFT, rigid=True)
    loads = [
        SpringDamper(rod.at_end, 80.0, 0.3, 0.5, ground=(1, 2), name="spring"),
        TorsionalSpringDamper(rod.at_start, 5.0, 0.1, free_angle=0.2, name="spiral"),
    ]
    scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81), loads=loads)
    run, system = simulate(scene, 0.5, HHT(1 / 128)), assemble(scene)
    length = np.linalg.norm(run.position(rod.at_end) - [1, 2], axis=1)
    angle = observe(rotation_angle(rod.at_start), run, system)
    found = [observe(spring_energy(x), run, system) for x in ("spring", "spiral", None)]
    np.testing.assert_allclose(found[0], 40 * (length - 0.5) ** 2, rtol=1e-12)
    np.testing.assert_allclose(found[1], 2.5 * (angle - 0.2) ** 2, rtol=1e-9)
    np.testing.assert_allclose(found[2], found[0] + found[1], rtol=1e-14)
    bare = Scene([rod], [Pin(rod.at_start)])
    still = simulate(bare, 0.1, HHT(1 / 64))
    assert not np.any(observe(potential_energy() - strain_energy(), still, assemble(bare)))


def test_a_law_is_a_factor_of_the_energy():
    ball = RigidBody("ball", (0, 1), mass=1.0, inertia=1.0)
    law = SmoothStep(1.0, 2.0, duration=0.5)
    spring = SpringDamper(ball.origin, 10.0, ground=(0, 0), free_length=0.5, law=law, name="s")
    scene = Scene([], loads=[spring], bodies=[ball])
    run = simulate(scene, 0.5, HHT(1 / 64))
    energy = observe(spring_energy("s"), run, assemble(scene))
    lengths = run.position(ball.origin)[[0, -1], 1]
    np.testing.assert_allclose(energy[[0, -1]], [5, 10] * (lengths - 0.5) ** 2, rtol=1e-12)


def test_gradients_in_stiffness_and_places():
    scene, objective = space(), Integral(potential_energy()) + Terminal(spring_energy("bearing"))
    springs = ["bearing.stiffness_y", "rope.free_length", "hinge.stiffness"]
    design = [*springs, "rod.height", "box.mass"]
    system = assemble(scene, design)
    direct, adjoint, step = (
        gradient(system, objective, 0.1, HHT(1 / 256), method=m).gradient
        for m in (DirectDifferentiation(), Adjoint(), ComplexStep())
    )
    size = np.abs(direct) + 1e-12
    np.testing.assert_allclose(adjoint / size, direct / size, atol=1e-8)
    np.testing.assert_allclose(step / size, direct / size, atol=1e-7)


def test_a_load_that_stores_no_energy_is_told_by_name():
    rod = Beam("rod", (0, 0), (1, 0), 1, Rectangle(0.02, 0.02), SOFT)
    push = PointForce(rod.at_end, (1, 0), name="push")
    system = assemble(Scene([rod], [Pin(rod.at_start)], loads=[push]))
    with pytest.raises(InvalidInputError, match="must be a spring"):
        spring_energy("push").check(system)
    with pytest.raises(UnknownNameError, match="rope"):
        spring_energy("rope").check(system)
