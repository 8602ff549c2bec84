"""Steps that are known before the run, and steps as large as the tolerances allow.

Steps that are known before the run: of one size, or between given instants.

Steps as large as the tolerances allow.

A step is accepted if its error, e, is at most 1.

**Size of the next step.** Where the step jumps, multipliers and accelerations suffer a transient
of first order (docs/theory/13-errors.md); where it changes slowly they keep the order of the
method. So sizes come from a digital filter (H211b of Soderlind 2003, with b = 4), aiming at
e = 1/2. With p the order of the method

    h_{n+1}/h_n = (x_n x_{n-1})^(1/8) (h_n/h_{n-1})^(-1/4),     x = (1/(2 e))^(1/p).

The step of a method that bears jumps follows e at once, h_{n+1}/h_n = x_n.

**Errors that no step removes.** Velocities of HHT-I3 meet their constraints up to O(h^2). What a
long step leaves of them, delta, the next step removes by accelerations of the size delta/h, and e
of that step, which goes with h a, is the same for every h. Where e does not fall with h the step
before is repeated with half its size, and if its own e does not fall then, the one before that.
"""

from __future__ import annotations

import abc
import math
import sys
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_array, require_count, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.integrator import require_rtol
from ancfdae.integrators.pace import Pace
from ancfdae.integrators.step_control.contracts import (
    BACK,
    Controller,
    OneStepMethod,
    StepControl,
    Tolerance,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import next_end

# Steps may miss the end time by this many parts of their number (accumulated round-off).
_WHOLE = 1e-9
# Steps that are taken at once.
_PACKET = 256
# A number of steps is exact up to here.
_COUNTABLE = 2.0**53
# A longer list of instants is shortened where it is printed.
_SHOWN = 6


class _KnownSteps(StepControl):
    @final
    def tolerance(self, t_end: float, sizes: Array, sizes_b: Array) -> Tolerance | None:
        return None

    @final
    def frozen(self, t: Array) -> StepControl:
        return self

    @abc.abstractmethod
    def instants(self, t_end: float) -> Array:
        """Return the times of a run to `t_end`, s; InvalidInputError if no step ends there."""

    @final
    def controller(
        self, t_end: float, method: OneStepMethod[Any], state: tuple[float, ...] = ()
    ) -> Controller:
        """Return the controller that takes the prescribed steps."""
        t = self.instants(t_end)
        return StepPlan(self.sizes(t), t[1:])

    @final
    def continues(self, t: Array, state: tuple[float, ...], t_end: float) -> bool:
        known = self.instants(t_end)[: len(t)]
        return len(known) == len(t) and np.allclose(t, known, rtol=_WHOLE, atol=0)


@final
@dataclass(frozen=True)
class FixedSteps(_KnownSteps):
    """Steps of one size (s); InvalidInputError if it is not positive, or its square is no number.

    Where the end time is no whole number of them, all are shorter by the same factor. (One shorter
    last step would cost the multipliers of HHT-I3 their order, docs/theory/13-errors.md.)
    """

    step: float

    def __post_init__(self) -> None:
        # Python's numbers: one of NumPy's of single precision would spread its precision.
        require_positive("FixedSteps.step", self.step)
        require_square("FixedSteps.step", float(self.step))
        object.__setattr__(self, "step", float(self.step))

    def count(self, t_end: float) -> int:
        """Return the number of steps of this size at most."""
        require_positive("t_end", t_end)
        steps = t_end / self.step
        if not steps < _COUNTABLE:
            rule, got = f"must be within {_COUNTABLE:.0e} steps", f"{t_end:.6g}"
            repair = f"Use a step above {self.step:.6g}."
            raise InvalidInputError("t_end", rule, got, repair)
        count = max(1, math.ceil(steps * (1 - _WHOLE)))
        require_square("t_end", t_end / count)
        return count

    def instants(self, t_end: float) -> Array:
        """Return multiples of the step, without accumulated round-off."""
        count = self.count(t_end)
        if self._is_step(t_end / count):
            return self.step * np.arange(count + 1)
        return np.linspace(0.0, t_end, count + 1)

    def sizes(self, t: Array) -> Array:
        """Return the step, free of the round-off of the instants."""
        return np.full(len(t) - 1, self._size(t))

    def refined(self, t: Array) -> StepControl:
        """Return a fixed step of half the size."""
        return FixedSteps(self._size(t) / 2)

    def _size(self, t: Array) -> float:
        """Return the step of a run with the instants t."""
        taken = float(t[1]) if len(t) > 1 else self.step
        return self.step if self._is_step(taken) else taken

    def _is_step(self, taken: float) -> bool:
        return math.isclose(taken, self.step, rel_tol=_WHOLE)


@final
@dataclass(frozen=True)
class PrescribedSteps(_KnownSteps):
    """Steps between given instants, such as those of another run.

    They increase from 0 on (s); the last one is the end of the run. InvalidInputError if they do
    not.
    """

    times: tuple[float, ...]

    def __post_init__(self) -> None:
        where, t = "PrescribedSteps.times", require_array("PrescribedSteps.times", self.times)
        repair = "Take the instants of a solution, or np.linspace(0, t_end, n)."
        if t.ndim != 1 or len(t) < 2:
            got = f"{len(t)} instant(s)" if t.ndim == 1 else f"an array of shape {t.shape}"
            raise InvalidInputError(where, "must be two or more instants", got, repair)
        if t[0] != 0.0:
            raise InvalidInputError(where, "must begin at 0, as every run does", t[0], repair)
        falls = np.flatnonzero(np.diff(t) <= 0)
        if len(falls):
            k = int(falls[0]) + 1
            got = f"times[{k}] = {t[k]:.6g} after times[{k - 1}] = {t[k - 1]:.6g}"
            raise InvalidInputError(where, "must increase", got, "Sort them, each instant once.")
        require_square("steps of PrescribedSteps.times", float(np.min(np.diff(t))))
        object.__setattr__(self, "times", tuple(t.tolist()))

    def __repr__(self) -> str:
        if len(self.times) <= _SHOWN:
            return f"PrescribedSteps(times={self.times})"
        first = ", ".join(map(repr, self.times[:3]))
        return f"PrescribedSteps(times=({first}, ..., {self.times[-1]!r}))"

    def count(self, t_end: float) -> int:
        """Return the number of steps; the end must be the last instant."""
        require_positive("t_end", t_end)
        last = self.times[-1]
        if not math.isclose(last, t_end, rel_tol=_WHOLE):
            raise InvalidInputError(
                "t_end",
                f"must be where the given instants end, PrescribedSteps.times[-1] = {last:.6g}",
                t_end,
                f"Run to t_end = {last:.6g}, or give instants up to {t_end:.6g}.",
            )
        return len(self.times) - 1

    def instants(self, t_end: float) -> Array:
        """Return the given times, shape (n + 1,), s; refuse a run that ends elsewhere."""
        self.count(t_end)
        return np.array(self.times)

    def sizes(self, t: Array) -> Array:
        """Return the distances of the instants."""
        return np.diff(t)

    def refined(self, t: Array) -> StepControl:
        """Return steps that halve each step of a run with times t."""
        halves = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])]))
        return PrescribedSteps(tuple(halves.tolist()))


