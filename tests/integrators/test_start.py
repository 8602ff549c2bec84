"""The start of HHT-I3: bounded under damping, of second order, exact in its derivatives."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    AtTimes,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    InitialVelocity,
    Material,
    Pin,
    PointForce,
    RotationDriver,
    Scene,
    assemble,
    gradient,
    simulate,
)
from ancfdae.integrators.hht.equations import Coefficients, NodeSensitivity
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.start import (
    Covectors,
    pull_back_start,
)
from ancfdae.laws import Harmonic
from ancfdae.observables import position
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum, WhirlingPendulum
from validation.scenes import crank_slider

TIMES = (1e-5, 1e-4, 1e-3, 1e-2, 1.0)


def cantilever(elements, damping_time, gravity=False):
    material = Material(2700, 7e10, 0.0, damping_time)
    rod = Beam("rod", (0, 0), (1, 0), elements, Rectangle(0.02, 0.02), material)
    tip = [] if gravity else [PointForce(rod.at_end, (0, 1.0))]
    field = (0, -9.81) if gravity else None
    return Scene([rod], [Clamp(rod.at_start)], field, loads=tip)


def tip(scene, t_end, integrator):
    run = simulate(scene, t_end, integrator)
    assert run.outcome.success, run.outcome
    return run.nodes("rod")[:, -1, 0, 1], run


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("elements", [2, 8])
@pytest.mark.parametrize("damping_time", TIMES)
def test_damped_beams_start_at_any_step(elements, damping_time, gravity):
    scene = cantilever(elements, damping_time, gravity)
    for step in (1e-2, 1e-3, 1e-4, 1e-5):
        _, run = tip(scene, 20 * step, HHT(step))
        # Two to five where forces move it; at 1e-14 round-off costs one or two more.
        assert run.statistics.iterations <= 8 * run.statistics.steps


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("damping_time", TIMES)
def test_damped_beams_start_right_where_the_step_resolves_the_slow_motion(damping_time, gravity):
    # The first bending mode has 103 rad/s: a step of 1 ms resolves it, whatever the faster ones do.
    scene, step, steps = cantilever(2, damping_time, gravity), 1e-3, 32
    coarse, _ = tip(scene, steps * step, HHT(step))
    fine, _ = tip(scene, steps * step, HHT(step / 16))
    # The issue asks 2 %.
    assert np.max(np.abs(coarse - fine[::16])) < 0.02 * np.max(np.abs(fine))


@pytest.mark.parametrize("damping_time", TIMES)
def test_error_control_gets_over_the_start_of_a_damped_beam(damping_time):
    scene = cantilever(2, damping_time)
    controlled, _ = tip(scene, 0.03, HHT(rtol=1e-3))
    fine, _ = tip(scene, 0.03, HHT(0.03 / 512))
    # 2 %, as above; the tolerance is relative to the length of the beam.
    assert abs(controlled[-1] - fine[-1]) < 0.02 * np.max(np.abs(fine))


@pytest.mark.parametrize("damping_time", [1e-5, 1e-3, 1e-2])
def test_a_damped_slider_crank_starts(damping_time):
    scene = crank_slider()
    scene = scene.with_values({f"{x}.damping_time": damping_time for x in ("crank", "rod")})
    coarse = simulate(scene, 2.0**-4, HHT(2.0**-7))
    fine = simulate(scene, 2.0**-4, HHT(2.0**-11))
    assert coarse.outcome.success
    x, x_fine = (run.nodes("rod")[:, -1, 0, 0] for run in (coarse, fine))
    travel = np.max(np.abs(x_fine - x_fine[0]))
    assert np.max(np.abs(x - x_fine[::16])) < 0.02 * travel


def resolved():
    """A damped pendulum in motion whose fastest mode the steps below resolve."""
    rod = Beam("rod", (0, 0), (1, 0), 1, Rectangle(0.1, 0.1), Material(1000, 1e5, 0.0, 2e-3))
    spin = [InitialVelocity("rod", 2.0, (0, 0))]
    return Scene([rod], [Pin(rod.at_start)], (0, -9.81), start=spin)


def driven():
    """A rod whose middle is turned by a sine: the third time derivative of Phi_q is not zero."""
    rod = Beam("rod", (0, 0), (1, 0), 1, Rectangle(0.1, 0.1), Material(1000, 1e5, 0.0))
    joints = [Pin(rod.at_start), RotationDriver(rod.at(0.5), Harmonic(0.5, 4.0), name="drive")]
    return Scene([rod], joints, start=[InitialVelocity("rod", 2.0, (0, 0))])


def test_a_moving_damped_start_is_of_second_order():
    runs = [simulate(resolved(), 0.05, HHT(0.05 / 2**k)) for k in (8, 9, 10, 14)]
    exact = runs[-1]
    for name in ("q", "v", "lam"):
        errors = []
        for k, run in zip((8, 9, 10), runs, strict=False):
            reference = getattr(exact, name)[:: 2 ** (14 - k)]
            errors.append(np.max(np.abs(getattr(run, name) - reference)))
        orders = np.log2(np.divide(errors[:-1], errors[1:]))
        # First order would show as 1; the last halving is the nearest to 2.
        assert orders[-1] > 1.9, (name, orders)


@pytest.mark.parametrize("step", [1e-2, 1e-4])
def test_gradients_through_a_damped_start_are_exact(step):
    scene, design = cantilever(2, 1e-2), ["rod.damping_time", "rod.height", "rod.length"]
    objective = AtTimes(position(scene.beams[0].at_end, 1), [step, 5 * step])
    found = [
        gradient(scene, objective, 5 * step, HHT(step), design=design, method=method).gradient
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    # Stiff equations leave 1e-9 of round-off; a forgotten term of the start shows at order one.
    np.testing.assert_allclose(found[0], found[2], rtol=1e-7)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-7)


@pytest.mark.parametrize(
    "system",
    [
        assemble(resolved(), ["rod.damping_time", "rod.height", "rod.length", "rod.density"]),
        assemble(crank_slider(), ["crank.length", "rod.height"]),
        CartesianPendulum(),
        WhirlingPendulum(-1.0, 2.0),
        assemble(driven(), ["rod.length", "drive.frequency"]),
    ],
    ids=["damped", "spatial", "curved constraint", "whirling", "driven"],
)
def test_the_start_is_pulled_back_by_its_transpose(system):
    problem = InitialValueProblem.of(system, 1.0).differentiated()
    initial, derivative = problem.initial, problem.derivative
    start = RecurrenceStart.of(problem, Coefficients(0.01, -0.3))
    node_b = start.sensitivity(derivative)
    rng = np.random.default_rng(0)
    on = [rng.standard_normal(system.n_q) * np.sqrt(system.weights) for _ in range(4)]
    on_lam = rng.standard_normal(system.n_lam)
    back = start.pull_back(NodeSensitivity(on[0], on[1], on[2], 0 * on_lam, on[3]))
    back = back.plus(Covectors(0 * on[0], 0 * on[0], 0 * on[0], on_lam, 0 * back.b))
    found = pull_back_start(system, problem.matrices, initial, back)
    parts = [x[:, None] * y for x, y in zip(on, (node_b.q_b, node_b.v_b, node_b.a_b), strict=False)]
    parts += [on[3][:, None] * node_b.A_b, on_lam[:, None] * derivative.lam_b]
    expected = sum(part.sum(axis=0) for part in parts)
    size = sum(np.abs(part).sum(axis=0) for part in parts)
    # Round-off of the terms that add up; accelerations of stiff modes cancel to 1e-4 of them. Where
    # bodies follow unstrained, forces are round-off: in the norm of the weights, in which the
    # covectors are of size one, times 10 for products.
    noise = 10 * np.sqrt(system.n_q) * system.traits.force_round_off / np.abs(system.b)
    assert np.all(np.abs(found - expected) <= 1e-11 * size + noise)
