"""Runs of any number of steps, integrated part by part; only some times of each are stored."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import Statistics
from ancfdae.errors.checks import require_array, require_count
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import Integrator, PartwiseIntegrator
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.timing import progress_bar

# An int k: every k-th step, with the start and the end. A sequence: times whose states are stored.
Keep: TypeAlias = int | Sequence[float] | Array

# Largest number of entries of a part: small compared with a run of a million steps.
_NUMBERS = 2_000_000
_ARRAYS = ("t", "q", "v", "a", "lam")


@final
class RunOfParts:
    """A run integrated part by part; iteration yields each part and its states to store.

    `times` are the times of all states to store, s.
    """

    def __init__(
        self,
        system: MechanicalSystem,
        t_end: float,
        integrator: Integrator,
        keep: Keep,
        progress: bool = False,
    ) -> None:
        if not isinstance(integrator, PartwiseIntegrator):
            rule = "needs one whose runs can be taken part by part, such as HHT"
            repair = "The others keep the instants of their intervals."
            raise InvalidInputError("keep, integrator", rule, repr(integrator), repair)
        self._system, self._progress = system, progress
        self._run = in_one_thread(integrator.replay)(system, t_end)
        t, self._between = self._run.t, not isinstance(keep, int)
        if isinstance(keep, int):
            require_count("keep", keep, "keep=100 keeps one instant of 100.")
            kept = np.arange(0, len(t), min(keep, len(t)) * self._run.degree)
            self.times = t[kept if kept[-1] == len(t) - 1 else np.append(kept, len(t) - 1)]
        else:
            self.times = instants("keep", keep, float(t[-1]))
        steps = _NUMBERS // (self._run.degree * (3 * system.n_q + system.n_lam + 1))
        self._length = max(1, steps) * self._run.degree

    def __iter__(self) -> Iterator[tuple[Solution, Solution]]:
        """Integrate; yield each part of the run with its states to store.

        The last may have failed.
        """
        node, last = in_one_thread(self._run.start)(), len(self._run.t) - 1
        with progress_bar(self._progress, total=last, unit="step") as bar:
            for first in range(0, last, self._length):
                end = min(first + self._length, last)
                part, node = in_one_thread(self._run.part)(node, first, end)
                from ancfdae.modes.analysis import advised

                part = advised(self._system, part)
                bar.update(len(part.t) - 1)
                lowest = -np.inf if first == 0 else part.t[0]
                times = self.times[(self.times > lowest) & (self.times <= part.t[-1])]
                if self._between and len(times):
                    yield part, part.at(times)
                else:
                    rows = _rows(part, np.searchsorted(part.t, times))
                    yield part, replace(part, **rows, degree=1)
                if not part.outcome.success:
                    return

    def solution(self) -> Solution:
        """Integrate all parts of the run, and return the stored states as one solution."""
        kept, ends = list[Solution](), list[Solution]()
        for part, some in self:
            ends.append(replace(part, **_rows(part, slice(-1, None))))
            kept.append(some)
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(x, name) for x in kept]) for name in _ARRAYS
        }
        counts: dict[str, Any] = {
            each.name: sum(getattr(end.statistics, each.name) for end in ends)
            for each in fields(Statistics)
        }
        # Without the steps in between the run cannot be continued: no `control`.
        told = Statistics(**counts)
        return replace(ends[-1], **arrays, statistics=told, degree=1, control=())


def instants(where: str, given: Sequence[float] | Array, end: float) -> Array:
    """Return times of a run as an array, shape (n,); s.

    Raises InvalidInputError unless they ascend and lie in [0, end].
    """
    times = require_array(where, given)
    if times.ndim != 1 or not len(times) or np.any(np.diff(times) <= 0):
        rule, repair = "must be ascending times", "For example np.linspace(0, t_end, 101)."
        raise InvalidInputError(where, rule, repr(given), repair)
    if times[0] < 0 or times[-1] > end:
        rule = f"must lie in [0, {end:.6g}]"
        raise InvalidInputError(
            where, rule, f"{times[0]:.6g} to {times[-1]:.6g}", "Let the run go on."
        )
    return times


def _rows(part: Solution, rows: Any) -> dict[str, Any]:
    return {name: getattr(part, name)[rows].copy() for name in _ARRAYS}
