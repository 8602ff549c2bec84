"""The pace of a run under error control: steps that lead nowhere, and too many to wait for."""

from __future__ import annotations

import warnings
from typing import final

from ancfdae.errors.kinds import ManyStepsWarning

# Steps that together advance by less than this share of the end time. Single steps may be lost in
# round-off: at tight tolerances Newton's method meets it, and SUNDIALS tries shorter steps until it
# gets on (a pendulum of IDA at 3e-13: five in a row, and the end time is reached).
_STEPS, _SHARE = 100, 1e-12
# Share of the advance of one quarter that the next one makes where steps are what they will be, at
# least and at most.
_SLOWER, _FASTER = 0.5, 1.5
# Hundreds in a row that must foretell too many steps.
_IN_A_ROW = 20


@final
class Pace:
    """Watches the times that the steps of a run reach.

    It warns, once, of a run that will take more steps than `many`, and says the reason and the
    remedy in words, by twenty hundreds of steps in a row; of a solver that is `sure` of its first
    steps by their first hundred alone. Short steps around a kick, at a start from rest, or where
    round-off disturbs some, say nothing of the others.
    """

    def __init__(self, t_end: float, many: int, remedy: str, *, sure: bool = False) -> None:
        self._t_end, self._many, self._remedy = t_end, many, remedy
        self._least, self._told = _SHARE * t_end, False
        self._foretold = _IN_A_ROW - 1 if sure else 0
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Start to count steps at time t."""
        self._mark = self._half = self._quarter = t
        self._taken = 0

    def stalls(self, t: float) -> bool:
        """Count a step to time t; return whether the last hundred steps made no progress.

        This ends runs that diverge, meet a jump too large to integrate, or integrate noise. The
        second half of a hundred says how many steps the run takes, unless steps still grow in it,
        or the run is about to stall.
        """
        self._taken += 1
        if 2 * self._taken == _STEPS:
            self._half = t
        if 4 * self._taken == 3 * _STEPS:
            self._quarter = t
        if self._taken < _STEPS:
            return False
        stalled = t - self._mark < self._least
        before, last = self._quarter - self._half, t - self._quarter
        steady = _SLOWER * before <= last <= _FASTER * before
        h = (t - self._half) / (_STEPS / 2)
        many = steady and not stalled and self._t_end - t > self._many * h
        self._foretold = self._foretold + 1 if many else 0
        if self._foretold >= _IN_A_ROW and not self._told:
            self._tell(t, h)
        self.restart(t)
        return stalled

    def _tell(self, t: float, h: float) -> None:
        self._told = True
        warnings.warn(
            f"about {(self._t_end - t) / h:.2g} steps are to come, of {h:.2g} s each as the last "
            f"ones: {self._remedy} Ctrl-C ends the run and keeps what is done.",
            ManyStepsWarning,
            stacklevel=2,
        )
