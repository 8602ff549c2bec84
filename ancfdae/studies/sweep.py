"""The call `sweep`: one function at many designs, in this process or in workers."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ancfdae.assembly.system import assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.complex_steps import at_values
from ancfdae.errors.checks import (
    require_count,
    require_flag,
    require_folder,
    require_kind,
    require_path,
    require_positive,
    require_sequence,
)
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError, UnknownNameError
from ancfdae.errors.outcomes import Interrupted
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.sensitivity.method import GradientMethod, Run, finished
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import Observable, observe, states_of
from ancfdae.studies.calls import as_system, gradient
from ancfdae.studies.jobs import answers
from ancfdae.studies.sweep_file import Sweep, SweepFile, SweepRow

if TYPE_CHECKING:
    from ancfdae.events.kinds import Event, Mode

Design = Mapping[str | DesignVariable, float]


@final
@dataclass(frozen=True)
class Evaluator:
    """Function of a model for `sweep`: the value of an objective, its gradient, or an observable.

    Parameters
    ----------
    of : Objective or Observable
    t_end : float
        End time; s.
    integrator : Integrator
    gradient : bool
        Whether to compute the gradient of an objective, too.
    design : sequence of str or DesignVariable, optional
        Design variables of the gradient, as in `gradient`.
    method : GradientMethod, optional
        As in `gradient`.
    events : sequence of Event, optional
    modes : mapping of str to Mode, optional
        As in `simulate`; the models of modes take the values of a design as the model does.
    """

    of: Objective | Observable
    t_end: float
    integrator: Integrator
    gradient: bool = False
    design: Sequence[str | DesignVariable] | None = None
    method: GradientMethod | None = None
    events: Sequence[Event] | None = None
    modes: Mapping[str, Mode] | None = None

    def __post_init__(self) -> None:
        require_flag("Evaluator.gradient", self.gradient)
        kinds = (Objective,) if self.gradient else (Objective, Observable)
        require_kind("Evaluator.of", self.of, kinds, "For example Terminal(position(...)).")
        require_kind("Evaluator.integrator", self.integrator, (Integrator,), "Give HHT(step=0.01).")
        require_positive("Evaluator.t_end", self.t_end)
        if self.design is not None:
            as_design(self.design)

    def __call__(self, model: Scene | MechanicalSystem) -> dict[str, Any]:
        """Run the model; return ``value``, with ``gradient``, or times ``t`` of an observable."""
        if self.gradient:
            assert isinstance(self.of, Objective)
            settings = {
                "design": self.design,
                "method": self.method,
                "events": self.events,
                "modes": self.modes,
            }
            answer = gradient(model, self.of, self.t_end, self.integrator, **settings)  # type: ignore[arg-type]
            return {"value": answer.value, "gradient": answer.gradient}
        system = as_system(model)
        if self.events is not None or self.modes is not None:
            return self._with_events(system)
        run = Run(system, self.t_end, self.integrator)
        if isinstance(self.of, Observable):
            solution = finished(run.solution())
            return {"value": observe(self.of, solution, system), "t": solution.t}
        self.of.check(system, self.t_end)
        solution, totals = run.integrals([self.of], differentiated=False)
        return {"value": self.of.value(system, states_of(solution), totals)}

    def _with_events(self, system: MechanicalSystem) -> dict[str, Any]:
        """Run a system with events; return ``value``, with times ``t`` for an observable."""
        from ancfdae.events.calls import EventRun
        from ancfdae.studies.events import observed, values

        events = self.events or ()
        run = EventRun.of(system, self.t_end, self.integrator, events, self.modes, None, False)
        if isinstance(self.of, Observable):
            found, value = observed(run, self.of)
            return {"value": value, "t": found.t}
        self.of.check(system, self.t_end)
        return {"value": float(values(run, [self.of])[1][0])}

    def at(self, design: Design) -> Evaluator:
        """Return the same function with the models of its modes at the values of a design."""
        moved = {
            name: replace(mode, model=_model_at(mode.model, design))
            for name, mode in (self.modes or {}).items()
        }
        return replace(self, modes=moved)


def sweep(
    model: Scene | MechanicalSystem,
    designs: Sequence[Design] | Array,
    what: Callable[[Any], Any],
    *,
    design: Sequence[str | DesignVariable] | None = None,
    executor: Executor | None = None,
    chunk: int = 1,
    file: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Sweep:
    """Return the results of a function at many designs; a failed design is a row with its error.

    Parameters
    ----------
    designs : sequence of mappings, or array, shape (n, n_b)
        Values by target or `DesignVariable`, as `Scene.with_values` takes them, for a system by the
        names of its design variables; or a row of values per design, for the variables `design`.
    what : callable
        Function of the model at the values of a design; `Evaluator` or a user-defined function.
    design : sequence of str or DesignVariable, optional
        Variables of the columns of `designs`; for a system by default all its design variables.
    executor : concurrent.futures.Executor, optional
        Executor of the calls, for example ``ProcessPoolExecutor(2)`` or ``client.get_executor()``
        of Dask; by default they run in this process, one after the other. Model and `what` must
        pickle.
    chunk : int
        Number of designs sent to a worker together, more than one for short calls: sending costs
        0.2 ms by processes, 4 ms by Dask. A chunk arrives, or is lost, as a whole.
    file : path, optional
        File to which rows are appended as they arrive, one JSON object a line; rows that it already
        holds are not computed again. Results must be numbers, texts, arrays, lists or mappings.
    progress : bool
        Whether to show a progress bar.
    """
    _check(model, what, executor, chunk, progress)
    given = _mappings(model, designs, design)
    values = [{_name(key): value for key, value in each.items()} for each in given]
    path = None if file is None else require_folder("file", require_path("file", file))
    kept = None if path is None else SweepFile(path, model, what, values)
    rows = {} if kept is None else kept.rows()
    study = _Study(model, what)
    tasks = {k: _Task(study, x, values[k]) for k, x in enumerate(given) if k not in rows}
    parts = {"model": model, "what": what}
    arriving = answers(_row, tasks, executor, parts, progress=progress, done=len(rows), chunk=chunk)
    # In this process the threads of linear algebra are limited once, not for each run.
    here = executor is None and isinstance(what, Evaluator)
    collect = in_one_thread(_collect) if here else _collect
    interrupted = collect(arriving, rows, values, kept)
    _assembled.cache_clear()
    left = "not computed: the sweep was interrupted"
    in_order = (rows.get(k) or SweepRow(x, None, left) for k, x in enumerate(values))
    done = Sweep(tuple(in_order))
    if interrupted:
        raise Interrupted(done, f"{len(rows)} of {len(values)} designs were done")
    return done


def _check(model: object, what: object, executor: object, chunk: int, progress: bool) -> None:
    require_kind("model", model, (Scene, MechanicalSystem), "Pass one of them.")
    require_flag("progress", progress)
    if not callable(what):
        raise InvalidInputError("what", "must be callable", repr(what), "Pass Evaluator(...).")
    if executor is not None:
        require_kind("executor", executor, (Executor,), "For example ProcessPoolExecutor(2).")
    require_count("chunk", chunk, "1 is best for calls of 0.1 s and more.")


def _collect(
    arriving: Generator[tuple[int, Any], None, None],
    rows: dict[int, SweepRow],
    values: list[dict[str, float]],
    kept: SweepFile | None,
) -> bool:
    """Store a sweep's rows as they arrive, also in the file; return whether Ctrl-C interrupted."""
    with closing(arriving):
        try:
            for k, answer in arriving:
                if isinstance(answer, str):
                    rows[k] = SweepRow(values[k], None, answer)
                else:
                    rows[k] = answer if kept is None else kept.append(k, answer)
        except KeyboardInterrupt:
            return True
    return False