@final
@dataclass(frozen=True, eq=False)
class StepPlan(Controller):
    """Sizes and ends of all steps, of the one that begins at instant n at place n."""

    all_sizes: Array
    ends: Array

    def plan(self, n: int, t: float) -> tuple[float, float] | Verdict:
        """Return the step as it is known."""
        if n == len(self.ends):
            return Verdict.FINISHED
        return float(self.all_sizes[n]), float(self.ends[n])

    def known(self, n: int) -> tuple[Array, Array]:
        """Return sizes and ends of the next steps from step n on; s."""
        packet = slice(n, n + _PACKET)
        return self.all_sizes[packet], self.ends[packet]

    def judge(self, n: int, t: float, h: float, error: float | None) -> int | Verdict:
        """Go on if the step was solved."""
        return Verdict.NO_CONVERGENCE if error is None else n + 1

    def state(self) -> tuple[float, ...]:
        """Return nothing: the instants say it all."""
        return ()


def require_square(where: str, value: float) -> None:
    """Refuse times whose square, or its inverse, is no number of full precision."""
    if not sys.float_info.min < value * value < math.inf:
        repair = "Choose units of time in which the run takes 1e-6 to 1e6."
        raise InvalidInputError(where, "must have a square that is a number", value, repair)


# Second order asks for a tolerance of the same size where coordinates pass through zero.
_LEAST_RTOL = 1e-12
# Sizes of derivatives need no better tolerance.
_ROUGH = 1e-3
# Instants to allot memory for where their number is not known.
_ROWS = 1000
_AIM = 0.5
# Exponent 1/b of the filter.
_FILTER = 0.25
# What is left per step of the largest e / h^p met.
_MEMORY = 0.95
_MOST = 4.0
# The step changes by less than pi/2 of this part.
_CHANGE = 0.2
# A step rejected among the first _RESTART restarts the run: the start is made for its step size.
_RESTART = 10
# The last _LAST_STEPS steps change linearly, and their number is fixed, to meet the end without a
# jump; a method that bears jumps takes _LAST_EQUAL equal steps instead.
_LAST_STEPS, _LAST_EQUAL = 10, 1
# Where a step is shorter than the attempt before by the first factor its error is smaller by the
# second, unless it stems from the state before the step.
_SHORTER, _SMALLER = 0.7, 0.8
# A run ends where the step falls below this part of its length, or of the time reached.
_SMALLEST = 1e-13
# Numbers of `_Filter.state`.
_NUMBERS = 8


