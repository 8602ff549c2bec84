"""Runs of high order: Radau IIA at fixed steps, and DOP853 at ever tighter tolerances.

Runs of Radau IIA damp waves that they do not resolve, so they are used where HHT-I3 shows that
steps resolve the waves, or that the waves fade. DOP853 resolves every wave.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, final

import numpy as np

from ancfdae.integrators.explicit import DOP853
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.radau.method import Radau
from ancfdae.numerics.arrays import Array
from ancfdae.studies.accuracy.bars import HIGH_GRANTED, Estimate, falls, refined, spread, tightened
from ancfdae.studies.accuracy.hht_runs import HHTRuns
from ancfdae.studies.accuracy.places import Places
from ancfdae.studies.accuracy.runs import (
    AIM,
    FEWER,
    OF_A_RUN,
    PERCENT,
    FixedStepRuns,
    Runs,
    Sample,
    Wanted,
)
from ancfdae.studies.accuracy.waves import pace

# Least number of steps over the number at which HHT showed that waves are resolved.
_SHARE = 0.25
# Number of steps of the last run over that of the first, as predicted before there are any runs.
_FURTHER = 4
# Least number of steps of Radau where waves fade, and error bar over the difference of two runs
# then.
_FADING, _OF_FADING = 32, 0.5


@final
class RadauRuns(FixedStepRuns):
    """Runs of Radau IIA, used where the sequence of HHT shows that waves are resolved.

    Its own runs damp unresolved waves, and agree without them.
    """

    name, order = "Radau", 5

    def __init__(self, seer: HHTRuns, *of: Any) -> None:
        super().__init__(*of)
        self._seer = seer

    @property
    def least(self) -> int:
        """Least number of steps; half of HHT's, because each step has three stages."""
        return max(self._seer.least // 2, self._following_places // 2)

    @property
    def lost(self) -> list[Array]:
        """Errors by waves: those of HHT's runs; of all unresolved waves until HHT resolves them."""
        return self._seer.lost if self._seer.resolved else self._seer.whole

    def _estimate(self, runs: Sequence[Array]) -> Estimate:
        """Return the error estimate of a result vector; without an order if stiff motions fade.

        Velocities and reactions over time have lower orders than the motion: an order of values
        over time is used only if three runs show it.
        """
        if self._seer.resolved and self._wanted.along:
            steps, differences = self.counts[-3:], np.diff(runs[-3:], axis=0)
            sizes = np.linalg.norm(differences, axis=1)
            seen = len(runs) > 2 and falls(sizes, steps, self.order, faster=True)
            return refined(runs[-3:], steps, self.order, seen and not self.bent, True)
        if self._seer.resolved:
            return super()._estimate(runs)
        return Estimate(runs[-1], _OF_FADING * spread(runs[-1] - runs[-2], self._wanted.along))

    @property
    def setting(self) -> Integrator:
        """The integrator Radau at the fixed step of the next run."""
        return Radau(self._t_end / self.count)

    @property
    def _last(self) -> float:
        """Number of steps to reach the tolerance, by the errors and waves of HHT's runs."""
        share = HIGH_GRANTED * PERCENT / (AIM * self._tolerance)
        of_error = self._seer.percent / FEWER * math.pow(share, 1 / self.order)
        return max(of_error, self._seer.counts[-1] * _SHARE, self.least)

    @property
    def _planned(self) -> int:
        if not self.samples:
            # Where waves fade, differences of HHT-I3 exceed the error of the smooth motion.
            share, least = (2, 5) if self._seer.resolved else (4, _FADING)
            return max(math.ceil(self._last / share), least, 2 * self._taken)
        return math.ceil(self._taken * self._growth(self.order, 4.0))

    @property
    def left(self) -> float:
        """Estimated cost to reach the tolerance, microseconds; infinite with unresolved waves.

        It is also infinite where waves that the runs of HHT-I3 lose change more than the
        tolerance: each bar of Radau holds this change.
        """
        if not self.resolved or self._seer.damps:
            return math.inf
        if self.relative(self.lost, self._seer.samples[-1].vectors) > self._tolerance:
            return math.inf
        if self.samples:
            return self._work(self._growth(self.order, math.inf) * self._taken)
        return self._work(self.count) + self._work(_FURTHER * self.count)

    def _of_a_step(self, steps: float) -> float:
        """Return the cost of a step, microseconds, in a run of `steps` steps."""
        return self._prices.radau

    @property
    def resolved(self) -> bool:
        """Whether no wave is damped unnoticed: HHT resolves all waves, or they fade."""
        seer = self._seer
        return (seer.resolved or seer.fades) and (self._wanted.slopes or not seer.passes)

    @property
    def words(self) -> str:
        """A sentence that says whether waves are resolved, or fade."""
        if self._seer.resolved or not self.resolved:
            return super().words
        return f"{self.name} does not resolve all waves, which change little"

    def _growth(self, order: float, most: float) -> float:
        """Return the factor to the next number of steps; the first run is compared with HHT's."""
        if self.estimates:
            return super()._growth(order, most)
        if not (self._seer.resolved and self._seer.estimates):
            return 2.0
        far = HIGH_GRANTED * self.apart(self._seer) / (AIM * self._tolerance)
        return min(max(math.pow(far, 1 / order), 2.0), most)

    def judged(self) -> list[Estimate]:
        """Return estimates from the runs; none if they contradict the estimates of HHT."""
        return super().judged() if self.agrees(self._seer) else []


# -- DOP853 ------------------------------------------------------------------------------------


# First tolerance of DOP853 over the requested one, and least and largest factor to the next one. A
# run only judges the next one: errors of runs whose tolerances are a factor of ten apart may be
# alike.
_FIRST, _TIGHTER, _TIGHTEST = 1.0, 100.0, 1e3
# Loosest and tightest tolerance of DOP853 in a search.
_LOOSEST, _LEAST_RTOL = 1e-2, 3e-14
# Number of last paths whose sharp places have stops, and how often the stops are doubled.
_PATHS, _FINER_STOPS = 3, 3
# Least distance of two stops, over the length of a run.
_APART = 1e-7
# Least number of steps that is counted without stops.
_LEAST_CHOSEN = 8
# Least error bar over rtol.
_PER_RTOL = 1.0
# Largest stable step times the fastest |s|, and tolerance below which steps are shorter.
_STABLE, _FOLLOWED = 5.7, 1e-3
# Assumed least number of steps; if they prove too few, more are allowed.
_FEWEST = 20.0
# Tolerance over the change of state within the narrowest transition of forces.
_OF_NARROW = 0.1


@final
class DOP853Runs(Runs):
    """Runs of DOP853 under error control, which resolves all waves.

    The error at a given tolerance depends on the scene: two runs show it.
    """

    name = "DOP853"
    words = "DOP853 follows every wave; two tolerances tell its errors"
    # Factor on the predicted number of steps.
    _more = 1.0
    # Sharp places of the last paths, and stops within them.
    _places: tuple[Places, ...] = ()
    _stops: tuple[float, ...] = ()
    _chosen = _LEAST_CHOSEN

    def __init__(self, seer: HHTRuns, intervals: int, wanted: Wanted) -> None:
        super().__init__(wanted)
        self._seer, self._intervals = seer, intervals
        self._asked, self._taken = min(_FIRST * self._tolerance, _LOOSEST), list[float]()

    @property
    def _rtol(self) -> float:
        """Tolerance of the next run; with it derivatives pass over no transition of forces."""
        if not self._wanted.slopes:
            return self._asked
        return min(self._asked, _OF_NARROW * self._seer.transitions.narrow)

    @property
    def setting(self) -> Integrator:
        """The integrator DOP853 at the tolerance of the next run."""
        stops = (*self._wanted.features.stops, *self._stops)
        most = math.ceil(3 * self._foreseen) + 20 + 3 * len(stops)
        # Interpolation between output times is an error too: each run doubles their number.
        intervals = self._intervals * 2 ** len(self._taken)
        return DOP853(max(self._rtol, _LEAST_RTOL), intervals, most, stops=stops)

    @property
    def chosen(self) -> int:
        """Number of steps of the last run of DOP853, less the number of stops."""
        return self._chosen

    def _stop(self) -> None:
        """Set stops in sharp places; later runs have more, so that steps at stops differ, too."""
        times = 2 ** min(len(self._taken), _FINER_STOPS)
        each = sorted({x for places in self._places for x in places.stops(times)})
        least = _APART * self._t_end
        self._stops = tuple(x for before, x in pairwise([-least, *each]) if x > before + least)

    def follows(self, places: Places) -> bool:
        """Return whether the stops of the runs divide every sharp place of the last path."""
        return places.followed((*self._wanted.features.stops, *self._stops))

    @property
    def stops_there(self) -> bool:
        """Whether the runs of DOP853 stop in sharp places of their paths."""
        return bool(self._stops)

    def mind(self, places: Places) -> None:
        """Restart the sequence with stops in the given sharp places."""
        self._places = (*self._places[1 - _PATHS :], places) if places.parts else self._places
        self.samples, self._taken = [], []
        self._stop()
        self._asked = min(_FIRST * self._tolerance, _LOOSEST)
        super().mind(places)

    def take(self, sample: Sample) -> None:
        """Add a run, and choose the tolerance of the next, or allow more steps after a failure."""
        if sample.vectors:
            self._taken.append(self._rtol)
        super().take(sample)
        self._chosen = max(sample.steps - len(self._stops), _LEAST_CHOSEN)
        self._stop()
        if not sample.vectors:
            self._more *= 3
            self._taken = []
        else:
            self._asked = self._next

    @property
    def _next(self) -> float:
        """Tolerance of the next run of DOP853, from the error of the runs so far."""
        if not self.estimates:
            return self._rtol / _TIGHTER
        further = self.error / (AIM * self._tolerance)
        return self._rtol / min(max(further, _TIGHTER), _TIGHTEST)

    @cached_property
    def _fastest(self) -> tuple[float, bool]:
        """Number of steps for stability, and whether tight tolerances need more of them."""
        seer, per_speed = self._seer, self._t_end / _STABLE
        if seer.transitions.steps and seer.samples:
            # A start within a transition is stiff there, but leaves it at once.
            speed = pace(self._system, seer.samples[-1].run)
            if speed is not None:
                return speed * per_speed, False
        return self._wanted.speed * per_speed, True

    def _steps(self, rtol: float) -> float:
        """Return the predicted number of steps at a tolerance, for accuracy or stability."""
        if self.samples:
            return self.samples[-1].steps * math.pow(max(self._taken[-1] / rtol, 1.0), 1 / 8)
        smooth = self._seer.percent / FEWER * math.pow(max(PERCENT / rtol, 1.0), 1 / 8)
        if self._seer.waves:  # Waves cause HHT's error; stability resolves them anyway.
            smooth = _FEWEST
        waves, vibrate = self._fastest
        if vibrate:
            waves *= math.pow(max(_FOLLOWED / rtol, 1.0), 1 / 8)
        return self._more * max(smooth, waves)

    @property
    def _foreseen(self) -> float:
        return self._steps(self._rtol)

    @property
    def work(self) -> float:
        """Estimated cost of the next run at the predicted number of steps, microseconds.

        Infinite after a run at the tightest tolerance.
        """
        tightest = self._taken and self._taken[-1] <= _LEAST_RTOL
        return math.inf if tightest else self._of(self._foreseen)

    def _of(self, steps: float) -> float:
        instants = 8 * self._intervals
        evaluations = 12 * steps + instants
        # Measured with up to three variables, each of which adds a row to the states.
        rows = max(1.0, (1 + self._system.n_b) / 4)
        return OF_A_RUN + evaluations * self._prices.evaluation * rows

    @property
    def left(self) -> float:
        """Estimated cost of the next run and of the one that judges it, microseconds.

        Infinite until there are runs of HHT to compare.
        """
        if not self._seer.asked:
            return math.inf
        if self.samples:
            return self.work
        return self.work + self._of(self._steps(self._rtol / _TIGHTER))

    def judged(self) -> list[Estimate]:
        """Return estimates from the last two runs; from three if HHT's runs contradict them."""
        if len(self.samples) < 2 or (len(self.samples) == 2 and not self.agrees(self._seer)):
            return []
        before, after = (x.vectors for x in self.samples[-2:])
        least = _PER_RTOL * self._taken[-1]
        estimates = []
        for x, y, size in zip(before, after, self._sizes(after), strict=True):
            floor = least * size / math.sqrt(y.size)
            bar = np.maximum(tightened(x, y, self._wanted.along), floor)
            estimates.append(Estimate(y, bar))
        return estimates
