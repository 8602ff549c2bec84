"""Base classes of the sensitivity methods, the runs that they differentiate, and their results.

A run is checked for states at which it has no derivative: functions of a user that are called with
complex numbers must be analytic there, and constraints must keep full rank.
"""

from __future__ import annotations

import abc
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from ancfdae.equations import ErrorEstimates, MechanicalSystem
from ancfdae.equations.complex_steps import at_values
from ancfdae.equations.event_solution import EventSolution
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_flag, require_kind
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError, SingularMatrix, StabilityWarning
from ancfdae.errors.outcomes import PassFailed, Verdict, uninterrupted
from ancfdae.errors.text import PrintedTable, TableText
from ancfdae.integrators.integrator import Integrator, QuadratureIntegrator, with_contacts
from ancfdae.integrators.prescribed_motion import nearest_to_singular, singular_position
from ancfdae.integrators.recorder import Rows
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.objectives.objective import NO_TOTALS, NonFiniteObjectiveError, Totals
from ancfdae.sensitivity.objectives.reductions import read_at_end, totals_of
from ancfdae.sensitivity.observables.observable import states_of

# Number of states, evenly spaced in the run, at which functions of a user are checked, and at which
# redundant equations that are left out are.
_STATES, _FEW = 64, 5
# A run warns of a nearly singular position if it is _NEAR times nearer to losing rank there than at
# its best state, and if errors so amplified exceed _WRONG times the size of the coordinates.
_NEAR, _WRONG = 5.0, 0.05
# Largest distance from a breakpoint, in steps, of a time that counts as at the breakpoint.
_BESIDE = 0.01
# Most entries of Phi_q with which singular values are computed.
_DENSE = 100_000


def require_differentiable(
    system: MechanicalSystem,
    t: Array,
    q: Array,
    v: Array,
    errors: ErrorEstimates | None = None,
) -> None:
    """Check that a run, (k,) times t and (k, n_q) q and v, has derivatives; `errors` are estimates.

    Raises InvalidInputError if a user's function is not analytic at one of the states, or if a
    variable of the design opens a joint of which redundant equations are left out. Warns with
    StabilityWarning if a step passes over a singular position, or if errors are large near one.
    """
    if system.called_functions or system.traits.rows_left_out:
        count = _STATES if system.called_functions else _FEW
        some = np.unique(np.linspace(0, len(t) - 1, count).astype(int))
        for time, each in zip(_beside_breakpoints(system, t)[some], some, strict=True):
            system.require_derivatives_at(float(time), q[each], v[each])
    if system.traits.linear_constraints or not system.n_lam or not system.has_loops:
        return
    singular = singular_position(system, Rows(t, q, v))
    if singular is not None:
        warnings.warn(
            f"The run passes a singular position at t = {singular:.6g} s, where Phi_q loses rank: "
            "constraints have several branches there. Neighbouring designs may leave on others, "
            "or lock: the motion beyond has no derivative then, and the gradient depends on the "
            "steps. Compare two steps, end the run before, or change a length.",
            StabilityWarning,
            stacklevel=4,
        )
    else:
        # Errors of derivatives grow twice: from errors of the motion, and by themselves.
        warn_near_singular(system, Rows(t, q, v), errors, 2, stacklevel=5)


def _beside_breakpoints(system: MechanicalSystem, t: Array) -> Array:
    """Return the times t of a run, (k,), those at breakpoints moved towards a neighbour.

    A function has two derivatives in time at a breakpoint, and steps end there.
    """
    marks = np.array(system.breakpoints(float(t[-1])))
    if not marks.size or len(t) < 2:
        return t
    after = np.append(t[1:], t[-2]) - t
    near = np.abs(t[:, None] - marks).min(axis=1) < _BESIDE * np.abs(after)
    return np.asarray(t + near * after / 2)


