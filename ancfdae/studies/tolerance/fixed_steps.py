"""Runs at fixed steps, each finer than the one before: what they cost and what they tell."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from typing import ClassVar, final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.studies.tolerance.bars import Estimate, refined
from ancfdae.studies.tolerance.places import Places
from ancfdae.studies.tolerance.runs import AIM, OF_A_RUN, Runs, Sample

# States and their derivatives of a run at fixed steps, bytes.
_MEMORY = 5e8
# Least factor of the steps from a run to the next.
_LEAST = 1.4
# Errors over the tolerance of two runs that do not resolve waves, at least: they may agree by
# chance in all that is wanted.
_DOUBTED = 2.0


class FixedStepRuns(Runs):
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
        wanted = math.pow(error / (AIM * self._tolerance), 1 / order)
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
