"""Sequences of runs, each finer than the one before: what they cost and what they tell."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.equations import ErrorEstimates
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.explicit import DOP853
from ancfdae.integrators.hht.method import HHT
from ancfdae.integrators.hht.small_steps import small_from
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.radau.method import Radau
from ancfdae.numerics.arrays import Array
from ancfdae.studies.tolerance.bars import HIGH_GRANTED, Estimate, falls, refined, spread, tightened
from ancfdae.studies.tolerance.places import Places
from ancfdae.studies.tolerance.runs import OF_A_RUN, Runs, Sample, Wanted
from ancfdae.studies.tolerance.spectrum import fades, pace
from ancfdae.studies.tolerance.transitions import RESOLVED, Transition, passed_over
from ancfdae.studies.tolerance.waves import Missed, Wave, followed, missed, unresolved

# Order at which the estimated errors of derivatives fall where steps resolve their waves: from two
# runs, and, lower, from the second and third of three.
_RESOLVED, _NEARLY = 1.95, 1.9
# Estimated errors above this have no order: the run is another motion.
_SENSE = 1.0
# States and their derivatives of a run at fixed steps, bytes.
_MEMORY = 5e8
# A run aims at the part _AIM of the tolerance, with at least _LEAST times the steps of the last.
_AIM, _LEAST = 0.7, 1.4
# Numerical damping of HHT-I3.
_ALPHA = -0.05
# Least order that is hoped for where waves are not resolved.
_UNSEEN = 1.2
# Where HHT errs by a hundredth, methods of high order do so with a share of its steps; Radau takes
# a share of those at which HHT saw that waves are resolved.
_PERCENT, _FEWER, _SHARE = 1e-2, 8.0, 0.25
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
# Differences over the tolerance whose order need not be seen.
_SMALL = 0.05
# What all unresolved waves may change, over the tolerance, for the order to be believed, and the
# improvement of numbers by it; and bars then, over those of resolved waves.
_LITTLE, _NOTHING, _ORDER_ONLY = 0.2, 0.05, 2.0
# Fewest steps of Radau where waves fade, and its error over the difference of two runs then.
_FADING, _OF_FADING = 32, 0.5
# Errors over the tolerance of two runs that do not resolve waves, at least: they may agree by
# chance in all that is wanted.
_DOUBTED = 2.0
# How much faster than with the order estimated errors may fall; else the coarse run is another
# motion.
_FASTER = 0.6
# Part of the narrowest transition of forces that error control must know the state to.
_OF_NARROW = 0.1
# Work of the derivatives of a small step of HHT-I3 (`small_from`).
_OF_A_SMALL = 60.0


class _Steps(Runs):
    """Runs of one integrator at fixed steps, each finer than the one before."""

    order: ClassVar[int]
    _taken = 0
    # Steps that follow sharp places, and that jump over no kink.
    _following_places = _kinks = 0

    @property
    def counts(self) -> list[int]:
        """Steps of the runs."""
        return [x.steps for x in self.samples]

    @property
    def count(self) -> int:
        """Steps of the next run."""
        return max(self._planned, self._taken + 1)

    @property
    @abc.abstractmethod
    def _planned(self) -> int:
        """Steps that the next run should have."""

    @property
    @final
    def work(self) -> float:
        """Estimated work of the next run, microseconds; infinite if its states exceed _MEMORY."""
        row = 8.0 * (3 * self._n + self._system.n_lam) * (1 + self._system.n_b)
        return self._work(self.count) if self.count * row < _MEMORY else math.inf

    def take(self, sample: Sample) -> None:
        """Add a run and note its number of steps."""
        self._taken = self.count
        super().take(sample)

    @property
    def chosen(self) -> int:
        """Steps of the last run."""
        return self.counts[-1]

    def follows(self, places: Places) -> bool:
        """Return whether no place lies between the steps of the last run; kinks are known."""
        return places.steps <= self.counts[-1] and places.kinks <= self._kinks

    @property
    def bent(self) -> bool:
        """Whether steps of the last run jump over kinks, so that errors have no order."""
        return bool(self.samples) and self.counts[-1] < self._kinks

    def mind(self, places: Places) -> None:
        """Take as many steps as follow the places."""
        self._following_places = max(self._following_places, places.steps)
        self._kinks = max(self._kinks, places.kinks)
        super().mind(places)

    def _growth(self, order: float, most: float) -> float:
        """Return the factor of the number of steps that leads to the tolerance, at most `most`."""
        error = (
            self.error if self.estimates else self.relative(self._gaps, self.samples[-1].vectors)
        )
        wanted = math.pow(error / (_AIM * self._tolerance), 1 / order)
        return min(max(wanted, _LEAST), most)

    @property
    def _gaps(self) -> list[Array]:
        """Differences of the last two runs."""
        before, after = (x.vectors for x in self.samples[-2:])
        return [y - x for x, y in zip(before, after, strict=True)]

    @final
    def _work(self, steps: float) -> float:
        return OF_A_RUN + steps * self._of_a_step(steps)

    @abc.abstractmethod
    def _of_a_step(self, steps: float) -> float:
        """Return the measured work of one step, microseconds, in a run of `steps` steps."""

    @property
    @abc.abstractmethod
    def resolved(self) -> bool:
        """Whether steps resolve the waves of the motion and of its derivatives."""

    @property
    def words(self) -> str:
        """Whether waves are resolved."""
        if not self.resolved:
            return f"{self.name} does not resolve all waves; bars are those of its differences"
        return f"{self.name} resolves all waves of the derivatives; errors fall with its order"

    def judged(self) -> list[Estimate]:
        """Compare the runs; add what they may miss by waves that they damp."""
        if len(self.samples) < 2 or self.counts[-2] < self.least:
            return []
        estimates = [
            self._estimate(x) for x in zip(*(x.vectors for x in self.samples[-5:]), strict=True)
        ]
        if len(self.samples) == 2 and not self.resolved:
            sizes = self._sizes([x for x, _ in estimates])
            least = (_DOUBTED * self._tolerance * size for size in sizes)
            estimates = [
                Estimate(x, np.maximum(bar, doubt / math.sqrt(x.size)))
                for (x, bar), doubt in zip(estimates, least, strict=True)
            ]
        lost = self.lost or [np.zeros(x.shape) for x, _ in estimates]
        return [Estimate(x, bar + more) for (x, bar), more in zip(estimates, lost, strict=True)]

    @property
    def least(self) -> int:
        """Steps below which laws or objectives have features that runs pass over."""
        return max(self._wanted.features.steps, self._following_places)

    def _estimate(self, runs: Sequence[Array]) -> Estimate:
        """Judge a vector of the last two to five runs."""
        ordered = self.resolved and not self.bent
        return refined(runs[-3:], self.counts[-3:], self.order, ordered, self._wanted.along)

    @property
    @abc.abstractmethod
    def lost(self) -> list[Array]:
        """Possible errors of the vectors by waves that numerical damping removes; empty if none."""


@final
class Second(_Steps):
    """Runs of HHT-I3, hht_alpha = -0.05: unresolved waves appear as differences between runs."""

    name, order = "HHT", 2

    def __init__(self, wanted: Wanted) -> None:
        super().__init__(wanted)
        # What is lost by waves, and the waves.
        self._lost, self._damped = list[Array](), list[Wave]()
        # What all unresolved waves change, and its size.
        self.whole, self._whole = list[Array](), math.inf
        # The error of the run before.
        self._before = math.inf
        # Whether they fade; None as long as nobody asks.
        self._fades: bool | None = None
        # Whether its runs damped waves of the motion.
        self.waves = False
        # Steps above which they are small.
        self._small = math.inf
        # Transitions of forces that its runs pass over.
        self.transitions = RESOLVED

    def take(self, sample: Sample) -> None:
        """Add a run; look for waves that it damps.

        Runs that damp waves, or pass over features, which the next one follows say nothing of it.
        Nor do those whose estimated errors are of another motion.
        """
        taken = self.count
        if self._taken < self.least <= taken or self._another(sample):
            self.samples = []
        elif self.damps:
            self.samples = self.samples[-1:] if sample.steps < self._following / 2 else []
        self._lost, self._damped, self.whole, self._whole, self._fades = [], [], [], math.inf, None
        wanted, system = self._wanted, self._system
        self._before = self.error
        if sample.vectors:
            found = passed_over(wanted.problem, sample.run, self._tolerance)
            steps = max(found.steps, self.transitions.steps)
            self.transitions = Transition(steps, min(found.narrow, self.transitions.narrow))
        if sample.vectors and wanted.slopes:
            self._small = small_from(system, sample.run, _ALPHA)
        if self.samples and sample.vectors:
            self._weigh(sample, _resolve([*self.samples, sample]))
        super().take(sample)
        self._taken = taken

    def _weigh(self, sample: Sample, resolved: bool) -> None:
        """Weigh the waves that a run does not resolve."""
        wanted = self._wanted
        waves = unresolved(wanted.problem, sample.run, _ALPHA, not resolved)
        self._damped = [x.wave for x in waves if x.damped]
        self.waves = self.waves or bool(self._damped)
        lost = missed(
            wanted.problem, sample.run, waves, (wanted.numbers, wanted.integrated, wanted.partials)
        )
        self._lost, self.whole = map(self._parts, lost)
        # Waves of derivatives are seen where the run has them.
        if wanted.slopes and sample.run.sensitivities is not None:
            self._whole = self.relative(self.whole, sample.vectors)

    def _another(self, sample: Sample) -> bool:
        """Return whether estimated errors fall faster than runs of one motion allow."""
        if not (self.samples and sample.vectors):
            return False
        return _estimated_order(self.samples[-1], sample) > self.order + _FASTER

    @property
    def least(self) -> int:
        """Steps that also resolve transitions of forces, which derivatives need."""
        return max(super().least, self.transitions.steps if self._wanted.slopes else 0)

    @property
    def passes(self) -> bool:
        """Whether its steps pass over transitions of forces."""
        return self._taken < self.transitions.steps

    @property
    def lost(self) -> list[Array]:
        """By the last two runs; all of unresolved waves where they are few."""
        return self.whole if self.smooth and not self.resolved else self._lost

    @property
    def smooth(self) -> bool:
        """Whether all that unresolved waves change is below the tolerance; of three runs."""
        return self._whole <= _LITTLE * self._tolerance and len(self.samples) > 2

    def _estimate(self, runs: Sequence[Array]) -> Estimate:
        """Judge a vector; its order is believed where it is seen and no wave can be a part of it.

        The improvement of numbers by extrapolation is believed where waves change nothing. Steps
        that jump over a kink of forces err by where they meet it, to first order.
        """
        earlier, runs = runs[:-1], runs[-3:]
        kinked = len(earlier) == 4 and not (
            self._seen(earlier[:3], self.counts[-5:-2])
            or self._seen(earlier[1:], self.counts[-4:-1])
        )
        if kinked or self.passes or self.bent:
            return refined(runs, self.counts[-3:], self.order, False, self._wanted.along)
        if self._wanted.along:
            return self._over_time(runs)
        if self.resolved or not self.smooth:
            return super()._estimate(runs)
        if not self._seen(runs, self.counts[-3:]):
            return super()._estimate(runs)
        known = self.counts[-3:], self.order, True, self._wanted.along
        x, bar = refined(runs, *known, improved=self._whole <= _NOTHING * self._tolerance)
        return Estimate(x, _ORDER_ONLY * bar)

    def _over_time(self, runs: Sequence[Array]) -> Estimate:
        """Judge values at increasing instants; their order is believed where it is seen.

        That the motion resolves its waves says little of velocities and reactions.
        """
        resolved = self.resolved and (len(runs) < 3 or self._seen(runs, self.counts[-3:]))
        known = self.counts[-3:], self.order, resolved, True
        x, bar = refined(runs, *known)
        return Estimate(x, bar if len(runs) > 2 or not resolved else _ORDER_ONLY * bar)

    def _seen(self, runs: Sequence[Array], counts: Sequence[int]) -> bool:
        """Return whether the differences of three runs fall with the order, or faster."""
        return falls(np.linalg.norm(np.diff(runs, axis=0), axis=1), counts, self.order, faster=True)

    @property
    def regular(self) -> bool:
        """Whether the order is seen in all that is not small beside the tolerance, without waves.

        Then numbers do not depend on whether waves are resolved.
        """
        if not self.smooth:
            return False
        vectors = [x.vectors for x in self.samples[-3:]]
        sizes = self._sizes(vectors[-1])
        return all(
            self._seen(runs, self.counts[-3:])
            or float(np.linalg.norm(runs[-1] - runs[-2])) <= _SMALL * self._tolerance * size
            for runs, size in zip(zip(*vectors, strict=True), sizes, strict=True)
        )

    @property
    def fades(self) -> bool:
        """Whether damping takes away all waves that its last run does not resolve."""
        if self._fades is None:
            self._fades = self.smooth and fades(self._system, self.samples[-1].run)
        return self._fades

    def _parts(self, parts: Sequence[Missed]) -> list[Array]:
        """Return what is lost of each vector."""
        return [x for each in parts for x in each[: 1 + self._wanted.slopes]]

    @property
    def damps(self) -> bool:
        """Whether waves that it damps may change more than the tolerance allows."""
        vectors = self.samples[-1].vectors if self.samples else []
        return bool(self._damped) and self.relative(self._lost, vectors) > _AIM * self._tolerance

    @property
    def words(self) -> str:
        """A sentence on the waves of the motion and whether runs of HHT damp them."""
        if self.damps:
            waves = f"waves of about {max(x.speed for x in self._damped):.2g} rad/s"
            return f"{self.name} damps {waves}, which its steps pass over; bars hold their share"
        if self.smooth and not self.resolved:
            return f"{self.name} does not resolve all waves, which change little; bars hold that"
        return super().words

    @property
    def setting(self) -> Integrator:
        """HHT at the fixed step of the next run."""
        return HHT(self._t_end / self.count, hht_alpha=_ALPHA)

    @property
    def _planned(self) -> int:
        """Steps: first such that they cost what a run costs without; nested where waves hide."""
        if len(self.samples) < 2:
            return 2 * self._taken or (64 if self._compiled else 16)
        if self._taken < self.least:
            return self.least
        if self.damps:
            return math.ceil(self._following)
        growth = 2.0
        if self.resolved or self.regular:
            growth = self._growth(3, self._stride) if self.resolved else self._growth(2, 2.0)
        return math.ceil(growth * self._taken)

    @property
    def _stride(self) -> float:
        """Most times the steps of a run that the next one has where waves are resolved.

        Long strides say little of the last run alone, which bars over time and pulses need.
        """
        return 2.0 if self._wanted.along or self.least else 4.0

    @property
    def _following(self) -> float:
        """Steps that keep the waves which the last run damps."""
        return followed(self._damped, self._t_end, _ALPHA, 1.4 * self._taken)

    @property
    def left(self) -> float:
        """Estimated work to reach the tolerance, microseconds.

        The next run alone while there are fewer than two, then all runs up to one that is fine
        enough.
        """
        if len(self.samples) < 2:
            return self.work
        if self._taken < self.least:
            return self._work(self.least) + self._work(2 * self.least)
        if self.damps:
            return self._work(self._following) + self._work(2 * self._following)
        order = 3 if self.resolved else 2 if self.regular else self._falls
        last = max(self._growth(order, math.inf) * self._taken, self.count)
        most = self._stride if self.resolved else 2.0
        runs = math.ceil(math.log(last / self._taken) / math.log(most))
        return self._work(last) * (1 - most**-runs) / (1 - 1 / most)

    @property
    def _falls(self) -> float:
        """Order that is hoped for where waves are not resolved: that of the last two errors."""
        if not (self.error < self._before < math.inf):
            return _UNSEEN
        seen = math.log(self._before / self.error) / math.log(self.counts[-1] / self.counts[-2])
        return min(max(seen, _UNSEEN), self.order)

    def _of_a_step(self, steps: float) -> float:
        """Return the work of a compiled step, or of one in Python; small steps count extra."""
        if not self._compiled:
            return 1300.0
        return 4.0 + 0.7 * self._n + (_OF_A_SMALL if steps > self._small else 0.0)

    @property
    def resolved(self) -> bool:
        """Whether the errors that two runs estimate themselves fell with the order.

        Finer steps resolve what coarser ones did.
        """
        return _resolve(self.samples)

    @property
    def asked(self) -> bool:
        """Whether there are runs to compare, or the first one failed."""
        return self._taken > 0 and len(self.samples) != 1

    @property
    def percent(self) -> float:
        """Steps at which an error is a hundredth, by the last difference; a guess without."""
        if len(self.samples) < 2:
            return float(max(self._planned, 2 * self._taken))
        ratio = self.counts[-1] / self.counts[-2]
        error = self.relative(self._gaps, self.samples[-1].vectors) / (ratio**2 - 1)
        return self.counts[-1] * math.sqrt(error / _PERCENT)


def _resolve(samples: Sequence[Sample]) -> bool:
    """Return whether the errors that runs estimate themselves fell with the order once."""
    orders = list(map(_estimated_order, samples, samples[1:]))
    return max(orders, default=0.0) >= _RESOLVED or max(orders[1:], default=0.0) >= _NEARLY


def _estimated_order(coarse: Sample, fine: Sample) -> float:
    """Return the order at which estimated errors fall from a run to a finer one."""
    before, after = _largest(coarse.estimated), _largest(fine.estimated)
    if not (0 < after < math.inf and 0 < before <= _SENSE):
        return 0.0
    return math.log(before / after) / math.log(fine.steps / coarse.steps)


def _largest(errors: ErrorEstimates | None) -> float:
    """Return the largest error of derivatives, or of the motion where there is none of them."""
    if errors is None:
        return math.inf
    known = [x for x in errors.derivatives or () if not math.isnan(x)]
    return max(known, default=errors.motion)


@final
class Fifth(_Steps):
    """Radau IIA, where another sequence sees that waves are resolved.

    Its runs damp those that they do not resolve, and agree without them.
    """

    name, order = "Radau", 5

    def __init__(self, seer: Second, *of: Any) -> None:
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
        """Steps that lead to the tolerance, by what the other sequence tells of the waves."""
        share = HIGH_GRANTED * _PERCENT / (_AIM * self._tolerance)
        of_error = self._seer.percent / _FEWER * math.pow(share, 1 / self.order)
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
        """Estimated work to reach the tolerance; infinite until runs of HHT resolve all waves."""
        if not self.resolved or self._seer.damps:
            return math.inf
        if self.samples:
            return self._work(self._growth(self.order, math.inf) * self._taken)
        return self._work(self.count) + self._work(2 * self.count)

    def _of_a_step(self, steps: float) -> float:
        """Return the work of a compiled step, or of one in Python, microseconds."""
        if not self._compiled:
            return 6500.0
        return 100.0 + 25.0 * self._n + 6.0 * self._of_laws

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
        """By what the runs tell; the first one by how far it is from the other kind."""
        if self.estimates:
            return super()._growth(order, most)
        if not (self._seer.resolved and self._seer.estimates):
            return 2.0
        far = HIGH_GRANTED * self.apart(self._seer) / (_AIM * self._tolerance)
        return min(max(math.pow(far, 1 / order), 2.0), most)

    def judged(self) -> list[Estimate]:
        """Compare the runs; those that contradict the other kind tell nothing."""
        return super().judged() if self.agrees(self._seer) else []


@final
class Eighth(Runs):
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

    def __init__(self, seer: Second, intervals: int, wanted: Wanted) -> None:
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
        further = self.error / (_AIM * self._tolerance)
        return self._rtol / min(max(further, _TIGHTER), _TIGHTEST)

    @cached_property
    def _fastest(self) -> tuple[float, bool]:
        """Steps that stability takes, and whether tight tolerances take more of them."""
        from ancfdae.modes.configuration import LinearisationPoint
        from ancfdae.modes.periods import fastest

        seer, per_speed = self._seer, self._t_end / _STABLE
        if seer.transitions.steps and seer.samples:
            # What starts within a transition is stiff there, and leaves it at once.
            speed = pace(self._system, seer.samples[-1].run)
            if speed is not None:
                return speed * per_speed, False
        try:
            initial = self._wanted.problem.initial
            at = LinearisationPoint(initial.q, initial.lam, t=initial.t)
            return fastest(self._system, at) * per_speed, True
        except AncfdaeError:  # Nothing vibrates.
            return 0.0, False

    def _steps(self, rtol: float) -> float:
        """Return the steps at a tolerance, of accuracy or of stability."""
        if self.samples:
            return self.samples[-1].steps * math.pow(max(self._taken[-1] / rtol, 1.0), 1 / 8)
        smooth = self._seer.percent / _FEWER * math.pow(max(_PERCENT / rtol, 1.0), 1 / 8)
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
        of_one = 16.0 + 0.12 * self._n if self._compiled else 1100.0
        traits = self._system.traits
        if not (traits.constant_mass and traits.constant_constraints):
            of_one = max(of_one, 60.0 + self._n)
        of_one += self._of_laws
        # Measured with up to three variables; every one is a row of the states.
        return OF_A_RUN + evaluations * of_one * max(1.0, (1 + self._system.n_b) / 4)

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
