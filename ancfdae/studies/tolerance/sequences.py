"""Sequences of runs, each finer than the one before: what they cost and what they tell."""

from __future__ import annotations

import abc
import math
import warnings
from collections.abc import Callable
from typing import NamedTuple, final

from ancfdae.equations import EstimatedErrors, MechanicalSystem, PlannedSystem
from ancfdae.errors import ManySteps
from ancfdae.integrators import HHT, Explicit, Integrator, Radau
from ancfdae.numerics.arrays import Array
from ancfdae.studies.tolerance.bars import Estimate, halved, tightened

# Orders at which the estimated errors of derivatives fall where steps resolve their waves; it is
# 1.9 at least (docs/reports/error-bars).
_RESOLVED = 1.9
# States and their derivatives of a run at fixed steps, bytes.
_MEMORY = 5e8


class Sample(NamedTuple):
    """What a run gives: vectors that are wanted, what it estimates, its steps, its result.

    `reached` is the part of the time that it got through; without vectors less than all.
    """

    vectors: list[Array]
    estimated: EstimatedErrors | None
    steps: int
    result: object
    reached: float = 1.0


# Integrates; a run that does not end has no vectors.
Measure = Callable[[Integrator], Sample]


class Sequence(abc.ABC):
    """Runs of one integrator. Work is in equal, small pieces: some tenths of a microsecond.

    `gain` is by how much a run improves on the one before at best, `needed` how many runs the
    first estimate takes.
    """

    name: str
    gain: float
    needed: int

    def __init__(self, system: MechanicalSystem, t_end: float) -> None:
        self.t_end, self.runs = t_end, list[Sample]()
        self._compiled = isinstance(system, PlannedSystem) and system.plan is not None
        self._system, self._n = system, system.n_q
        self._row = 8.0 * (3 * system.n_q + system.n_lam) * (1 + system.n_b)

    @property
    @abc.abstractmethod
    def setting(self) -> Integrator:
        """The integrator of the next run."""

    @abc.abstractmethod
    def work(self, ahead: int = 0) -> float:
        """Return what the next run takes, or one further ahead."""

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """Why its result is trusted, as far as it is."""

    @abc.abstractmethod
    def expected(self, tolerance: float) -> int:
        """Return how many runs lead to a tolerance where all goes well."""

    @abc.abstractmethod
    def estimates(self) -> list[Estimate]:
        """Return the wanted vectors with bars; `needed` runs are there."""

    def advance(self, measure: Measure) -> Sample:
        """Take the next run."""
        sample = measure(self.setting)
        # Runs before one that failed are no part of a sequence.
        self.runs = [*self.runs, sample] if sample.vectors else []
        return sample


class _Halved(Sequence):
    """Runs at fixed steps, each with twice as many as the one before."""

    order: int
    first: int

    def __init__(self, system: MechanicalSystem, t_end: float) -> None:
        super().__init__(system, t_end)
        self.steps = self.first

    @final
    def work(self, ahead: int = 0) -> float:
        """Return that of the steps; infinite where they would not fit into memory."""
        steps = self.steps * 2.0**ahead
        return steps * self.of_a_step() if steps * self._row < _MEMORY else math.inf

    @final
    def expected(self, tolerance: float) -> int:
        """Return the runs from an error of one."""
        return self.needed - 1 + math.ceil(-math.log(tolerance) / math.log(self.gain))

    @abc.abstractmethod
    def of_a_step(self) -> float:
        """Return the work of a step, as measured (docs/measurements.md)."""

    @final
    def advance(self, measure: Measure) -> Sample:
        """Take the next run."""
        sample = super().advance(measure)
        self.steps *= 2
        return sample

    @property
    def words(self) -> str:
        """Whether waves are resolved."""
        if not self.resolved:
            return f"{self.name} does not resolve all waves; bars are those of its differences"
        return f"{self.name} resolves all waves of the derivatives; errors fall with its order"

    @property
    @abc.abstractmethod
    def resolved(self) -> bool:
        """Whether steps resolve the waves of the motion and of its derivatives."""

    @final
    def estimates(self) -> list[Estimate]:
        """Compare the runs."""
        rows = zip(*(run.vectors for run in self.runs), strict=True)
        return [halved(row, self.order, self.resolved) for row in rows]


