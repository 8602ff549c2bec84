"""The search: whichever sequence of runs promises to get to the tolerance for least goes on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch
from ancfdae.sensitivity.method import Trial
from ancfdae.studies.tolerance.bars import Estimate
from ancfdae.studies.tolerance.sequences import Measure, Sample, Sequence

# Most work of a search; that of a million steps of HHT of a small system.
_MOST = 6e7
# A gain that is hoped for is this power of the best one at least.
_LEAST = 0.6
_MOST_RUNS = 60

# Returns the sizes that errors of vectors are relative to.
Sizes = Callable[[list[Array]], list[float]]


@final
class _State:
    """A sequence in the search: its relative errors so far, and the time that it took."""

    def __init__(self, sequence: Sequence) -> None:
        self.sequence, self.errors = sequence, list[float]()
        self.seconds, self.work = 0.0, 0.0
        self.estimates: list[Estimate] = []

    @property
    def error(self) -> float:
        return self.errors[-1] if self.errors else math.inf

    def left(self, tolerance: float) -> float:
        """Return the work that leads to the tolerance, if gains stay as they are."""
        sequence = self.sequence
        if not self.errors:
            count = sequence.expected(tolerance) - len(sequence.runs)
        else:
            gain = sequence.gain
            if len(self.errors) > 1:
                gain = min(gain, max(gain**_LEAST, self.errors[-2] / self.errors[-1]))
            count = math.ceil(math.log(self.error / tolerance) / math.log(gain))
        return sum(sequence.work(k) for k in range(min(max(count, 1), _MOST_RUNS)))

    def price(self, tolerance: float) -> str:
        """Return in words what the tolerance costs by this sequence."""
        name, left = self.sequence.name, self.left(tolerance)
        if not self.work:
            return f"{name} was not tried"
        seen = "" if math.isinf(self.error) else f" (at {self.error:.1g})"
        if math.isinf(left) or left > 1e3 * _MOST:
            return f"{name}{seen} out of reach"
        return f"{name}{seen} about {self.seconds / self.work * left:.1g} s more"

    def advance(self, measure: Measure, sizes: Sizes) -> tuple[Trial, Sample]:
        """Take the next run and judge it."""
        sequence, clock = self.sequence, stopwatch()
        setting, work = sequence.setting, sequence.work()
        sample = sequence.advance(measure)
        seconds = clock()
        self.seconds, self.work = self.seconds + seconds, self.work + work
        if len(sequence.runs) >= sequence.needed:
            self.judge(sizes)
        error = self.error if sample.vectors else math.inf
        return Trial(setting, sample.steps if sample.vectors else 0, seconds, error), sample

    def judge(self, sizes: Sizes) -> None:
        """Keep the estimates and the largest relative error."""
        self.estimates = self.sequence.estimates()
        bars = [float(np.linalg.norm(each.bar)) for each in self.estimates]
        relative = zip(bars, sizes([each.x for each in self.estimates]), strict=True)
        self.errors.append(max(bar / size if bar else 0.0 for bar, size in relative))


@final
@dataclass(frozen=True)
class Found:
    """Estimates of the wanted vectors, the last result of their sequence, and the way there."""

    estimates: list[Estimate]
    result: object
    reached: bool
    integrator: Integrator
    why: str
    trials: tuple[Trial, ...]


def search(sequences: list[Sequence], measure: Measure, sizes: Sizes, tolerance: float) -> Found:
    """Take runs until the error of some sequence is below the tolerance, or the next is too dear.

    Raises what the last run raised if none gave an estimate.
    """
    states = [_State(each) for each in sequences]
    trials: list[Trial] = []
    chosen: dict[_State, tuple[Integrator, object]] = {}
    failures: list[Exception] = []
    spent = 0.0
    while True:
        best = min(states, key=lambda each: each.error)
        going = [each for each in states if spent + each.sequence.work() <= _MOST]
        if best.error <= tolerance or not going:
            break
        state = min(going, key=lambda each: each.left(tolerance))
        spent += state.sequence.work()
        trial, sample = state.advance(measure, sizes)
        trials.append(trial)
        if sample.vectors:
            chosen[state] = trial.integrator, sample.result
        elif isinstance(sample.result, Exception):
            failures.append(sample.result)
    if best not in chosen or not best.estimates:
        raise failures[-1]
    integrator, result = chosen[best]
    reached = best.error <= tolerance
    others = "; ".join(each.price(tolerance) for each in states if not reached or each is not best)
    why = best.sequence.words
    why += f". Not taken: {others}." if reached else f". To the tolerance: {others}."
    return Found(best.estimates, result, reached, integrator, why, tuple(trials))
