"""Steps under error control one by one, in Python: what the loop of the kernel is compared with."""

import numpy as np

from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.step_control.contracts import Batch, Failure, OneStepMethod
from ancfdae.kernels import FILTER, March


class OneByOne(OneStepMethod):
    """A method that tries one step in a call: `advance` solves it, `error` is its e.

    The recorder, an attribute, gets its rows. Times of a step's states stand first in a record.
    """

    def error(self, h, before, after):
        raise NotImplementedError

    def controlled(self, begin, controller, most, tries=None):
        n, t, last, now, _ = begin
        h, end = controller.plan(n, t)
        before = self.resized(now, h / last)
        after = self.advance(h, before, end)
        failed = isinstance(after, Failure)
        judged = controller.judge(n, t, h, None if failed else self.error(h, before, after))
        none = np.zeros(0), np.zeros(0), np.zeros((0, FILTER)), None
        if judged == n + 1:
            times, *rows, _ = self.recorded(after)
            times = np.atleast_1d(times)
            for to, x in zip(self.recorder.room(len(times)), rows, strict=True):
                to[:] = x
            filters = controller.numbers[None].copy()
            return Batch(times, np.array([end]), filters, lambda k: after, March.ALL_TAKEN, 0.0)
        self.recorder.rejected += 1
        if isinstance(judged, Verdict):
            why = March.INACCURATE if judged is Verdict.ERROR_TEST else March.NO_CONVERGENCE
            return Batch(*none, why, after.correction if failed else 0.0)
        if judged == n:
            return Batch(*none, March.ALL_TAKEN, 0.0)
        return Batch(*none, March.BEGIN_ANEW if judged == 0 else March.STEP_BEFORE, 0.0)
