"""When two kinds of runs of a search by tolerance contradict each other."""

import numpy as np
import pytest

from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.studies.accuracy.bars import Estimate
from ancfdae.studies.accuracy.runs import Runs, Sample, Wanted
from tests.support.mechanisms import CartesianPendulum


class Told(Runs):
    """One run that found a number, with a bar."""

    name, setting, work, left, words = "told", None, 0.0, 0.0, ""

    def __init__(self, number, bar):
        self._found = [Estimate(np.array([number]), np.array([bar]))]
        sizes = lambda vectors: [1.0 for _ in vectors]  # noqa: E731
        problem = InitialValueProblem.of(CartesianPendulum(), 1.0)
        super().__init__(Wanted(problem, 1.0, 0.01, sizes, None, (), None, False, None, 0.0))
        self.take(Sample([x.x for x in self._found], None, 1, None, None))

    def judged(self):
        return self._found

    def chosen(self):
        return 1

    def follows(self, places):
        return True


@pytest.mark.parametrize("sign", [1, -1])
def test_runs_agree_within_three_bars_and_the_tolerance(sign):
    # One bar in twenty does not hold, but errs by less than three; 0.02 is that of the other kind,
    # 0.01 the tolerance. The bar of the run that is judged does not count.
    other, limit = Told(2.0, 0.02), 3 * 0.02 + 0.01
    assert Told(2.0 + sign * limit * 0.999, 0.5).agrees(other)
    assert not Told(2.0 + sign * limit * 1.001, 0.5).agrees(other)


def test_runs_agree_with_those_that_know_nothing():
    other = Told(2.0, 0.02)
    other.take(Sample([], None, 0, None, None))
    assert Told(50.0, 0.5).agrees(other)
