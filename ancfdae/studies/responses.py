"""Several functions of a design from one run per design, in the form that optimisers need.

**Designs without values.** A line search may try a design whose run ends early. Infinite values
would make only some methods step back (in SciPy 1.17 L-BFGS-B stops and reports success,
trust-constr gives up). So a function is continued from the last design x_0 with values, with d = x
- x_0, as

    f = f_0 + r,   f_x = 3 r d / |d|^2,   r = |f_x0| |d|,

the slope along d of the parabola through f_0 that decreases by r at first: line searches that fit a
parabola, or a cubic, step back to about a quarter. Constraints are continued towards violation.
Residuals of least squares are infinite, which SciPy's least-squares methods handle.

Each design is computed once.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.event_solution import EventSolution
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import (
    require_array,
    require_finite,
    require_flag,
    require_kind,
    require_text,
)
from ancfdae.errors.kinds import (
    AncfdaeError,
    FailedDesignWarning,
    InvalidInputError,
    UnknownNameError,
)
from ancfdae.integrators.integrator import AdjointIntegrator, Integrator
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import progress_bar
from ancfdae.sensitivity.adjoint import DirectDifferentiation
from ancfdae.sensitivity.method import GradientMethod, Run
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import (
    as_system,
    cheapest,
    design_bounds,
    differentiable,
    require_objectives,
    without_end,
)
from ancfdae.studies.sweep_file import Sweep, SweepRow

if TYPE_CHECKING:
    from ancfdae.events.calls import EventRun
    from ancfdae.events.kinds import Event, Mode

# Type of the result from which the values at a design come: a run, modes.
R = TypeVar("R")
# A run at a design, and its solution.
_Ran: TypeAlias = "tuple[Run | EventRun, Solution | EventSolution]"
# Function of design values, of whether derivatives are wanted, and of a cached result, if any.
Compute: TypeAlias = Callable[[Array, bool, R | None], tuple[Array, Array | None, R]]


@final
@dataclass(frozen=True)
class Evaluation:
    """Result at one design x: values, shape (m,), and, if requested, derivatives in x.

    If the design has no values, `error` says why, `near` is the last x before with values; the
    values are infinite and the derivatives NaN.
    """

    x: Array
    values: Array
    jacobian: Array | None
    error: AncfdaeError | None = None
    near: Array | None = None


@final
class Evaluations(Generic[R]):
    """Cache of results at designs x = b / scale, with the runs of the last `kept` designs.

    The first design must have values, with `strict` every design; otherwise a design without values
    raises a warning. `rows` are the designs in order, with values or errors.
    """

    def __init__(
        self,
        names: Sequence[str],
        count: int,
        compute: Compute[R],
        *,
        scale: Array | float = 1.0,
        kept: int = 1,
        strict: bool = False,
        progress: bool = False,
    ) -> None:
        self._names, self._count, self._compute = tuple(names), count, compute
        self._scale, self._most, self._strict = scale, kept, strict
        self._bar = progress_bar(progress, unit="design", mininterval=0)
        self._known: dict[bytes, Evaluation] = {}
        self._results: dict[bytes, R] = {}
        self._good: list[Array] = []
        self.rows: list[SweepRow] = []

    def at(self, x: Array, *, derivatives: bool = True) -> Evaluation:
        """Return the result (run or modes) at x; without `derivatives` possibly values only."""
        x = require_array("design values", x, (len(self._names),))
        known = self._known.get(x.tobytes())
        if known is None or (derivatives and known.jacobian is None):
            known = self._evaluated(x, derivatives)
        return known

    def result(self, x: Array) -> R:
        """Return the result (run or modes) at x; raise the error of a design without one."""
        known = self.at(x, derivatives=False)
        if known.error is not None:
            raise known.error
        if known.x.tobytes() not in self._results:
            self._evaluated(known.x, derivatives=False)
        return self._results[known.x.tobytes()]

    def _evaluated(self, x: Array, derivatives: bool) -> Evaluation:
        key, b = x.tobytes(), x * self._scale
        at = dict(zip(self._names, b.tolist(), strict=True))
        others = [other for other in self._good if not np.array_equal(other, x)]
        try:
            values, jacobian, result = self._compute(b, derivatives, self._results.pop(key, None))
        except AncfdaeError as error:
            self.rows.append(SweepRow(at, None, f"{type(error).__name__}: {error}"))
            if self._strict or not others:
                raise
            warnings.warn(
                f"the design {at} has no values: {error}", FailedDesignWarning, stacklevel=5
            )
            none = np.full(self._count, np.inf), np.full((self._count, len(x)), np.nan)
            evaluation = Evaluation(x, *none, error, others[-1])
        else:
            if key not in self._known:
                self.rows.append(SweepRow(at, values))
                self._bar.update()
            self._good = [*others, x][-2:]
            if len(self._results) == self._most:
                del self._results[next(iter(self._results))]
            self._results[key] = result
            slopes = None if jacobian is None else jacobian * self._scale
            evaluation = Evaluation(x, values, slopes)
        self._known[key] = evaluation
        return evaluation


# Number of cached runs: optimisers return to the design before the last one if a step was too long.
# All values are cached: COBYQA evaluates old designs repeatedly.
_KEPT = 4


@final
class Responses:
    """Objective and constraints as functions of the design, with one run for each design.

    ``r["mass"]`` is a function for SciPy's optimisers, ``r["mass"].gradient`` its gradient,
    ``r.constraint("miss", upper=1.0)`` a `NonlinearConstraint`; `values` and `jacobian` return all
    functions at once, for `least_squares`. The first evaluation runs the design; further ones use
    its results. Values alone cost only the run: `HHT` differentiates the run when a gradient is
    first requested; other integrators, and `Adjoint(memory)`, which compute both at once, do so in
    every run after the first such request.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    functions : mapping of str to Objective
        Functions of the design by name.
    t_end : float
        End time; s.
    integrator : Integrator
    design : sequence of str or DesignVariable, optional
        As in `gradient`; it may contain ``"t_end"``, the end time.
    method : GradientMethod, optional
        As in `gradients`.
    events : sequence of Event, optional
    modes : mapping of str to Mode, optional
        Events of every run, and the models that it continues with, as in `simulate`.
    scale : float or array, shape (n_b,)
        Functions take x = b / scale (dimensionless). Optimisers need variables of similar size: the
        values at the start are a good scale.
    strict : bool
        Whether a design without values, whose run ends early or which cannot be assembled, raises
        its error. By default only the first design does; a later one gives a `FailedDesignWarning`
        and is made unattractive, so that the optimiser steps back: functions increase towards it,
        constraints are violated, `values` are infinite. Call `solution` at the optimum, which
        raises the error of a design without one.
    progress : bool
        Whether to show a progress bar, which counts the designs that were run.

    Attributes
    ----------
    names : tuple of str
        Names of the functions.
    design_names : tuple of str
    """

    def __init__(
        self,
        model: Scene | MechanicalSystem,
        functions: Mapping[str, Objective],
        t_end: float,
        integrator: Integrator,
        *,
        design: Sequence[str | DesignVariable] | None = None,
        method: GradientMethod | None = None,
        events: Sequence[Event] | None = None,
        modes: Mapping[str, Mode] | None = None,
        scale: float | Sequence[float] | Array = 1.0,
        strict: bool = False,
        progress: bool = False,
    ) -> None:
        repair = 'For example {"mass": Terminal(mass("rod"))}.'
        require_kind("functions", functions, (Mapping,), repair)
        if not functions:
            raise InvalidInputError("functions", "must not be empty", "none", repair)
        for name in functions:
            require_text("functions", name)
        require_kind("integrator", integrator, (Integrator,), "For example HHT(step=0.01).")
        require_flag("strict", strict)
        require_flag("progress", progress)
        design, free_end = without_end(design)
        system = as_system(model, design) if free_end else differentiable(model, design)
        n_b = system.n_b + free_end
        require_objectives(system, list(functions.values()), t_end)
        if method is None:
            adjoint = isinstance(integrator, AdjointIntegrator)
            method = cheapest(n_b, len(functions)) if adjoint else DirectDifferentiation()
        require_kind(
            "method", method, (GradientMethod,), "For example Adjoint() or DirectDifferentiation()."
        )
        self._run: Run | EventRun = Run(system, t_end, integrator)
        self._start, self._limits = system.b, design_bounds(system, design)
        self.design_names = tuple(system.design_names)
        if events is not None or modes is not None or free_end:
            from ancfdae.events.calls import EventRun

            self._run = run = EventRun.of(
                system, t_end, integrator, events or (), modes, design, False, free_end
            )
            self._start, self.design_names = run.b, run.design_names
            lower, upper = self._limits
            if free_end:
                self._limits = np.append(lower, 0.0), np.append(upper, np.inf)
        self._method = method
        self._functions, self._scale = dict(functions), _scale(scale, n_b)
        # Whether a finished run can be differentiated: then values are computed without
        # derivatives.
        self._asked = False
        self._resumes = method.takes_runs and integrator.differentiates_runs
        self._resumes = self._resumes and isinstance(self._run, Run)
        self.names = tuple(functions)
        self._designs = Evaluations(
            self.design_names,
            len(functions),
            self._computed,
            scale=self._scale,
            kept=_KEPT,
            strict=strict,
            progress=progress,
        )

    @property
    def start(self) -> Array:
        """Design values of the model over their scale, x, shape (n_b,)."""
        return np.asarray(self._start / self._scale, dtype=float)

    @property
    def bounds(self) -> scipy.optimize.Bounds:
        """Bounds of the design variables over their scale, in x; infinite if undeclared."""
        return scipy.optimize.Bounds(*(limit / self._scale for limit in self._limits))

    @property
    def history(self) -> Sweep:
        """Every design that was run, in order, with its values by name or its error."""
        rows = [
            replace(row, result=dict(zip(self.names, row.result.tolist(), strict=True)))
            if row.finished
            else row
            for row in self._designs.rows
        ]
        return Sweep(tuple(rows))

    def __getitem__(self, name: str) -> Response:
        """Return the function of this name; UnknownNameError if it is missing."""
        require_text("function of the design", name)
        if name not in self.names:
            raise UnknownNameError("function of the design", name, self.names)
        return Response(self, self.names.index(name))

    def constraint(
        self, name: str, lower: float = -np.inf, upper: float = np.inf
    ) -> scipy.optimize.NonlinearConstraint:
        """Return lower <= function <= upper for ``minimize(constraints=...)``."""
        response = self[name]
        for bound, free in ((lower, -np.inf), (upper, np.inf)):
            if str(bound) != str(free):
                require_finite(f"constraint {name!r}", bound)
        if not lower <= upper or (lower, upper) == (-np.inf, np.inf):
            rule, repair = "lower and upper must bound it", 'For example upper=1.0 for "at most 1".'
            raise InvalidInputError(f"constraint {name!r}", rule, f"{lower} and {upper}", repair)
        fun = Response(self, response.index, 1.0 if upper < np.inf else -1.0)
        return scipy.optimize.NonlinearConstraint(fun, lower, upper, jac=fun.gradient)

    def values(self, x: Array) -> Array:
        """Return the values of all functions at x, shape (m,); infinite if the design has none."""
        return self.at(x, derivatives=False).values.copy()

    def jacobian(self, x: Array) -> Array:
        """Return the responses' derivatives in x, shape (m, n_b); NaN without values."""
        matrix = self.at(x).jacobian
        assert matrix is not None  # asked for
        return matrix.copy()

    def solution(self, x: Array) -> Solution | EventSolution:
        """Return the run at x; raise the error of a design that has none."""
        return self._designs.result(x)[1]

    def __repr__(self) -> str:
        """Return the names of the functions and the designs that were run, as text."""
        lines = f"Responses: {', '.join(self.names)}; {len(self._designs.rows)} designs run"
        return f"{lines}\n{self.history}" if self._designs.rows else lines

    def at(self, x: Array, *, derivatives: bool = True) -> Evaluation:
        """Return the evaluation of a design x; without `derivatives` possibly values only."""
        return self._designs.at(x, derivatives=derivatives)

    def _computed(
        self, b: Array, derivatives: bool, ran: _Ran | None
    ) -> tuple[Array, Array | None, _Ran]:
        """Return values, derivatives or None, and run at a design; a given run is reused."""
        self._asked = self._asked or derivatives
        run, solution = ran or (self._run.at(b), None)
        functions = list(self._functions.values())
        if not isinstance(run, Run):
            return self._with_events(run, functions, derivatives)
        assert solution is None or isinstance(solution, Solution)
        if not derivatives and (self._resumes or not self._asked):
            solution, values = run.values(functions)
            return values, None, (run, solution)
        after = solution if self._resumes else None
        answers = self._method.gradients(replace(run, after=after), functions)
        values = np.array([each.value for each in answers])
        jacobian = np.array([each.gradient for each in answers])
        return values, jacobian, (run, answers[0].solution)

    def _with_events(
        self, run: EventRun, functions: list[Objective], derivatives: bool
    ) -> tuple[Array, Array | None, _Ran]:
        """Return values, derivatives or None, and run at a design, by a run with events."""
        from ancfdae.studies import events

        if not derivatives and not self._asked:
            found, values = events.values(run, functions)
            return values, None, (run, found)
        answers = events.gradients(run, functions, self._method)
        ended = answers[0].event_solution
        assert ended is not None  # of a run with events
        values = np.array([each.value for each in answers])
        return values, np.array([each.gradient for each in answers]), (run, ended)


