"""Observables at some times of a run of any number of steps."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.event_solution import EventRecord
from ancfdae.equations.files import replacing
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_each, require_kind, require_path
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import RunOutcome, Verdict, uninterrupted
from ancfdae.errors.text import PrintedTable, TableText
from ancfdae.events.calls import EventRun, solution
from ancfdae.events.kinds import Event, Mode
from ancfdae.events.objectives import SAME
from ancfdae.events.phases import Phase
from ancfdae.events.thinning import only_ends, thinned
from ancfdae.integrators.integrator import Integrator
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Observable, remembered, states_of
from ancfdae.studies.calls import as_system
from ancfdae.studies.events import kept_states
from ancfdae.studies.parts import Keep, RunOfParts


@final
@dataclass(frozen=True, repr=False)
class ObservableRecord(PrintedTable):
    """Values observed during a run.

    Attributes
    ----------
    t : array, shape (n,)
        Times of the values, up to the time that the run reached; s.
    values : array, shape (n, n_observables)
        Values of the observables at `t`, each in its unit; a view of the file if there is one.
    steps : int
    outcome : RunOutcome
    events : tuple of EventRecord
        Events of the run in the order of time.
    """

    t: Array
    values: Array
    steps: int
    outcome: RunOutcome
    events: tuple[EventRecord, ...] = ()

    def to_dataframe(self) -> Any:
        """Return the values as a pandas table, with t as its index and observables by number."""
        names = [str(k) for k in range(self.values.shape[1])]
        index = pandas().Index(self.t, name="t")
        return pandas().DataFrame(np.asarray(self.values), index=index, columns=names)

    def _printed(self) -> TableText:
        head = f"ObservableRecord: {len(self.t)} instants of {self.steps} steps"
        rows = [["observable", "last value"]]
        rows += [[str(k), f"{x:.6g}"] for k, x in enumerate(self.values[-1] if len(self.t) else ())]
        return head, rows, str(self.outcome)


def record_observables(
    model: Scene | MechanicalSystem,
    observables: Sequence[Observable],
    t_end: float,
    integrator: Integrator,
    *,
    keep: Keep,
    file: str | os.PathLike[str] | None = None,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> ObservableRecord:
    """Integrate a model and store observables at some times only, in bounded memory.

    Parameters
    ----------
    model, t_end, integrator, keep, events, modes, progress
        As in `simulate`. With events an int `keep` also stores both sides of every event, and a
        sequence of times has the value before an event at its time. The memory is that of the
        longest phase.
    observables : sequence of Observable
    file : path, optional
        File to which rows of time and values are written as they arrive: a NumPy array, (n, 1 + k),
        that ``np.load(file, mmap_mode="r")`` reads; NaN for times that the run did not reach. With
        events `keep` must then be a sequence of times.
    """
    system = as_system(model)
    repair = "For example position(rod.at_end, 0)."
    observables = require_each("observables", observables, (Observable,), repair)
    for each in observables:
        each.check(system)
    require_kind("integrator", integrator, (Integrator,), "For example HHT(step=0.01).")
    if events is not None or modes is not None:
        made = EventRun.of(system, t_end, integrator, events or (), modes, None, progress)
        return _with_events(made, observables, keep, file)
    run = RunOfParts(system, t_end, integrator, keep, progress)
    shape = len(run.times), 1 + len(observables)
    rows = np.zeros(shape) if file is None else _on_disk(file, shape)
    done, steps, outcome = 0, 0, RunOutcome(Verdict.INTERRUPTED, 0.0, 0, 0.0)
    seen = [_Seen(each) for each in observables]
    try:
        for part, some in run:
            values = [some.t, *(each.values(system, part, some) for each in seen)]
            rows[done : done + len(some.t)] = np.transpose(values)
            done, steps, outcome = done + len(some.t), steps + part.statistics.steps, part.outcome
            if isinstance(rows, np.memmap):
                rows.flush()
    except KeyboardInterrupt:  # between parts
        outcome = replace(outcome, verdict=Verdict.INTERRUPTED)
    return uninterrupted(ObservableRecord(rows[:done, 0], rows[:done, 1:], steps, outcome))


@final
class _Seen:
    """One observable along the parts of a run; one with memory is evaluated at all steps."""

    def __init__(self, observable: Observable) -> None:
        self._observable = observable
        self._past: dict[object, float] = {}

    def values(self, system: MechanicalSystem, part: Solution, some: Solution) -> Array:
        """Return the observable at the times `some.t` of a part of the run, shape (n,)."""
        if not self._observable.remembers_any:
            there = len(some.t) > 0
            return self._observable.value(system, states_of(some)) if there else some.t
        times = np.union1d(part.t, some.t)
        states = replace(states_of(part.at(times)), past=self._past)
        nodes = self._observable.node_values(system, states)
        self._past = remembered(nodes)
        return list(nodes.values())[-1][np.searchsorted(times, some.t)]


def _with_events(
    run: EventRun,
    observables: Sequence[Observable],
    keep: Keep,
    file: str | os.PathLike[str] | None,
) -> ObservableRecord:
    """Return the record of a run with events, each phase of which is left when it is observed."""
    for mode, each in product(run.modes.values(), observables):
        each.check(mode.system)
    asked = kept_states(keep, run.t_end)
    if file is not None and isinstance(asked, int):
        rule = "must be a sequence of times with a file and events"
        repair = "The number of steps is not known before the run: np.linspace(0, t_end, 1001)."
        raise InvalidInputError("keep", rule, repr(keep), repair)
    shape = (0 if isinstance(asked, int) else len(asked)), 1 + len(observables)
    rows = None if file is None else _on_disk(file, shape)
    seen, found, done = [_Seen(each) for each in observables], [np.zeros((0, shape[1]))], 0

    def observed(phase: Phase) -> Phase:
        nonlocal done
        part = replace(phase.run, t=phase.times)
        if isinstance(asked, int):
            thin = thinned(asked)(phase)
            some = replace(thin.run, t=thin.times)
        else:
            last = np.searchsorted(asked, part.t[-1] + SAME * run.t_end, side="right")
            times = np.clip(asked[done:last], part.t[0], part.t[-1])
            some = part.at(times) if len(times) else replace(part, t=times)
        system = phase.mode.system
        values = [some.t, *(each.values(system, part, some) for each in seen)]
        found.append(np.transpose(values))
        if rows is not None:
            rows[done : done + len(some.t)] = found.pop()
            rows.flush()
        done += len(some.t)
        return only_ends(phase)

    ended = solution(run.phased(thin=observed))
    table = np.concatenate(found) if rows is None else rows[:done]
    outcome = ended.outcome
    record = ObservableRecord(table[:, 0], table[:, 1:], outcome.step, outcome, ended.events)
    return uninterrupted(record)


def _on_disk(file: str | os.PathLike[str], shape: tuple[int, int]) -> np.memmap[Any, Any]:
    """Return an array in a new file, memory-mapped and filled with NaN."""
    path = require_path("file", file)
    # A reader in the meantime finds rows of NaN, never zeros.
    with replacing("file", path) as out:
        np.save(out, np.broadcast_to(np.nan, shape))
    return np.lib.format.open_memmap(path, mode="r+")
