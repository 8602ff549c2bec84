"""Tells when a run gets nowhere."""

from __future__ import annotations

from typing import final

# Steps that together advance by less than this share of the end time. Single steps may be lost in
# round-off: at tight tolerances Newton's method meets it, and SUNDIALS tries shorter steps until it
# gets on (a pendulum of IDA at 3e-13: five in a row, and the end time is reached).
_STEPS, _SHARE = 100, 1e-12


@final
class Progress:
    """Watches the times that a solver reaches.

    Parameters
    ----------
    t_end : float
    """

    def __init__(self, t_end: float) -> None:
        self._mark, self._least, self._taken = 0.0, _SHARE * t_end, 0

    def stalls(self, t: float) -> bool:
        """Take note of a step to t; return whether the last hundred led nowhere.

        So end a blow-up, a jump too large to integrate, and noise.
        """
        self._taken += 1
        if self._taken < _STEPS:
            return False
        stalled = t - self._mark < self._least
        self._mark, self._taken = t, 0
        return stalled