@final
class Second(_Halved):
    """HHT-I3, hardly damped, so that waves that it does not resolve show in differences."""

    name, order, first, gain, needed = "HHT", 2, 16, 8.0, 4

    @property
    def setting(self) -> Integrator:
        """A fixed step."""
        return HHT(self.t_end / self.steps, hht_alpha=-0.05)

    def of_a_step(self) -> float:
        """Return the work of a compiled step, or of one in Python."""
        return 30.0 + self._n if self._compiled else 1700.0

    @property
    def resolved(self) -> bool:
        """Whether the errors that the runs estimate themselves fall with the order."""
        errors = [run.estimated for run in self.runs[-2:]]
        if len(errors) < 2:
            return False
        before, after = (_largest(x) for x in errors)
        return 0 < after < math.inf and math.log2(before / after) >= _RESOLVED


def _largest(errors: EstimatedErrors | None) -> float:
    """Return the largest error of derivatives, or of the motion where there is none of them."""
    if errors is None:
        return math.inf
    known = [x for x in errors.derivatives or () if not math.isnan(x)]
    return max(known, default=errors.motion)


@final
class Fifth(_Halved):
    """Radau IIA, where another sequence sees that waves are resolved.

    Its runs damp those that they do not resolve, and agree without them.
    """

    name, order, first, gain, needed = "Radau", 5, 16, 32.0, 3

    def __init__(self, system: MechanicalSystem, t_end: float, seer: Second) -> None:
        super().__init__(system, t_end)
        self._seer = seer

    @property
    def setting(self) -> Integrator:
        """A fixed step."""
        return Radau(self.t_end / self.steps)

    def of_a_step(self) -> float:
        """Return the work of a step; infinite until the other sequence resolves all waves."""
        if not self.resolved:
            return math.inf
        return 1000.0 + 50.0 * self._n if self._compiled else 13000.0

    @property
    def resolved(self) -> bool:
        """Whether there are no waves that are damped without a word."""
        return self._seer.resolved


@final
class Eighth(Sequence):
    """DOP853 under error control, which resolves all waves; a run ends early if it costs too much.

    The work of a run is that of the last attempt, which went so far with so many steps.
    """

    name, gain, needed = "Explicit", 30.0, 2
    words = "Explicit follows every wave; errors fall with its tolerance"
    # The error falls with the power 8 of the step.
    _dearer: float = gain ** (1 / 8)

    def __init__(self, system: MechanicalSystem, t_end: float, tolerance: float) -> None:
        super().__init__(system, t_end)
        self._rtol = min(1e-2, tolerance)
        self._steps = 20.0

    @property
    def setting(self) -> Integrator:
        """A tolerance, and twice as many steps as are foreseen."""
        return Explicit(max(self._rtol, 3e-14), max_steps=int(2 * self._steps))

    def work(self, ahead: int = 0) -> float:
        """Return that of the steps as foreseen."""
        of_a_step = 1000.0 + 4.0 * self._n if self._compiled else 110000.0
        traits = self._system.traits
        if not (traits.constant_mass and traits.constant_constraints):
            of_a_step = max(of_a_step, 12000.0 + 100.0 * self._n)
        return self._steps * self._dearer**ahead * of_a_step

    def expected(self, tolerance: float) -> int:
        """Return the two runs that the tolerance is set for."""
        return self.needed

    def advance(self, measure: Measure) -> Sample:
        """Take the next run; one that does not end tells how many steps it needs."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ManySteps)
            sample = measure(self.setting)
        self._steps = max(sample.steps, 1) / max(sample.reached, 1e-12)
        if sample.vectors:
            self.runs.append(sample)
            self._rtol /= self.gain
            self._steps *= self._dearer
        return sample

    def estimates(self) -> list[Estimate]:
        """Compare the last two runs."""
        rows = zip(*(run.vectors for run in self.runs), strict=True)
        return [tightened(row) for row in rows]