def warn_near_singular(
    system: MechanicalSystem,
    rows: Rows,
    errors: ErrorEstimates | None,
    power: int = 1,
    stacklevel: int = 3,
) -> None:
    """Warn of a run whose estimated errors are large where constraints nearly lose rank.

    Along the free motion errors grow there by the nearness to the singular position, to the power
    `power` (docs/theory/13-errors.md).
    """
    if errors is None or system.traits.linear_constraints or not system.n_lam:
        return
    if not system.has_loops or system.n_lam * system.n_q > _DENSE or np.iscomplexobj(rows.q):
        return
    if not _WRONG * 1e-2 < errors.motion < np.inf:
        return
    time, nearness = nearest_to_singular(system, rows)
    if nearness < _NEAR or errors.motion * nearness**power < _WRONG:
        return
    of = "derivatives" if power > 1 else "positions"
    warnings.warn(
        f"The motion passes near a singular position at t = {time:.6g} s, where Phi_q is "
        f"{nearness:.2g} times nearer to losing rank than elsewhere: errors of the run, estimated "
        f"at {errors.motion:.2g} of the size of the coordinates, grow there, in {of} to "
        f"{errors.motion * nearness**power:.2g} and more. Take shorter steps, or rtol, and compare "
        "two of them.",
        StabilityWarning,
        stacklevel=stacklevel,
    )


# -- results and runs --------------------------------------------------------------------------


# Larger derivatives count as infinite: derivatives of operation lists replace 1/0 by 1e150.
_INFINITE = 1e100


@final
@dataclass(frozen=True)
class Trial:
    """A run of a search for a tolerance: its steps (zero if it did not end), processor time in s.

    `error` is the largest relative error bar from this run and the coarser ones of its kind.
    """

    integrator: Integrator
    steps: int
    seconds: float
    error: float


@dataclass(frozen=True, repr=False)
class ToleranceSearch(PrintedTable):
    """Base of results of calls with `tolerance`: the tolerance, the chosen integrator, all runs.

    Attributes
    ----------
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
    """

    tolerance: float
    reached: bool
    integrator: Integrator
    why: str
    trials: tuple[Trial, ...]

    @property
    def seconds(self) -> float:
        """Processor time of all runs of the search; s."""
        return sum(each.seconds for each in self.trials)

    def _runs(self) -> TableText:
        verdict = "reached" if self.reached else "NOT reached"
        rows = [("run", "steps", "seconds", "error")]
        for each in self.trials:
            numbers = str(each.steps or "not ended"), f"{each.seconds:.2g}", f"{each.error:.1g}"
            rows.append((type(each.integrator).__name__, *numbers))
        head = f"tolerance {self.tolerance:g} {verdict}, {self.seconds:.2g} s. {self.why}"
        return head, rows, ""


@final
@dataclass(frozen=True, repr=False)
class Accuracy(ToleranceSearch):
    """Error bars of value and gradient that a call with `tolerance` reached.

    The tolerance is relative to the norm of the gradient scaled by the design values, (b_j
    dpsi/db_j); for a value to the larger of that norm and the magnitude of the value.

    Attributes
    ----------
    value_bar : float
        Estimated bound of the error of the value; unit of the objective.
    gradient_bar : array, shape (n_b,)
        Estimated bounds of the errors of the gradient; not proven: docs/reports/tolerance says how
        often they hold.
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

    value_bar: float
    gradient_bar: Array

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each run: integrator, steps, seconds and error."""
        rows = [(repr(run.integrator), run.steps, run.seconds, run.error) for run in self.trials]
        return pandas().DataFrame(rows, columns=["run", "steps", "seconds", "error"])

    def _printed(self) -> TableText:
        return self._runs()


@final
class UnfinishedRunError(AncfdaeError):
    """Raised if a gradient is requested of a run that did not reach its end time.

    `solution` holds the computed part of the run and its outcome.
    """

    def __init__(self, solution: Solution) -> None:
        super().__init__(f"no gradient: {solution.outcome}")
        self.solution = solution


