"""Observables of a run to a tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_each, require_flag, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.errors.text import TableText, plain
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import LOBATTO_DEGREE, TimeGrid
from ancfdae.sensitivity.method import ToleranceSearch, UnfinishedRunError
from ancfdae.sensitivity.observables.observable import Observable
from ancfdae.sensitivity.observables.states import States, states_of
from ancfdae.studies.parts import instants
from ancfdae.studies.tolerance.features import features
from ancfdae.studies.tolerance.gradients import require_tolerance
from ancfdae.studies.tolerance.places import Seen, Witness
from ancfdae.studies.tolerance.runs import Sample, Wanted
from ancfdae.studies.tolerance.search import search
from ancfdae.studies.tolerance.spectrum import speed

# Instants of a run where none are asked for, and intervals of those of high order.
_INSTANTS, _INTERVALS = 65, 64


@final
@dataclass(frozen=True, repr=False)
class ObservableEstimates(ToleranceSearch):
    """Values of observables at given times with estimated bounds of their errors.

    The tolerance is relative: of each observable the norm of its error over the instants, to the
    norm of its values there.

    Attributes
    ----------
    t : array, shape (n,)
        Times of the values; s.
    values, bars : array, shape (n, n_observables)
        The bars are estimated bounds of the errors, no proofs. Values may be extrapolated from
        several runs; they are then better than those of the solution.
    solution : Solution
        The finest run of the chosen kind.
    tolerance : float
        The tolerance that was asked for; relative.
    reached : bool
        Whether all bars are within it.
    integrator : Integrator
        The integrator of the finest run of the chosen kind.
    why : str
        The reason for this integrator, or why the tolerance is out of reach and its price.
    trials : tuple of Trial
        All runs in their order.
    seconds : float
        Processor time of all runs; s.
    """

    t: Array
    values: Array
    bars: Array
    solution: Solution

    def to_dataframe(self) -> Any:
        """Return values and bars over time as a table of pandas, with t as its index."""
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
    """Return observables with bars below the tolerance, or a warning and the best."""
    require_positive("t_end", t_end)
    require_tolerance(tolerance)
    require_flag("progress", progress)
    asked = _checked(observables, system)
    times = np.linspace(0.0, t_end, _INSTANTS) if at is None else instants("at", at, t_end)

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
        problem, t_end, tolerance, _sizes, numbers, none, None, True, fast, speed(problem)
    )
    witness = Witness(system, tuple(map(Seen, asked)), tolerance)
    reached = search(wanted, measure, witness, _INTERVALS, 3)
    assert isinstance(reached.result, Solution)
    values, bars = (
        np.stack(x, axis=1) for x in zip(*((e.x, e.bar) for e in reached.estimates), strict=True)
    )
    told = tolerance, reached.reached, reached.integrator, reached.why, reached.trials
    return ObservableEstimates(*told, times, values, bars, reached.result)


def _checked(
    observables: Sequence[Observable] | None, system: MechanicalSystem
) -> Sequence[Observable]:
    """Return the observables. Raise InvalidInputError if they are empty or not in the system."""
    repair = "For example observables=[position(rod.at_end, 0)]."
    named = () if observables is None else observables
    wanted = require_each("observables", named, (Observable,), repair)
    if not wanted:
        raise InvalidInputError("observables", "must be named for a tolerance", "none", repair)
    for each in wanted:
        each.check(system)
    return wanted


def _interpolated(values: Array, run: States, times: Array) -> Array:
    """Return values of all instants of a run at other times, with an error of higher order.

    Splines go through the ends of steps: cubic ones for order 2, quintic ones for order 5.
    Instants of high order have the polynomials of their panels.
    """
    if run.degree == LOBATTO_DEGREE:
        grid = TimeGrid(run.t, run.degree)
        shares = (grid.interpolation(float(time)) for time in times)
        return np.array([share @ values[rows] for rows, share in shares])
    ends = slice(None, None, run.degree)
    spline = scipy.interpolate.make_interp_spline(run.t[ends], values[ends], k=run.degree + 2)
    return np.asarray(spline(times))


def _sizes(vectors: Sequence[Array]) -> list[float]:
    return [float(np.linalg.norm(each)) for each in vectors]