@final
@dataclass(frozen=True)
class _Study:
    """A model and the function computed on it, the same for all designs of a sweep.

    A scene that `Evaluator` runs is assembled once in every process; its designs are values of this
    one system. Copies in other processes have the same `number`.
    """

    model: Scene | MechanicalSystem = field(compare=False)
    what: Callable[[Any], Any] = field(compare=False)
    number: uuid.UUID = field(default_factory=uuid.uuid4)

    def result(self, design: Design) -> Any:
        """Return the sweep's function of the model at the values of a design."""
        if isinstance(self.what, Evaluator) and self.what.modes is not None:
            return self.what.at(design)(_model_at(self.model, design))
        if isinstance(self.model, MechanicalSystem):
            return self.what(_moved(self.model, design))
        system = _assembled(self, tuple(design))
        if system is not None and isinstance(self.what, Evaluator):
            # An error is raised again by the scene at the values, naming the user's targets.
            what = self.what if self.what.design is None else replace(self.what, design=None)
            with suppress(Exception):
                return what(_moved(system, design))
        return self.what(self.model.with_values(design))


@lru_cache(maxsize=4)
def _assembled(study: _Study, keys: tuple[str | DesignVariable, ...]) -> MechanicalSystem | None:
    """Return the scene assembled with a design's variables, or None if that would affect runs."""
    what, scene = study.what, study.model
    if not (isinstance(what, Evaluator) and isinstance(scene, Scene)):
        return None
    integrator = what.integrator
    along = isinstance(integrator, SteppedIntegrator) and not integrator.differentiates_runs
    try:
        variables = as_design(keys)
        if what.gradient:
            wanted = as_design(what.design or ())
            if set(wanted) != set(variables):
                return None
            variables = wanted
        elif along:
            return None
        # `Scene.with_values` closes joints at every design.
        return assemble(replace(scene, assemble=True), variables)
    except AncfdaeError:
        return None


