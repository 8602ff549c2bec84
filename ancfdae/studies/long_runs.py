"""Long runs of which little is kept: some instants, or observables at some instants.

A run is taken part by part, and of each part only what was asked for is kept, so that memory does
not grow with the number of steps.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.files import replacing
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import Statistics
from ancfdae.errors import (
    InvalidInput,
    Outcome,
    Verdict,
    require_array,
    require_count,
    require_each,
    require_kind,
    require_path,
    uninterrupted,
)
from ancfdae.errors.text import columns
from ancfdae.integrators import Integrator, PartwiseIntegrator
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables import Observable, remembered, states_of
from ancfdae.studies.calls import as_system

# Numbers of a part: small against what a run of a million steps holds.
_NUMBERS = 2_000_000
_ARRAYS = ("t", "q", "v", "a", "lam")


@final
@dataclass(frozen=True)
class Observations:
    """Values observed during a run.

    Attributes
    ----------
    t : array, shape (n,)
        Instants; of a run that ended early those that it reached.
    values : array, shape (n, n_observables)
        With a file a view of it.
    steps : int
    outcome : Outcome
    """

    t: Array
    values: Array
    steps: int
    outcome: Outcome

    def __repr__(self) -> str:
        """Return sizes, the last values and the outcome."""
        head = f"Observations: {len(self.t)} instants of {self.steps} steps"
        rows = [["observable", "last value"]]
        rows += [[str(k), f"{x:.6g}"] for k, x in enumerate(self.values[-1] if len(self.t) else ())]
        return f"{head}\n{columns(rows)}\n{self.outcome}"


def simulate_thinned(
    model: Scene | MechanicalSystem,
    t_end: float,
    integrator: Integrator,
    *,
    every: int | None = None,
    at: Sequence[float] | Array | None = None,
) -> Solution:
    """Integrate as `simulate` does, and keep some instants only.

    Parameters
    ----------
    model, t_end, integrator
        As in `simulate`; the integrator is `HHT` at steps that are known before the run. (The
        others keep the instants of their `intervals`.)
    every : int, optional
        Keep the start, every so many steps, and the end.
    at : sequence of float, optional
        Keep these instants, ascending in [0, t_end], interpolated as by `Solution.at`; s. One of
        both is given.

    Raises
    ------
    InvalidInput
        If the input makes no sense; before anything is integrated.
    Interrupted
        At Ctrl-C, with the instants so far.
    """
    run = _LongRun(as_system(model), t_end, integrator, every, at)
    kept, parts = list[Solution](), list[Solution]()
    for part, some in run:
        parts.append(replace(part, **_rows(part, slice(-1, None))))
        kept.append(some)
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(x, name) for x in kept]) for name in _ARRAYS
    }
    counts: dict[str, Any] = {
        each.name: sum(getattr(part.statistics, each.name) for part in parts)
        for each in fields(Statistics)
    }
    # Without the steps in between nothing can go on from its end.
    thin = replace(parts[-1], **arrays, statistics=Statistics(**counts), control=())
    return uninterrupted(thin)


def observations(
    model: Scene | MechanicalSystem,
    observables: Sequence[Observable],
    t_end: float,
    integrator: Integrator,
    *,
    every: int | None = None,
    at: Sequence[float] | Array | None = None,
    file: str | os.PathLike[str] | None = None,
) -> Observations:
    """Integrate and keep observables at some instants only.

    Parameters
    ----------
    model, t_end, integrator, every, at
        As in `simulate_thinned`.
    observables : sequence of Observable
    file : path, optional
        Where rows of the instant and the values go as they arrive: an array of NumPy, (n, 1 + k),
        that ``np.load(file, mmap_mode="r")`` reads; NaN where the run did not get to.

    Raises
    ------
    InvalidInput, Interrupted
        As `simulate_thinned`.
    """
    system = as_system(model)
    repair = "For example position(rod.at_end, 0)."
    observables = require_each("observables", observables, (Observable,), repair)
    for each in observables:
        each.check(system)
    run = _LongRun(system, t_end, integrator, every, at)
    shape = len(run.times), 1 + len(observables)
    rows = np.zeros(shape) if file is None else _on_disk(file, shape)
    done, steps, outcome = 0, 0, Outcome(Verdict.INTERRUPTED, 0.0, 0, 0.0)
    seen = [_Seen(each, system) for each in observables]
    try:
        for part, some in run:
            values = [some.t, *(each.values(part, some) for each in seen)]
            rows[done : done + len(some.t)] = np.transpose(values)
            done, steps, outcome = done + len(some.t), steps + part.statistics.steps, part.outcome
            if isinstance(rows, np.memmap):
                rows.flush()
    except KeyboardInterrupt:  # between parts
        outcome = replace(outcome, verdict=Verdict.INTERRUPTED)
    return uninterrupted(Observations(rows[:done, 0], rows[:done, 1:], steps, outcome))


@final
class _Seen:
    """An observable along the parts of a run; one that remembers is followed over all steps."""

    def __init__(self, observable: Observable, system: MechanicalSystem) -> None:
        self._observable, self._system = observable, system
        self._past: dict[object, float] = {}

    def values(self, part: Solution, some: Solution) -> Array:
        """Return the values at some of the instants within a part."""
        if not self._observable.remembers_any:
            there = len(some.t) > 0
            return self._observable.value(self._system, states_of(some)) if there else some.t
        times = np.union1d(part.t, some.t)
        states = replace(states_of(part.at(times)), past=self._past)
        nodes = self._observable.node_values(self._system, states)
        self._past = remembered(nodes)
        return list(nodes.values())[-1][np.searchsorted(times, some.t)]


def _on_disk(file: str | os.PathLike[str], shape: tuple[int, int]) -> Array:
    """Return an array in a new file, filled with NaN."""
    path = require_path("file", file)
    # Who reads it meanwhile finds rows of NaN, never of zeros.
    with replacing("file", path) as out:
        np.save(out, np.broadcast_to(np.nan, shape))
    rows: Array = np.lib.format.open_memmap(path, mode="r+")
    return rows


@final
class _LongRun:
    """Yields the parts of a run, and of each the instants to keep; `times` are all of these."""

    def __init__(
        self,
        system: MechanicalSystem,
        t_end: float,
        integrator: Integrator,
        every: int | None,
        at: Sequence[float] | Array | None,
    ) -> None:
        require_kind("integrator", integrator, (Integrator,), "For example HHT(step=0.01).")
        if not isinstance(integrator, PartwiseIntegrator):
            rule = "needs one whose runs can be taken part by part, such as HHT"
            repair = "The others keep the instants of their intervals."
            raise InvalidInput("integrator", rule, repr(integrator), repair)
        if (every is None) == (at is None):
            got = "none" if at is None else "both"
            raise InvalidInput("every, at", "needs one of both", got, "For example every=100.")
        self._replay, self._at = integrator.replay(system, t_end), at is not None
        t = self._replay.t
        if at is not None:
            self.times = _instants(at, float(t[-1]))
        else:
            require_count("every", every, "every=100 keeps one instant of 100.")
            kept = np.arange(0, len(t), every)
            self.times = t[kept if kept[-1] == len(t) - 1 else np.append(kept, len(t) - 1)]
        self._length = max(1, _NUMBERS // (3 * system.n_q + system.n_lam + 1))

    def __iter__(self) -> Iterator[tuple[Solution, Solution]]:
        """Integrate; the last part may have failed."""
        node, last = self._replay.start(), len(self._replay.t) - 1
        for first in range(0, last, self._length):
            part, node = self._replay.part(node, first, min(first + self._length, last))
            lowest = -np.inf if first == 0 else part.t[0]
            own = self.times[(self.times > lowest) & (self.times <= part.t[-1])]
            if self._at and len(own):
                yield part, part.at(own)
            else:
                yield part, replace(part, **_rows(part, np.searchsorted(part.t, own)))
            if not part.outcome.success:
                return


def _instants(at: Sequence[float] | Array, end: float) -> Array:
    """Return instants to keep; refuse what does not ascend from 0 to the end."""
    times = require_array("at", at)
    if times.ndim != 1 or not len(times) or np.any(np.diff(times) <= 0):
        raise InvalidInput("at", "must be instants that ascend", repr(at), "Sort them.")
    if times[0] < 0 or times[-1] > end:
        rule = f"must lie in [0, {end:.6g}]"
        raise InvalidInput("at", rule, f"{times[0]:.6g} to {times[-1]:.6g}", "Let the run go on.")
    return times


def _rows(part: Solution, rows: Any) -> dict[str, Any]:
    return {name: getattr(part, name)[rows].copy() for name in _ARRAYS}
