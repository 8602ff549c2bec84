"""The call: measure settings here or in the workers of an executor."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, as_completed
from typing import Any

from tqdm import tqdm

from ancfdae.api.calls import differentiable, require_objectives
from ancfdae.api.tradeoff_result import Tradeoff, compared
from ancfdae.api.tradeoff_run import Measurement, Results, Task, measure
from ancfdae.design import DesignVariable
from ancfdae.errors import InvalidInput, Verdict, require_count, require_kind, require_sequence
from ancfdae.integrators import Explicit, Integrator
from ancfdae.objectives import Objective
from ancfdae.protocol import MechanicalSystem
from ancfdae.scene import Scene
from ancfdae.sensitivity import GradientMethod

# Of the reference by default: enough for scenes that it suits (the crank-slider of the paper takes
# 29,410), few enough to tell a stiff one within minutes.
_STEPS = 50_000


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
    system = differentiable(model, design)
    require_objectives(system, [objective], t_end)
    # The reference runs once, because its time is not compared.
    tasks = [Task(system, objective, t_end, reference, method, 1)]
    tasks += [Task(system, objective, t_end, each, method, repeats) for each in settings]
    with tqdm(total=len(tasks), disable=not progress, unit="run") as bar:
        measured = _in_turn(tasks, bar) if executor is None else _by_workers(tasks, executor, bar)
    exact = _required(measured[0])
    rows = [compared(system, t.integrator, r, exact) for t, r in zip(tasks, measured, strict=True)]
    return Tradeoff(tuple(rows[1:]), rows[0])


def _in_turn(tasks: Sequence[Task], bar: Any) -> list[Measurement]:
    measured = []
    for task in tasks:
        measured.append(measure(task))
        _required(measured[0])
        bar.update()
    return measured


def _by_workers(tasks: Sequence[Task], executor: Executor, bar: Any) -> list[Measurement]:
    """Submit all tasks; an exception in a worker becomes a row with its message."""
    submitted: list[Future[Measurement] | BrokenExecutor] = []
    for task in tasks:
        try:
            submitted.append(executor.submit(measure, task))
        except BrokenExecutor as error:
            submitted.append(error)
    futures = [x for x in submitted if isinstance(x, Future)]
    try:
        for _ in as_completed(futures):
            bar.update()
    except BaseException:
        for future in futures:
            future.cancel()
        raise
    measured = [_answer(x) for x in submitted]
    if measured[0].results is None:
        _require_pickles(tasks[0])
    return measured


def _answer(submitted: Future[Measurement] | BrokenExecutor) -> Measurement:
    error: BaseException | None
    try:
        error = submitted if isinstance(submitted, BrokenExecutor) else submitted.exception()
    except CancelledError as cancelled:
        error = cancelled
    if error is None:
        assert isinstance(submitted, Future)
        return submitted.result()
    return Measurement(0.0, f"{type(error).__name__} in a worker: {error}")


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


def _require_pickles(task: Task) -> None:
    """Name the part that does not pickle, if that is why the reference failed."""
    for name, part in (("model", task.system), ("objective", task.objective)):
        try:
            pickle.dumps(part)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InvalidInput(
                f"{name}, executor",
                "must pickle to be sent to a worker",
                str(error),
                "Define functions at the top of a module, or leave the executor out.",
            ) from error