@final
@dataclass(frozen=True)
class _Task:
    """One design of a sweep, and its values by name."""

    study: _Study
    design: Design
    values: Mapping[str, float]


def _row(task: _Task) -> SweepRow:
    """Return the sweep's row for a design; an exception of any kind becomes its error."""
    try:
        return SweepRow(task.values, task.study.result(task.design))
    except Exception as error:  # noqa: BLE001  # `what` is the user's and may raise anything.
        return SweepRow(task.values, None, f"{type(error).__name__}: {error}")


def _model_at(model: Scene | MechanicalSystem, design: Design) -> Scene | MechanicalSystem:
    """Return a scene or system at the values of a design."""
    return model.with_values(design) if isinstance(model, Scene) else _moved(model, design)


def _moved(model: MechanicalSystem, design: Design) -> MechanicalSystem:
    """Return the system at the values of a design; UnknownNameError for unknown variables."""
    b = dict(zip(model.design_names, model.b.tolist(), strict=True))
    named = {_name(key): value for key, value in design.items()}
    for name in named:
        if name not in b:
            raise UnknownNameError("design variable", name, b)
    return at_values(model, np.array(list((b | named).values())))


def _name(key: object) -> str:
    return key.name if isinstance(key, DesignVariable) else str(key)


def _mappings(
    model: Scene | MechanicalSystem,
    designs: Sequence[Design] | Array,
    variables: Sequence[str | DesignVariable] | None,
) -> list[Design]:
    """Return every design of a sweep as a mapping of variables to values."""
    rows = require_sequence("designs", designs)
    if all(isinstance(row, Mapping) for row in rows):
        if variables is not None:
            rule = "must be left out where designs are mappings"
            repair = "Mappings name their variables."
            raise InvalidInputError("design", rule, repr(variables), repair)
        return list(rows)
    if variables is None and isinstance(model, MechanicalSystem):
        variables = model.design_names
    keys = require_sequence("design", variables, "must name the columns of rows of values")
    for key in keys:
        require_kind("design", key, (str, DesignVariable), 'For example ["rod.height"].')
    return [dict(zip(keys, _values(k, row, len(keys)), strict=True)) for k, row in enumerate(rows)]


def _values(k: int, row: object, count: int) -> tuple[float, ...]:
    """Return one row of design values, checked for its length only."""
    rule, repair = f"must have {count} values", "Give rows throughout, or mappings throughout."
    values = require_sequence(f"designs[{k}]", row, rule, repair)
    if isinstance(row, Mapping) or len(values) != count:
        raise InvalidInputError(f"designs[{k}]", rule, repr(row), repair)
    return values
