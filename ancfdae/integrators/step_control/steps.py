"""Fixed and prescribed steps, and adaptive steps as large as the tolerances allow.

Adaptive steps are accepted if their error e is at most 1.

**Size of the next step.** Where the step jumps, multipliers and accelerations suffer a transient of
first order (docs/theory/13-errors.md); where it changes slowly they keep the order of the method.
So sizes come from a digital filter (H211b of Soderlind 2003, with b = 4), aiming at e = 1/2. With p
the order of the method

    h_{n+1}/h_n = (x_n x_{n-1})^(1/8) (h_n/h_{n-1})^(-1/4),     x = (1/(2 e))^(1/p).

The step of a method that bears jumps follows e at once, h_{n+1}/h_n = x_n.

**Errors that no step removes.** Velocities of HHT-I3 satisfy their constraints up to O(h^2). The
violation delta that a long step leaves, the next step removes by accelerations of the size delta/h,
and e of that step, which goes with h a, is the same for every h. Where e does not fall with h the
step before is repeated with half its size, and if its own e does not fall then, the one before
that.
"""

from __future__ import annotations

import abc
import math
import sys
import warnings
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_array, require_count, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError, ManyStepsWarning
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.integrator import require_rtol
from ancfdae.integrators.step_control.contracts import (
    Controller,
    ErrorController,
    Failure,
    KnownController,
    OneStepMethod,
    StepControl,
    Tolerance,
)
from ancfdae.kernels import (
    FILTER,
    FINISHED,
    NEVER_SOLVED,
    PLANNED,
    judge_step,
    plan_step,
)
from ancfdae.numerics.arrays import Array

# Largest relative difference of the end of the steps from the end time (accumulated round-off).
_WHOLE = 1e-9
# Most steps of one call of the kernel.
_PACKET = 256
# Largest number of steps that a float represents exactly.
_COUNTABLE = 2.0**53
# Most times that are printed; longer lists are shortened.
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
        """Return the controller that takes the known steps."""
        t = self.instants(t_end)
        return StepPlan(self.sizes(t), t[1:])

    @final
    def continues(self, t: Array, state: tuple[float, ...], t_end: float) -> bool:
        known = self.instants(t_end)[: len(t)]
        return len(known) == len(t) and np.allclose(t, known, rtol=_WHOLE, atol=0)


@final
@dataclass(frozen=True)
class FixedSteps(_KnownSteps):
    """Steps of one size, s; InvalidInputError if it is not positive, or its square loses precision.

    If the end time is not a whole number of steps, all are shorter by the same factor. (One shorter
    last step would cost the multipliers of HHT-I3 their order, docs/theory/13-errors.md.)
    """

    step: float

    def __post_init__(self) -> None:
        # Converted to a Python float: single precision of NumPy would spread.
        require_positive("FixedSteps.step", self.step)
        require_square("FixedSteps.step", float(self.step))
        object.__setattr__(self, "step", float(self.step))

    def count(self, t_end: float) -> int:
        """Return the number of steps of at most this size to `t_end`, s."""
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
        """Return the times of the steps, (n + 1,), s, without accumulated round-off."""
        count = self.count(t_end)
        if math.isclose(t_end / count, self.step, rel_tol=_WHOLE):
            return self.step * np.arange(count + 1)
        return np.linspace(0.0, t_end, count + 1)

    def sizes(self, t: Array) -> Array:
        """Return the step size for each step, (n,), s, free of the round-off of the times t."""
        return np.full(len(t) - 1, self._size(t))

    def refined(self, t: Array) -> StepControl:
        """Return a fixed step of half the size."""
        return FixedSteps(self._size(t) / 2)

    def _size(self, t: Array) -> float:
        """Return the step size of a run with times t; s."""
        taken = float(t[1]) if len(t) > 1 else self.step
        return self.step if math.isclose(taken, self.step, rel_tol=_WHOLE) else taken


