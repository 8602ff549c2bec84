"""Steps that are known before the run: of one size, or between given instants."""

import abc
import math
import sys
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_array, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.step_control.contracts import (
    Controller,
    OneStepMethod,
    StepControl,
)
from ancfdae.integrators.step_control.tolerance import Tolerance
from ancfdae.numerics.arrays import Array

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
        """Return the given times, shape (n + 1,), s; InvalidInputError if the run ends elsewhere."""
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
