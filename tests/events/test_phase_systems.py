"""Derivatives that a phase adds to its system, against complex steps of the phase as a whole."""

import numpy as np
import pytest

from ancfdae import Beam, Material, MotorTorque, Pin, RotationDriver, Scene, SpringDamper, assemble
from ancfdae.equations import MechanicalSystem, StateDirection
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.laws import Harmonic
from ancfdae.sections import Rectangle


def driven_arm():
    """Return a driven arm with a torque over time, a damper and three design variables."""
    rubber, section = Material(1000.0, 1e7, 0.3), Rectangle(0.05, 0.04)
    upper = Beam("upper", (0, 0), (0.6, 0.1), 1, section, rubber)
    lower = Beam("lower", upper.at_end, (0.5, 0.0), 1, section, rubber)
    joints = [
        RotationDriver(upper.at_start, Harmonic(0.3, 5.0), name="drive"),
        Pin(upper.at_start),
        Pin(upper.at_end, lower.at_start),
    ]
    loads = [
        MotorTorque(lower.at_start, 2.0, name="motor", law=Harmonic(1.0, 7.0)),
        SpringDamper(lower.at_end, 30.0, 0.5, 0.4, ground=(1.0, 0.5), name="spring"),
    ]
    scene = Scene([upper, lower], joints, (0, -9.81), loads=loads)
    return assemble(scene, ("upper.height", "drive.amplitude", "spring.damping"))


@pytest.fixture(scope="module")
def phase():
    system, rng = driven_arm(), np.random.default_rng(5)
    q, _ = system.start()
    start = PhaseStart(
        0.13, q, rng.normal(size=q.size), rng.normal(size=3),
        rng.normal(size=(q.size, 3)), rng.normal(size=(q.size, 3)),
    )  # fmt: skip
    numbers = start.free(3)
    # Starts that depend on the design and on numbers of their own.
    both = start._replace(
        t_b=numbers.t_b + np.pad(start.t_b, (0, numbers.t_b.size - 3)),
        q_b=numbers.q_b + np.pad(start.q_b, ((0, 0), (0, numbers.t_b.size - 3))),
        v_b=numbers.v_b + np.pad(start.v_b, ((0, 0), (0, numbers.t_b.size - 3))),
    )
    return PhaseSystem(system, both, 0.4, first=False)


def states_of(phase, count):
    """Return random states near the start, and their derivatives."""
    rng, q = np.random.default_rng(8), phase.start()[0]
    states = [q + 0.01 * rng.normal(size=q.size), *rng.normal(size=(2, q.size))][:count]
    return tuple(states), tuple(rng.normal(size=(len(x), phase.n_b)) for x in states)


@pytest.mark.parametrize("rates", [0, 1, 2])
def test_totals_of_constraints_are_those_of_complex_steps(phase, rates):
    motion, motion_b = states_of(phase, rates + 1)
    for along in (motion_b, None):
        ours = phase.constraint_total(0.07, motion, along)
        theirs = MechanicalSystem.constraint_total(phase, 0.07, motion, along)
        # Laws of time are differentiated once more by differences.
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


def test_totals_along_a_direction_are_those_of_complex_steps(phase):
    rng = np.random.default_rng(3)
    (q, v, a), (q_b, v_b, a_b) = states_of(phase, 3)
    lam, lam_b = rng.normal(size=phase.n_lam), rng.normal(size=(phase.n_lam, phase.n_b))
    direction = StateDirection(1.0, rng.normal(size=q.size), rng.normal(size=q.size))
    moved = rng.normal(size=(2, q.size, phase.n_b))
    given = 0.07, (q, v, a, lam), direction
    ours = phase.along_total(*given, (q_b, v_b, a_b, lam_b), tuple(moved))
    theirs = MechanicalSystem.along_total(phase, *given, (q_b, v_b, a_b, lam_b), tuple(moved))
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
    mu = rng.normal(size=q.size)
    ours, theirs = (
        along(phase, *given, mu)
        for along in (PhaseSystem.along_pull_back, MechanicalSystem.along_pull_back)
    )
    for mine, generic in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, generic, rtol=1e-9, atol=1e-9 * np.abs(generic).max())
