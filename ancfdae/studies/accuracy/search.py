"""Calls with a tolerance: gradients of objectives, and observables at given times.

The search continues the sequence of runs that is predicted to reach the tolerance at the least
cost.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.equations.derived import design_sizes
from ancfdae.equations.event_solution import EventSolution
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_each, require_flag, require_positive
from ancfdae.errors.kinds import (
    InvalidInputError,
    ManyStepsWarning,
    StabilityWarning,
    ToleranceWarning,
)
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.errors.text import TableText, plain
from ancfdae.integrators.integrator import AdjointIntegrator, Integrator
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import LOBATTO_DEGREE, TimeGrid
from ancfdae.numerics.timing import stopwatch
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.sensitivity.method import (
    Accuracy,
    Gradient,
    GradientMethod,
    Run,
    ToleranceSearch,
    Trial,
    UnfinishedRunError,
)
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.objectives.objective import ObjectivePartials
from ancfdae.sensitivity.objectives.reductions import OverTime, SmoothUpperBound, read_at_end
from ancfdae.sensitivity.observables.expression import leaves
from ancfdae.sensitivity.observables.observable import Observable, States, states_of
from ancfdae.studies.accuracy.bars import Estimate
from ancfdae.studies.accuracy.endings import Ending
from ancfdae.studies.accuracy.features import features
from ancfdae.studies.accuracy.hht_runs import HHTRuns
from ancfdae.studies.accuracy.high_order_runs import DOP853Runs, RadauRuns
from ancfdae.studies.accuracy.places import Seen, Witness
from ancfdae.studies.accuracy.runs import Measure, Runs, Sample, Wanted
from ancfdae.studies.accuracy.waves import speed
from ancfdae.studies.parts import instants

# Largest cost of a search, microseconds.
_MOST = 4e7
# Cost, microseconds, after which the path of HHT-I3 is searched for sharp places, and runs for
# round-off, which may explain why no run is accurate enough.
_EARLY = 5e5
# Most restarts of the sequences because runs passed over sharp places of their paths.
_LOOKS = 12
# Largest effect of round-off, over the tolerance, on a result that counts as reached. A relative
# effect of _ALL or more is one on a number that the runs have not met yet.
_NOISE, _ALL = 0.5, 1e3
# Largest cost of HHT runs, over the predicted cost, that are made because they may show that less
# is needed.
_WORTH = 0.1


@final
@dataclass(frozen=True)
class Found:
    """Result of a search: error estimates of the wanted vectors, last result, and all runs."""

    estimates: list[Estimate]
    result: object
    reached: bool
    integrator: Integrator
    why: str
    trials: tuple[Trial, ...]


@final
@dataclass(frozen=True)
class _Spent:
    """Runs of a search: sequence, result and cost of each."""

    runs: list[tuple[Runs, Trial, float]]

    @property
    def work(self) -> float:
        """Predicted cost of all runs of the search, microseconds."""
        return sum(work for _, _, work in self.runs)

    def take(self, runs: Runs, measure: Measure) -> Sample:
        """Make the next run of a sequence, add it there, and return it."""
        setting, work, clock = runs.setting, runs.work, stopwatch()
        sample = measure(setting)
        runs.take(sample)
        steps = sample.steps if sample.vectors else 0
        self.runs.append((runs, Trial(setting, steps, clock(), runs.error), work))
        return sample

    def price(self, runs: Runs, left: float) -> str:
        """Return in words the cost of the tolerance by a sequence of runs."""
        seen = "" if math.isinf(runs.error) else f" (at {runs.error:.1g})"
        if math.isinf(left) and runs.work < math.inf:
            return f"{runs.name}{seen} at a cost that is not known"
        if left > 1e3 * _MOST:
            return f"{runs.name}{seen} out of reach"
        seconds = sum(trial.seconds for _, trial, _ in self.runs) / self.work * left
        return f"{runs.name}{seen} about {seconds:.1g} s more"


def _out_of_reach(
    spent: _Spent, ways: dict[Runs, float], seer: HHTRuns, tolerance: float
) -> InvalidInputError:
    """Return the error for a search whose runs cannot resolve the motion and give no error bar."""
    costs, steps = "; ".join(spent.price(*x) for x in ways.items()), seer.transitions.steps
    if steps and seer.least >= steps:
        # Without loads that depend on the state the jump is one of the joints' reactions.
        what, like, more = "accelerations jump", "", ""
        if seer.loaded:
            what, more = "a force jumps", "; or raise smooth_speed"
            like = ", as dry friction does within its smooth_speed"
        return InvalidInputError(
            "tolerance",
            f"derivatives need {steps} equal steps: {what} while the state changes by "
            f"{seer.transitions.narrow:.1g} of its size{like}, and the slope of the jump must be "
            "met by steps",
            costs,
            "Control the errors of derivatives instead, which takes short steps at jumps alone: "
            f"Radau(AdaptiveSteps({0.01 * tolerance:.1g}, sensitivities=True)), and again with a "
            f"tenth of that rtol to see the error{more}.",
        )
    return InvalidInputError(
        "tolerance",
        "must be within reach: laws, observables or waves are too fast for the steps of a search",
        costs,
        "Choose an integrator, for example HHT(step=...), or a shorter t_end.",
    )


def search(
    wanted: Wanted, measure: Measure, witness: Witness, intervals: int | None, level: int
) -> Found:
    """Search for the wanted accuracy; warn if it is out of reach.

    `DOP853` reports its first run on this number of intervals, and is not used if `intervals` is
    None. `level` is the stack level of the warning, as in `warnings.warn`.
    """
    seer = HHTRuns(wanted)
    others: list[Runs] = [RadauRuns(seer, wanted)]
    others += [] if intervals is None else [DOP853Runs(seer, intervals, wanted)]
    with warnings.catch_warnings():
        # Coarse runs are made only to be compared, and short steps in sharp places are intended.
        for kind in (StabilityWarning, ManyStepsWarning):
            warnings.simplefilter("ignore", kind)
        found = _search(seer, others, measure, wanted, witness)
    if not found.reached:
        text = f"tolerance {wanted.tolerance:g}: {found.why}"
        warnings.warn(text, ToleranceWarning, stacklevel=level + 1)
    return found


def _search(
    seer: HHTRuns, others: Sequence[Runs], measure: Measure, wanted: Wanted, witness: Witness
) -> Found:
    """Run integrators until one reaches the tolerance or the next run would exceed the cost limit.

    A run that passed over a sharp place does not count; all sequences then resolve the places of
    its path. If no run gave an estimate, the last exception is raised again; where the motion ends
    early, UnfinishedRunError says so at the second run that fails.
    """
    kinds, tolerance = [seer, *others], wanted.tolerance
    ending = Ending(wanted.problem, wanted.t_end, tolerance)
    spent, failures, ways = _Spent([]), list[Exception](), dict[Runs, float]()
    looks = 0
    while True:
        best = min(kinds, key=lambda runs: runs.error)
        if best.error <= tolerance:
            places = witness.of(best.samples[-1].run, best.chosen)
            if best.follows(places):
                if (noise := _noise(best, best)) > _NOISE * tolerance:
                    return _lost_in_noise(spent, best, noise)
                break
            if looks == _LOOKS:
                return _passed_over(spent, best, places.words)
            looks += 1
            for each in kinds:
                each.mind(places)
            continue
        ways = {runs: runs.left for runs in kinds}
        most = _MOST if len(spent.runs) > 1 else math.inf
        going = [x for x in kinds if ways[x] < math.inf and spent.work + x.work <= most]
        if not going:
            break
        runs = min(going, key=ways.__getitem__)
        if not seer.resolved and seer in going and seer.pilot <= _WORTH * ways[runs]:
            runs = seer
        if not looks and seer.samples and spent.work > _EARLY:
            looks = 1
            early = witness.of(seer.samples[-1].run, seer.chosen)
            if not seer.follows(early):
                for each in kinds:
                    each.mind(early)
                continue
        sample = spent.take(runs, measure)
        late = best.estimates and sample.vectors and spent.work > _EARLY
        if late and tolerance < (noise := _noise(runs, best)) < _ALL:
            return _lost_in_noise(spent, best, noise)  # Finer runs have more of it.
        if runs.stops_there and runs.samples and looks < _LOOKS:
            places = witness.of(runs.samples[-1].run, runs.chosen)
            if not runs.follows(places):
                looks += 1
                runs.mind(places)
        if isinstance(sample.result, Exception):
            failures.append(sample.result)
            ending.require_motion(spent.runs[-1][1].integrator, sample.run)
    if not best.estimates:
        ended = any(x.samples for x in kinds)
        raise (
            failures[-1] if failures and not ended else _out_of_reach(spent, ways, seer, tolerance)
        )
    reached = best.error <= tolerance
    # Costs as predicted before the last run.
    left = "; ".join(spent.price(*x) for x in ways.items() if not reached or x[0] is not best)
    why = f"{best.words}. {'Not taken' if reached else 'To the tolerance'}: {left}."
    return _found(spent, best, best.estimates, reached, why)


def _found(spent: _Spent, best: Runs, estimates: list[Estimate], reached: bool, why: str) -> Found:
    integrator = next(trial.integrator for runs, trial, _ in spent.runs[::-1] if runs is best)
    trials = tuple(trial for _, trial, _ in spent.runs)
    return Found(estimates, best.samples[-1].result, reached, integrator, why, trials)


def _passed_over(spent: _Spent, best: Runs, why: str) -> Found:
    """Return estimates with infinite bars: no run resolved the sharp places of its path."""
    unknown = [Estimate(x, np.full(x.shape, np.inf)) for x, _ in best.estimates]
    return _found(spent, best, unknown, False, f"{why}.")


def _noise(runs: Runs, best: Runs) -> float:
    """Return the change by round-off of the last of `runs`, relative to the best estimates."""
    return runs.relative(runs.noise, [x for x, _ in best.estimates])


def _lost_in_noise(spent: _Spent, best: Runs, noise: float) -> Found:
    """Return estimates whose bars hold the round-off of the states, as if all steps added to it."""
    steps, pairs = best.samples[-1].steps, zip(best.estimates, best.noise, strict=True)
    estimates = [Estimate(x, bar + steps * np.abs(more)) for (x, bar), more in pairs]
    why = (
        f"round-off of coordinates changes the result by about {noise:.1g} of its size; bars hold "
        "that. It is relative to itself: add a size that matters, for example 1 + x for x near 0."
    )
    return _found(spent, best, estimates, False, why)


# -- gradients ---------------------------------------------------------------------------------


# Most variables with which HHT uses direct differentiation, which also shows whether waves are
# resolved.
_DIRECT = 6
# Output intervals of DOP853 where objectives read the end only, and otherwise, or where forces may
# have sharp places along the path.
_FEW, _MANY = 4, 64


def gradients_within(
    system: MechanicalSystem,
    objectives: Sequence[Objective],
    t_end: float,
    tolerance: float,
    method: GradientMethod | None,
    progress: bool,
) -> list[Gradient]:
    """Return values and gradients with error bars within the tolerance, or the best ones.

    A warning says that the tolerance was not reached.
    """
    require_tolerance(tolerance)
    scale = design_sizes(system)

    def measure(integrator: Integrator) -> Sample:
        way = method or _method(integrator, system.n_b)
        try:
            results = way.gradients(Run(system, t_end, integrator, progress), objectives)
        except UnfinishedRunError as error:
            return Sample([], None, error.solution.statistics.steps, error, error.solution)
        vectors = [x for each in results for x in (np.array([each.value]), each.gradient * scale)]
        run = results[0].solution
        return Sample(vectors, run.estimated_errors, run.statistics.steps, results, run)

    wanted = _wanted(system, objectives, t_end, tolerance)
    witness, intervals = Witness(system, _seen(objectives), tolerance), None
    if method is None or isinstance(method, DirectDifferentiation):
        few = read_at_end(system, objectives, t_end) and not witness.looks
        intervals = _FEW if few else _MANY
    reached = search(wanted, measure, witness, intervals, 4)
    return with_bars(reached, scale, tolerance)


def _wanted(
    system: MechanicalSystem, objectives: Sequence[Objective], t_end: float, tolerance: float
) -> Wanted:
    """Return the task of a search for objectives and their gradients."""

    def numbers(states: States) -> list[Array]:
        with np.errstate(all="ignore"):
            return [np.array([np.real(x.value(system, states))]) for x in objectives]

    def partials(states: States) -> list[ObjectivePartials]:
        return [x.partials(system, states) for x in objectives]

    parts = [leaves(x) for x in objectives]
    over = [[x for x in each if isinstance(x, OverTime)] for each in parts]
    integrated = [len(x) == len(y) for x, y in zip(parts, over, strict=True)]
    problem = InitialValueProblem.of(system, t_end)
    fast = features(problem, [x.observable for each in over for x in each], t_end)
    return Wanted(
        problem,
        t_end,
        tolerance,
        paired_norms,
        numbers,
        integrated,
        partials,
        False,
        fast,
        speed(problem),
    )


def require_tolerance(tolerance: float) -> None:
    """Raise InvalidInputError unless a tolerance lies between 1e-11 and 0.1."""
    require_positive("tolerance", tolerance)
    if not 1e-11 <= tolerance <= 0.1:
        raise InvalidInputError(
            "tolerance", "must lie in [1e-11, 0.1]", tolerance, "For example 1e-3."
        )


def _method(integrator: Integrator, variables: int) -> GradientMethod:
    adjoint = isinstance(integrator, AdjointIntegrator) and variables > _DIRECT
    return Adjoint() if adjoint else DirectDifferentiation()


def _seen(objectives: Sequence[Objective]) -> tuple[Seen, ...]:
    """Return the observables that objectives read between the ends of a run."""
    each = dict.fromkeys(x for objective in objectives for x in leaves(objective))
    over = (x for x in each if isinstance(x, OverTime | SmoothUpperBound))
    return tuple(Seen(x.observable, getattr(x, "sharpness", None)) for x in over)


def paired_norms(vectors: Sequence[Array]) -> list[float]:
    """Return the sizes to which errors of pairs of a value and a scaled gradient are relative."""
    sizes = norms(vectors)
    pairs = zip(sizes[::2], sizes[1::2], strict=True)
    return [size for value, slope in pairs for size in (max(value, slope), slope)]


def with_bars(reached: Found, scale: Array, tolerance: float) -> list[Gradient]:
    """Return the results of the finest run with the estimates and their accuracy."""
    results, done = reached.result, []
    assert isinstance(results, list)
    for each, value, slope in zip(
        results, reached.estimates[::2], reached.estimates[1::2], strict=True
    ):
        accuracy = Accuracy(
            tolerance,
            reached.reached,
            reached.integrator,
            reached.why,
            reached.trials,
            float(value.bar[0]),
            slope.bar / scale,
        )
        numbers = {"value": float(value.x[0]), "gradient": slope.x / scale}
        done.append(replace(each, **numbers, accuracy=accuracy))
    return done


# -- observables -------------------------------------------------------------------------------


# Default number of output times, and number of intervals of DOP853.
_INSTANTS, _INTERVALS = 65, 64


@final
@dataclass(frozen=True, repr=False)
class ObservableEstimates(ToleranceSearch):
    """Values of observables at given times with estimated bounds of their errors.

    The tolerance is relative: for each observable the norm of its error over the times, divided by
    the norm of its values.

    Attributes
    ----------
    t : array, shape (n,)
        Times of the values; s.
    values, bars : array, shape (n, n_observables)
        Values, and estimated bounds of their errors, which are not proven. Values may be
        extrapolated from several runs; they are then better than those of the solution.
    solution : Solution or EventSolution
        The finest run of the chosen kind.
    tolerance : float
        The requested tolerance; relative.
    reached : bool
        Whether all error bars are within it.
    integrator : Integrator
        The integrator of the finest run of the chosen kind.
    why : str
        The reason for this integrator, or why the tolerance is out of reach and its cost.
    trials : tuple of Trial
        All runs in their order.
    seconds : float
        Processor time of all runs; s.
    """

    t: Array
    values: Array
    bars: Array
    solution: Solution | EventSolution

    def to_dataframe(self) -> Any:
        """Return values and bars over time as a pandas table with index t, s."""
        names = range(self.values.shape[1])
        table = dict(zip(map(str, names), self.values.T, strict=True))
        table |= {f"bar of {k}": bar for k, bar in zip(names, self.bars.T, strict=True)}
        return pandas().DataFrame(table, index=pandas().Index(self.t, name="t"))

    def _printed(self) -> TableText:
        rows = [["observable", "last value"]]
        last = zip(self.values[-1], self.bars[-1], strict=True)
        rows += [[str(k), f"{x:.9g} +- {bar:.1g}"] for k, (x, bar) in enumerate(last)]
        head = f"ObservableEstimates: {len(self.t)} instants to t = {self.t[-1]:.6g}"
        return head, rows, plain(*self._runs())


def observed_within(
    system: MechanicalSystem,
    observables: Sequence[Observable] | None,
    at: Sequence[float] | Array | None,
    t_end: float,
    tolerance: float,
    progress: bool,
) -> ObservableEstimates:
    """Return observables with error bars within the tolerance, or the best ones and a warning."""
    require_positive("t_end", t_end)
    require_tolerance(tolerance)
    require_flag("progress", progress)
    asked, times = asked_for(observables, at, system, t_end)

    def measure(integrator: Integrator) -> Sample:
        run = uninterrupted(integrator.integrate(system, t_end, progress=progress))
        steps = run.statistics.steps
        if not run.outcome.success:
            return Sample([], None, steps, UnfinishedRunError(run), run)
        return Sample(numbers(states_of(run)), run.estimated_errors, steps, run, run)

    def numbers(states: States) -> list[Array]:
        return [_interpolated(x.value(system, states), states, times) for x in asked]

    problem, none = InitialValueProblem.of(system, t_end), [False] * len(asked)
    fast = features(problem, (), t_end)
    wanted = Wanted(
        problem, t_end, tolerance, norms, numbers, none, None, True, fast, speed(problem)
    )
    witness = Witness(system, tuple(map(Seen, asked)), tolerance)
    reached = search(wanted, measure, witness, _INTERVALS, 3)
    return estimates_of(reached, tolerance, times)


def estimates_of(reached: Found, tolerance: float, times: Array) -> ObservableEstimates:
    """Return estimates of observables with the finest run of a search."""
    assert isinstance(reached.result, Solution | EventSolution)
    values, bars = (
        np.stack(x, axis=1) for x in zip(*((e.x, e.bar) for e in reached.estimates), strict=True)
    )
    told = tolerance, reached.reached, reached.integrator, reached.why, reached.trials
    return ObservableEstimates(*told, times, values, bars, reached.result)


def asked_for(
    observables: Sequence[Observable] | None,
    at: Sequence[float] | Array | None,
    system: MechanicalSystem,
    t_end: float,
) -> tuple[Sequence[Observable], Array]:
    """Return the observables and their times.

    Raise InvalidInputError if there are no observables, if one is not in the system, or if times do
    not ascend within the run.
    """
    repair = "For example observables=[position(rod.at_end, 0)]."
    named = () if observables is None else observables
    wanted = require_each("observables", named, (Observable,), repair)
    if not wanted:
        raise InvalidInputError("observables", "must be named for a tolerance", "none", repair)
    for each in wanted:
        each.check(system)
    times = np.linspace(0.0, t_end, _INSTANTS) if at is None else instants("at", at, t_end)
    return wanted, times


def _interpolated(values: Array, run: States, times: Array) -> Array:
    """Return values of a run interpolated at other times, with an error of higher order.

    Splines pass through the ends of steps: cubic ones for order 2, quintic ones for order 5. Runs
    of high order are interpolated by the polynomials of their panels.
    """
    if run.degree == LOBATTO_DEGREE:
        grid = TimeGrid(run.t, run.degree)
        shares = (grid.interpolation(float(time)) for time in times)
        return np.array([share @ values[rows] for rows, share in shares])
    ends = slice(None, None, run.degree)
    spline = scipy.interpolate.make_interp_spline(run.t[ends], values[ends], k=run.degree + 2)
    return np.asarray(spline(times))


def norms(vectors: Sequence[Array]) -> list[float]:
    """Return the Euclidean norms of vectors, a list."""
    return [float(np.linalg.norm(each)) for each in vectors]
