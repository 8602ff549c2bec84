"""Accelerations of scenes in the kernel, against the protocol in Python and closed forms."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    Beam,
    FollowerForce,
    Integral,
    Material,
    Pin,
    PointForce,
    RigidBody,
    RotationDriver,
    Scene,
    SpringDamper,
    Terminal,
    assemble,
    gradient,
)
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.integrators.problem import (
    Accelerations,
    CompiledAccelerations,
    InitialValueProblem,
    accelerations,
)
from ancfdae.laws import Harmonic
from ancfdae.observables import driver_torque, position
from ancfdae.sections import Rectangle
from tests.support.design_cases import CASES
from tests.support.nets import net
from tests.support.scenes import SCENES


def four_bar():
    """A driven four-bar with a load that follows a law, a spring and a damped coupler."""
    places, soft = [(0, 0), (0, 0.15), (0.7, 0.5), (0.7, 0)], Material(2700.0, 2e6, 0.3, 1e-4)
    crank, rod, rocker = (
        Beam(name, places[k], places[k + 1], 2, Rectangle(0.02, 0.02), soft)
        for k, name in enumerate(("crank", "rod", "rocker"))
    )
    joints = [
        Pin(crank.at_start),
        Pin(crank.at_end, rod.at_start),
        Pin(rod.at_end, rocker.at_start),
        Pin(rocker.at_end),
        RotationDriver(crank.at_start, Harmonic(0.6, 7.0, 0.2), name="motor"),
    ]
    loads = [
        PointForce(rod.at(0.5), (3.0, 5.0), law=Harmonic(1.5, 20.0, 0.4), name="shake"),
        FollowerForce(rod.at(0.7), (1.0, 2.0), law=Harmonic(0.8, 15.0, 0.3), name="jet"),
        SpringDamper(rod.at(0.4), 40.0, 2.0, 0.3, ground=(0.2, 0.8), name="spring"),
    ]
    return Scene([crank, rod, rocker], joints, (0, -9.81), [], loads, project_start=True)


FOUR_BAR = ["motor.amplitude", "shake.amplitude", "shake.frequency", "shake.force_x"]
FOUR_BAR += ["jet.amplitude", "spring.stiffness", "rod.height", "crank.density"]
WEB = [f"x{k}.density" for k in range(4)] + ["y1.youngs_modulus", "y2.damping_time"]
EACH = {name: (SCENES[scene], design) for name, (scene, design) in CASES.items()}
EACH |= {"four-bar": (four_bar, FOUR_BAR), "web": (lambda: net(4, damping=1e-3), WEB)}


@pytest.mark.parametrize("case", EACH.values(), ids=EACH)
def test_accelerations_in_the_kernel_are_those_of_the_protocol(case):
    make, design = case
    system, rng = assemble(make(), design), np.random.default_rng(5)
    matrices, (q, v), n = saddle_point(system, 0.0), system.start(), system.n_q
    ours, exact = accelerations(system, matrices), Accelerations(system, matrices)
    assert isinstance(ours, CompiledAccelerations)
    t, size = np.array([0.0, 0.013, 0.11]), np.ptp(q)

    def near(found, expected):
        largest = np.max(np.abs(expected), axis=(0, 2), keepdims=True, initial=1e-300)
        assert np.max(np.abs(found - expected) / largest, initial=0.0) < 1e-9

    for rows in {1, 1 + system.n_b}:
        moved, speeds = 1e-3 * size * rng.normal(size=(3, rows, n)), rng.normal(size=(3, rows, n))
        moved[:, 0] += q
        speeds[:, 0] += v
        states = np.stack([moved, speeds], axis=1)
        found, expected = (x.rows_of(t, states) for x in (ours, exact))
        assert found.shape == (3, rows, n + system.n_lam)
        near(found[..., :n], expected[..., :n])
        near(found[..., n:], expected[..., n:])
        found, expected = (x.projected_of(t, states) - states for x in (ours, exact))
        assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected), initial=1e-300)


def test_a_driven_pendulum_has_the_torque_of_its_law():
    # I theta'' + m g r cos(theta) is the torque of the driver.
    mass, inertia, r, g, law = 2.0, 0.05, 0.4, 9.81, Harmonic(0.5, 3.0, 0.2)
    arm = RigidBody("arm", (0.0, 0.0), mass, inertia, centre=(r, 0.0))
    joints = [Pin(arm.origin, name="pin"), RotationDriver(arm.origin, law, name="motor")]
    scene = Scene([], joints, (0, -g), bodies=[arm], project_start=True)
    names = ["motor.amplitude", "motor.frequency", "arm.mass"]
    end, explicit = Terminal(driver_torque("motor")), DOP853(1e-10, intervals=1)
    found = gradient(scene, end, 1.0, explicit, design=names)
    # A wave of amplitude 0.5 and frequency 3 at t = 1: x = 0.5 sin(3.2), x'' = -9 x.
    x, cosine, turning = 0.5 * np.sin(3.2), np.cos(3.2), inertia + mass * r**2
    weight = mass * g * r
    assert found.value == pytest.approx(-9.0 * turning * x + weight * np.cos(x), rel=1e-8)
    by_frequency = -turning * (6.0 * x + 9.0 * 0.5 * cosine) - weight * np.sin(x) * 0.5 * cosine
    exact = [
        -9.0 * turning * x / 0.5 - weight * np.sin(x) * x / 0.5,
        by_frequency,
        (-9.0 * turning * x + weight * np.cos(x) + 9.0 * inertia * x) / mass,
    ]
    assert found.gradient == pytest.approx(exact, rel=1e-7)


def test_gradients_of_a_driven_scene_are_those_of_finite_differences():
    scene, base = four_bar(), four_bar().beams[1]
    objective = Integral(position(base.at(0.5), 1) ** 2) + Terminal(position(base.at_end, 0))
    call = objective, 0.03, DOP853(1e-11, intervals=1)
    found = gradient(scene, *call, design=FOUR_BAR)
    system = assemble(scene, FOUR_BAR)
    for k, name in enumerate(FOUR_BAR):
        b, step = system.b[k], 2e-4 * system.b[k]
        values = [
            gradient(scene.with_values({name: b + s * step}), *call, design=[name]).value
            for s in (-2, -1, 1, 2)
        ]
        difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * step)
        scale = max(abs(difference), abs(found.value / b) * 1e-6)
        assert abs(found.gradient[k] - difference) < 2e-5 * scale, name


def test_an_error_in_a_law_is_that_of_the_run():
    class Torn(Harmonic):
        def derivative(self, p, t, order):
            if np.any(np.asarray(t) > 0.05):
                raise ZeroDivisionError("no table beyond 0.05 s")
            return super().derivative(p, t, order)

    rod = Beam("rod", (0, 0), (1, 0), 2, Rectangle(0.05, 0.05), Material(2000.0, 1e7, 0.3))
    load = PointForce(rod.at_end, (0.0, 1.0), law=Torn(1.0, 2.0), name="push")
    system = assemble(Scene([rod], [Pin(rod.at_start)], loads=[load]))
    problem = InitialValueProblem.of(system, 0.1)
    for time, fails in ((0.04, False), (0.06, True)):
        states = np.stack([problem.initial.q, problem.initial.v])[None, :, None]
        if fails:
            with pytest.raises(ZeroDivisionError, match="no table"):
                problem.accelerations.rows_of(np.array([time]), states)
        else:
            assert np.all(np.isfinite(problem.accelerations.rows_of(np.array([time]), states)))
