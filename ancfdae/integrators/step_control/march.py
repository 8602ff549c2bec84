"""The loop over the steps of a run."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.errors import Outcome, SingularMatrix, Verdict
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.step_control.contracts import Controller, OneStepMethod


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
) -> Solution:
    """Step to the end; after a failure or an interrupt the solution holds the steps so far.

    The recorder has what was reached before.
    """
    from tqdm import tqdm

    if reached is _NOWHERE:
        recorder.record(*method.consistent())
    with tqdm(total=t_end, initial=reached.t, disable=not progress, unit="s") as bar:
        try:
            # A run that diverges overflows; its outcome reports it, so NumPy's warnings are off.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                verdict = _to_end(method, controller, recorder, bar, reached)
        except SingularMatrix:
            verdict = Verdict.SINGULAR
        except KeyboardInterrupt:
            verdict = Verdict.INTERRUPTED
    ended = recorder.time, recorder.steps
    if verdict is Verdict.FINISHED:
        return recorder.solution(Outcome(verdict, *ended, 0.0))
    why = method.failure()
    return recorder.solution(Outcome(verdict, *ended, why.correction, advice=why.remedy))


def _to_end(
    method: OneStepMethod[Any],
    controller: Controller,
    recorder: Recorder,
    bar: Any,
    reached: Reached,
) -> Verdict:
    n, t, last, now = reached
    while not isinstance(planned := controller.plan(n, t), Verdict):
        h, t_next = planned
        before = method.start(h) if now is None else method.resized(now, h / last)
        after = method.advance(h, before, t_next)
        error = None if after is None else method.error(h, before, after)
        found = controller.judge(n, t, h, error)
        if isinstance(found, int) and found > n:
            n, t, last, now = found, t_next, h, after
            recorder.record(*method.recorded(after), control=controller.state())
            bar.update(h)
            continue
        recorder.rejected += 1
        if isinstance(found, Verdict):
            return method.failure().verdict if after is None else found
        if found == 0:
            n, t, last, now = _NOWHERE
            recorder.restart()
            bar.reset()
    return planned
