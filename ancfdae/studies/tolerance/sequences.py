"""Sequences of runs, each finer than the one before: what they cost and what they tell."""

from __future__ import annotations

import abc
import math
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.equations import EstimatedErrors
from ancfdae.errors import AncfdaeError
from ancfdae.integrators import HHT, Explicit, Integrator, Radau
from ancfdae.integrators.problem import Problem
from ancfdae.modes.configuration import Configuration
from ancfdae.modes.periods import fastest
from ancfdae.studies.tolerance.bars import HIGH_GRANTED, Estimate, refined, tightened
from ancfdae.studies.tolerance.runs import OF_A_RUN, Runs, Sample

# Order at which the estimated errors of derivatives fall where steps resolve their waves; where
# there are three runs, a little less will do.
_RESOLVED, _NEARLY = 1.95, 1.9
# States and their derivatives of a run at fixed steps, bytes.
_MEMORY = 5e8
# A run aims at a share of the tolerance, with at least so many times the steps of the one before.
_AIM, _LEAST = 0.7, 1.4
# Order that is hoped for where waves are not resolved.
_UNSEEN = 1.2
# Where HHT errs by a hundredth, methods of high order do so with a share of its steps; Radau takes
# a share of those at which HHT saw that waves are resolved.
_PERCENT, _FEWER, _SHARE = 1e-2, 8.0, 0.25
# Errors of Explicit over rtol, with what round-off needs; the tolerance from one run to the next.
_PER_RTOL, _JUST, _TIGHTER = 4.0, 0.99, 30.0
# Errors of components over the root mean square of a long vector's.
_UNEVEN = 2.4
# Length of its steps times the fastest motion, and the tolerance below which they are shorter.
_STABLE, _FOLLOWED = 5.7, 1e-3


class _Steps(Runs):
    """Runs at fixed steps."""

    order: ClassVar[int]
    _taken = 0

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
        """What the next run takes; infinite where its states would not fit into memory."""
        row = 8.0 * (3 * self._n + self._system.n_lam) * (1 + self._system.n_b)
        return self._work(self.count) if self.count * row < _MEMORY else math.inf

    @final
    def take(self, sample: Sample) -> None:
        """Add a run."""
        self._taken = self.count
        super().take(sample)

    def _growth(self, order: float, most: float) -> float:
        """How many times the steps lead to the tolerance from the last error, and at most."""
        wanted = math.pow(self.error / (_AIM * self._tolerance), 1 / order)
        return min(max(wanted, _LEAST), most)

    @final
    def _work(self, steps: float) -> float:
        return OF_A_RUN + steps * self.of_a_step

    @property
    @abc.abstractmethod
    def of_a_step(self) -> float:
        """The work of a step, as measured (docs/measurements.md)."""

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
        """Compare the runs."""
        if len(self.samples) < 2:
            return []
        rows = zip(*(x.vectors for x in self.samples[-3:]), strict=True)
        return [refined(x, self.counts[-3:], self.order, self.resolved) for x in rows]


@final
class Second(_Steps):
    """HHT-I3, hardly damped, so that waves that it does not resolve show in differences."""

    name, order = "HHT", 2

    @property
    def setting(self) -> Integrator:
        """A fixed step."""
        return HHT(self._t_end / self.count, hht_alpha=-0.05)

    @property
    def _planned(self) -> int:
        """Steps: first such that they cost what a run costs without; nested where waves hide."""
        if len(self.samples) < 2:
            return 2 * self._taken or (64 if self._compiled else 16)
        growth = self._growth(3, 4.0) if self.resolved else 2.0
        return math.ceil(growth * self._taken)

    @property
    def left(self) -> float:
        """That of the next run, or of all whose last one is fine enough."""
        if len(self.samples) < 2:
            return self.work
        growth = self._growth(3 if self.resolved else _UNSEEN, math.inf)
        last = max(growth * self._taken, self.count)
        most = 4.0 if self.resolved else 2.0
        runs = math.ceil(math.log(last / self._taken) / math.log(most))
        return self._work(last) * (1 - most**-runs) / (1 - 1 / most)

    @property
    def of_a_step(self) -> float:
        """That of a compiled step, or of one in Python."""
        return 4.0 + 0.7 * self._n if self._compiled else 1300.0

    @property
    def resolved(self) -> bool:
        """Whether the errors that two runs estimate themselves fell with the order.

        Finer steps resolve what coarser ones did.
        """
        orders = list(map(_estimated_order, self.samples, self.samples[1:]))
        return max(orders, default=0.0) >= _RESOLVED or max(orders[1:], default=0.0) >= _NEARLY

    @property
    def asked(self) -> bool:
        """Whether there are runs to compare, or the first one failed."""
        return self._taken > 0 and len(self.samples) != 1

    @property
    def percent(self) -> float:
        """Steps at which an error is a hundredth, by the last difference; a guess without."""
        if len(self.samples) < 2:
            return float(max(self._planned, 2 * self._taken))
        vectors = [x.vectors for x in self.samples[-2:]]
        ratio = self.counts[-1] / self.counts[-2]
        gaps = [y - x for x, y in zip(*vectors, strict=True)]
        error = self.relative(gaps, vectors[-1]) / (ratio**2 - 1)
        return self.counts[-1] * math.sqrt(error / _PERCENT)