@final
@dataclass(frozen=True)
class PrescribedSteps(_KnownSteps):
    """Steps between given times, such as the times of another run.

    Times, s, increase from 0; the last one is the end of the run. Raises InvalidInputError
    otherwise.
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
        """Return the number of steps; `t_end` must be the last of the times."""
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
        """Return the given times, (n + 1,), s; InvalidInputError if the run ends elsewhere."""
        self.count(t_end)
        return np.array(self.times)

    def sizes(self, t: Array) -> Array:
        """Return the differences of the times t, (n,); s."""
        return np.diff(t)

    def refined(self, t: Array) -> StepControl:
        """Return steps that halve each step of a run with times t."""
        halves = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])]))
        return PrescribedSteps(tuple(halves.tolist()))


@final
@dataclass(frozen=True, eq=False)
class StepPlan(KnownController):
    """A controller of known steps: sizes and ends of all steps, step n at index n."""

    all_sizes: Array
    ends: Array

    def plan(self, n: int, t: float) -> tuple[float, float] | Verdict:
        """Return size and end of step n."""
        if n == len(self.ends):
            return Verdict.FINISHED
        return float(self.all_sizes[n]), float(self.ends[n])

    def known(self, n: int) -> tuple[Array, Array]:
        """Return sizes and ends of the next steps from step n on; s."""
        packet = slice(n, n + _PACKET)
        return self.all_sizes[packet], self.ends[packet]


def require_square(where: str, value: float) -> None:
    """Raise InvalidInputError for times whose square, or its inverse, loses precision."""
    if not sys.float_info.min < value * value < math.inf:
        repair = "Choose units of time in which the run takes 1e-6 to 1e6."
        raise InvalidInputError(where, "must have a square that is a number", value, repair)


# Least rtol of adaptive steps.
_LEAST_RTOL = 1e-12
# Tolerance of the rough run that determines sizes of derivatives.
_ROUGH = 1e-3
# Number of rows to reserve if the number of steps is not known.
_ROWS = 1000
_AIM = 0.5
#: Numbers of a filter that change in a run and continue it.
_CHANGING = slice(4, FILTER)
_NUMBERS = FILTER - _CHANGING.start


@final
@dataclass(frozen=True)
class AdaptiveSteps(StepControl):
    """Steps under error control.

    Parameters
    ----------
    rtol : float
        Bound of the sum of the errors of all steps, relative to the size of every vector (slope, or
        position from the mean position at the start); the step sizes follow from it. The run errs
        by up to 10 times as much (docs/theory/13-errors.md).
    atol : float, optional
        The same relative to the size of the coordinates at the start (`Scales`), for coordinates
        that pass through zero; by default rtol. With `sensitivities` also relative to the size of
        each derivative: the smaller, the shorter the first steps, where they are zero.
    max_steps : int
        Largest number of steps, rejected ones included, after which a run ends with an outcome.
    sensitivities : bool
        Whether the tolerance also bounds the errors of the design derivatives q_b, each relative to
        its largest size in the run. They are then always integrated with the motion, after a run
        that determines their sizes. Without it gradients of undamped waves can be wrong by any
        factor of the tolerance (docs/reports/work-precision).
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
        """Return the control of the rough run that determines the sizes of the derivatives."""
        return replace(self, rtol=max(self.rtol, _ROUGH), atol=None, sensitivities=False)

    def count(self, t_end: float) -> int:
        """Return a guess of the number of rows to reserve, because the steps are not known."""
        require_positive("t_end", t_end)
        require_square("t_end", float(t_end))
        return _ROWS

    def tolerance(self, t_end: float, sizes: Array, sizes_b: Array) -> Tolerance | None:
        """Return the tolerance for the error of a step, from sizes of states and derivatives."""
        atol = self.rtol if self.atol is None else self.atol
        return Tolerance(self.rtol, atol, t_end, sizes, sizes_b)

    def continues(self, t: Array, state: tuple[float, ...], t_end: float) -> bool:
        """Return whether the state is that of a digital filter, which can continue any run."""
        return len(state) == _NUMBERS

    def controller(
        self, t_end: float, method: OneStepMethod[Any], state: tuple[float, ...] = ()
    ) -> Controller:
        """Return the digital filter; the first step has half the error at which it aims."""
        if state:
            return _Filter(method, 0.0, t_end, self.max_steps, state)
        e, longest = method.start_error(), t_end / 20
        first = longest if e == 0 else min(longest, _root(_AIM / 2 / e, method.order))
        return _Filter(method, first, t_end, self.max_steps)

    def sizes(self, t: Array) -> Array:
        """Return the step sizes between times t, shape (n - 1,); s."""
        return np.diff(t)

    def frozen(self, t: Array) -> StepControl:
        """Return steps at the times t; after a run without steps, control of the motion alone."""
        return (
            PrescribedSteps(tuple(t.tolist())) if len(t) > 1 else replace(self, sensitivities=False)
        )

    def refined(self, t: Array) -> StepControl:
        """Return steps that halve each step of a run with times t."""
        return PrescribedSteps(tuple(t.tolist())).refined(t)


