"""The call `work_precision`: cost and errors of settings, in this process or in workers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import replace
from typing import Any

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.event_solution import START
from ancfdae.errors.checks import (
    require_count,
    require_each,
    require_flag,
    require_kind,
    require_positive,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import Interrupted, Verdict, uninterrupted
from ancfdae.events.calls import EventRun
from ancfdae.events.kinds import Event, Mode
from ancfdae.integrators.explicit import DOP853
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.sundials.ida import IDA
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.scene import Scene
from ancfdae.sensitivity.method import GradientMethod
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import differentiable, require_objectives
from ancfdae.studies.jobs import answers
from ancfdae.studies.meshes import known_design
from ancfdae.studies.tradeoff_result import (
    Measurement,
    Results,
    Task,
    WorkPrecision,
    compared,
    measure,
)

# Largest number of steps of the default reference: the paper's crank-slider takes 29,410 by
# `DOP853`.
_STEPS = 50_000
# The steps of `DOP853` in the first of _PARTS parts of the motion show whether it can be the
# reference; fewer than _FEW steps show nothing.
_PARTS, _FEW = 64, 20
_LEFT = Measurement(0.0, "not measured: the comparison was interrupted")


def work_precision(
    model: Scene | MechanicalSystem,
    objective: Objective,
    t_end: float,
    settings: Sequence[Integrator],
    *,
    design: Sequence[str | DesignVariable] | None = None,
    reference: Integrator | None = None,
    method: GradientMethod | None = None,
    repeats: int = 1,
    time_limit: float | None = None,
    executor: Executor | None = None,
    models: Mapping[str, Scene] | None = None,
    events: Sequence[Event] | None = None,
    modes: Mapping[str, Mode] | None = None,
    progress: bool = False,
) -> WorkPrecision:
    """Measure processor time and errors of settings; a failed one is a row with its message.

    With events multipliers, drift and energy are not compared: modes have other joints, and forces
    and energies jump at events, whose times differ from setting to setting.

    Parameters
    ----------
    model, objective, t_end, design, method, events, modes, progress
        As in `gradient`.
    settings : sequence of Integrator
        For example ``[HHT(step=h) for h in (0.01, 0.005)] + [HHT(rtol=1e-3), IDA(1e-6)]``.
    reference : Integrator, optional
        The integrator against which errors are measured. By default ``DOP853(1e-10)``. If it
        would take more than 50,000 steps, or if stability rather than accuracy would limit its
        step, ``IDA(1e-9)``.
    repeats : int
        Number of runs of each setting, of which the fastest counts; runs above a second are not
        repeated.
    time_limit : float, optional
        Largest elapsed time for the runs of one setting, except the reference; s.
    executor, models : optional
        Executor of the runs, as in `sweep`, but not threads, which count each other's time; and
        other models of the scene by name, compared in objective and gradient; not with events.
    """
    limits = repeats, time_limit
    settings = _checked(settings, reference, method, executor, *limits, progress)
    system = differentiable(model, design)
    require_objectives(system, [objective], t_end)
    given: dict[str, Any] = {}
    if events is not None or modes is not None:
        runs = [EventRun.of(system, t_end, x, events or (), modes, design, False) for x in settings]
        systems = {x.name: x for x in runs[0].modes.values() if x.name != START}
        of_modes = {name: Mode(x.system, x.events) for name, x in systems.items()}
        given = {"events": tuple(events or ()), "modes": of_modes}
    if models and given:
        rule, repair = "must be left out with events", "Compare the models one by one."
        raise InvalidInputError("models", rule, sorted(models), repair)
    reference, why = (reference, "") if reference is not None else _suitable(system, t_end)
    first = Task(system, objective, t_end, reference, method, 1, None, given=given)
    tasks = [first]  # timed by nobody
    for name, other in [("", system), *_others(models or {}, design)]:
        own = replace(first, system=other, repeats=repeats, time_limit=time_limit, model=name)
        tasks += [replace(own, integrator=x) for x in settings]
    measured = _measured(tasks, executor, progress)
    exact = _required(measured[0])
    rows = [compared(system, t, r, exact) for t, r in zip(tasks, measured, strict=True)]
    done = WorkPrecision(tuple(rows[1:]), replace(rows[0], outcome=rows[0].outcome + why))
    count, left = len(done.rows), sum(each is _LEFT for each in measured)
    if left:
        raise Interrupted(done, f"{count - left} of {count} settings were measured")
    return done


def _others(
    models: Mapping[str, Scene], design: Sequence[str | DesignVariable] | None
) -> Iterator[tuple[str, MechanicalSystem]]:
    """Yield the comparison's other models by name, as systems with the variables that they have."""
    variables = as_design(() if design is None else design)
    for name, scene in models.items():
        require_kind(f"models, {name}", scene, (Scene,), "Pass a Scene.")
        yield name, differentiable(scene, known_design(scene, variables))


