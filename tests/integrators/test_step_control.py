"""Control of the step serves any one-step method: implicit Euler uses it without a copy."""

from types import SimpleNamespace

import numpy as np
import pytest

from ancfdae import DOP853, AdaptiveSteps, FixedSteps, PrescribedSteps, simulate
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.integrators.problem import Scales
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.start import consistent_start
from ancfdae.integrators.step_control.contracts import Failure, march
from ancfdae.results import Verdict
from tests.support.mechanisms import CartesianPendulum
from tests.support.members import constraint_force, constraint_force_q
from tests.support.one_by_one import OneByOne


class ImplicitEuler(OneByOne):
    """M (v - v_n) = h (Q - Phi_q^T lam), Phi(q) = 0, q = q_n + h v for a system without Q_q, Q_v.

    The positions miss delta = -h (v - v_n)/2 in a step, so that the rate falls with h. A state is
    (t, q, v, a, lam).
    """

    order = 1

    def __init__(self, system, steps, t_end):
        self.system, self.correction, self.solved, self.errors = system, np.inf, 0, []
        self.initial = consistent_start(system, saddle_point(system, 0.0), 0.0)[0]
        sizes = Scales.of(system, self.initial, t_end).q
        self.tolerance = steps.tolerance(t_end, sizes, np.zeros(0))

    def consistent(self):
        x = self.initial
        return x.t, x.q, x.v, x.a, x.lam, ()

    def start(self, h):
        return self.consistent()[:-1]

    def resized(self, state, ratio):
        return state

    def advance(self, h, before, t):
        system, (_, q_n, v_n, _, lam) = self.system, before
        v = v_n
        for _ in range(20):
            q = q_n + h * v
            B = system.constraint_q(t, q)[None]
            K = np.eye(2) + h**2 * constraint_force_q(system, t, q, lam).reshape(2, 2)
            force = system.force(t, q, v) - constraint_force(system, t, q, lam)
            R = np.append(v - v_n - h * force, system.constraint(t, q) / h)
            x = np.linalg.solve(np.block([[K, h * B.T], [B, np.zeros((1, 1))]]), -R)
            v, lam, self.correction = v + x[:2], lam + x[2:], np.linalg.norm(x[:2])
            if self.correction < 1e-12:
                self.solved += 1
                return t, q_n + h * v, v, (v - v_n) / h, lam
        return Failure(Verdict.NO_CONVERGENCE, self.correction)

    def recorded(self, state):
        return *state, ()

    def error(self, h, before, after):
        size = np.maximum(np.abs(before[1]), np.abs(after[1]))
        self.errors.append(self.tolerance.of_motion(h, -h * (after[2] - before[2]) / 2, size))
        return self.errors[-1]

    def start_error(self):
        x = self.initial
        return self.tolerance.of_motion(1.0, -x.a / 2, np.abs(x.q))


def run(steps, t_end=1.0):
    system = CartesianPendulum(0.7, 1.0)
    method = ImplicitEuler(system, steps, t_end)
    recorder = method.recorder = SolutionRecorder(system, steps.count(t_end) + 1)
    return method, march(method, steps.controller(t_end, method), recorder, t_end, False)[0]


def test_the_tolerance_bounds_the_error_of_another_method():
    exact = simulate(CartesianPendulum(0.7, 1.0), 1.0, DOP853(1e-9))
    counts = []
    for rtol in (1e-2, 2e-3):
        method, found = run(AdaptiveSteps(rtol))
        assert found.outcome.success
        assert found.t[-1] == 1.0
        error = np.max(np.abs(found.q[-1] - exact.q[-1])) / np.max(np.abs(exact.q))
        # The claim of `AdaptiveSteps`: never wrong by more than ten times the tolerance.
        assert 1e-2 * rtol < error < 10 * rtol
        assert method.solved == found.statistics.steps + found.statistics.rejected
        counts.append(found.statistics.steps)
    # First order: a fifth of the tolerance asks for five times the steps; the first ones, before
    # the filter settles, and the memory of the largest error leave some tenths.
    assert counts[1] / counts[0] == pytest.approx(5.0, rel=0.15)


