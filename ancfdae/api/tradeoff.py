"""The call: measure settings here or in the workers of an executor."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import closing
from typing import Any

from tqdm import tqdm

from ancfdae.api.calls import differentiable, require_objectives
from ancfdae.api.jobs import answers, require_pickles
from ancfdae.api.tradeoff_result import Tradeoff, compared
from ancfdae.api.tradeoff_run import Measurement, Results, Task, measure
from ancfdae.design import DesignVariable
from ancfdae.errors import (
    Interrupted,
    InvalidInput,
    Verdict,
    require_count,
    require_kind,
    require_positive,
    require_sequence,
)
from ancfdae.integrators import Explicit, Integrator
from ancfdae.objectives import Objective
from ancfdae.protocol import MechanicalSystem
from ancfdae.scene import Scene
from ancfdae.sensitivity import GradientMethod

# Of the reference by default: enough for scenes that it suits (the crank-slider of the paper takes
# 29,410), few enough to tell a stiff one within minutes.
_STEPS = 50_000
_LEFT = Measurement(0.0, "not measured: the tradeoff was interrupted")


def tradeoff(
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
    progress: bool = False,
) -> Tradeoff:
    """Measure what accuracy costs: every setting's processor time and errors on one scene.

    Parameters
    ----------
    model, objective, t_end, design, method, progress
        As in `gradient`.
    settings : sequence of Integrator
        For example ``[HHT(step=h) for h in (0.01, 0.005)] + [HHT(rtol=1e-3), IDA(1e-6)]``.
    reference : Integrator, optional
        What errors are measured against, ``Explicit(1e-10, max_steps=50_000)`` by default. For
        stiff scenes something that needs fewer steps, such as ``HHT`` at a small one.
    repeats : int
        Runs of each setting, of which the least processor time counts; runs of more than a
        second are not repeated.
    time_limit : float, optional
        Longest time for the runs of one setting, by the clock; s. What takes longer is a row that
        says so. The reference is limited by its `max_steps` only.
    executor : concurrent.futures.Executor, optional
        Where the runs take place, for example ``ProcessPoolExecutor(2)`` or that of a Dask
        client; by default in this process, one after the other. Model and objective must
        pickle (no lambda in `custom` or `apply`). Threads would count each other's processor time.

    Returns
    -------
    Tradeoff
        A setting that fails is a row with its message.

    Raises
    ------
    InvalidInput
        If the input makes no sense, or the reference does not finish.
    Interrupted
        At Ctrl-C; its `result` is the table, with rows that say that they were not measured.
    KeyboardInterrupt
        If Ctrl-C comes before the reference is there.
    """
    settings = require_sequence("settings", settings)
    if not settings:
        raise InvalidInput("settings", "must not be empty", "none", "For example [HHT(step=0.01)].")
    for setting in settings:
        require_kind("settings", setting, (Integrator,), "For example [HHT(step=0.01)].")
    reference = Explicit(1e-10, max_steps=_STEPS) if reference is None else reference
    require_kind("reference", reference, (Integrator,), "For example Explicit(1e-10).")
    if method is not None:
        require_kind("method", method, (GradientMethod,), "For example Direct().")
    if executor is not None:
        require_kind("executor", executor, (Executor,), "For example ProcessPoolExecutor(2).")
    require_count("repeats", repeats, "1 is enough for ratios of long runs.")
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    system = differentiable(model, design)
    require_objectives(system, [objective], t_end)
    # The reference runs once, because its time is not compared.
    tasks = [Task(system, objective, t_end, reference, method, 1, None)]
    tasks += [
        Task(system, objective, t_end, each, method, repeats, time_limit) for each in settings
    ]
    with tqdm(total=len(tasks), disable=not progress, unit="run") as bar:
        measured = _measured(tasks, executor, bar)
    exact = _required(measured[0])
    rows = [compared(system, t.integrator, r, exact) for t, r in zip(tasks, measured, strict=True)]
    done = Tradeoff(tuple(rows[1:]), rows[0])
    left = sum(each is _LEFT for each in measured)
    if left:
        raise Interrupted(done, f"{len(settings) - left} of {len(settings)} settings were measured")
    return done


def _measured(tasks: Sequence[Task], executor: Executor | None, bar: Any) -> list[Measurement]:
    """Measure all tasks, the reference first; after an interrupt with rows that say so."""
    found: dict[int, Measurement] = {}
    arriving = answers(measure, dict(enumerate(tasks)), executor)
    with closing(arriving):
        try:
            for k, answer in arriving:
                if isinstance(answer, Measurement):
                    found[k] = answer
                else:
                    parts = {"model": tasks[k].system, "objective": tasks[k].objective}
                    require_pickles(answer, parts)
                    error = f"{type(answer).__name__} in a worker: {answer}"
                    found[k] = Measurement(0.0, error)
                if k == 0:
                    _required(found[0])
                bar.update()
        except KeyboardInterrupt:
            # Without the reference nothing could be said of the others.
            if 0 not in found:
                raise
    return [found.get(k, _LEFT) for k in range(len(tasks))]


def _required(reference: Measurement) -> Results:
    if reference.results is None:
        limited = reference.verdict is Verdict.STEP_LIMIT
        repair = "Raise its max_steps, loosen" if limited else "Loosen"
        rule, repair = (
            "must finish and give a gradient",
            f"{repair} it, or take another integrator.",
        )
        raise InvalidInput("reference", rule, reference.outcome, repair)
    return reference.results
