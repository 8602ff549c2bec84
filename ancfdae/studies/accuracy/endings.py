"""Motions that end before a search does: its runs fail there, and no shorter steps get further."""

from __future__ import annotations

from dataclasses import replace
from typing import final

from ancfdae.equations import Solution
from ancfdae.errors.outcomes import Verdict, uninterrupted
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.method import Radau
from ancfdae.integrators.step_control.steps import AdaptiveSteps
from ancfdae.sensitivity.method import UnfinishedRunError

# Reasons for which a run ends where the motion does, or where its steps are too long.
_STUCK = frozenset(
    {
        Verdict.NO_CONVERGENCE,
        Verdict.SINGULAR,
        Verdict.NOT_FINITE,
        Verdict.ERROR_TEST,
        Verdict.OFF_ROOT,
        Verdict.FOLDED,
        Verdict.OFF_ROUTE,
        Verdict.POLE,
        Verdict.OPENED,
        Verdict.INDEFINITE,
    }
)
# Largest tolerance of the run that finds the end of the motion, and its largest number of steps
# over the steps of the failed run.
_RTOL, _MORE = 1e-5, 16
# Largest distance of the end of a run from the end of the motion, steps. A motion whose
# acceleration grows as q^m reaches infinity at T as (T - t)^-p, p = 2/(m - 1), and small changes of
# it grow at the rate sqrt((p + 1)(p + 2))/(T - t). Newton's method fails where a step times this
# rate is about one: 2.4 steps before T for m = 3, and 8 for m = 1.31.
_NEAR = 8.0


@final
class Ending:
    """Search for the end of a motion from runs of it that failed.

    One failure says little, because shorter steps may succeed. After the second one Radau IIA runs
    under error control. It needs few steps in stiff motions, and stops only where no step, however
    short, gets further.
    """

    def __init__(self, problem: InitialValueProblem, t_end: float, tolerance: float) -> None:
        self._system, self._t_end, self._tolerance = problem.system, t_end, tolerance
        self._failures = 0
        self._controlled: Solution | None = None

    def require_motion(self, setting: Integrator, run: Solution) -> None:
        """Raise UnfinishedRunError if the motion ends where a run with this setting failed."""
        if run.outcome.verdict not in _STUCK:
            return
        self._failures += 1
        if self._failures < 2:
            return
        steps, reached = run.statistics.steps, run.outcome.time
        if self._controlled is None:
            control = AdaptiveSteps(min(self._tolerance, _RTOL), max_steps=_MORE * (steps + 1))
            integrator = Radau(control)
            whole = uninterrupted(integrator.integrate(self._system, self._t_end))
            if whole.outcome.verdict is Verdict.STEP_LIMIT:
                return  # The next failure allows more steps.
            self._controlled = whole
        end = self._controlled.outcome
        apart = abs(end.time - reached) * max(steps, 1)
        if end.verdict in _STUCK and apart <= _NEAR * reached:
            advice = (
                f"The motion ends there: {type(setting).__name__} ended at t = {reached:.6g} with "
                f"{steps} steps, and no shorter steps get further. Choose a smaller t_end."
            )
            outcome = replace(end, advice=advice)
            raise UnfinishedRunError(replace(self._controlled, outcome=outcome))