def _estimated_order(coarse: Sample, fine: Sample) -> float:
    """Return the order at which estimated errors fall from a run to a finer one."""
    before, after = _largest(coarse.estimated), _largest(fine.estimated)
    if not 0 < after < math.inf:
        return 0.0
    return math.log(before / after) / math.log(fine.steps / coarse.steps)


def _largest(errors: EstimatedErrors | None) -> float:
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
    def setting(self) -> Integrator:
        """A fixed step."""
        return Radau(self._t_end / self.count)

    @property
    def _last(self) -> float:
        """Steps that lead to the tolerance, by what the other sequence tells of the waves."""
        share = HIGH_GRANTED * _PERCENT / (_AIM * self._tolerance)
        of_error = self._seer.percent / _FEWER * math.pow(share, 1 / self.order)
        return max(of_error, self._seer.counts[-1] * _SHARE)

    @property
    def _planned(self) -> int:
        if not self.samples:
            return max(math.ceil(self._last / 2), 5, 2 * self._taken)
        return math.ceil(self._taken * self._growth(self.order, 4.0))

    @property
    def left(self) -> float:
        """Infinite until the other sequence resolves all waves."""
        if not self.resolved:
            return math.inf
        if self.samples:
            return self._work(self._growth(self.order, math.inf) * self._taken)
        return self._work(self.count) + self._work(2 * self.count)

    @property
    def of_a_step(self) -> float:
        """That of a compiled step, or of one in Python."""
        return 100.0 + 25.0 * self._n if self._compiled else 6500.0

    @property
    def resolved(self) -> bool:
        """Whether there are no waves that are damped without a word."""
        return self._seer.resolved

    def _growth(self, order: float, most: float) -> float:
        """By what the runs tell; the first one by how far it is from the other kind."""
        if self.estimates:
            return super()._growth(order, most)
        far = HIGH_GRANTED * self.apart(self._seer) / (_AIM * self._tolerance)
        return min(max(math.pow(far, 1 / order), 2.0), most)

    def judged(self) -> list[Estimate]:
        """Compare the runs; those that contradict the other kind tell nothing."""
        return super().judged() if self.agrees(self._seer) else []


@final
class Eighth(Runs):
    """DOP853 under error control, which resolves all waves."""

    name = "Explicit"
    words = "Explicit follows every wave; errors are those of its tolerance"
    # Times as many steps as foreseen.
    _more = 1.0

    def __init__(self, seer: Second, intervals: int, longest: int, *of: Any) -> None:
        super().__init__(*of)
        self._seer, self._intervals = seer, intervals
        # The bars of the longest vector then make the tolerance.
        self._rtol = _JUST * self._tolerance / (_PER_RTOL * min(math.sqrt(longest), _UNEVEN))

    @property
    def setting(self) -> Integrator:
        """A tolerance."""
        most = math.ceil(3 * self._foreseen) + 20
        return Explicit(max(self._rtol, 3e-14), self._intervals, most)

    def take(self, sample: Sample) -> None:
        """Add a run; the next is tighter, or may take more steps."""
        super().take(sample)
        if sample.vectors:
            self._rtol /= _TIGHTER
        else:
            self._more *= 3

    @cached_property
    def _fastest(self) -> float:
        """Steps that stability takes."""
        try:
            initial = Problem.of(self._system, self._t_end).initial
            speed = fastest(self._system, Configuration(initial.q, initial.lam, t=initial.t))
        except AncfdaeError:  # Nothing vibrates.
            return 0.0
        return speed * self._t_end / _STABLE

    @property
    def _foreseen(self) -> float:
        """Steps at the tolerance, of accuracy or of stability."""
        if self.samples:
            return self.samples[-1].steps * math.pow(_TIGHTER, 1 / 8)
        smooth = self._seer.percent / _FEWER * math.pow(max(_PERCENT / self._rtol, 1.0), 1 / 8)
        waves = self._fastest * math.pow(max(_FOLLOWED / self._rtol, 1.0), 1 / 8)
        return self._more * max(smooth, waves)

    @property
    def work(self) -> float:
        """That of the steps as foreseen."""
        instants = 8 * self._intervals
        evaluations = 12 * self._foreseen + instants
        of_one = 8.0 + 0.25 * self._n if self._compiled else 1100.0
        traits = self._system.traits
        if not (traits.constant_mass and traits.constant_constraints):
            of_one = max(of_one, 100.0 + 7.0 * self._n)
        # Measured with up to three variables; every one is a row of the states.
        return OF_A_RUN + evaluations * of_one * max(1.0, (1 + self._system.n_b) / 4)

    @property
    def left(self) -> float:
        """That of the next run; others go first."""
        return self.work if self._seer.asked else math.inf

    def judged(self) -> list[Estimate]:
        """Return bars by the tolerance of the last run, and by what the last two differ by."""
        vectors, *before = (x.vectors for x in self.samples[::-1])
        if not (before or self.agrees(self._seer)):
            return []
        bars = [
            np.full(x.shape, _PER_RTOL * self._rtol * size * min(1.0, _UNEVEN / math.sqrt(x.size)))
            for x, size in zip(vectors, self._sizes(vectors), strict=True)
        ]
        if before:
            pairs = zip(bars, before[0], vectors, strict=True)
            bars = [np.maximum(bar, tightened(x, y)) for bar, x, y in pairs]
        return [Estimate(x, bar) for x, bar in zip(vectors, bars, strict=True)]
