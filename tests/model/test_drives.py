"""What drives do: torque, force and power, in balance with the energy of the scene.

Partials are compared with a complex step to round-off; energies to the error of the method.
"""

import dataclasses

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    ComplexStep,
    DirectDifferentiation,
    FollowerForce,
    Integral,
    Material,
    Pin,
    Revolute,
    RotationDriver,
    Scene,
    SpringDamper,
    Terminal,
    TranslationDriver,
    assemble,
    gradients,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.observables.mass import inertia
from ancfdae.sensitivity.observables.observable import States, observe
from ancfdae.sensitivity.observables.quantities import (
    driver_force,
    driver_torque,
    joint_power,
    kinetic_energy,
    load_power,
    strain_energy,
)

RUBBER = Material(density=1100.0, youngs_modulus=5e6, poisson_ratio=0.3)
SECTION = Rectangle(height=0.06, width=0.04)
DESIGN = ["arm.length", "arm.density", "motor.amplitude", "motor.frequency"]
EPS = 1e-40


def crank(d, law=None, gravity=9.81):
    law = Harmonic(0.5, 6.0) if law is None else law
    z = (0.0,) * (d - 2)
    arm = Beam("arm", (0.0, 0.0, *z), (0.8, 0.2, *z), 2, SECTION, RUBBER)
    holds = Pin(arm.at_start, name="pin")
    if d == 3:
        holds = Revolute(arm.at_start, axis=(0.0, 0.0, 1.0), name="pin")
    motor = RotationDriver(arm.at_start, law, name="motor")
    return Scene([arm], [holds, motor], (0.0, -gravity, *z), project_start=True)


@pytest.mark.parametrize("d", [2, 3])
def test_the_energy_grows_by_the_work_of_the_drive(d):
    errors = []
    for h in (2**-9, 2**-10):
        solution, system = simulate(crank(d), 0.5, HHT(h, hht_alpha=-0.01)), assemble(crank(d))
        energy = observe(strain_energy() + kinetic_energy(), solution, system)
        energy = energy + system.energies.gravity(solution.q)
        power = observe(joint_power("motor"), solution, system)
        work = np.concatenate([[0.0], np.cumsum(0.5 * h * (power[1:] + power[:-1]))])
        errors.append(np.max(np.abs(energy - energy[0] - work)) / np.max(np.abs(work)))
    # Second order; hht_alpha = -0.01 damps less than the tolerance of this test.
    assert errors[1] <= 3e-4
    assert errors[1] <= 0.35 * errors[0]


def test_the_energy_grows_by_the_work_of_the_loads():
    arm = crank(2).beams[0]
    spring = SpringDamper(arm.at_end, 40.0, 0.5, 0.3, ground=(0.5, 0.9), name="spring")
    push = FollowerForce(arm.at(0.6), (0.0, 3.0), law=Harmonic(1.0, 9.0), name="push")
    scene = Scene([arm], [Pin(arm.at_start)], loads=[spring, push])
    errors = []
    for h in (2**-9, 2**-10):
        solution, system = simulate(scene, 0.5, HHT(h, hht_alpha=-0.01)), assemble(scene)
        energy = observe(strain_energy() + kinetic_energy(), solution, system)
        power = observe(load_power("spring") + load_power("push"), solution, system)
        work = np.concatenate([[0.0], np.cumsum(0.5 * h * (power[1:] + power[:-1]))])
        errors.append(np.max(np.abs(energy - energy[0] - work)) / np.max(np.abs(work)))
    # Second order, as above.
    assert errors[1] <= 1e-3
    assert errors[1] <= 0.35 * errors[0]
    with pytest.raises(UnknownNameError):
        load_power("pull").check(system)


@pytest.mark.parametrize("d", [2, 3])
def test_torque_times_rate_is_the_power(d):
    scene = crank(d)
    solution, system = simulate(scene, 0.5, HHT(2**-8)), assemble(scene)
    rate = 0.5 * 6.0 * np.cos(6.0 * solution.t)
    torque = observe(driver_torque("motor"), solution, system)
    power = observe(joint_power("motor"), solution, system)
    assert np.allclose(torque * rate, power, rtol=1e-12, atol=1e-12 * np.max(np.abs(power)))


