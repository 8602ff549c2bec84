"""Runs of HHT-I3: whether their steps resolve the waves, and what unresolved waves may change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from ancfdae.equations import ErrorEstimates
from ancfdae.integrators.hht.equations import small_from
from ancfdae.integrators.hht.method import HHT
from ancfdae.integrators.integrator import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.studies.accuracy.bars import (
    ORDERLESS,
    RESOLVED_ORDER,
    Estimate,
    closely,
    falls,
    improved,
    observed_order,
    refined,
    remainder,
)
from ancfdae.studies.accuracy.features import RESOLVED, Transition, passed_over
from ancfdae.studies.accuracy.runs import AIM, PERCENT, FixedStepRuns, Sample, Wanted
from ancfdae.studies.accuracy.waves import Wave, fades, followed, missed, unresolved

# Order at which the estimated errors of derivatives fall where steps resolve their waves: from two
# runs, and, lower, from the second and third of three.
_NEARLY = 1.9
# Estimated errors above this are of another motion than any other run's.
_MOTION = 1.0
# Numerical damping of HHT-I3.
_ALPHA = -0.05
# Angle of the fastest motion in a run above which equations are stiff.
_STIFF = 1e5
# Least order that is hoped for where waves are not resolved.
_UNSEEN = 1.2
# Differences over the tolerance whose order need not be seen.
_SMALL = 0.05
# What all unresolved waves may change, over the tolerance, for the order to be believed, and the
# improvement of numbers by it; and bars then, over those of resolved waves.
_LITTLE, _NOTHING, _ORDER_ONLY = 0.2, 0.05, 2.0
# How much faster than with the order estimated errors may fall; else the coarse run is another
# motion.
_FASTER = 0.6
# Factors of the steps from the first run to the second: where this is enough for the tolerance by
# the estimated error, and where it is not.
_REACHED, _DOUBLED = 2.25, 2.0
# Work of a step above which the first run has few.
_DEAR = 200.0


@final
class HHTRuns(FixedStepRuns):
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
        # Steps above which they are small; None as long as nobody asks.
        self._small: float | None = None
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
        wanted = self._wanted
        self._before, self._small = self.error, None
        if sample.vectors:
            found = passed_over(wanted.problem, sample.run, self._tolerance)
            steps = max(found.steps, self.transitions.steps)
            self.transitions = Transition(steps, min(found.narrow, self.transitions.narrow))
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
        # Of each number its value, and its derivatives if they are wanted.
        kinds = 1 + wanted.slopes
        self._lost, self.whole = ([x for each in kind for x in each[:kinds]] for kind in lost)
        # Waves of derivatives are seen where the run has them.
        if wanted.slopes and sample.run.sensitivities is not None:
            self._whole = self.relative(self.whole, sample.vectors)

    def _another(self, sample: Sample) -> bool:
        """Return whether estimated errors fall faster than runs of one motion allow."""
        if not (self.samples and sample.vectors):
            return False
        return _estimated_order(self.samples[-1], sample, _MOTION) > self.order + _FASTER

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
        """Whether all that unresolved waves change is below the tolerance; of three runs.

        Where estimated errors grow with finer steps there are waves that coarser runs did not have.
        """
        if len(self.samples) < 3 or self._whole > _LITTLE * self._tolerance:
            return False
        return _estimated_order(self.samples[-2], self.samples[-1]) >= 0

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
        if self._whole > _NOTHING * self._tolerance and closely(runs, self.counts[-3:], self.order):
            return improved(runs, self.counts[-3:], self.order)
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

    @property
    def damps(self) -> bool:
        """Whether waves that it damps may change more than the tolerance allows."""
        vectors = self.samples[-1].vectors if self.samples else []
        return bool(self._damped) and self.relative(self._lost, vectors) > AIM * self._tolerance

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
            return math.ceil(self._second * self._taken) or self._first
        if self._taken < self.least:
            return self.least
        if self.damps:
            return math.ceil(self._following)
        growth = 2.0
        if self.resolved or self.regular:
            growth = self._growth(3, self._stride) if self.resolved else self._growth(2, 2.0)
        return math.ceil(growth * self._taken)

    @property
    def _first(self) -> int:
        """Steps of the first run; Newton's method needs shorter ones where equations are stiff."""
        if self._prices.hht > _DEAR:
            return 16
        return 128 if self._wanted.speed * self._t_end > _STIFF else 64

    @property
    def _second(self) -> float:
        """Times as many steps of the second run: enough for the tolerance where it is in reach."""
        error = _largest(self.samples[0].estimated) if self.samples else math.inf
        wanted = math.pow(error / self._tolerance, 1 / 3)
        return wanted if _DOUBLED < wanted < _REACHED else _DOUBLED

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
        enough. Bars of extrapolated numbers fall faster than with the order at first, and later
        with it.
        """
        if len(self.samples) < 2:
            return self.work
        if self._taken < self.least:
            return self._work(self.least) + self._work(2 * self.least)
        if self.damps:
            return self._work(self._following) + self._work(2 * self._following)
        order = self.order if self.resolved or self.regular else self._falls
        last = max(self._growth(order, math.inf) * self._taken, self.count)
        most = self._stride if self.resolved else 2.0
        runs = math.ceil(math.log(last / self._taken) / math.log(most))
        return self._work(last) * (1 - most**-runs) / (1 - 1 / most)

    @property
    def _falls(self) -> float:
        """Order that is hoped for where waves are not resolved: that of the last two errors."""
        if not (self.error < self._before < math.inf):
            return _UNSEEN
        seen = observed_order(self._before, self.error, self.counts[-1] / self.counts[-2])
        return min(max(float(seen), _UNSEEN), self.order)

    def _of_a_step(self, steps: float) -> float:
        """Return the work of a step; small ones may count extra."""
        prices = self._prices
        if prices.small and self._small is None and self._wanted.slopes and self.samples:
            self._small = small_from(self._system, self.samples[-1].run, _ALPHA)
        return prices.hht + (prices.small if steps > (self._small or math.inf) else 0.0)

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
        """Estimated number of steps for an error of 1 %, from the difference of the last two runs.

        With fewer than two runs it is the number of steps planned.
        """
        if len(self.samples) < 2:
            return float(max(self._planned, 2 * self._taken))
        ratio = self.counts[-1] / self.counts[-2]
        errors = [remainder(x, ratio, self.order) for x in self._gaps]
        error = self.relative(errors, self.samples[-1].vectors)
        return self.counts[-1] * math.sqrt(error / PERCENT)


def _resolve(samples: Sequence[Sample]) -> bool:
    """Return whether the errors that runs estimate themselves fell with the order once."""
    orders = list(map(_estimated_order, samples, samples[1:]))
    return max(orders, default=0.0) >= RESOLVED_ORDER or max(orders[1:], default=0.0) >= _NEARLY


def _estimated_order(coarse: Sample, fine: Sample, most: float = ORDERLESS) -> float:
    """Return the order at which estimated errors fall from a run to a finer one.

    Zero where the coarse run estimates more than `most`, or one of them nothing.
    """
    before, after = _largest(coarse.estimated), _largest(fine.estimated)
    if not (0 < after < math.inf and 0 < before <= most):
        return 0.0
    return float(observed_order(before, after, fine.steps / coarse.steps))


def _largest(errors: ErrorEstimates | None) -> float:
    """Return the largest error of derivatives, or of the motion where there is none of them."""
    if errors is None:
        return math.inf
    known = [x for x in errors.derivatives or () if not math.isnan(x)]
    return max(known, default=errors.motion)