@final
@dataclass(frozen=True)
class AdaptiveSteps(StepControl):
    """Steps under error control.

    Parameters
    ----------
    rtol : float
        What the errors of all steps may add up to, relative to the size of every vector (slope,
        or position from the mean position at the start); the step follows from it. The run errs
        by up to 10 times as much (docs/theory/13-errors.md).
    atol : float, optional
        The same relative to the size of the coordinates at the start (`Scales`), for coordinates
        that pass through zero; by default rtol. With `sensitivities` also relative to the size of
        each derivative: the smaller, the shorter the first steps, where they are zero.
    max_steps : int
        Steps, repeated ones included, before a run ends with an outcome.
    sensitivities : bool
        Whether the tolerance also bounds the errors of the design derivatives q_b, each relative
        to its largest size in the run. They are then always integrated with the
        motion, after a run that determines their sizes. Without it gradients of undamped waves can
        be wrong by any factor of the tolerance (docs/reports/work-precision).
    """

    kind: ClassVar[str] = "controlled"

    rtol: float
    atol: float | None = None
    max_steps: int = 1_000_000
    sensitivities: bool = False

    def __post_init__(self) -> None:
        # Python's numbers: one of NumPy's of single precision would spread its precision.
        require_rtol("AdaptiveSteps.rtol", self.rtol, _LEAST_RTOL)
        object.__setattr__(self, "rtol", float(self.rtol))
        if self.atol is not None:
            require_positive("AdaptiveSteps.atol", self.atol)
            object.__setattr__(self, "atol", float(self.atol))
        require_count("AdaptiveSteps.max_steps", self.max_steps, "1000000 is plenty.")
        where = "AdaptiveSteps.sensitivities"
        require_kind(where, self.sensitivities, (bool,), "True or False.")

    def rough(self) -> AdaptiveSteps:
        """Return the control of the run from which the sizes of the derivatives are read."""
        return replace(self, rtol=max(self.rtol, _ROUGH), atol=None, sensitivities=False)

    def count(self, t_end: float) -> int:
        """Return a guess of the number of rows to reserve: the steps are not known."""
        require_positive("t_end", t_end)
        require_square("t_end", float(t_end))
        return _ROWS

    def tolerance(self, t_end: float, sizes: Array, sizes_b: Array) -> Tolerance | None:
        """Return the tolerance for the error of a step, from sizes of states and derivatives."""
        atol = self.rtol if self.atol is None else self.atol
        return Tolerance(self.rtol, atol, t_end, sizes, sizes_b)

    def continues(self, t: Array, state: tuple[float, ...], t_end: float) -> bool:
        """Whether the state is one of the filter."""
        return len(state) == _NUMBERS

    def controller(
        self, t_end: float, method: OneStepMethod[Any], state: tuple[float, ...] = ()
    ) -> Controller:
        """Return the digital filter; the first step has half the error that it aims at."""
        if state:
            return _Filter(method, 0.0, t_end, self.max_steps, state)
        e, longest = method.start_error(), t_end / 20
        first = longest if e == 0 else min(longest, _root(_AIM / 2 / e, method.order))
        return _Filter(method, first, t_end, self.max_steps)

    def sizes(self, t: Array) -> Array:
        """Return the step sizes between times t, shape (n - 1,); s."""
        return np.diff(t)

    def frozen(self, t: Array) -> StepControl:
        """Return the instants; of a run that never left its start, control of the motion."""
        return (
            PrescribedSteps(tuple(t.tolist())) if len(t) > 1 else replace(self, sensitivities=False)
        )

    def refined(self, t: Array) -> StepControl:
        """Return steps that halve each step of a run with times t."""
        return PrescribedSteps(tuple(t.tolist())).refined(t)