@pytest.mark.parametrize("d", [2, 3])
def test_a_stiff_arm_needs_the_torque_of_a_rigid_one(d):
    # Turned with an angular acceleration of 3 rad/s^2, without gravity: I alpha.
    stiff = dataclasses.replace(RUBBER, youngs_modulus=5e10, damping_time=1e-4)
    scene = crank(d, ConstantAcceleration(0.0, acceleration=3.0), gravity=0.0)
    arm = dataclasses.replace(scene.beams[0], material=stiff)
    scene = dataclasses.replace(scene, beams=[arm])
    solution, system = simulate(scene, 0.25, HHT(2**-8)), assemble(scene)
    torque = observe(driver_torque("motor"), solution, system)
    expected = 3.0 * observe(inertia(about=arm.at_start), solution, system)
    # The start, a jump of the acceleration, leaves a damped vibration.
    assert np.allclose(torque[-20:], expected[-20:], rtol=1e-2)
    assert np.mean(torque[-20:]) == pytest.approx(np.mean(expected[-20:]), rel=1e-3)


def test_a_guide_lifts_the_weight():
    rod = Beam("rod", (0.0, 0.0), (0.0, 1.0), 1, SECTION, RUBBER)
    lift = TranslationDriver(rod.at_start, (0.0, 2.0), ConstantAcceleration(1.5), name="lift")
    scene = Scene([rod], [lift], (0.0, -9.81), project_start=True)
    still = simulate(scene, 2**-8, HHT(2**-8))
    system = assemble(scene)
    # At the start, with the rod not yet stretched, a = 0.
    force = observe(driver_force("lift"), still, system)[0]
    power = observe(joint_power("lift"), still, system)[0]
    assert power == pytest.approx(1.5 * force, rel=1e-12)
    assert force > 0


@pytest.mark.parametrize("d", [2, 3])
def test_partials_are_those_of_the_value(d):
    system, random = assemble(crank(d), DESIGN), np.random.default_rng(3)
    q, v = system.start()
    q, v = (x + 0.1 * random.standard_normal((4, len(q))) for x in (q, v))
    t, lam = np.linspace(0.1, 0.7, 4), random.standard_normal((4, system.n_lam))
    states = States(t, q, v, lam)
    dq, dlam, db = (random.standard_normal(x.shape) for x in (q, lam, system.b))
    moved = States(t, q + 1j * EPS * dq, v, lam + 1j * EPS * dlam)
    for observable in (driver_torque("motor"), joint_power("motor")):
        observable.check(system)
        p = observable.partials(system, states)
        along = np.sum(p.q * dq, axis=1) + np.sum(p.lam * dlam, axis=1) + p.b @ db
        slope = observable.value(system.with_values(system.b + 1j * EPS * db), moved).imag / EPS
        # A dozen products.
        assert np.allclose(along, slope, rtol=1e-13, atol=1e-13 * np.max(np.abs(slope)))


def test_gradients_by_every_method_agree_with_the_complex_step():
    objectives = [Terminal(driver_torque("motor")), Integral(joint_power("motor"))]
    scene = crank(2)
    found = {
        type(method).__name__: gradients(
            scene, objectives, 0.25, HHT(2**-7), design=DESIGN, method=method
        )
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    }
    for k in range(len(objectives)):
        exact = found["ComplexStep"][k].gradient
        for name in ("DirectDifferentiation", "Adjoint"):
            assert np.allclose(found[name][k].gradient, exact, rtol=1e-9, atol=0), (name, k)


def test_only_drives_do_work():
    system = assemble(crank(2))
    for observable in (driver_torque("pin"), joint_power("pin")):
        with pytest.raises(InvalidInputError, match="must be driven"):
            observable.check(system)
    with pytest.raises(UnknownNameError):
        joint_power("engine").check(system)