@final
@dataclass(frozen=True, repr=False)
class Gradient(PrintedTable):
    """Value and gradient of an objective.

    Attributes
    ----------
    value : float
        Value of the objective, in its unit.
    gradient : array, shape (n_b,)
        Total derivatives with respect to the design variables; unit of the objective over that of
        the variable.
    names : tuple of str
        Names of the design variables.
    method : GradientMethod
        The method that computed the gradient.
    solution : Solution
        The run at the design; of a call with `tolerance` the finest run, of a call with events the
        last phase.
    accuracy : Accuracy, optional
        Error bars of a call with `tolerance`, and how they were reached.
    event_solution : EventSolution, optional
        All phases of a call with events, and the events between them.
    """

    value: float
    gradient: Array
    names: tuple[str, ...]
    method: GradientMethod
    solution: Solution
    accuracy: Accuracy | None = None
    event_solution: EventSolution | None = None

    def __post_init__(self) -> None:
        wrong = np.flatnonzero(~(np.abs(self.gradient) < _INFINITE))
        if wrong.size:
            what = f"the derivative with respect to {self.names[wrong[0]]!r} by {self.method}"
            raise NonFiniteObjectiveError("gradient", what, None)

    @property
    def pair(self) -> tuple[float, Array]:
        """Value and gradient, shape (n_b,), as ``scipy.optimize.minimize(jac=True)`` wants them."""
        return self.value, self.gradient

    def to_dataframe(self) -> Any:
        """Return the derivatives as a table of pandas, a row for each design variable.

        The value of the objective is in its ``attrs``.
        """
        index = pandas().Index(self.names, name="design variable")
        table = pandas().DataFrame({"derivative": self.gradient}, index=index)
        table.attrs["objective"] = self.value
        return table

    def _printed(self) -> TableText:
        slopes = [f"{slope:.6g}" for slope in self.gradient]
        value, end = f"{self.value:.9g}", str(self.solution.outcome)
        if self.accuracy is not None:
            bars = self.accuracy.gradient_bar
            slopes = [f"{x} +- {bar:.1g}" for x, bar in zip(slopes, bars, strict=True)]
            value, end = f"{value} +- {self.accuracy.value_bar:.1g}", repr(self.accuracy)
        rows = [("design variable", "derivative"), *zip(self.names, slopes, strict=True)]
        return f"objective {value}, gradient by {self.method}", rows, end


