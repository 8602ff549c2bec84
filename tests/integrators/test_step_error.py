"""Error of a step of HHT-I3 and sizes of derivatives, against their formulas."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import HHT, Radau
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.integrators.hht.equations import Coefficients
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.hht.step import HHTStepper
from ancfdae.integrators.problem import InitialValueProblem, Scales
from ancfdae.integrators.radau.step import RadauStepper
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.start import consistent_start
from ancfdae.integrators.step_control import AdaptiveSteps
from ancfdae.integrators.step_control.contracts import (
    derivative_sizes,
    sizes_hold,
    smaller_sizes,
)
from tests.support.mechanisms import CartesianPendulum

H, RTOL, ATOL, T_END = 0.1, 1e-2, 1e-3, 5.0
SIZES, SIZES_B = np.array([2.0, 4.0]), np.array([3.0, 0.0, 10.0])
STEPS = AdaptiveSteps(RTOL, ATOL)
INCREMENTS = np.array([[0.3, 9.0, -0.1], [-0.2, 9.0, 0.7]])
VALUES = np.array([[0.0, 1.0, -4.0], [0.5, 1.0, 3.0]])


def stepper(initial=None, derivative=None, alpha=-0.3, sizes_b=SIZES_B):
    system = CartesianPendulum()
    tolerance, problem = (
        STEPS.tolerance(T_END, SIZES, sizes_b),
        InitialValueProblem.of(system, T_END),
    )
    if initial is not None:
        problem = replace(problem, initial=initial)
    problem = replace(problem, derivative=derivative)
    return HHTStepper(problem, alpha, (1.0, 1), tolerance, SolutionRecorder(system, 1))


def expected_error(j, alpha):
    """The formula of the module, term by term."""
    delta = (1 + 3 * alpha**2) / 12 * H**2 * INCREMENTS[:, j]
    allowed = RTOL * np.abs(VALUES[:, j]) + ATOL * SIZES_B[j] * SIZES
    return np.sqrt(np.mean((2 * T_END * delta / H / allowed) ** 2))


@pytest.mark.parametrize("alone", [0, 2])
def test_error_of_a_step_is_the_formula_of_its_module(alone):
    alpha, chosen = -0.3, np.arange(3) == alone
    # The variable without a size has no part in it.
    increments = np.where(chosen | (SIZES_B == 0), INCREMENTS, 0.0)
    error = stepper(alpha=alpha)._error_of_derivatives(H, VALUES, increments)
    assert error == pytest.approx(expected_error(alone, alpha), rel=1e-14)


def test_error_at_the_start_follows_from_the_third_derivative():
    system, alpha, sizes_b = CartesianPendulum(0.3, 1.0), -0.3, np.array([3.0, 10.0])
    problem = InitialValueProblem.of(system, 1.0).differentiated()
    initial, derivative = problem.initial, problem.derivative
    # Without velocity forces it is the same for every first step.
    start = RecurrenceStart.of(problem, Coefficients(0.7, alpha))
    jerk = start.jerks[0]
    jerk_b = start.jerk_total(jerk, derivative, derivative.a_b)
    C = (1 + 3 * alpha**2) / 12
    motion = T_END * C * jerk.jerk / (RTOL * np.abs(initial.q) + ATOL * SIZES)
    allowed = RTOL * np.abs(derivative.q_b) + ATOL * sizes_b * SIZES[:, None]
    own = 2 * T_END * C * jerk_b / allowed
    expected = np.sqrt(max(np.mean(motion**2), *np.mean(own**2, axis=0)))
    method = stepper(initial, derivative, alpha, sizes_b)
    assert expected > 0
    assert method.start_error() == pytest.approx(expected, rel=1e-12)
    # The first step is tried at a quarter; e goes with the square of the step.
    tried, _ = STEPS.controller(T_END, method).plan(0, 0.0)
    assert tried == pytest.approx(min(np.sqrt(0.25 / expected), T_END / 20), rel=1e-12)


@pytest.mark.parametrize(("kind", "stepper"), [(HHT, HHTStepper), (Radau, RadauStepper)])
def test_the_larger_error_counts_whether_of_motion_or_derivatives(kind, stepper, monkeypatch):
    system, told = CartesianPendulum(0.3, 1.0), [0.0]
    monkeypatch.setattr(stepper, "_error_of_derivatives", lambda *_: told[0])
    steps = AdaptiveSteps(1e-3, sensitivities=True)
    alone = kind(AdaptiveSteps(1e-3)).integrate(system, 1.0)
    for told[0], accepted in ((1e-9, True), (1.5, False), (np.nan, False)):
        both = kind(steps).integrate(system, 1.0)
        assert both.outcome.success is accepted
        np.testing.assert_array_equal(both.t, alone.t if accepted else [0.0])


def test_sizes_of_derivatives():
    system = CartesianPendulum(b=(1.0, 1e-6))
    scales = Scales.of(system, consistent_start(system, saddle_point(system, 0.0), 0.0)[0], 1.0)
    # The largest instant counts, which is not the last. The second variable is so small that a
    # change of it by its own size is round-off where the same derivative in the first is not.
    q_b = np.zeros((3, 2, 2))
    q_b[1] = np.array([[3.0, 3e-7], [4.0, 4e-7]]) * scales.q[:, None]
    np.testing.assert_allclose(derivative_sizes(scales, q_b), [np.sqrt(12.5), 0.0], rtol=1e-14)
    np.testing.assert_allclose(
        derivative_sizes(scales, q_b * 1e3), [np.sqrt(12.5e6), np.sqrt(12.5) * 1e-4], rtol=1e-14
    )
    for undefined in (np.nan, np.inf, 1e200):
        q_b[2, 0, 0] = undefined
        assert derivative_sizes(scales, q_b)[0] == np.inf


def test_comparison_of_sizes():
    found = np.array([1.0, 2.0, 0.0])
    assert sizes_hold(np.array([2.0, 1e-3, 0.0]), found)
    assert not sizes_hold(np.array([2.1, 2.0, 0.0]), found)
    assert not sizes_hold(np.array([0.0, 2.0, 0.0]), found)
    assert sizes_hold(np.array([1.0, 2.0, 0.1]), found)
    np.testing.assert_array_equal(smaller_sizes(np.array([3.0, 0.0, 1.0]), found), [1.0, 2.0, 1.0])
    np.testing.assert_array_equal(smaller_sizes(np.array([0.5, 2.0, 0.0]), found), [0.5, 2.0, 0.0])