def test_steps_settle_where_control_aims():
    # Between the first steps and the last ones, which meet the end. The memory keeps e below 1/2
    # where the acceleration falls.
    method, found = run(AdaptiveSteps(1e-3))
    assert found.statistics.rejected == 0
    middle = method.errors[len(method.errors) // 2 : -12]
    assert 0.3 < np.median(middle) <= 0.55


@pytest.mark.parametrize("rtol", [1e-2, 1e-3])
def test_given_steps_repeat_a_controlled_run(rtol):
    _, first = run(AdaptiveSteps(rtol))
    _, again = run(AdaptiveSteps(rtol).frozen(first.t))
    np.testing.assert_array_equal(again.t, first.t)
    np.testing.assert_array_equal(again.q, first.q)


def test_fixed_steps_are_instants_at_equal_distance():
    _, fixed = run(FixedSteps(2.0**-6))
    _, given = run(PrescribedSteps(tuple(np.arange(65) / 64)))
    np.testing.assert_array_equal(given.q, fixed.q)


def test_a_rejection_near_the_start_begins_anew(monkeypatch):
    true_error, true_start, starts, calls = ImplicitEuler.error, ImplicitEuler.start, [], []

    def rejecting_the_third(self, h, before, after):
        calls.append(h)
        return 2.0 if len(calls) == 3 else true_error(self, h, before, after)

    def seen(self, h):
        starts.append(h)
        return true_start(self, h)

    monkeypatch.setattr(ImplicitEuler, "error", rejecting_the_third)
    monkeypatch.setattr(ImplicitEuler, "start", seen)
    method, found = run(AdaptiveSteps(1e-3))
    assert found.outcome.success
    # What was rejected shrinks, and so does the first step: to a half at most.
    assert len(starts) == 2
    assert starts[1] <= starts[0] / 2
    # The instants of the run given up are forgotten, its two steps are counted as tried.
    assert np.all(np.diff(found.t) > 0)
    assert len(found.t) == found.statistics.steps + 1 == method.solved - 2


@pytest.mark.parametrize("order", [1, 2, 4])
def test_sizes_are_the_formula_of_the_filter(order):
    # For an error k h^p the ratio e/h^p is equal in all steps, so that the memory has no effect.
    steps, k, t_end = AdaptiveSteps(1e-3), 3e4, 10.0
    method = NumbersOnly(order, k)
    controller, t, last_x, ratio = steps.controller(t_end, method), 0.0, 1.0, 1.0
    expected = (0.25 / k) ** (1 / order)
    for n in range(20):
        h, t_next = controller.plan(n, t)
        assert h == pytest.approx(expected, rel=1e-12)
        e = k * h**order
        assert controller.judge(n, t, h, e) == n + 1
        x = (1 / (2 * e)) ** (1 / order)
        ratio = (x * last_x) ** (1 / 8) * ratio ** (-1 / 4)
        ratio = 1 + 0.2 * np.arctan((ratio - 1) / 0.2)
        t, last_x, expected = t_next, x, h * ratio
    # Near it the next run begins with half its first step at most, or with what was rejected.
    near = steps.controller(t_end, method)
    first, _ = near.plan(0, 0.0)
    assert near.judge(3, 4 * first, first, 2.0) == 0
    assert near.plan(0, 0.0)[0] == pytest.approx(first * min(0.25 ** (1 / order), 0.5), rel=1e-12)
    # Far from the start a rejected step is repeated: smaller by the root of what it errs too much.
    assert controller.judge(20, t, h, 2.0) == 20
    assert controller.plan(20, t)[0] == pytest.approx(h * max(0.25 ** (1 / order), 0.2), rel=1e-12)
    # An error that does not fall with the step stems from the step before, which is halved.
    assert controller.judge(20, t, 0.5 * h, 1.9) == 19
    assert controller.plan(19, t)[0] == pytest.approx(0.5 * h, rel=1e-12)
    assert controller.judge(20, t, 1e-13, 2.0) is Verdict.ERROR_TEST


def stepped_to_its_last_steps(steps, t_end, method):
    """Take steps until the next one is one of the last, which meet the end."""
    controller, n, t = steps.controller(t_end, method), 0, 0.0
    for n in range(1000):
        h, t_next = controller.plan(n, t)
        if controller.state()[7] > 0:  # Steps left.
            return controller, n, t, h, t_next
        controller.judge(n, t, h, method.e * h**method.order)
        t = t_next
    raise AssertionError


@pytest.mark.parametrize("taken", [0, 1, 3])
def test_a_run_that_goes_on_within_its_last_steps_meets_the_end_alike(taken):
    steps, method, t_end = AdaptiveSteps(1e-3), NumbersOnly(2, 3e4), 1.0
    controller, n, t, h, t_next = stepped_to_its_last_steps(steps, t_end, method)
    for _ in range(taken):
        n, t = controller.judge(n, t, h, method.e * h**2), t_next
        h, t_next = controller.plan(n, t)
    # What the filter proposes is not asked within the last steps: their number is kept, and tells.
    proposed, *rest = controller.state()
    again = steps.controller(t_end, method, (3 * proposed, *rest))
    while True:
        assert controller.plan(n, t) == again.plan(n, t)
        if controller.plan(n, t) is Verdict.FINISHED:
            break
        h, t_next = controller.plan(n, t)
        for each in (controller, again):
            assert each.judge(n, t, h, method.e * h**2) == n + 1
        n, t = n + 1, t_next


@pytest.mark.parametrize("taken", [0, 2])
def test_a_step_rejected_within_the_last_ones_becomes_smaller(taken):
    """Error estimate 2, four times the target 1/2, halves the step: (1/4)^(1/2) at order 2."""
    steps, method, t_end = AdaptiveSteps(1e-3), NumbersOnly(2, 3e4), 1.0
    controller, n, t, h, t_next = stepped_to_its_last_steps(steps, t_end, method)
    for _ in range(taken):
        n, t = controller.judge(n, t, h, method.e * h**2), t_next
        h, t_next = controller.plan(n, t)
    assert controller.judge(n, t, h, 2.0) == n
    # More steps are left now; they share what is left, the first within an eighth of what it asks.
    assert controller.plan(n, t)[0] == pytest.approx(h / 2, rel=1 / 8)


def test_the_error_of_a_step_is_that_from_the_state_it_began_with(monkeypatch):
    """The state of another step size is made for this one first, and the error counts from it."""
    began, measured = [], []

    def resized(self, state, ratio):
        began.append((*state, ratio))
        return (state[0] + 0.0, *state[1:])

    def advance(self, h, before, t, true=ImplicitEuler.advance):
        began.append(before)
        return true(self, h, before, t)

    def error(self, h, before, after, true=ImplicitEuler.error):
        measured.append(before is began[-1])
        return true(self, h, before, after)

    for name, function in (("resized", resized), ("advance", advance), ("error", error)):
        monkeypatch.setattr(ImplicitEuler, name, function)
    run(AdaptiveSteps(1e-2))
    assert len(measured) > 10
    assert all(measured)


class NumbersOnly:
    """All that a controller reads of a method."""

    bears_jumps = False
    system = SimpleNamespace(breakpoints=lambda t_end: ())
    many, remedy = 1_000_000, "HHT."

    def __init__(self, order, e):
        self.order, self.e = order, e

    def start_error(self):
        return self.e


def test_what_is_never_solved_is_an_outcome(monkeypatch):
    never = Failure(Verdict.NO_CONVERGENCE, 1.0)
    monkeypatch.setattr(ImplicitEuler, "advance", lambda self, h, before, t: never)
    for steps in (FixedSteps(0.1), AdaptiveSteps(1e-3)):
        _, found = run(steps)
        assert found.outcome.verdict is Verdict.NO_CONVERGENCE
        assert len(found.t) == 1
    _, found = run(AdaptiveSteps(1e-3, max_steps=4))
    assert found.outcome.verdict is Verdict.STEP_LIMIT
    assert found.statistics.rejected == 4
