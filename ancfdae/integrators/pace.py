"""The pace of a run under error control: steps that lead nowhere, and too many to wait for."""

from __future__ import annotations

import warnings
from typing import final

from ancfdae.errors import ManySteps

# Steps that together advance by less than this share of the end time. Single steps may be lost in
# round-off: at tight tolerances Newton's method meets it, and SUNDIALS tries shorter steps until it
# gets on (a pendulum of IDA at 3e-13: five in a row, and the end time is reached).
_STEPS, _SHARE = 100, 1e-12
# Share of the advance of one quarter that the next one makes where steps are what they will be, at
# least and at most.
_SLOWER, _FASTER = 0.5, 1.5


@final
class Pace:
    """Watches the times that the steps of a run reach.

    It warns, once, of a run that will take more steps than `many`, and says the reason and the
    remedy in words.
    """

    def __init__(self, t_end: float, many: int, remedy: str) -> None:
        self._t_end, self._many, self._remedy = t_end, many, remedy
        self._least, self._told = _SHARE * t_end, False
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Begin to count at t."""
        self._mark = self._half = self._quarter = t
        self._taken = 0

    def stalls(self, t: float) -> bool:
        """Take note of a step to t; return whether the last hundred led nowhere.

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
        if steady and not (stalled or self._told):
            self._tell(t, (t - self._half) / (_STEPS / 2))
        self.restart(t)
        return stalled

    def _tell(self, t: float, h: float) -> None:
        steps = (self._t_end - t) / h
        if steps > self._many:
            self._told = True
            warnings.warn(
                f"about {steps:.2g} steps are to come, of {h:.2g} s each as the last ones: "
                f"{self._remedy} Ctrl-C ends the run and keeps what is done.",
                ManySteps,
                stacklevel=2,
            )
