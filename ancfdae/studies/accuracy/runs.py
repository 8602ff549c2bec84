"""Sequences of runs of one integrator: their cost, their error bars, and the next run.

`Runs` is the interface of the search; `FixedStepRuns` has ever finer fixed steps.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple, final

import numpy as np

from ancfdae.equations import ErrorEstimates, MechanicalSystem, Solution
from ancfdae.equations.plans import CalledPlan, ListPlan
from ancfdae.equations.system import planned
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.pulses import Pulses
from ancfdae.sensitivity.observables.observable import states_of
from ancfdae.studies.accuracy.bars import Estimate, refined
from ancfdae.studies.accuracy.places import Places
from ancfdae.studies.accuracy.waves import Numbers, Partials

# Cost of a run without its steps, microseconds.
OF_A_RUN = 2500.0
# Relative error in place of infinity, from which numbers of steps can still be computed.
_BEYOND = 1e30
#: A run aims at an error of AIM times the tolerance.
AIM = 0.7
#: Methods of high order have an error of PERCENT with FEWER times fewer steps than HHT.
PERCENT, FEWER = 1e-2, 8.0
# Relative change of a state by round-off: a few roundings.
_ROUNDED = 2 * np.finfo(float).eps
# Two kinds of runs contradict each other if they differ by more than _CONTRADICTS error bars, of
# which one in twenty does not hold.
_CONTRADICTS = 3.0


class Sample(NamedTuple):
    """Result of one run: wanted vectors, estimated errors, steps, returned value, and the run.

    If the run did not end there are no vectors, and the result is the exception raised.
    """

    vectors: list[Array]
    estimated: ErrorEstimates | None
    steps: int
    result: object
    run: Solution


# Measure runs an integrator; Sizes returns the sizes to which errors of vectors are relative.
Measure = Callable[[Integrator], Sample]
Sizes = Callable[[Sequence[Array]], Sequence[float]]


class Wanted(NamedTuple):
    """Task of a search: vectors of a system's motion to a tolerance relative to their sizes.

    `numbers` evaluates the wanted numbers on states, one array each; `integrated` says which are
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
        """The system whose motion the search computes."""
        return self.problem.system

    @property
    def slopes(self) -> bool:
        """Whether design derivatives are wanted."""
        return self.partials is not None


class Prices(NamedTuple):
    """Measured costs of a step of HHT-I3, a step of Radau and an evaluation by DOP853.

    In microseconds, with the derivatives of two or three variables. `small` is the additional cost
    of the derivatives of a small step of HHT-I3 (`small_from`).
    """

    hht: float
    small: float
    radau: float
    evaluation: float

    @staticmethod
    def of(system: MechanicalSystem) -> Prices:
        """Return the costs for a scene, for lists of operations, or for functions of Python."""
        plan, n, traits = planned(system), system.n_q, system.traits
        if isinstance(plan, CalledPlan):
            return Prices(360.0, 0.0, 2100.0, 280.0)
        if isinstance(plan, ListPlan):
            return Prices(2.0 + 0.5 * n, 60.0, 15.0 + 3.0 * n, 1.0 + 0.5 * n)
        driven = plan.joint_factors is not None
        radau = 30.0 + 3.0 * n + 0.055 * n**2 + 150.0 * driven
        evaluation = 0.5 + 0.12 * n
        if not (traits.constant_mass and traits.constant_constraints):
            evaluation = 2.0 + 0.2 * n
        return Prices(1.0 + 0.4 * n, 45.0, radau, evaluation + 22.0 * driven)


