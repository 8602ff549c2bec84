"""The search: whichever kind of runs promises to get to the tolerance for least goes on."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.kinds import (
    InvalidInputError,
    ManyStepsWarning,
    StabilityWarning,
    ToleranceWarning,
)
from ancfdae.integrators.integrator import Integrator
from ancfdae.numerics.timing import stopwatch
from ancfdae.sensitivity.method import Trial
from ancfdae.studies.tolerance.bars import Estimate
from ancfdae.studies.tolerance.dop853_runs import DOP853Runs
from ancfdae.studies.tolerance.hht_runs import HHTRuns
from ancfdae.studies.tolerance.places import Witness
from ancfdae.studies.tolerance.radau_runs import RadauRuns
from ancfdae.studies.tolerance.runs import Measure, Runs, Sample, Wanted

# Most work of a search, about as many microseconds.
_MOST = 4e7
# Work after which a look at the path of HHT-I3 may show why no run is good enough.
_EARLY = 5e5
# Times that runs begin again because a path has sharp places which they passed over.
_LOOKS = 12
# Share of the work foreseen that a run may take which may show that less is needed.
_WORTH = 0.1


@final
@dataclass(frozen=True)
class Found:
    """Estimates of the wanted vectors, the last result of their kind of runs, and the way there."""

    estimates: list[Estimate]
    result: object
    reached: bool
    integrator: Integrator
    why: str
    trials: tuple[Trial, ...]


@final
@dataclass(frozen=True)
class _Spent:
    """Runs of a search: of which kind, what was seen, and its work."""

    runs: list[tuple[Runs, Trial, float]]

    @property
    def work(self) -> float:
        """Work of all runs."""
        return sum(work for _, _, work in self.runs)

    def take(self, runs: Runs, measure: Measure) -> Sample:
        """Make and judge the next run of one kind of runs."""
        setting, work, clock = runs.setting, runs.work, stopwatch()
        sample = measure(setting)
        runs.take(sample)
        steps = sample.steps if sample.vectors else 0
        self.runs.append((runs, Trial(setting, steps, clock(), runs.error), work))
        return sample

    def price(self, runs: Runs, left: float) -> str:
        """Return in words what the tolerance costs by a kind of runs."""
        seen = "" if math.isinf(runs.error) else f" (at {runs.error:.1g})"
        if math.isinf(left) or left > 1e3 * _MOST:
            return f"{runs.name}{seen} out of reach"
        seconds = sum(trial.seconds for _, trial, _ in self.runs) / self.work * left
        return f"{runs.name}{seen} about {seconds:.1g} s more"


def _out_of_reach(
    spent: _Spent, ways: dict[Runs, float], seer: HHTRuns, tolerance: float
) -> InvalidInputError:
    """Return the refusal of a search whose runs do not follow what happens, and say no error."""
    costs, steps = "; ".join(spent.price(*x) for x in ways.items()), seer.transitions.steps
    if steps and seer.least >= steps:
        return InvalidInputError(
            "tolerance",
            f"derivatives need {steps} equal steps: a force jumps while the state changes by "
            f"{seer.transitions.narrow:.1g} of its size, as dry friction does within its "
            "smooth_speed, and the slope of the jump must be met by steps",
            costs,
            "Control the errors of derivatives instead, which takes short steps at jumps alone: "
            f"Radau(AdaptiveSteps({0.01 * tolerance:.1g}, sensitivities=True)), and again with a "
            "tenth of that rtol to see the error; or raise smooth_speed.",
        )
    return InvalidInputError(
        "tolerance",
        "must be within reach: laws, observables or waves are too fast for the steps of a search",
        costs,
        "Choose an integrator, for example HHT(step=...), or a shorter t_end.",
    )


def search(
    wanted: Wanted, measure: Measure, witness: Witness, intervals: int | None, level: int
) -> Found:
    """Search what is wanted; warn where it is out of reach.

    `DOP853` reports its first run on this number of intervals, and takes no part if that is None.
    `level` is the stack level of the warning, as in `warnings.warn`.
    """
    seer = HHTRuns(wanted)
    others: list[Runs] = [RadauRuns(seer, wanted)]
    others += [] if intervals is None else [DOP853Runs(seer, intervals, wanted)]
    with warnings.catch_warnings():
        # Coarse runs are there to be compared, and short steps in sharp places are meant.
        for kind in (StabilityWarning, ManyStepsWarning):
            warnings.simplefilter("ignore", kind)
        found = _search(seer, others, measure, wanted.tolerance, witness)
    if not found.reached:
        text = f"tolerance {wanted.tolerance:g}: {found.why}"
        warnings.warn(text, ToleranceWarning, stacklevel=level + 1)
    return found


def _search(
    seer: HHTRuns, others: Sequence[Runs], measure: Measure, tolerance: float, witness: Witness
) -> Found:
    """Run integrators until one reaches the tolerance or the next run would exceed the work limit.

    A run that passed over a sharp place reached nothing. All then follow the places of its path.
    If no run gave an estimate, the last exception is raised again.
    """
    kinds: list[Runs] = [seer, *others]
    spent, failures, ways = _Spent([]), list[Exception](), dict[Runs, float]()
    looks = 0
    while True:
        best = min(kinds, key=lambda runs: runs.error)
        if best.error <= tolerance:
            places = witness.of(best.samples[-1].run, best.chosen)
            if best.follows(places):
                break
            if looks == _LOOKS:
                return _passed_over(spent, best, places.words)
            looks += 1
            for each in kinds:
                each.mind(places)
            continue
        ways = {runs: runs.left for runs in kinds}
        most = _MOST if len(spent.runs) > 1 else math.inf
        going = [x for x in kinds if ways[x] < math.inf and spent.work + x.work <= most]
        if not going:
            break
        runs = min(going, key=ways.__getitem__)
        if not seer.resolved and seer in going and seer.work <= _WORTH * ways[runs]:
            runs = seer
        if not looks and seer.samples and spent.work > _EARLY:
            looks = 1
            early = witness.of(seer.samples[-1].run, seer.chosen)
            if not seer.follows(early):
                for each in kinds:
                    each.mind(early)
                continue
        sample = spent.take(runs, measure)
        if runs.stops_there and runs.samples and looks < _LOOKS:
            places = witness.of(runs.samples[-1].run, runs.chosen)
            if not runs.follows(places):
                looks += 1
                runs.mind(places)
        if isinstance(sample.result, Exception):
            failures.append(sample.result)
    if not best.estimates:
        ended = any(x.samples for x in kinds)
        raise (
            failures[-1] if failures and not ended else _out_of_reach(spent, ways, seer, tolerance)
        )
    reached = best.error <= tolerance
    # What was foreseen before the last run.
    left = "; ".join(spent.price(*x) for x in ways.items() if not reached or x[0] is not best)
    why = f"{best.words}. {'Not taken' if reached else 'To the tolerance'}: {left}."
    return _found(spent, best, best.estimates, reached, why)


def _found(spent: _Spent, best: Runs, estimates: list[Estimate], reached: bool, why: str) -> Found:
    integrator = next(trial.integrator for runs, trial, _ in spent.runs[::-1] if runs is best)
    trials = tuple(trial for _, trial, _ in spent.runs)
    return Found(estimates, best.samples[-1].result, reached, integrator, why, trials)


def _passed_over(spent: _Spent, best: Runs, why: str) -> Found:
    """Return the estimates without bars: no run followed the sharp places of its path."""
    unknown = [Estimate(x, np.full(x.shape, np.inf)) for x, _ in best.estimates]
    return _found(spent, best, unknown, False, f"{why}.")