@final
@dataclass(frozen=True)
class Run:
    """Instructions for a run: a system, an integrator and the end time `t_end` (s) from t = 0.

    `after` is a run to be continued, or a finished run to be differentiated. `progress` shows a
    bar.
    """

    system: MechanicalSystem
    t_end: float
    integrator: Integrator
    progress: bool = False
    after: Solution | None = None

    def __post_init__(self) -> None:
        repair = "For example HHT(step=0.01), or give a tolerance."
        require_kind("integrator", self.integrator, (Integrator,), repair)
        require_flag("progress", self.progress)
        if self.after is not None:
            require_kind("after", self.after, (Solution,), "Pass what simulate returned.")

    def _advised(self, run: Solution) -> Solution:
        """Return a failed run with hints from its modes; loads the package `modes` only then."""
        from ancfdae.modes.analysis import advised

        return advised(self.system, run)

    def solution(self, *, sensitivities: bool = False) -> Solution:
        """Integrate the motion, from `after` if given, with design derivatives if requested."""
        settings = {"sensitivities": sensitivities, "progress": self.progress}
        if self.after is not None:
            run = self.integrator.resume(self.system, self.t_end, self.after, **settings)
            run = run if run.outcome.success else self._advised(run)
        else:
            run = self.integrator.integrate(self.system, self.t_end, **settings)
            run = self._told(run, sensitivities)
        system, traits = self.system, self.system.traits
        if sensitivities and (system.called_functions or not traits.linear_constraints):
            require_differentiable(system, run.t, run.q, run.v, run.estimated_errors)
        slopes = run.sensitivities if run.outcome.success else None
        if slopes is not None and not np.all(np.isfinite(slopes.v_b[-1:])):
            wrong = np.any(~np.isfinite(slopes.v_b), axis=(1, 2))
            time = float(run.t[np.argmax(wrong)])
            raise NonFiniteObjectiveError("motion", "a design derivative", time)
        return run

    def integrals(
        self, objectives: Sequence[Objective], *, differentiated: bool, sensitivities: bool = False
    ) -> tuple[Solution, Totals]:
        """Return a finished run, and the integrals that the integrator took during its steps.

        The run has few output times if no objective reads states between its ends.
        """
        integrator = self.integrator
        if self.after is not None or not isinstance(integrator, QuadratureIntegrator):
            run = finished(self.solution(sensitivities=sensitivities))
            if differentiated and not sensitivities:
                require_differentiable(self.system, run.t, run.q, run.v, run.estimated_errors)
            return run, NO_TOTALS
        totals = totals_of(self.system, objectives, differentiated)
        if read_at_end(self.system, objectives, self.t_end):
            integrator = integrator.at_end(self.system, self.t_end)
        run = integrator.integrate(
            self.system,
            self.t_end,
            sensitivities=sensitivities,
            progress=self.progress,
            integrands=list(totals.values()),
        )
        if differentiated:
            require_differentiable(self.system, run.t, run.q, run.v, run.estimated_errors)
        return finished(self._told(run, sensitivities)), totals

    def _told(self, run: Solution, sensitivities: bool) -> Solution:
        """Return a run with hints if it failed; reject one without the requested derivatives."""
        contacts = None if self.integrator.checks_contacts else self.system.contacts()
        run = with_contacts(run, contacts) if contacts else run
        if not run.outcome.success:
            return self._advised(run)
        if sensitivities and run.sensitivities is None:
            raise InvalidInputError(
                f"integrator {type(self.integrator).__name__}",
                "must integrate design derivatives when `sensitivities` asks for them",
                "a run without",
                "Refuse there, and take method=ComplexStep() or FiniteDifference().",
            )
        return run

    def values(self, objectives: Sequence[Objective]) -> tuple[Solution, Array]:
        """Return a finished run and the values of the objectives, shape (n,)."""
        solution, totals = self.integrals(objectives, differentiated=False)
        states = states_of(solution)
        return solution, np.array([each.value(self.system, states, totals) for each in objectives])

    def at(self, b: Array) -> Run:
        """Return the same run at other design values b, shape (n_b,)."""
        return replace(self, system=at_values(self.system, b), after=None)

    def repeating(self, solution: Solution) -> Run:
        """Return a run that repeats the steps of `solution`, up to the time that it reached."""
        done = solution.outcome.success or len(solution.t) < 2
        t_end = self.t_end if done else float(solution.t[-1])
        frozen = self.integrator.frozen(solution)
        return replace(self, integrator=frozen, t_end=t_end, after=None)


class GradientMethod(abc.ABC):
    """Immutable settings of a method that computes gradients of objectives of a run."""

    @property
    def takes_runs(self) -> bool:
        """Whether the method can differentiate an existing run, `Run.after`."""
        return True

    @abc.abstractmethod
    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """Return value and gradient of every objective from as few runs as possible."""


class Method(GradientMethod):
    """A method that differentiates the whole trajectory, and so any objective of it."""

    @abc.abstractmethod
    def differentiate(self, run: Run) -> Solution:
        """Return the solution with the design derivatives of its trajectory.

        If a run ends early, derivatives reach to the last time that all runs of the method reached.
        """


@contextmanager
def keeping(solution: Solution) -> Iterator[None]:
    """Raise UnfinishedRunError or Interrupted, with the run, if a backward pass inside fails."""
    try:
        yield
    except (KeyboardInterrupt, SingularMatrix, PassFailed) as error:
        verdict = Verdict.SINGULAR if isinstance(error, SingularMatrix) else Verdict.INTERRUPTED
        verdict = error.verdict if isinstance(error, PassFailed) else verdict
        outcome = replace(solution.outcome, verdict=verdict)
        raise UnfinishedRunError(uninterrupted(replace(solution, outcome=outcome))) from error


def finished(solution: Solution) -> Solution:
    """Return a solution that reached its end time; else raise UnfinishedRunError or Interrupted."""
    if not uninterrupted(solution).outcome.success:
        raise UnfinishedRunError(solution)
    return solution