@final
class _Filter(ErrorController):
    """The digital filter of the module, which tries `first`, s, as first step.

    Its formulas are in `kernels/control.h`; they read and change `numbers` (`StepFilter` there).
    """

    def __init__(
        self,
        method: OneStepMethod[Any],
        first: float,
        t_end: float,
        max_steps: int,
        state: tuple[float, ...] = (),
    ) -> None:
        self.stops = np.array(method.system.breakpoints(t_end), dtype=float)
        self.numbers = np.zeros(FILTER)
        self.numbers[:4] = method.order, method.bears_jumps, t_end, max_steps
        # Size, first size, wish, ratio, memory, last size, steps tried, steps left to the end; no
        # attempt to repeat, and no accepted steps.
        begun = first, first, 1.0, 1.0, 0.0, first
        self.numbers[_CHANGING] = state or (*begun, *[0.0] * (_NUMBERS - len(begun)))
        self._pace = Pace(t_end, method.many, method.remedy, max_steps)

    def state(self) -> tuple[float, ...]:
        """Return the numbers of the filter that change in a run, to continue it."""
        return tuple(self.numbers[_CHANGING].tolist())

    def plan(self, n: int, t: float) -> tuple[float, float] | Verdict:
        """Return the proposed step; the last steps before an end change linearly."""
        planned, h, end = plan_step(self.numbers, self.stops, t)
        if planned == PLANNED:
            return h, end
        return Verdict.FINISHED if planned == FINISHED else Verdict.STEP_LIMIT

    def judge(self, n: int, t: float, h: float, error: float | None) -> int | Verdict:
        """Compare the error of the step with the tolerance, and choose the next size."""
        judged = judge_step(self.numbers, n, t, h, error)
        if judged < 0:
            return Verdict.NO_CONVERGENCE if judged == NEVER_SOLVED else Verdict.ERROR_TEST
        if judged == 0:
            self._pace.restart(0.0)
        return judged

    def passed(self, ends: Array, anew: bool) -> tuple[int, Failure | None]:
        """Return how many accepted steps, which end at the times `ends`, pass the check of pace."""
        for k, end in enumerate(ends.tolist()):
            if verdict := self._pace.ends_run(end):
                return k, Failure(verdict, 0.0, self._pace.advice)
        if anew:
            self._pace.restart(0.0)
        return len(ends), None


def _root(x: float, order: int) -> float:
    """Return x^(1/order); the square root is exact to the last bit."""
    return math.sqrt(x) if order == 2 else float(x ** (1 / order))


# A run makes no progress if _STEPS steps together advance by less than _SHARE of the end time.
# Single steps may be lost in round-off: at tight tolerances Newton's method meets it, and SUNDIALS
# tries shorter steps until one succeeds (a pendulum of IDA at 3e-13: five in a row, and the end
# time is reached).
_STEPS, _SHARE = 100, 1e-12
# Steps count as steady if the last quarter of the first hundred advances by a factor between these
# limits relative to the quarter before, or the last half of many hundreds relative to the half
# before: repeated steps disturb quarters where stability or noise limits their size.
_SLOWER, _FASTER = 0.5, 1.5
# None of many steady hundreds advances by less than this share of their mean: bounces of a body,
# each with short and long steps, are not steady.
_LEAST_SHARE = 0.3
# Number of hundreds of steps that must predict too many steps before a warning.
_HUNDREDS = 20
# A run creeps if it would need more than _CREEP times `max_steps` at the mean pace of _CREEPING
# hundreds of steps.
_CREEPING, _CREEP = 50, 100


