"""The loop over the steps of a run."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.errors import Outcome, SingularMatrix, Verdict
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.step_control.contracts import Controller, Failure, OneStepMethod
from ancfdae.numerics.progress import progress_bar


class Reached(NamedTuple):
    """Where a run stands: instant, time, size of the last step, and state of the method."""

    n: int
    t: float
    last: float
    now: Any


_NOWHERE = Reached(0, 0.0, 0.0, None)


def march(
    method: OneStepMethod[Any],
    controller: Controller,
    recorder: Recorder,
    t_end: float,
    progress: bool,
    reached: Reached = _NOWHERE,
) -> tuple[Solution, Reached]:
    """Step to the end; after a failure or an interrupt the solution holds the steps so far.

    The recorder has what was reached before.
    """
    if reached is _NOWHERE:
        recorder.record(*method.consistent())
    with progress_bar(progress, total=t_end, initial=reached.t, unit="s") as bar:
        try:
            # A run that diverges overflows; its outcome reports it, so NumPy's warnings are off.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                while isinstance(end := _next(method, controller, recorder, reached), Reached):
                    bar.update(end.t - reached.t)
                    reached = end
        except SingularMatrix:
            end = Failure(Verdict.SINGULAR, 0.0)
        except KeyboardInterrupt:
            end = Failure(Verdict.INTERRUPTED, 0.0)
    verdict, correction, remedy = end
    outcome = Outcome(verdict, recorder.time, recorder.steps, correction, advice=remedy)
    return recorder.solution(outcome), reached


def _next(
    method: OneStepMethod[Any], controller: Controller, recorder: Recorder, reached: Reached
) -> Reached | Failure:
    """Try a step; return where the run stands then, or how it ends there."""
    n, t, last, now = reached
    planned = controller.plan(n, t)
    if isinstance(planned, Verdict):
        return Failure(planned, 0.0)
    h, end = planned
    before = method.start(h) if now is None else method.resized(now, h / last)
    sizes, ends = controller.known(n)
    if len(sizes):
        taken, after = method.march(before, sizes, ends)
        if taken:
            return Reached(n + taken, float(ends[taken - 1]), float(sizes[taken - 1]), after)
    after = method.advance(h, before, end)
    failed = isinstance(after, Failure)
    if failed and after.verdict is Verdict.SINGULAR:
        return after
    judged = controller.judge(n, t, h, None if failed else method.error(h, before, after))
    if isinstance(judged, int) and judged > n:
        recorder.record(*method.recorded(after), control=controller.state())
        return Reached(judged, end, h, after)
    recorder.rejected += 1
    if isinstance(judged, Verdict):
        return after if failed else Failure(judged, 0.0)
    if judged > 0:
        return reached
    recorder.restart()
    return _NOWHERE