def _checked(
    settings: Sequence[Integrator],
    reference: Integrator | None,
    method: GradientMethod | None,
    executor: Executor | None,
    repeats: int,
    time_limit: float | None,
    progress: bool,
) -> Sequence[Integrator]:
    """Return the integrator settings as a tuple; InvalidInputError for unusable arguments."""
    require_flag("progress", progress)
    repair = "For example [HHT(step=0.01)]."
    settings = require_each("settings", settings, (Integrator,), repair)
    if not settings:
        raise InvalidInputError("settings", "must not be empty", "none", repair)
    if reference is not None:
        require_kind("reference", reference, (Integrator,), "For example DOP853(1e-10).")
    if method is not None:
        require_kind("method", method, (GradientMethod,), "For example DirectDifferentiation().")
    if executor is not None:
        require_kind("executor", executor, (Executor,), "For example ProcessPoolExecutor(2).")
    require_count("repeats", repeats, "1 is enough for ratios of long runs.")
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    return settings


def _suitable(system: MechanicalSystem, t_end: float) -> tuple[Integrator, str]:
    """Return a reference integrator that can finish, and why it is not `DOP853`, as text.

    If stability limits the steps of `DOP853`, a loose tolerance needs about as many as a tight one;
    if accuracy does, it needs 10^(-5/8) = 0.24 times as many.
    """
    tight, loose = (
        uninterrupted(
            DOP853(rtol, max_steps=2 * _STEPS // _PARTS).integrate(system, t_end / _PARTS)
        )
        for rtol in (1e-10, 1e-5)
    )
    steps = tight.statistics.steps
    if tight.outcome.success and (steps < _FEW or loose.statistics.steps < steps / 2):
        return DOP853(1e-10, max_steps=_STEPS), ""
    why = " Chosen because DOP853(1e-10) would need short steps only to be stable."
    if not tight.outcome.success:
        why = f" Chosen because DOP853(1e-10) would take more than {_STEPS} steps."
    return IDA(1e-9, max_steps=_STEPS), why


def _measured(
    tasks: Sequence[Task], executor: Executor | None, progress: bool
) -> list[Measurement]:
    """Return the measurements of all tasks, reference first; rows not computed say so."""
    measured: dict[int, Measurement] = {}
    parts = {"model": tasks[0].system, "objective": tasks[0].objective}
    arriving = answers(measure, dict(enumerate(tasks)), executor, parts, progress=progress)
    with closing(arriving):
        try:
            for k, answer in arriving:
                measured[k] = Measurement(0.0, answer) if isinstance(answer, str) else answer
                if k == 0:
                    _required(measured[0])
        except KeyboardInterrupt:
            # Without the reference no error of the other settings is known.
            if 0 not in measured:
                raise
    return [measured.get(k, _LEFT) for k in range(len(tasks))]


def _required(reference: Measurement) -> Results:
    if reference.results is None:
        limited = reference.verdict is Verdict.STEP_LIMIT
        repair = "Raise its max_steps, loosen" if limited else "Loosen"
        rule, repair = (
            "must finish and give a gradient",
            f"{repair} it, or take another integrator.",
        )
        raise InvalidInputError("reference", rule, reference.outcome, repair)
    return reference.results
