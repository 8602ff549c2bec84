"""Detects runs under error control that make no progress, or will take too many steps."""

from __future__ import annotations

import warnings
from typing import final

from ancfdae.errors.kinds import ManyStepsWarning

# A run makes no progress if _STEPS steps together advance by less than _SHARE of the end time.
# Single steps may be lost in round-off: at tight tolerances Newton's method meets it, and SUNDIALS
# tries shorter steps until one succeeds (a pendulum of IDA at 3e-13: five in a row, and the end
# time is reached).
_STEPS, _SHARE = 100, 1e-12
# Steps count as steady if the last quarter of a hundred advances by a factor between these limits
# relative to the quarter before, or a hundred relative to the hundred before: where stability
# limits steps, repeated ones disturb quarters.
_SLOWER, _FASTER = 0.5, 1.5
# Number of hundreds of steps in a row that must predict too many steps before a warning.
_IN_A_ROW = 20


@final
class Pace:
    """Watches the times that the steps of a run reach; warns if the run will take too many steps.

    It warns once, with the `remedy`, if twenty hundreds of steps in a row predict more than `many`
    steps; if the solver is `sure` of its first steps, the first hundred suffices. Short steps
    around a kick, at a start from rest, or where round-off disturbs some, do not predict the number
    of later steps.
    """

    def __init__(self, t_end: float, many: int, remedy: str, *, sure: bool = False) -> None:
        self._t_end, self._many, self._remedy = t_end, many, remedy
        self._least, self._told = _SHARE * t_end, False
        self._foretold, self._hundred = _IN_A_ROW - 1 if sure else 0, 0.0
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Start counting steps anew at time t, s."""
        self._mark = self._half = self._quarter = t
        self._taken = 0

    def stalls(self, t: float) -> bool:
        """Count a step to time t, s; return whether the last hundred steps made no progress.

        A run without progress diverges, meets a jump too large to integrate, or integrates noise.
        The number of steps of the run is predicted from the second half of the hundred, unless
        steps still grow in it, or the run makes no progress.
        """
        self._taken += 1
        if 2 * self._taken == _STEPS:
            self._half = t
        if 4 * self._taken == 3 * _STEPS:
            self._quarter = t
        if self._taken < _STEPS:
            return False
        hundred, before = t - self._mark, self._quarter - self._half
        stalled = hundred < self._least
        pairs = (before, t - self._quarter), (self._hundred, hundred)
        steady = any(_SLOWER * x <= y <= _FASTER * x for x, y in pairs)
        self._hundred = hundred
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
