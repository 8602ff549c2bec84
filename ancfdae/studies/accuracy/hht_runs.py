"""Runs of HHT-I3: whether their steps resolve the waves, and the effect of unresolved waves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from ancfdae.equations import ErrorEstimates, PlannedSystem
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

# Least order at which the estimated errors of derivatives fall from the second to the third run if
# steps resolve their waves (RESOLVED_ORDER from the first to the second).
_NEARLY = 1.9
# Runs with larger estimated errors follow another motion, and are not compared.
_MOTION = 1.0
# Numerical damping of HHT-I3.
_ALPHA = -0.05
# Phase angle, rad, of the fastest motion over a run above which equations are stiff.
_STIFF = 1e5
# Order that is assumed in predictions where waves are not resolved, at least.
_UNSEEN = 1.2
# Differences below _SMALL times the tolerance need no observed order.
_SMALL = 0.05
# Largest effect of all unresolved waves, over the tolerance, with which an observed order is used,
# and with which extrapolation by it is; and factor on bars then.
_LITTLE, _NOTHING, _ORDER_ONLY = 0.2, 0.05, 2.0
# Most by which estimated errors may fall faster than with the order; otherwise the coarse run
# followed another motion.
_FASTER = 0.6
# Largest ratio of the widths of one transition in two runs.
_ALIKE = 4.0
# Part of an error of phase that is left in the error bar of an extrapolated number.
_EXTRAPOLATED = 0.15
# Factors of the number of steps from the first run to the second: the largest if it suffices for
# the tolerance by the estimated error, and the one otherwise.
_REACHED, _DOUBLED = 2.25, 2.0
# Cost of a step, microseconds, above which the first run has few steps.
_DEAR = 200.0


@final
class HHTRuns(FixedStepRuns):
    """Runs of HHT-I3, hht_alpha = -0.05: unresolved waves appear as differences between runs."""

    name, order = "HHT", 2

    def __init__(self, wanted: Wanted) -> None:
        super().__init__(wanted)
        # Errors by waves that numerical damping removes, and these waves.
        self._lost, self._damped = list[Array](), list[Wave]()
        # Effect of all unresolved waves on the vectors, and its relative size.
        self.whole, self._whole = list[Array](), math.inf
        # Relative error bar before the last run.
        self._before = math.inf
        # Whether unresolved waves fade; None until it is computed.
        self._fades: bool | None = None
        # Whether numerical damping removed waves of the motion in any run.
        self.waves = False
        # Number of steps above which steps are small; None until it is computed.
        self._small: float | None = None
        # Transitions of forces that the runs pass over, the number of steps of the last run that
        # did, and whether two runs found the same width.
        self.transitions, self._seen_at, self._confirmed = RESOLVED, 0, False

    def take(self, sample: Sample) -> None:
        """Add a run, and find the waves that numerical damping removes from it.

        Runs that damp waves or pass over features that the new run follows are removed from the
        sequence, and so are runs whose estimated errors show that they followed another motion.
        """
        taken = self.count
        if self._taken < self.least <= taken or self._another(sample):
            self.samples = []
        elif self.damps:
            self.samples = self.samples[-1:] if sample.steps < self._following / 2 else []
        self._lost, self._damped, self.whole, self._whole, self._fades = [], [], [], math.inf, None
        self._before, self._small = self.error, None
        if sample.vectors and self._passes(sample):
            self.samples = []
        if self.samples and sample.vectors:
            self._weigh(sample, _resolve([*self.samples, sample]))
        super().take(sample)
        self._taken = taken

    def _passes(self, sample: Sample) -> bool:
        """Find the transitions that a run passes over; return whether those seen before are gone.

        The width of a transition in the state does not depend on the steps. A close passage has
        another width in every run, until half the steps resolve it.
        """
        before, problem = self.transitions, self._wanted.problem
        found = passed_over(problem, sample.run, self._tolerance)
        if not found.steps:
            gone = bool(before.steps) and sample.steps >= 2 * self._seen_at
            if gone:
                self.transitions, self._confirmed = RESOLVED, False
            return gone
        wide, narrow = max(found.narrow, before.narrow), min(found.narrow, before.narrow)
        self._confirmed = self._confirmed or (bool(before.steps) and wide <= _ALIKE * narrow)
        kept = Transition(max(found.steps, before.steps), narrow) if self._confirmed else found
        self.transitions, self._seen_at = kept, sample.steps
        return False

    def _weigh(self, sample: Sample, resolved: bool) -> None:
        """Estimate the effect on the wanted vectors of the waves that a run does not resolve."""
        wanted = self._wanted
        waves = unresolved(wanted.problem, sample.run, _ALPHA, not resolved)
        self._damped = [x.wave for x in waves if x.damped]
        self.waves = self.waves or bool(self._damped)
        lost = missed(
            wanted.problem, sample.run, waves, (wanted.numbers, wanted.integrated, wanted.partials)
        )
        # For each number its value, and its derivatives if they are wanted.
        kinds = 1 + wanted.slopes
        self._lost, self.whole = ([x for each in kind for x in each[:kinds]] for kind in lost)
        # Waves of derivatives are known only if the run has derivatives.
        if wanted.slopes and sample.run.sensitivities is not None:
            self._whole = self.relative(self.whole, sample.vectors)

    def _another(self, sample: Sample) -> bool:
        """Return whether estimated errors fall faster than runs of the same motion allow."""
        if not (self.samples and sample.vectors):
            return False
        return _estimated_order(self.samples[-1], sample, _MOTION) > self.order + _FASTER

    @property
    def least(self) -> int:
        """Least number of steps; for derivatives it also resolves transitions of forces."""
        return max(super().least, self.transitions.steps if self._wanted.slopes else 0)

    @property
    def _doubtful(self) -> bool:
        """Whether the steps are too few only for a transition that no second run confirmed."""
        return not self._confirmed and self._taken >= super().least

    @property
    def loaded(self) -> bool:
        """Whether loads may depend on the state, as in every system without a plan."""
        plan = self._system.plan if isinstance(self._system, PlannedSystem) else None
        return plan is None or bool(plan.moving)

    @property
    def passes(self) -> bool:
        """Whether the steps of the last run pass over transitions of forces."""
        return self._taken < self.transitions.steps

    @property
    def lost(self) -> list[Array]:
        """Errors by damped waves of the last run; by all unresolved waves if these are few."""
        return self.whole if self.smooth and not self.resolved else self._lost

    @property
    def smooth(self) -> bool:
        """Whether unresolved waves together change less than the tolerance, from three runs.

        If estimated errors grow with finer steps there are waves that coarser runs did not have.
        """
        if len(self.samples) < 3 or self._whole > _LITTLE * self._tolerance:
            return False
        return _estimated_order(self.samples[-2], self.samples[-1]) >= 0

    def _estimate(self, runs: Sequence[Array]) -> Estimate:
        """Return the error estimate of a result vector from its values in the runs.

        An observed order is used only if no wave can be a part of it, extrapolation only if waves
        change nothing. Steps that jump over a kink of forces have errors of first order, which
        depend on where they meet it.
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
        """Return the estimate of values at increasing times; an order is used if it is observed.

        That steps resolve the waves of the motion says little about velocities and reactions.
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
        """Whether all vectors, unless small beside the tolerance, show the order without waves.

        Then the result does not depend on whether waves are resolved.
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
        """Whether physical damping removes all waves that the last run does not resolve."""
        if self._fades is None:
            self._fades = self.smooth and fades(self._system, self.samples[-1].run)
        return self._fades

    @property
    def damps(self) -> bool:
        """Whether waves that the run damps may change more than the tolerance allows."""
        vectors = self.samples[-1].vectors if self.samples else []
        return bool(self._damped) and self.relative(self._lost, vectors) > AIM * self._tolerance

    @property
    def words(self) -> str:
        """A sentence on the waves of the motion and whether HHT damps them."""
        if self.damps:
            waves = f"waves of about {max(x.speed for x in self._damped):.2g} rad/s"
            return f"{self.name} damps {waves}, which its steps pass over; bars hold their share"
        if self.smooth and not self.resolved:
            return f"{self.name} does not resolve all waves, which change little; bars hold that"
        return super().words

    @property
    def setting(self) -> Integrator:
        """The integrator HHT at the fixed step of the next run."""
        return HHT(self._t_end / self.count, hht_alpha=_ALPHA)

    @property
    def _planned(self) -> int:
        """Steps planned for the next run: twice as many until waves are resolved, then by order."""
        if len(self.samples) < 2:
            return math.ceil(self._second * self._taken) or self._first
        if self._taken < self.least:
            return min(self.least, 2 * self._taken) if self._doubtful else self.least
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
        """Factor of steps to the second run: enough for the tolerance if it is within reach."""
        error = _largest(self.samples[0].estimated) if self.samples else math.inf
        wanted = math.pow(error / self._tolerance, 1 / 3)
        return wanted if _DOUBLED < wanted < _REACHED else _DOUBLED

    @property
    def _stride(self) -> float:
        """Largest factor of the number of steps from a run to the next if waves are resolved.

        Large factors would leave the bar to the last run alone; bars over time and pulses need
        smaller.
        """
        return 2.0 if self._wanted.along or self.least else 4.0

    @property
    def _following(self) -> float:
        """Number of steps that keep the waves which numerical damping removed from the last run."""
        return followed(self._damped, self._t_end, _ALPHA, 1.4 * self._taken)

    @property
    def pilot(self) -> float:
        """Estimated cost of the next runs up to one that can be compared, microseconds."""
        if not self.damps:
            return self.work
        return self._work(self._following) + self._work(2 * self._following)

    @property
    def _in_phase(self) -> float:
        """Number of steps with which errors of phase of damped waves are below the tolerance.

        Extrapolation leaves a small part of these errors.
        """
        whole = self._whole
        if whole == math.inf:  # Without derivatives the effect on the values is known.
            whole = self.relative(self.whole, self.samples[-1].vectors)
        turned = max(x.turned(self._t_end, self._taken) for x in self._damped)
        return self._taken * math.sqrt(turned * _EXTRAPOLATED * whole / self._tolerance)

    @property
    def left(self) -> float:
        """Estimated cost to reach the tolerance, microseconds.

        It is the cost of the next run while there are fewer than two, then of all runs up to one
        that is fine enough. Bars of extrapolated numbers fall faster than with the order at first,
        and later with it.
        """
        if len(self.samples) < 2:
            return self.work
        if self._taken < self.least and self._doubtful:
            return self.work
        if self._taken < self.least:
            return self._work(self.least) + self._work(2 * self.least)
        if self.damps:
            first = self._following
            runs = math.ceil(math.log2(max(self._in_phase / first, 2.0)))
            return self._work(2.0**runs * first) * (2 - 2.0**-runs)
        order = self.order if self.resolved or self.regular else self._falls
        last = max(self._growth(order, math.inf) * self._taken, self.count)
        most = self._stride if self.resolved else 2.0
        runs = math.ceil(math.log(last / self._taken) / math.log(most))
        return self._work(last) * (1 - most**-runs) / (1 - 1 / most)

    @property
    def _falls(self) -> float:
        """Order of the last two error bars, limited, for predictions if waves are not resolved."""
        if not (self.error < self._before < math.inf):
            return _UNSEEN
        seen = observed_order(self._before, self.error, self.counts[-1] / self.counts[-2])
        return min(max(float(seen), _UNSEEN), self.order)

    def _of_a_step(self, steps: float) -> float:
        """Return the cost of a step, microseconds, in a run of `steps` steps."""
        prices = self._prices
        if prices.small and self._small is None and self._wanted.slopes and self.samples:
            self._small = small_from(self._system, self.samples[-1].run, _ALPHA)
        return prices.hht + (prices.small if steps > (self._small or math.inf) else 0.0)

    @property
    def resolved(self) -> bool:
        """Whether the error estimates of single runs fell with the order of HHT-I3.

        If so, finer steps resolve the same waves as the coarser steps.
        """
        return _resolve(self.samples)

    @property
    def asked(self) -> bool:
        """Whether the search has two runs of HHT to compare, or the first one failed."""
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
    """Return whether the errors that runs estimate of themselves fell with the order once."""
    orders = list(map(_estimated_order, samples, samples[1:]))
    return max(orders, default=0.0) >= RESOLVED_ORDER or max(orders[1:], default=0.0) >= _NEARLY


def _estimated_order(coarse: Sample, fine: Sample, most: float = ORDERLESS) -> float:
    """Return the order at which estimated errors fall from a run to a finer one.

    Zero if the coarse run estimates more than `most`, or one of them has no estimate.
    """
    before, after = _largest(coarse.estimated), _largest(fine.estimated)
    if not (0 < after < math.inf and 0 < before <= most):
        return 0.0
    return float(observed_order(before, after, fine.steps / coarse.steps))


def _largest(errors: ErrorEstimates | None) -> float:
    """Return the largest estimated error of derivatives, or of the motion without derivatives."""
    if errors is None:
        return math.inf
    known = [x for x in errors.derivatives or () if not math.isnan(x)]
    return max(known, default=errors.motion)
