"""Step sizes of HHT-I3: uniform, given, or controlled by the error of a step.

A step with error control is accepted if its error, e of `step_error`, is at most 1.

**Size of the next step.** Where the step jumps, multipliers and accelerations suffer a transient
of first order (docs/theory.md); where it changes slowly they keep their second order. So sizes
come from a digital filter (H211b of Soderlind 2003, with b = 4), aiming at e = 1/2:

    h_{n+1}/h_n = (x_n x_{n-1})^(1/8) (h_n/h_{n-1})^(-1/4),     x = sqrt(1/(2 e)).
"""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from typing import final

from ancfdae.errors import Verdict
from ancfdae.integrators.hht.equations import Coefficients
from ancfdae.integrators.hht.step import Instant
from ancfdae.integrators.hht.step_error import StepError
from ancfdae.integrators.start import InitialSensitivity, InitialState

_AIM = 0.5
# Exponent 1/b of the filter; the error per unit step is of order 2 in the step.
_FILTER = 0.25
# What is left per step of the largest e / h^2 met.
_MEMORY = 0.95
_MOST = 4.0
# The step changes by less than pi/2 of this part.
_CHANGE = 0.2
# A rejection within so many steps of the start begins anew: the start is made for its step.
_RESTART = 10
# So many last steps change linearly, and their number is fixed, to meet the end without a jump.
_LAST_STEPS = 10
# Smaller steps than this part of the run, or of the time reached, are a dead end.
_SMALLEST = 1e-13


class Pace(abc.ABC):
    """What the next step is, and whether the last one counts."""

    @abc.abstractmethod
    def next(self, n: int, t: float) -> tuple[float, float]:
        """Return size and end of the step after instant n at time t."""

    def restarts(self, n: int) -> bool:
        """Whether the run begins anew after a step from instant n was not accepted."""
        return False

    @abc.abstractmethod
    def accepts(self, c: Coefficients, before: Instant, after: Instant | None) -> bool:
        """Judge a step; None stands for one whose equations were not solved."""

    @abc.abstractmethod
    def failure(self) -> Verdict | None:
        """Return why a step that was not accepted cannot be repeated; None if it can."""

    def exhausted(self) -> bool:
        """Whether the steps allowed are used up."""
        return False

    @abc.abstractmethod
    def done(self, n: int, t: float) -> bool:
        """Whether instant n at time t is the end."""


@final
class Uniform(Pace):
    """Steps of one size; times are multiples of it, without accumulated round-off."""

    def __init__(self, step: float, count: int) -> None:
        self._step, self._count = step, count

    def next(self, n: int, t: float) -> tuple[float, float]:
        """Return the step."""
        return self._step, (n + 1) * self._step

    def accepts(self, c: Coefficients, before: Instant, after: Instant | None) -> bool:
        """Accept what was solved."""
        return after is not None

    def failure(self) -> Verdict | None:
        """Name the solver's failure: nothing can be changed."""
        return Verdict.NO_CONVERGENCE

    def done(self, n: int, t: float) -> bool:
        """Whether all steps are taken."""
        return n >= self._count


@final
class Given(Pace):
    """Instants given beforehand, such as those of another run."""

    def __init__(self, times: Sequence[float]) -> None:
        self._times = times

    def next(self, n: int, t: float) -> tuple[float, float]:
        """Return the distance to the next instant, and it."""
        return self._times[n + 1] - self._times[n], self._times[n + 1]

    def accepts(self, c: Coefficients, before: Instant, after: Instant | None) -> bool:
        """Accept what was solved."""
        return after is not None

    def failure(self) -> Verdict | None:
        """Name the solver's failure: nothing can be changed."""
        return Verdict.NO_CONVERGENCE

    def done(self, n: int, t: float) -> bool:
        """Whether the last instant is reached."""
        return n + 1 >= len(self._times)


@final
class Controlled(Pace):
    """Steps as large as the tolerances allow (module description).

    Parameters
    ----------
    error : StepError
    first : float
        First step that is tried.
    max_steps : int
    """

    def __init__(self, error: StepError, first: float, max_steps: int) -> None:
        self._error, self._t_end, self._max_steps = error, error.t_end, max_steps
        self._h = self._start = first
        self._verdict: Verdict | None = None
        self._taken = 0
        self._last_wish = self._last_ratio = 1.0
        self._memory = 0.0
        self._remaining, self._last_h = 0, self._h

    def next(self, n: int, t: float) -> tuple[float, float]:
        """Return the proposed step; the last ones of a run change linearly to meet its end."""
        left = self._t_end - t
        if self._remaining == 0 and left < (_LAST_STEPS + 0.5) * self._h:
            self._remaining = max(1, math.ceil(left / self._h * (1 - 1e-9)))
        count = self._remaining
        if count == 1:
            return left, self._t_end
        h = self._h
        if count > 0:
            # Sizes h_0 (1 + c j), j = 1 .. count, with the sum that is left.
            h = self._last_h * (1 + 2 * (left / self._last_h - count) / (count * (count + 1)))
        end = t + h
        # What the instants will say, so that a run over given ones repeats this one.
        return end - t, end

    def accepts(self, c: Coefficients, before: Instant, after: Instant | None) -> bool:
        """Compare the error of the step with the tolerance, and choose the next size."""
        self._taken += 1
        if after is None:
            return self._reject(c.h / 4, before.node.t, Verdict.NO_CONVERGENCE)
        error = self._error.of_step(c, before, after)
        if not error <= 1.0:
            factor = math.sqrt(_AIM / error) if error < math.inf else 0.0
            return self._reject(c.h * min(0.9, max(0.2, factor)), before.node.t, Verdict.ERROR_TEST)
        # The third derivative passes through zero: without memory the step would leap there.
        self._memory = max(error / c.h**2, _MEMORY * self._memory)
        wish = math.sqrt(_AIM / (self._memory * c.h**2)) if self._memory > 0 else _MOST
        ratio = (wish * self._last_wish) ** (_FILTER / 2) * self._last_ratio**-_FILTER
        ratio = 1 + _CHANGE * math.atan((ratio - 1) / _CHANGE)
        self._last_wish, self._last_ratio = wish, ratio
        self._remaining = max(self._remaining - 1, 0)
        self._h, self._last_h = c.h * ratio, c.h
        return True

    def restarts(self, n: int) -> bool:
        """Whether the start is so near that it can be made for the smaller step."""
        if n > _RESTART:
            return False
        self._h = self._start = min(self._h, 0.5 * self._start)
        self._memory, self._last_h = 0.0, self._h
        return True

    def failure(self) -> Verdict | None:
        """Return what ended the run, or None while it may go on."""
        return self._verdict

    def exhausted(self) -> bool:
        """Whether the steps allowed are used up, repeated ones included."""
        return self._taken >= self._max_steps

    def done(self, n: int, t: float) -> bool:
        """Whether the end is reached."""
        return t >= self._t_end

    def _reject(self, h: float, t: float, why: Verdict) -> bool:
        self._h, self._last_wish, self._last_ratio = h, 1.0, 1.0
        self._remaining, self._last_h = 0, h
        if h <= _SMALLEST * max(t, self._t_end):
            self._verdict = why
        return False


def first_step(
    error: StepError, alpha: float, initial: InitialState, derivative: InitialSensitivity | None
) -> float:
    """Return the step whose estimated error at the start is half of what is aimed at."""
    e = error.of_start(Coefficients.of(1.0, alpha), initial, derivative)
    longest = error.t_end / 20
    return longest if e == 0 else min(longest, math.sqrt(_AIM / 2 / e))
