"""Sequences of runs of one integrator: what they cost, what they say, what it takes to go on.

`Runs` is the contract of the search; `FixedStepRuns` has ever finer fixed steps.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple, final

import numpy as np

from ancfdae.equations import ErrorEstimates, MechanicalSystem, Solution
from ancfdae.equations.system import planned
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.kernels import CalledPlan, ListPlan
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.pulses import Pulses
from ancfdae.studies.accuracy.bars import Estimate, refined
from ancfdae.studies.accuracy.places import Places
from ancfdae.studies.accuracy.waves import Numbers, Partials

# Work of a run without its steps.
OF_A_RUN = 2500.0
# An error relative to nothing, with which steps can still be counted.
_BEYOND = 1e30
#: A run aims at the part AIM of the tolerance.
AIM = 0.7
#: Where HHT errs by a hundredth, PERCENT, methods of high order do so with steps FEWER times fewer.
PERCENT, FEWER = 1e-2, 8.0
# Two kinds of runs contradict each other if they differ by more than _CONTRADICTS error bars: one
# bar in twenty does not hold.
_CONTRADICTS = 3.0


class Sample(NamedTuple):
    """Result of one run: wanted vectors, estimated errors, steps, returned value, and the run.

    No vectors where it did not end; the result is what it raised then.
    """

    vectors: list[Array]
    estimated: ErrorEstimates | None
    steps: int
    result: object
    run: Solution


# Integrates; returns the sizes that errors of vectors are relative to.
Measure = Callable[[Integrator], Sample]
Sizes = Callable[[Sequence[Array]], Sequence[float]]


class Wanted(NamedTuple):
    """Task of a search: vectors of a system's motion to a tolerance relative to their sizes.

    `numbers` evaluates what they are about on states, one array each; `integrated` says which are
    integrals over time. If there are `partials`, the derivatives of the numbers in the states, each
    is followed by its logarithmic design derivatives as a vector. If `along` is True a vector holds
    values at increasing times. `speed` is the largest |s| of motions e^(s t) about the start, 1/s;
    zero where nothing vibrates.
    """

    problem: InitialValueProblem
    t_end: float
    tolerance: float
    sizes: Sizes
    numbers: Numbers
    integrated: Sequence[bool]
    partials: Partials | None
    along: bool
    features: Pulses
    speed: float

    @property
    def system(self) -> MechanicalSystem:
        """The system whose motion is wanted."""
        return self.problem.system

    @property
    def slopes(self) -> bool:
        """Whether derivatives are wanted."""
        return self.partials is not None


class Prices(NamedTuple):
    """Measured work of a step of HHT-I3, of one of Radau, and of an evaluation by DOP853.

    Microseconds, with the derivatives of two or three variables along; `small` is what the
    derivatives of a small step of HHT-I3 add (`small_from`).
    """

    hht: float
    small: float
    radau: float
    evaluation: float

    @staticmethod
    def of(system: MechanicalSystem) -> Prices:
        """Return the prices of a scene, of lists of operations, or of functions of Python."""
        plan, n, traits = planned(system), system.n_q, system.traits
        if isinstance(plan, CalledPlan):
            return Prices(360.0, 0.0, 2200.0, 280.0)
        if isinstance(plan, ListPlan):
            return Prices(2.0 + 0.5 * n, 0.0, 220.0 + 5.0 * n, 3.0 + n)
        moving, driven = len(plan.moving), plan.joint_factors is not None
        radau = 100.0 + 4.5 * n + 0.055 * n**2 + 25.0 * moving + 700.0 * driven
        evaluation = 10.0 + 0.17 * n
        if not (traits.constant_mass and traits.constant_constraints):
            evaluation = 35.0 + 0.5 * n
        evaluation += 12.0 * moving + 130.0 * driven
        return Prices(4.0 + 0.5 * n, 45.0, radau, evaluation)


class Runs(abc.ABC):
    """Runs of one integrator, the step of each chosen for the tolerance from the runs before it.

    Work is counted, not timed, in microseconds of the machine on which it was measured, so that
    the same call takes the same runs (docs/measurements.md).
    """

    name: ClassVar[str]

    def __init__(self, wanted: Wanted) -> None:
        system = wanted.system
        self._wanted, self._system, self._n, self._t_end = wanted, system, system.n_q, wanted.t_end
        self._tolerance, self._sizes = wanted.tolerance, wanted.sizes
        self._prices = Prices.of(system)
        self.samples, self.estimates = list[Sample](), list[Estimate]()
        self.error = math.inf

    @property
    @abc.abstractmethod
    def setting(self) -> Integrator:
        """The integrator of the next run."""

    @property
    @abc.abstractmethod
    def work(self) -> float:
        """Estimated work of the next run, microseconds."""

    @property
    @abc.abstractmethod
    def left(self) -> float:
        """Estimated work to reach the tolerance if errors fall as before, microseconds."""

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """A sentence that says why the result can be trusted, or how far."""

    @abc.abstractmethod
    def judged(self) -> list[Estimate]:
        """Return the wanted vectors with bars; none as long as runs do not tell."""

    def take(self, sample: Sample) -> None:
        """Add a run and judge the sequence, which begins anew after a run that failed."""
        self.samples = [*self.samples, sample] if sample.vectors else []
        self._judge()

    @property
    @abc.abstractmethod
    def chosen(self) -> int:
        """Steps of the last run, without those that stops asked for."""

    @abc.abstractmethod
    def follows(self, places: Places) -> bool:
        """Return whether the last run follows the sharp places of its path."""

    @property
    def stops_there(self) -> bool:
        """Whether runs stop in sharp places, and each knows more closely where they are."""
        return False

    def mind(self, places: Places) -> None:
        """Follow sharp places from now on, and judge again."""
        self._judge()

    @final
    def _judge(self) -> None:
        self.estimates = self.judged() if self.samples else []
        self.error = math.inf
        if self.estimates:
            bars = [x.bar for x in self.estimates]
            self.error = self.relative(bars, [x.x for x in self.estimates])

    @final
    def relative(self, parts: Sequence[Array], of: Sequence[Array]) -> float:
        """Return the largest norm of some vectors, relative to the sizes of others."""
        norms = [float(np.linalg.norm(x)) for x in parts]
        pairs = zip(norms, self._sizes(of), strict=True)
        return max((_over(x, size) for x, size in pairs), default=0.0)

    @final
    def apart(self, other: Runs) -> float:
        """Return the distance of the last run from the estimate of the other kind of runs."""
        estimates = [y.x for y in other.estimates]
        gaps = [x - y for x, y in zip(self.samples[-1].vectors, estimates, strict=True)]
        return self.relative(gaps, estimates)

    @final
    def agrees(self, other: Runs) -> bool:
        """Whether the last run agrees with the estimate of the other kind; True without one."""
        allowed = _CONTRADICTS * other.error + self._tolerance
        return not other.estimates or self.apart(other) <= allowed


def _over(x: float, size: float) -> float:
    """Return x over a size; as good as infinite over nothing."""
    return 0.0 if x == 0 else x / size if size > x / _BEYOND else _BEYOND


# -- fixed steps -------------------------------------------------------------------------------


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
