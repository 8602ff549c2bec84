"""Several functions of a design from one run, as optimisers ask for them: one after the other.

**Designs without values.** A line search may try a design whose run ends early. Infinity would make
it step back only in some methods (in SciPy 1.17 L-BFGS-B stops and reports success, trust-constr
gives up). So a function goes on from the last design x_0 that has a value, with d = x - x_0, as

    f = f_0 + r,   f_x = 3 r d / |d|^2,   r = |f_x0| |d|,

the slope along d of the parabola through f_0 that falls by r at first: line searches that fit one,
or a cubic, step back to about a quarter. Constraints go on towards what they forbid. Residuals of
least squares are infinite, which SciPy's methods for them know.

Each design is computed once.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeAlias, TypeVar, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
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
from ancfdae.numerics.progress import progress_bar
from ancfdae.sensitivity.adjoint import DirectDifferentiation
from ancfdae.sensitivity.method import GradientMethod, Run
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import cheapest, design_bounds, differentiable, require_objectives
from ancfdae.studies.sweep_file import Sweep, SweepRow

# What values come from at a design: a run, modes.
R = TypeVar("R")
# Takes the design values, whether derivatives are wanted, and the result there if it is kept.
Compute: TypeAlias = Callable[[Array, bool, R | None], tuple[Array, Array | None, R]]


@final
@dataclass(frozen=True)
class Evaluation:
    """Result at one design: values and, if they were asked for, derivatives in x.

    A design that has none has the error, and the last x before that had values; its values are
    infinite, its derivatives NaN.
    """

    x: Array
    values: Array
    jacobian: Array | None
    error: AncfdaeError | None = None
    near: Array | None = None


@final
class Evaluations(Generic[R]):
    """Results at designs x = b / scale, with the runs of the last `kept` of them.

    The first design must have values, and with `strict` every one; of a later one without values
    the user is warned. `rows` are the designs in their order, with values or errors.
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
        """Return the result at x; without `derivatives` perhaps its values only."""
        x = require_array("design values", x, (len(self._names),))
        known = self._known.get(x.tobytes())
        if known is None or (derivatives and known.jacobian is None):
            known = self._evaluated(x, derivatives)
        return known

    def result(self, x: Array) -> R:
        """Return the run behind the values at x; raise the error of a design without a result."""
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


# Runs that are kept: optimisers go back to the design before the last one where a step was too
# long. Values are all kept: COBYQA asks for those of old designs again and again.
_KEPT = 4