@final
class Pace:
    """Watches the times that the steps of a run reach; warns if the run will take too many steps.

    It warns once, with the `remedy`, if twenty hundreds of steps predict more than `many` steps; if
    the solver is `sure` of its first steps, the first hundred suffices. Short steps around a kick,
    at a start from rest, or where round-off disturbs some, do not predict the number of later
    steps. A run ends if the last 5,000 steps predict more than 100 times `max_steps`; `advice`
    then says how far these steps came and what to do.
    """

    advice = ""

    def __init__(
        self, t_end: float, many: int, remedy: str, max_steps: int, *, sure: bool = False
    ) -> None:
        self._t_end, self._many, self._remedy, self._max_steps = t_end, many, remedy, max_steps
        self._least, self._told, self._sure = _SHARE * t_end, False, sure
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """Start counting steps anew at time t, s."""
        # Times before and after the last hundreds of steps.
        self._ends = deque([t], maxlen=_CREEPING + 1)
        self._half = self._quarter = t
        self._taken = 0

    def ends_run(self, t: float) -> Verdict | None:
        """Count a step to time t, s; return why the run ends there, or None if it goes on.

        It ends if the last hundred steps made no progress: it diverges, meets a jump too large to
        integrate, or integrates noise. It ends, too, if it creeps. The number of steps of the run
        is predicted from the last steps, unless these still grow.
        """
        self._taken += 1
        if 2 * self._taken == _STEPS:
            self._half = t
        if 4 * self._taken == 3 * _STEPS:
            self._quarter = t
        if self._taken < _STEPS:
            return None
        stalled = t - self._ends[-1] < self._least
        self._taken = 0
        self._ends.append(t)
        if stalled:
            return Verdict.ERROR_TEST
        if not self._told:
            self._warn_of_many(t)
        self._sure = False
        return Verdict.STEPS_TOO_SHORT if self._creeps(t) else None

    def _creeps(self, t: float) -> bool:
        """Return whether the last 5,000 steps, up to time t, s, predict far too many steps."""
        count, way = _CREEPING * _STEPS, t - self._ends[0]
        left = count * (self._t_end - t)
        if len(self._ends) <= _CREEPING or left <= _CREEP * self._max_steps * way:
            return False
        self.advice = (
            f"The last {count} steps, up to t = {t:.6g}, advance by {way:.2g} s, and "
            f"{left / way:.2g} like them are to come: {self._remedy} If the motion becomes slower "
            "later, give a larger max_steps."
        )
        return True

    def _warn_of_many(self, t: float) -> None:
        """Warn if steady steps up to time t, s, predict too many steps."""
        marks, steps, even = [self._half, self._quarter, t], _STEPS // 4, True
        if not self._sure:
            ends = list(self._ends)[-_HUNDREDS - 1 :]
            if len(ends) <= _HUNDREDS:
                return
            marks, steps = [ends[k] for k in (0, _HUNDREDS // 2, -1)], _HUNDREDS * _STEPS // 2
            even = np.diff(ends).min() > _LEAST_SHARE * (t - marks[0]) / _HUNDREDS
        before, last = marks[1] - marks[0], marks[2] - marks[1]
        h = (before + last) / (2 * steps)
        steady = even and _SLOWER * before <= last <= _FASTER * before
        if steady and self._t_end - t > self._many * h:
            self._tell(t, h)

    def _tell(self, t: float, h: float) -> None:
        self._told = True
        warnings.warn(
            f"about {(self._t_end - t) / h:.2g} steps are to come if all are as short as the "
            f"last ones, {h:.2g} s: {self._remedy} Ctrl-C ends the run and keeps what is done.",
            ManyStepsWarning,
            stacklevel=3,
        )
