"""IDAS of SUNDIALS (sundials4py): staggered forward sensitivities, and the adjoint.

Forward: the stabilised index-2 or the index-1 form with `IDASensInit` in the staggered mode and
the sensitivities in the error test, so that every design variable costs one more solve with the
matrix of the states. Backward: see `idas_adjoint`.
"""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.high_order import March, NotFinite
from ancfdae.integrators.index_1 import stacked
from ancfdae.integrators.integrator import AdjointIntegrator, Seeds
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.quadrature import Quadrature
from ancfdae.integrators.sundials.bindings import Bindings, IdasEquations, verdict
from ancfdae.integrators.sundials.idas_adjoint import BackwardRun
from ancfdae.integrators.sundials.index_reduced import SundialsIntegrator
from ancfdae.integrators.sundials.step_points import StepPoints
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True, repr=False)
class IDAS(SundialsIntegrator, AdjointIntegrator):
    """Variable-order BDF of SUNDIALS with its own sensitivity analysis.

    Needs the package sundials4py (Python 3.12 or newer) when it runs, or raises
    MissingPackageError. Parameters: `form`, and those of `HighOrder`.
    """

    def start(self, problem: InitialValueProblem, t_end: float, quadrature: Quadrature) -> March:
        """Set up a run by IDAS from the start of the system."""
        return _IdasMarch(Bindings.load(), self, problem, t_end, quadrature)

    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient of an objective by the adjoint with checkpoints."""
        t_end = float(solution.t[-1])
        problem = InitialValueProblem.of(system, t_end).differentiated()
        form = self.form.form(system, problem.scales)
        return BackwardRun(Bindings.load(), problem, form, self, solution, seeds).gradient()


@final
class _IdasMarch(March):
    """One forward run of IDAS."""

    def __init__(
        self,
        bindings: Bindings,
        settings: IDAS,
        problem: InitialValueProblem,
        t_end: float,
        quadrature: Quadrature,
    ) -> None:
        super().__init__(problem, t_end, settings.max_steps)
        self._bindings, self._rtol = bindings, settings.rtol
        self._form = settings.form.form(problem.system, problem.scales)
        start = self._form.start(problem.initial)
        equations = IdasEquations(bindings, self._form, settings.rtol, start)
        self._equations, self._memory = equations, equations.memory
        self._out = bindings.vector(equations.context, np.zeros(self._form.n))
        Y = Yp = np.zeros((self._form.n, 0))
        if problem.derivative is not None:
            Y, Yp = self._form.start_b(problem.derivative)
        self._m = Y.shape[1]
        if self._m:
            self._add_sensitivities(Y, Yp)
        self._points = StepPoints(self._form, quadrature, self._m)
        self._points.add(0.0, np.append(start[0], Y.T), np.append(start[1], Yp.T))

    def _steps(self, target: float) -> list[float] | Verdict:
        idas, e = self._bindings.idas, self._equations
        self._bindings.check(idas.IDASetStopTime(self._memory, self._stop))
        flag, reached = idas.IDASolve(self._memory, self._t_end, e.y, e.yp, idas.IDA_ONE_STEP)
        self._count()
        not_finite = e.guard.raise_kept()
        if flag < 0:
            return Verdict.NOT_FINITE if not_finite else verdict(flag)
        if self._points.wanted:
            self._points.add(reached, *self._reached(reached))
        return [reached]

    def _states(self, times: Array) -> Array:
        return np.array([self._state(t) for t in times.tolist()])

    def _state(self, t: float) -> Array:
        self._bindings.check(self._bindings.idas.IDAGetDky(self._memory, t, 0, self._out))
        y = self._bindings.array(self._out)
        if not finite(y):
            raise NotFinite
        q, v = self._form.coordinates(y)
        if self._m == 0:
            return stacked(q, v)
        return stacked(q, v, *self._form.coordinates_b(self._sensitivities(t, 0).T))

    def finish(self) -> None:
        self._points.finish()

    def _reached(self, t: float) -> tuple[Array, Array]:
        """Return copies of y and y' after a step to t, their sensitivities appended."""
        array = self._bindings.array
        y, yp = (array(x).copy() for x in (self._equations.y, self._equations.yp))
        if self._m == 0:
            return y, yp
        Y, Yp = self._sensitivities(t, 0), self._sensitivities(t, 1)
        return np.append(y, Y), np.append(yp, Yp)

    def _sensitivities(self, t: float, k: int) -> Array:
        """Time derivatives of order k of the sensitivities, shape (m, n)."""
        rows = np.empty((self._m, self._form.n))
        for i, row in enumerate(rows):
            self._bindings.check(
                self._bindings.idas.IDAGetSensDky1(self._memory, t, k, i, self._out)
            )
            row[:] = self._bindings.array(self._out)
        return rows

    def _add_sensitivities(self, Y: Array, Yp: Array) -> None:
        bindings, idas, context = self._bindings, self._bindings.idas, self._equations.context
        tolerances = self._form.tolerances(self._rtol)
        # IDAS keeps references to the vectors, not the vectors.
        self._Y = [bindings.vector(context, column) for column in Y.T]
        self._Yp = [bindings.vector(context, column) for column in Yp.T]
        self._atol = [bindings.vector(context, tolerances) for _ in range(self._m)]
        check, residual = bindings.check, self._equations.guard.callback(self._residual_b)
        vectors = self._Y, self._Yp
        check(idas.IDASensInit(self._memory, self._m, idas.IDA_STAGGERED, residual, *vectors))
        check(idas.IDASensSVtolerances(self._memory, self._rtol, self._atol))
        check(idas.IDASetSensErrCon(self._memory, 1))

    def _residual_b(
        self, m: int, t: float, y: Any, yp: Any, R: Any, Y: Any, Yp: Any, RY: Any, *_: Any
    ) -> None:
        array = self._bindings.array
        columns, rates = (np.stack([array(x) for x in X], axis=1) for X in (Y, Yp))
        values = self._form.residual_b(t, array(y), array(yp), columns, rates)
        if not finite(values):
            raise NotFinite
        for i, vector in enumerate(RY):
            array(vector)[:] = values[:, i]

    def _count(self) -> None:
        idas, memory = self._bindings.idas, self._memory
        self.steps = idas.IDAGetNumSteps(memory)[1]
        self.residuals = idas.IDAGetNumResEvals(memory)[1]
        self.iterations = idas.IDAGetNumNonlinSolvIters(memory)[1]
        self.factorisations = idas.IDAGetNumLinSolvSetups(memory)[1]
        self.residual = self._equations.last
