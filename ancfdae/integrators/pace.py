"""Detects runs under error control that make no progress, or will take too many steps."""

from __future__ import annotations

import warnings
from collections import deque
from typing import final

from ancfdae.errors.kinds import ManyStepsWarning

# A run makes no progress if _STEPS steps together advance by less than _SHARE of the end time.
# Single steps may be lost in round-off: at tight tolerances Newton's method meets it, and SUNDIALS
# tries shorter steps until one succeeds (a pendulum of IDA at 3e-13: five in a row, and the end
# time is reached).
_STEPS, _SHARE = 100, 1e-12
# Steps count as steady if the last quarter of a hundred advances by a factor between these limits
# relative to the quarter before, or the last half of many hundreds relative to the half before:
# repeated steps disturb quarters where stability or noise limits their size.
_SLOWER, _FASTER = 0.5, 1.5
# Number of hundreds of steps that must predict too many steps before a warning.
_HUNDREDS = 20


@final
class Pace:
    """Watches the times that the steps of a run reach; warns if the run will take too many steps.

    It warns once, with the `remedy`, if twenty hundreds of steps predict more than `many` steps; if
    the solver is `sure` of its first steps, the first hundred suffices. Short steps around a kick,
    at a start from rest, or where round-off disturbs some, do not predict the number of later
    steps.
    """

    def __init__(self, t_end: float, many: int, remedy: str, *, sure: bool = False) -> None:
        self._t_end, self._many, self._remedy = t_end, many, remedy
        self._least, self._told, self._sure = _SHARE * t_end, False, sure
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Start counting steps anew at time t, s."""
        # Times before and after the last hundreds of steps.
        self._ends = deque([t], maxlen=_HUNDREDS + 1)
        self._half = self._quarter = t
        self._taken = 0

    def stalls(self, t: float) -> bool:
        """Count a step to time t, s; return whether the last hundred steps made no progress.

        A run without progress diverges, meets a jump too large to integrate, or integrates noise.
        The number of steps of the run is predicted from the last steps, unless these still grow, or
        the run makes no progress.
        """
        self._taken += 1
        if 2 * self._taken == _STEPS:
            self._half = t
        if 4 * self._taken == 3 * _STEPS:
            self._quarter = t
        if self._taken < _STEPS:
            return False
        stalled = t - self._ends[-1] < self._least
        self._taken = 0
        self._ends.append(t)
        if not self._told and not stalled:
            self._warn_of_many(t)
        self._sure = False
        return stalled

    def _warn_of_many(self, t: float) -> None:
        """Warn if steady steps up to time t, s, predict too many steps."""
        marks, steps = [self._half, self._quarter, t], _STEPS // 4
        if not self._sure:
            if len(self._ends) <= _HUNDREDS:
                return
            marks, steps = [self._ends[k] for k in (0, _HUNDREDS // 2, -1)], _HUNDREDS * _STEPS // 2
        before, last = marks[1] - marks[0], marks[2] - marks[1]
        h = (before + last) / (2 * steps)
        if _SLOWER * before <= last <= _FASTER * before and self._t_end - t > self._many * h:
            self._tell(t, h)

    def _tell(self, t: float, h: float) -> None:
        self._told = True
        warnings.warn(
            f"about {(self._t_end - t) / h:.2g} steps are to come, of {h:.2g} s each as the last "
            f"ones: {self._remedy} Ctrl-C ends the run and keeps what is done.",
            ManyStepsWarning,
            stacklevel=3,
        )
