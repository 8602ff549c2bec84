"""Runs of Radau IIA, believed where HHT-I3 sees that steps resolve the waves, or waves fade."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, final

from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.radau.method import Radau
from ancfdae.numerics.arrays import Array
from ancfdae.studies.tolerance.bars import HIGH_GRANTED, Estimate, spread
from ancfdae.studies.tolerance.fixed_steps import FixedStepRuns
from ancfdae.studies.tolerance.hht_runs import HHTRuns
from ancfdae.studies.tolerance.runs import AIM, FEWER, PERCENT

# Part of the steps at which HHT saw that waves are resolved, at least.
_SHARE = 0.25
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
        """Steps that lead to the tolerance, by what the other sequence tells of the waves."""
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
        far = HIGH_GRANTED * self.apart(self._seer) / (AIM * self._tolerance)
        return min(max(math.pow(far, 1 / order), 2.0), most)

    def judged(self) -> list[Estimate]:
        """Compare the runs; those that contradict the other kind tell nothing."""
        return super().judged() if self.agrees(self._seer) else []
