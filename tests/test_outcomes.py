"""Trouble on the way is an outcome in words, and what was computed stays usable."""

import numpy as np
import pytest

from ancfdae import HHT, Verdict, simulate
from validation.scenes import pendulum

from mechanisms import CartesianPendulum


class Failing(CartesianPendulum):
    """A pendulum whose force does something bad from a given time on."""

    def __init__(self, action, since):
        super().__init__(0.5, 3.0)
        self.action, self.since = action, since

    def force(self, q, v, t):
        if t >= self.since:
            return self.action()
        return super().force(q, v, t)


def interrupt():
    raise KeyboardInterrupt


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_forces_that_are_not_finite_end_the_run_with_its_results(value):
    run = simulate(Failing(lambda: np.full(2, value), 0.5), 1.0, HHT(2.0**-5))
    assert run.outcome.verdict is Verdict.NOT_FINITE
    assert run.outcome.step == len(run.t) - 1 == 15
    assert run.outcome.time == run.t[-1] == 15 / 32
    assert np.all(np.isfinite(run.q))
    good = simulate(CartesianPendulum(0.5, 3.0), 1.0, HHT(2.0**-5))
    np.testing.assert_array_equal(run.q, good.q[:16])
    assert "t = 0.46875" in str(run.outcome)


def test_an_interrupt_keeps_what_was_computed():
    run = simulate(Failing(interrupt, 0.5), 1.0, HHT(2.0**-5))
    assert run.outcome.verdict is Verdict.INTERRUPTED
    assert len(run.t) == 16


def test_too_few_iterations_are_told_with_time_and_size():
    run = simulate(pendulum(), 1.0, HHT(2.0**-7, max_iterations=1))
    assert run.outcome.verdict is Verdict.NO_CONVERGENCE
    assert not run.outcome.success
    assert run.outcome.residual > 0
    assert "did not converge at t = " in str(run.outcome)


def test_a_step_beyond_all_reason_ends_cleanly():
    run = simulate(pendulum(youngs_modulus=1e3), 40.0, HHT(10.0))
    assert isinstance(run.outcome.verdict, Verdict)
    assert np.all(np.isfinite(run.q))


def test_progress_bar_only_on_request(capsys):
    simulate(CartesianPendulum(), 0.25, HHT(2.0**-4))
    assert capsys.readouterr().err == ""
    simulate(CartesianPendulum(), 0.25, HHT(2.0**-4), progress=True)
    assert "4/4" in capsys.readouterr().err


def test_statistics_count_what_was_done():
    run = simulate(pendulum(), 0.25, HHT(2.0**-7))
    s = run.statistics
    assert s.steps == 32
    assert s.iterations == s.residuals >= 2 * s.steps
    assert 1 <= s.factorisations <= s.iterations
    assert s.wall_seconds > 0
