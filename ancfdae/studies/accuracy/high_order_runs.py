"""Runs of high order: Radau IIA at fixed steps, and DOP853 at ever tighter tolerances.

Runs of Radau IIA damp waves that they do not resolve, so they are believed where HHT-I3 sees that
steps resolve the waves, or that the waves fade. DOP853 follows every wave.
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
from ancfdae.studies.accuracy.bars import HIGH_GRANTED, Estimate, spread, tightened
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

# Part of the steps at which HHT saw that waves are resolved, at least.
_SHARE = 0.25
# Times the steps of the first run that the last one has, of which nothing is known before.
_FURTHER = 4
# Fewest steps of Radau where waves fade, and its error over the difference of two runs then.
_FADING, _OF_FADING = 32, 0.5


@final
class RadauRuns(FixedStepRuns):
    """Radau IIA, where another sequence sees that waves are resolved.

    Its runs damp those that they do not resolve, and agree without them.
    """

    name, order = "Radau", 5

    def __init__(self, seer: HHTRuns, *of: Any) -> None:
        super().__init__(*of)
        self._seer = seer

    @property
    def least(self) -> int:
        """Stages of a step see half as much again."""
        return max(self._seer.least // 2, self._following_places // 2)

    @property
    def lost(self) -> list[Array]:
        """Waves that runs of HHT-I3 lose; until those resolve them, all that fade."""
        return self._seer.lost if self._seer.resolved else self._seer.whole

    def _estimate(self, runs: Sequence[Array]) -> Estimate:
        """Judge a vector; stiff motions that fade leave nothing of the order."""
        if self._seer.resolved:
            return super()._estimate(runs)
        return Estimate(runs[-1], _OF_FADING * spread(runs[-1] - runs[-2], self._wanted.along))

    @property
    def setting(self) -> Integrator:
        """Return Radau at the fixed step of the next run."""
        return Radau(self._t_end / self.count)

    @property
    def _last(self) -> float:
        """Return the steps that reach the tolerance, by the waves of the other sequence."""
        share = HIGH_GRANTED * PERCENT / (AIM * self._tolerance)
        of_error = self._seer.percent / FEWER * math.pow(share, 1 / self.order)
        return max(of_error, self._seer.counts[-1] * _SHARE, self.least)

    @property
    def _planned(self) -> int:
        if not self.samples:
            # Differences of HHT-I3 are too large for its smooth motion where waves fade.
            share, least = (2, 5) if self._seer.resolved else (4, _FADING)
            return max(math.ceil(self._last / share), least, 2 * self._taken)
        return math.ceil(self._taken * self._growth(self.order, 4.0))

    @property
    def left(self) -> float:
        """Estimated work to reach the tolerance; infinite until runs of HHT resolve all waves.

        What waves may change that the last of these runs loses is part of each bar.
        """
        if not self.resolved or self._seer.damps:
            return math.inf
        if self.relative(self.lost, self._seer.samples[-1].vectors) > self._tolerance:
            return math.inf
        if self.samples:
            return self._work(self._growth(self.order, math.inf) * self._taken)
        return self._work(self.count) + self._work(_FURTHER * self.count)

    def _of_a_step(self, steps: float) -> float:
        """Return the work of a step, microseconds."""
        return self._prices.radau

    @property
    def resolved(self) -> bool:
        """Whether there are no waves that are damped without a word."""
        seer = self._seer
        return (seer.resolved or seer.fades) and (self._wanted.slopes or not seer.passes)

    @property
    def words(self) -> str:
        """Whether waves are resolved, or fade."""
        if self._seer.resolved or not self.resolved:
            return super().words
        return f"{self.name} does not resolve all waves, which change little"

    def _growth(self, order: float, most: float) -> float:
        """Return the growth that the runs show; a first run is compared with the other kind."""
        if self.estimates:
            return super()._growth(order, most)
        if not (self._seer.resolved and self._seer.estimates):
            return 2.0
        far = HIGH_GRANTED * self.apart(self._seer) / (AIM * self._tolerance)
        return min(max(math.pow(far, 1 / order), 2.0), most)

    def judged(self) -> list[Estimate]:
        """Compare the runs; runs that contradict the other kind are left out."""
        return super().judged() if self.agrees(self._seer) else []


# -- DOP853 ------------------------------------------------------------------------------------


# The first tolerance of DOP853 over the one asked for; what the next is tighter by, at least and
# at most.
_FIRST, _TIGHTER, _TIGHTEST = 0.1, 10.0, 1e3
# The loosest and the tightest that it takes.
_LOOSEST, _LEAST_RTOL = 1e-2, 3e-14
# Paths whose sharp places are stops, and how often these are doubled.
_PATHS, _FINER_STOPS = 3, 3
# Least distance of two stops, over the length of a run.
_APART = 1e-7
# Steps that it takes at least without stops.
_LEAST_CHOSEN = 8
# Errors over rtol, at least.
_PER_RTOL = 1.0
# Length of its steps times the fastest motion, and the tolerance below which they are shorter.
_STABLE, _FOLLOWED = 5.7, 1e-3
# Steps that it takes at least, so that more are tried where they are too few.
_FEWEST = 20.0
# Part of the narrowest transition of forces that error control must know the state to.
_OF_NARROW = 0.1


@final
class DOP853Runs(Runs):
    """DOP853 under error control, which resolves all waves.

    What a tolerance means for the error is the scene's: two runs tell.
    """

    name = "DOP853"
    words = "DOP853 follows every wave; two tolerances tell its errors"
    # Times as many steps as foreseen.
    _more = 1.0
    # Sharp places of the last paths, and stops in them.
    _places: tuple[Places, ...] = ()
    _stops: tuple[float, ...] = ()
    _chosen = _LEAST_CHOSEN

    def __init__(self, seer: HHTRuns, intervals: int, wanted: Wanted) -> None:
        super().__init__(wanted)
        self._seer, self._intervals = seer, intervals
        self._asked, self._taken = min(_FIRST * self._tolerance, _LOOSEST), list[float]()

    @property
    def _rtol(self) -> float:
        """The tolerance of the next run, at which derivatives pass over no transition of forces."""
        if not self._wanted.slopes:
            return self._asked
        return min(self._asked, _OF_NARROW * self._seer.transitions.narrow)

    @property
    def setting(self) -> Integrator:
        """DOP853 at the tolerance of the next run."""
        stops = (*self._wanted.features.stops, *self._stops)
        most = math.ceil(3 * self._foreseen) + 20 + 3 * len(stops)
        # Interpolation between instants is an error too: each run has twice as many.
        intervals = self._intervals * 2 ** len(self._taken)
        return DOP853(max(self._rtol, _LEAST_RTOL), intervals, most, stops=stops)

    @property
    def chosen(self) -> int:
        """Steps of the last run, without those that stops asked for."""
        return self._chosen

    def _stop(self) -> None:
        """Stop in places; steps that stops alone make must be finer in every run, to differ."""
        times = 2 ** min(len(self._taken), _FINER_STOPS)
        each = sorted({x for places in self._places for x in places.stops(times)})
        least = _APART * self._t_end
        self._stops = tuple(x for before, x in pairwise([-least, *each]) if x > before + least)

    def follows(self, places: Places) -> bool:
        """Return whether the runs stopped in every place of the last one."""
        return places.followed((*self._wanted.features.stops, *self._stops))

    @property
    def stops_there(self) -> bool:
        """Whether runs stop in sharp places."""
        return bool(self._stops)

    def mind(self, places: Places) -> None:
        """Begin again with stops in the places."""
        self._places = (*self._places[1 - _PATHS :], places) if places.parts else self._places
        self.samples, self._taken = [], []
        self._stop()
        self._asked = min(_FIRST * self._tolerance, _LOOSEST)
        super().mind(places)

    def take(self, sample: Sample) -> None:
        """Add a run; the next is as tight as the last two ask for, or may take more steps."""
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
        """The tolerance that the runs ask of the next one."""
        if not self.estimates:
            return self._rtol / _TIGHTER
        further = self.error / (AIM * self._tolerance)
        return self._rtol / min(max(further, _TIGHTER), _TIGHTEST)

    @cached_property
    def _fastest(self) -> tuple[float, bool]:
        """Steps that stability takes, and whether tight tolerances take more of them."""
        seer, per_speed = self._seer, self._t_end / _STABLE
        if seer.transitions.steps and seer.samples:
            # What starts within a transition is stiff there, and leaves it at once.
            speed = pace(self._system, seer.samples[-1].run)
            if speed is not None:
                return speed * per_speed, False
        return self._wanted.speed * per_speed, True

    def _steps(self, rtol: float) -> float:
        """Return the steps at a tolerance, of accuracy or of stability."""
        if self.samples:
            return self.samples[-1].steps * math.pow(max(self._taken[-1] / rtol, 1.0), 1 / 8)
        smooth = self._seer.percent / FEWER * math.pow(max(PERCENT / rtol, 1.0), 1 / 8)
        if self._seer.waves:  # HHT errs by these, which stability asks to be followed anyway.
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
        """Estimated work of the next run at the predicted number of steps, microseconds."""
        return self._of(self._foreseen)

    def _of(self, steps: float) -> float:
        instants = 8 * self._intervals
        evaluations = 12 * steps + instants
        # Measured with up to three variables; every one is a row of the states.
        rows = max(1.0, (1 + self._system.n_b) / 4)
        return OF_A_RUN + evaluations * self._prices.evaluation * rows

    @property
    def left(self) -> float:
        """Estimated work of the next run and of the one that judges it, microseconds.

        Infinite until the runs of HHT ask for it, and once the tolerance is the tightest.
        """
        if not self._seer.asked or (self._taken and self._taken[-1] <= _LEAST_RTOL):
            return math.inf
        if self.samples:
            return self.work
        return self.work + self._of(self._steps(self._rtol / _TIGHTER))

    def judged(self) -> list[Estimate]:
        """Return error bars from the last two runs; from a third one if HHT contradicts them."""
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