@final
class _Filter(Controller):
    """The digital filter of the module description, which tries the step `first` first."""

    def __init__(
        self,
        method: OneStepMethod[Any],
        first: float,
        t_end: float,
        max_steps: int,
        state: tuple[float, ...] = (),
    ) -> None:
        self._order, self._bears_jumps = method.order, method.bears_jumps
        self._last_steps = _LAST_EQUAL if method.bears_jumps else _LAST_STEPS
        self._t_end, self._max_steps = t_end, max_steps
        self._breakpoints = method.system.breakpoints(t_end)
        self._h = self._start = first
        self._taken = 0
        # Sizes and errors of the last steps; instant, size and error of an attempt to be repeated.
        self._accepted = deque[tuple[float, float]](maxlen=BACK)
        self._tried = (-1, 0.0, 0.0)
        self._last_wish = self._last_ratio = 1.0
        self._memory = 0.0
        self._remaining, self._last_h = 0, self._h
        self._pace = Pace(t_end, method.many, method.remedy)
        if state:
            self._h, self._start, self._last_wish, self._last_ratio, self._memory = state[:5]
            self._last_h, taken, remaining = state[5:]
            self._taken, self._remaining = int(taken), int(remaining)

    def state(self) -> tuple[float, ...]:
        """Return the numbers of the filter that change in a run, to continue it."""
        sizes = self._h, self._start, self._last_wish, self._last_ratio, self._memory
        return *sizes, self._last_h, float(self._taken), float(self._remaining)

    def plan(self, n: int, t: float) -> tuple[float, float] | Verdict:
        """Return the proposed step; the last ones before an end change linearly."""
        if t >= self._t_end:
            return Verdict.FINISHED
        if self._taken >= self._max_steps:
            return Verdict.STEP_LIMIT
        stop = next_end(self._breakpoints, t, self._t_end)
        left = stop - t
        if self._remaining == 0 and left < (self._last_steps + 0.5) * self._h:
            self._remaining = max(1, math.ceil(left / self._h * (1 - 1e-9)))
        count = self._remaining
        if count == 1:
            return left, stop
        h = self._h
        if count > 0:
            # Sizes h_0 (1 + c j), j = 1 .. count, with the sum that is left.
            h = self._last_h * (1 + 2 * (left / self._last_h - count) / (count * (count + 1)))
        end = t + h
        # What the instants will say, so that a run over given ones repeats this one.
        return end - t, end

    def judge(self, n: int, t: float, h: float, error: float | None) -> int | Verdict:
        """Compare the error of the step with the tolerance, and choose the next size."""
        self._taken += 1
        if error is None:
            return self._reject(n, t, h / 4, Verdict.NO_CONVERGENCE)
        at, longer, larger = self._tried
        stays = n == at and h < _SHORTER * longer and error > _SMALLER * larger
        if stays and error > _AIM / 2 and self._accepted:
            return self._back(n)
        if not error <= 1.0:
            self._tried = (n, h, error)
            factor = _root(_AIM / error, self._order) if error < math.inf else 0.0
            return self._reject(n, t, h * min(0.9, max(0.2, factor)), Verdict.ERROR_TEST)
        # What the error estimates passes through zero; without memory the step would grow far too
        # much there.
        before = 0.0 if self._bears_jumps else _MEMORY * self._memory
        self._memory = max(error / h**self._order, before)
        wish = _MOST
        if self._memory > 0:
            wish = _root(_AIM / (self._memory * h**self._order), self._order)
        ratio = min(wish, _MOST)
        if not self._bears_jumps:
            ratio = (wish * self._last_wish) ** (_FILTER / 2) * self._last_ratio**-_FILTER
            ratio = 1 + _CHANGE * math.atan((ratio - 1) / _CHANGE)
        self._last_wish, self._last_ratio = wish, ratio
        self._remaining = max(self._remaining - 1, 0)
        self._h, self._last_h = h * ratio, h
        self._accepted.append((h, error))
        return Verdict.ERROR_TEST if self._pace.stalls(t + h) else n + 1

    def _back(self, n: int) -> int:
        """Repeat the step before with half its size."""
        h, error = self._accepted.pop()
        self._tried = (n - 1, h, error)
        self._h = self._last_h = 0.5 * h
        self._last_wish, self._last_ratio, self._remaining = 1.0, 1.0, 0
        return n - 1

    def _reject(self, n: int, t: float, h: float, why: Verdict) -> int | Verdict:
        """Choose a smaller step; near the start, which is made for its step, begin anew with it."""
        if h <= _SMALLEST * max(t, self._t_end):
            return why
        anew = n <= _RESTART and not self._bears_jumps
        if anew:
            h = self._start = min(h, 0.5 * self._start)
            self._memory = 0.0
        self._h = self._last_h = h
        self._last_wish, self._last_ratio, self._remaining = 1.0, 1.0, 0
        if anew:
            self._accepted.clear()
            self._pace.restart(0.0)
        return 0 if anew else n


def _root(x: float, order: int) -> float:
    """Return x^(1/order); the square root is exact to the last bit."""
    return math.sqrt(x) if order == 2 else float(x ** (1 / order))
