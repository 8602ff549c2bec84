"""The loop over the steps of HHT-I3."""

from __future__ import annotations

from typing import Any

import numpy as np
from tqdm import tqdm

from ancfdae.errors import Outcome, SingularMatrix, Verdict
from ancfdae.integrators.hht.equations import Coefficients
from ancfdae.integrators.hht.step import Stepper
from ancfdae.integrators.hht.step_control import Pace
from ancfdae.protocol.solution import Solution


def march(stepper: Stepper, pace: Pace, alpha: float, t_end: float, progress: bool) -> Solution:
    """Step to the end; the solution says how that went, and keeps what an interrupt leaves."""
    recorder = stepper.recorder
    recorder.record(*stepper.consistent())
    with tqdm(total=t_end, disable=not progress, unit="s") as bar:
        try:
            verdict = _to_end(stepper, pace, alpha, bar)
        except SingularMatrix:
            verdict = Verdict.SINGULAR
        except KeyboardInterrupt:
            verdict = Verdict.INTERRUPTED
    size = 0.0 if verdict is Verdict.FINISHED else stepper.solver.correction
    return recorder.solution(Outcome(verdict, recorder.time, recorder.steps, size))


def _to_end(stepper: Stepper, pace: Pace, alpha: float, bar: Any) -> Verdict:
    n, t, last, now, recorder = 0, 0.0, 0.0, None, stepper.recorder
    while not pace.done(n, t):
        if pace.exhausted():
            return Verdict.STEP_LIMIT
        h, t_next = pace.next(n, t)
        c = Coefficients.of(h, alpha)
        # A run that blows up overflows; its outcome tells so, not NumPy's warnings.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            before = stepper.start(c) if now is None else now.rescaled(h / last)
            after = stepper.advance(c, before, t_next)
            accepted = pace.accepts(c, before, after)
        if not accepted or after is None:
            recorder.rejected += 1
            verdict = pace.failure()
            if verdict is not None:
                return stepper.solver.verdict if after is None else verdict
            if pace.restarts(n):
                n, t, last, now = 0, 0.0, 0.0, None
                recorder.restart()
                bar.reset()
            continue
        n, t, last, now = n + 1, t_next, h, after
        recorder.record(*after.recorded())
        bar.update(h)
    return Verdict.FINISHED
