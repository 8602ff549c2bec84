"""A kind of runs of the search: what it has, what it tells, what it takes to go on."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple, final

import numpy as np

from ancfdae.equations import ErrorEstimates, MechanicalSystem, PlannedSystem, Solution
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.pulses import Pulses
from ancfdae.studies.tolerance.bars import Estimate
from ancfdae.studies.tolerance.places import Places
from ancfdae.studies.tolerance.waves import Numbers, Partials

# Work of a run without its steps.
OF_A_RUN = 2500.0
# Work of one evaluation of loads that move, each, and of driven joints with their derivatives, by
# methods other than HHT-I3: in Python.
_OF_A_LOAD, _OF_DRIVES = 30.0, 350.0
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
        plan = system.plan if isinstance(system, PlannedSystem) else None
        self._compiled = plan is not None
        self._of_laws = 0.0
        if plan is not None:
            self._of_laws = _OF_A_LOAD * len(plan.moving)
            self._of_laws += _OF_DRIVES * (plan.joint_factors is not None)
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
        """Add a run and judge; those before one that failed are no part of a sequence."""
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
        """Return how far the last run is from what the other kind of runs estimates."""
        estimates = [y.x for y in other.estimates]
        gaps = [x - y for x, y in zip(self.samples[-1].vectors, estimates, strict=True)]
        return self.relative(gaps, estimates)

    @final
    def agrees(self, other: Runs) -> bool:
        """Whether the last run is within what the other kind knows, if it knows anything."""
        allowed = _CONTRADICTS * other.error + self._tolerance
        return not other.estimates or self.apart(other) <= allowed


def _over(x: float, size: float) -> float:
    """Return x over a size; as good as infinite over nothing."""
    return 0.0 if x == 0 else x / size if size > x / _BEYOND else _BEYOND