@final
class Responses:
    """Objective and constraints as functions of the design, with one run for each design.

    ``r["mass"]`` is a function for SciPy's optimisers, ``r["mass"].gradient`` its gradient,
    ``r.constraint("miss", upper=1.0)`` a `NonlinearConstraint`, and `values` and `jacobian` are
    those of all functions, for `least_squares`. The first evaluation runs the design; further ones
    use its results. Values alone cost the run alone, so that searches without derivatives pay
    for none: `HHT` differentiates the run when a gradient is asked for; other integrators, and
    `Adjoint(memory)`, which take both at once, do so in every run after the first such question.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    functions : mapping of str to Objective
        By names of your own.
    t_end : float
        End time; s.
    integrator : Integrator
    design : sequence of str or DesignVariable, optional
        As in `gradient`.
    method : GradientMethod, optional
        As in `gradients`.
    scale : float or array, shape (n_b,)
        Functions take x = b / scale, relative design values. Optimisers require variables of
        similar size: the values at the start are a good scale.
    strict : bool
        Whether a design without values, whose run ends early or which cannot be assembled,
        raises its error. By default a later one than the first is warned about
        (`FailedDesignWarning`) and made unattractive, so that the optimiser steps back: functions
        rise towards it, constraints turn to what they forbid, `values` are infinite. Ask for
        `solution` at the optimum, which raises the error if there is none.
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
        system = differentiable(model, design)
        require_objectives(system, list(functions.values()), t_end)
        if method is None:
            adjoint = isinstance(integrator, AdjointIntegrator)
            method = cheapest(system.n_b, len(functions)) if adjoint else DirectDifferentiation()
        require_kind(
            "method", method, (GradientMethod,), "For example Adjoint() or DirectDifferentiation()."
        )
        self._run, self._method = Run(system, t_end, integrator), method
        self._functions, self._scale = dict(functions), _scale(scale, system.n_b)
        self._limits = design_bounds(system, design)
        # Whether a run that is there can be differentiated: then values go without derivatives.
        self._asked = False
        self._resumes = method.takes_runs and integrator.differentiates_runs
        self.names, self.design_names = tuple(functions), tuple(system.design_names)
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
        """The model as it stands, in x, shape (n_b,)."""
        return np.asarray(self._run.system.b / self._scale, dtype=float)

    @property
    def bounds(self) -> scipy.optimize.Bounds:
        """Bounds of the design variables, in x; infinite where there are none."""
        return scipy.optimize.Bounds(*(limit / self._scale for limit in self._limits))

    @property
    def history(self) -> Sweep:
        """Every design that was run, in that order, with its values by name or its error."""
        rows = [
            replace(row, result=dict(zip(self.names, row.result.tolist(), strict=True)))
            if row.finished
            else row
            for row in self._designs.rows
        ]
        return Sweep(tuple(rows))

    def __getitem__(self, name: str) -> Response:
        """Return one of the functions."""
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
        """Return the values of all functions, shape (m,); infinite where the design has none."""
        return self.at(x, derivatives=False).values.copy()

    def jacobian(self, x: Array) -> Array:
        """Return their derivatives in x, shape (m, n_b); NaN where the design has no values."""
        matrix = self.at(x).jacobian
        assert matrix is not None  # asked for
        return matrix.copy()

    def solution(self, x: Array) -> Solution:
        """Return the run at x; raises the error of a design that has none."""
        return self._designs.result(x)[1]

    def __repr__(self) -> str:
        """Return the functions and what was run."""
        lines = f"Responses: {', '.join(self.names)}; {len(self._designs.rows)} designs run"
        return f"{lines}\n{self.history}" if self._designs.rows else lines

    def at(self, x: Array, *, derivatives: bool = True) -> Evaluation:
        """Return the result at the design x; without `derivatives` perhaps its values only."""
        return self._designs.at(x, derivatives=derivatives)

    def _computed(
        self, b: Array, derivatives: bool, ran: tuple[Run, Solution] | None
    ) -> tuple[Array, Array | None, tuple[Run, Solution]]:
        """Return values and derivatives at a design, by a new run or by the given one."""
        self._asked = self._asked or derivatives
        run, solution = ran or (self._run.at(b), None)
        functions = list(self._functions.values())
        if not derivatives and (self._resumes or not self._asked):
            solution, values = run.values(functions)
            return values, None, (run, solution)
        after = solution if self._resumes else None
        answers = self._method.gradients(replace(run, after=after), functions)
        values = np.array([each.value for each in answers])
        jacobian = np.array([each.gradient for each in answers])
        return values, jacobian, (run, answers[0].solution)


@final
@dataclass(frozen=True)
class Response:
    """One function of the design: a call returns its value, `gradient` its gradient.

    The sign is that of its change towards a design that has no value.
    """

    responses: Responses
    index: int
    sign: float = 1.0

    def __call__(self, x: Array) -> float:
        """Return the value at x; of derivatives nothing is computed."""
        evaluation = self.responses.at(x, derivatives=False)
        if evaluation.error is not None:
            return self._beyond(evaluation)[0]
        return float(evaluation.values[self.index])

    def gradient(self, x: Array) -> Array:
        """Return the gradient in x, shape (n_b,)."""
        evaluation = self.responses.at(x)
        if evaluation.error is not None:
            return self._beyond(evaluation)[1]
        assert evaluation.jacobian is not None  # asked for
        return np.array(evaluation.jacobian[self.index])

    def _beyond(self, evaluation: Evaluation) -> tuple[float, Array]:
        """Return substitutes for value and gradient of a design without a result."""
        assert evaluation.near is not None  # of every design with an error
        near, k = self.responses.at(evaluation.near), self.index
        if near.error is not None:
            raise near.error
        assert near.jacobian is not None  # asked for
        d = evaluation.x - near.x
        r = self.sign * np.linalg.norm(near.jacobian[k]) * np.linalg.norm(d)
        return float(near.values[k] + r), 3 * r * d / (d @ d)


def _scale(scale: object, n_b: int) -> Array:
    """Return the scales of all design variables, shape (n_b,)."""
    given = require_array("scale", scale)
    if given.shape not in ((), (n_b,)) or not np.all(given > 0):
        rule = f"must be positive, one number or one for each of {n_b} design variables"
        raise InvalidInputError("scale", rule, repr(scale), "For example np.abs(system.b).")
    return np.broadcast_to(given, n_b)