@final
@dataclass(frozen=True)
class Response:
    """One function of the design: a call returns its value, `gradient` its gradient.

    `sign` is the sign of its change towards a design without values.
    """

    responses: Responses
    index: int
    sign: float = 1.0

    def __call__(self, x: Array) -> float:
        """Return the value of the function at x, without computing derivatives."""
        evaluation = self.responses.at(x, derivatives=False)
        if evaluation.error is not None:
            return self._beyond(evaluation)[0]
        return float(evaluation.values[self.index])

    def gradient(self, x: Array) -> Array:
        """Return the gradient of the function in x, shape (n_b,)."""
        evaluation = self.responses.at(x)
        if evaluation.error is not None:
            return self._beyond(evaluation)[1]
        assert evaluation.jacobian is not None  # asked for
        return np.array(evaluation.jacobian[self.index])

    def _beyond(self, evaluation: Evaluation) -> tuple[float, Array]:
        """Return substitute value and gradient at a design without a result."""
        assert evaluation.near is not None  # of every design with an error
        near, k = self.responses.at(evaluation.near), self.index
        if near.error is not None:
            raise near.error
        assert near.jacobian is not None  # asked for
        d = evaluation.x - near.x
        r = self.sign * np.linalg.norm(near.jacobian[k]) * np.linalg.norm(d)
        return float(near.values[k] + r), 3 * r * d / (d @ d)


def _scale(scale: object, n_b: int) -> Array:
    """Return the scales of all design variables, (n_b,); InvalidInputError unless positive."""
    given = require_array("scale", scale)
    if given.shape not in ((), (n_b,)) or not np.all(given > 0):
        rule = f"must be positive, one number or one for each of {n_b} design variables"
        raise InvalidInputError("scale", rule, repr(scale), "For example np.abs(system.b).")
    return np.broadcast_to(given, n_b)