class Runs(abc.ABC):
    """Runs of one integrator, with the step of each chosen for the tolerance from earlier runs.

    Cost is predicted, not timed, in microseconds of the machine on which it was measured, so that
    the same call makes the same runs (docs/measurements.md).
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
        """The integrator with its settings for the next run."""

    @property
    @abc.abstractmethod
    def work(self) -> float:
        """Estimated cost of the next run, microseconds."""

    @property
    @abc.abstractmethod
    def left(self) -> float:
        """Estimated cost to reach the tolerance if errors fall as before, microseconds."""

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """A sentence that says why, or how far, the result can be trusted."""

    @abc.abstractmethod
    def judged(self) -> list[Estimate]:
        """Return the wanted vectors with error bars; empty as long as the runs do not suffice."""

    def take(self, sample: Sample) -> None:
        """Add a run and update the estimates; after a failed run the sequence starts anew."""
        self.samples = [*self.samples, sample] if sample.vectors else []
        self._judge()

    @property
    @abc.abstractmethod
    def chosen(self) -> int:
        """Number of steps of the last run, less the number of stops."""

    @abc.abstractmethod
    def follows(self, places: Places) -> bool:
        """Return whether the last run resolves the sharp places of its path."""

    @property
    def stops_there(self) -> bool:
        """Whether the runs stop in sharp places, whose position each run knows more closely."""
        return False

    def mind(self, places: Places) -> None:
        """Resolve the given sharp places from the next run on, and update the estimates."""
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
        """Return the largest norm of the vectors `parts`, relative to the sizes of `of`."""
        norms = [float(np.linalg.norm(x)) for x in parts]
        pairs = zip(norms, self._sizes(of), strict=True)
        return max((_over(x, size) for x, size in pairs), default=0.0)

    @final
    @property
    def noise(self) -> list[Array]:
        """Changes of the wanted vectors by round-off of the states of the last run.

        Coordinates change by _ROUNDED of their size, and velocities by that in a step. Logarithmic
        derivatives of a number are no better known than the number.
        """
        wanted, sample = self._wanted, self.samples[-1]
        states, random = states_of(sample.run), np.random.default_rng(0)
        q, v = (_ROUNDED * random.choice([-1, 1], states.q.shape) for _ in range(2))
        h = self._t_end / max(sample.steps, 1)
        moved = replace(
            states, q=states.q * (1 + q), v=states.v * (1 + v) + np.abs(states.q) * v / h
        )
        changed = [x - y for x, y in zip(*map(wanted.numbers, (moved, states)), strict=True)]
        if not wanted.slopes:
            return changed
        sizes = map(np.shape, sample.vectors[1::2])
        of_slopes = (
            np.full(n, np.linalg.norm(x) / math.sqrt(n[0]))
            for x, n in zip(changed, sizes, strict=True)
        )
        return [x for pair in zip(changed, of_slopes, strict=True) for x in pair]

    @final
    def apart(self, other: Runs) -> float:
        """Return the relative distance of the last run from the estimates of another sequence."""
        estimates = [y.x for y in other.estimates]
        gaps = [x - y for x, y in zip(self.samples[-1].vectors, estimates, strict=True)]
        return self.relative(gaps, estimates)

    @final
    def agrees(self, other: Runs) -> bool:
        """Return whether the last run agrees with the estimates of `other`; True without any."""
        allowed = _CONTRADICTS * other.error + self._tolerance
        return not other.estimates or self.apart(other) <= allowed


def _over(x: float, size: float) -> float:
    """Return x over a size; _BEYOND, as good as infinite, where the size is zero."""
    return 0.0 if x == 0 else x / size if size > x / _BEYOND else _BEYOND


# -- fixed steps -------------------------------------------------------------------------------


# Most memory of the states and their derivatives of a run at fixed steps, bytes.
_MEMORY = 5e8
# Least factor of the steps from a run to the next.
_LEAST = 1.4
# Least error bar over the tolerance from two runs that do not resolve waves, which may agree by
# chance.
_DOUBTED = 2.0


class FixedStepRuns(Runs):
    """Runs of one integrator at fixed steps, each with more steps than the one before."""

    order: ClassVar[int]
    _taken = 0
    # Number of steps that resolve sharp places, and number with which none jumps over a kink.
    _following_places = _kinks = 0

    @property
    def counts(self) -> list[int]:
        """Numbers of steps of the runs."""
        return [x.steps for x in self.samples]

    @property
    def count(self) -> int:
        """Number of steps of the next run."""
        return max(self._planned, self._taken + 1)

    @property
    @abc.abstractmethod
    def _planned(self) -> int:
        """Number of steps planned for the next run."""

    @property
    @final
    def work(self) -> float:
        """Estimated cost of the next run, microseconds; infinite if its states exceed _MEMORY."""
        row = 8.0 * (3 * self._n + self._system.n_lam) * (1 + self._system.n_b)
        return self._work(self.count) if self.count * row < _MEMORY else math.inf

    def take(self, sample: Sample) -> None:
        """Add a finished run to the sequence and store its number of steps."""
        self._taken = self.count
        super().take(sample)

    @property
    def chosen(self) -> int:
        """Number of steps of the last run."""
        return self.counts[-1]

    def follows(self, places: Places) -> bool:
        """Return whether the last run has enough steps to resolve the sharp places and kinks."""
        return places.steps <= self.counts[-1] and places.kinks <= self._kinks

    @property
    def bent(self) -> bool:
        """Whether steps of the last run jump over kinks, so that errors have no order."""
        return bool(self.samples) and self.counts[-1] < self._kinks

    def mind(self, places: Places) -> None:
        """Use enough steps to resolve the given sharp places from the next run on."""
        self._following_places = max(self._following_places, places.steps)
        self._kinks = max(self._kinks, places.kinks)
        super().mind(places)

    def _growth(self, order: float, most: float) -> float:
        """Return the factor of steps that leads to the tolerance, at most `most`."""
        error = (
            self.error if self.estimates else self.relative(self._gaps, self.samples[-1].vectors)
        )
        wanted = math.pow(error / (AIM * self._tolerance), 1 / order)
        return min(max(wanted, _LEAST), most)

    @property
    def _gaps(self) -> list[Array]:
        """Differences of the wanted vectors between the last two runs."""
        before, after = (x.vectors for x in self.samples[-2:])
        return [y - x for x, y in zip(before, after, strict=True)]

    @final
    def _work(self, steps: float) -> float:
        return OF_A_RUN + steps * self._of_a_step(steps)

    @abc.abstractmethod
    def _of_a_step(self, steps: float) -> float:
        """Return the measured cost of a step, microseconds, in a run of `steps` steps."""

    @property
    @abc.abstractmethod
    def resolved(self) -> bool:
        """Whether steps resolve the waves of the motion and of its derivatives."""

    @property
    def words(self) -> str:
        """A sentence that says whether waves are resolved."""
        if not self.resolved:
            return f"{self.name} does not resolve all waves; bars are those of its differences"
        return f"{self.name} resolves all waves of the derivatives; errors fall with its order"

    def judged(self) -> list[Estimate]:
        """Return estimates from the runs, with bars widened by the errors from damped waves."""
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
        """Number of steps below which runs pass over features of laws or objectives."""
        return max(self._wanted.features.steps, self._following_places)

    def _estimate(self, runs: Sequence[Array]) -> Estimate:
        """Return the error estimate of a result vector from its values in the last runs."""
        ordered = self.resolved and not self.bent
        return refined(runs[-3:], self.counts[-3:], self.order, ordered, self._wanted.along)

    @property
    @abc.abstractmethod
    def lost(self) -> list[Array]:
        """Possible errors of the vectors by waves that numerical damping removes; or empty."""
