"""IDAS of SUNDIALS (sundials4py): staggered forward sensitivities, and the adjoint.

Forward: the stabilised index-2 or the index-1 form with `IDASensInit` in the staggered mode and the
sensitivities in the error test, so that every design variable costs one more solve with the matrix
of the states.

Adjoint of a run (IDAA): forward with checkpoints, then backward. The backward problem is the
adjoint of the index-1 form, where a and lam are functions of (q, v, b, t). With the adjoint vectors
p_q, p_v of q and v, the objective int H(q, v, lam) dt, and on_q, on_v and on_b the results of
`AccelerationsAdjoint` for p_v on a and H_lam on lam,

    p_q' = -on_q - H_q,    p_v' = -p_q - on_v - H_v,

and the gradient is int (on_b) dt + p_q(0) q_b(0) + p_v(0) v_b(0). A value at one time adds its
partials to p_q and p_v there, that in lam through the same pull-back: the backward run is started
again. It is scaled so that its tolerances are pure numbers: with P the sum of the sizes of the
objective's partials,

    y = [p_q S_q, p_v S_v] / P,        quadrature  on_b b / P.
"""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.outcomes import PassFailed, Verdict
from ancfdae.integrators.high_order import HighOrder, March, NotFinite, pace
from ancfdae.integrators.integrator import AdjointIntegrator, Seeds
from ancfdae.integrators.problem import InitialValueProblem, stacked
from ancfdae.integrators.quadrature import Quadrature
from ancfdae.integrators.start import AccelerationsAdjoint, InitialState
from ancfdae.integrators.sundials.bindings import Bindings, IdasEquations, verdict
from ancfdae.integrators.sundials.index_reduced import IndexReduced, StepPoints, SundialsIntegrator
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import TimeGrid, next_end

# Number of steps between two checkpoints; IDAS stores the states between them in memory.
_CHECKPOINT = 250
_SMALL = 1e-2


@final
class AdjointSeeds:
    """Partial derivatives of an objective in the states: at output times, and in integrands."""

    def __init__(self, problem: InitialValueProblem, solution: Solution, seeds: Seeds) -> None:
        system, s = problem.system, problem.scales
        self._densities = seeds.densities
        sizes = (system.n_q, system.n_q, system.n_lam)
        given = (seeds.q, seeds.v, seeds.lam)
        self.rows = [
            np.zeros((len(solution.t), n)) if x is None else x
            for x, n in zip(given, sizes, strict=True)
        ]
        used = np.any(np.concatenate(self.rows, axis=1) != 0, axis=1)
        self.instants = [int(i) for i in np.flatnonzero(used)]
        weights = TimeGrid(solution.t, solution.degree).weights()[:, None]
        over_time = self.density(solution.t, solution.q, solution.v, solution.lam)
        scaled = zip(self.rows, over_time, (s.q, s.v, s.lam), strict=True)
        self.size = sum(
            float(np.sum(np.linalg.norm(np.hstack([x, weights * H]) * np.tile(scale, 2), axis=1)))
            for x, H, scale in scaled
        )

    def density(self, t: Array, q: Array, v: Array, lam: Array) -> list[Array]:
        """Return summed partials H_q, H_v, (k, n_q), and H_lam, (k, n_lam), of the integrands."""
        total = [np.zeros((len(t), x.shape[1])) for x in self.rows]
        for weight, density in self._densities:
            for H, partial in zip(total, density.partials(t, q, v, lam), strict=True):
                H += weight * partial
        return total


@final
class BackwardRun:
    """The backward run of IDAS for the adjoint of one objective."""

    def __init__(
        self,
        bindings: Bindings,
        problem: InitialValueProblem,
        form: IndexReduced,
        settings: HighOrder,
        solution: Solution,
        seeds: Seeds,
    ) -> None:
        self._bindings, self._problem, self._form = bindings, problem, form
        self._rtol, self._max_steps = settings.rtol, settings.max_steps
        self._solution, self._t_end = solution, float(solution.t[-1])
        self._pace, self._calls = pace(self._t_end, settings.max_steps), 0
        self._seeds = AdjointSeeds(problem, solution, seeds)
        s, size = problem.scales, self._seeds.size or 1.0
        self._scale, self._b_scale = np.concatenate([s.q, s.v]) / size, s.b / size
        self._n, self._breakpoints = len(self._scale), problem.system.breakpoints(self._t_end)
        self._which: int | None = None
        self._y: Any = None
        self._yp: Any = None
        self._quadrature: Any = None

    def gradient(self) -> Array:
        """Return the gradient, (n_b,), without the explicit partial in b; may raise PassFailed."""
        p, on_b = np.zeros(self._n), np.zeros(self._problem.system.n_b)
        if self._seeds.size == 0.0 or len(on_b) == 0:
            return on_b
        self._forward()
        t = self._t_end
        for instant in reversed(self._seeds.instants):
            time = float(self._solution.t[instant])
            p, share = self._back(t, time, p)
            jump, jump_b = self._jump(instant)
            p, on_b, t = p + jump, on_b + share + jump_b, time
        p, share = self._back(t, 0.0, p)
        derivative, n_q = self._problem.derivative, self._problem.system.n_q
        assert derivative is not None
        gradient: Array = on_b + share
        return gradient + p[:n_q] @ derivative.q_b + p[n_q:] @ derivative.v_b

    # -- forward -------------------------------------------------------------------------------

    def _forward(self) -> None:
        bindings, idas = self._bindings, self._bindings.idas
        start = self._form.start(self._problem.initial)
        self._equations = e = IdasEquations(bindings, self._form, self._rtol, start)
        self._memory = e.memory
        bindings.check(idas.IDAAdjInit(self._memory, _CHECKPOINT, idas.IDA_HERMITE))
        bindings.check(idas.IDASetMaxNumSteps(self._memory, self._max_steps))
        t = 0.0
        while t < self._t_end:
            t = next_end(self._breakpoints, t, self._t_end)
            bindings.check(idas.IDASetStopTime(self._memory, t))
            flag, _, _ = idas.IDASolveF(self._memory, t, e.y, e.yp, idas.IDA_NORMAL)
            e.guard.raise_kept()
            if flag < 0:
                raise PassFailed(verdict(flag))

    # -- backward ------------------------------------------------------------------------------

    def _back(self, t: float, stop: float, p: Array) -> tuple[Array, Array]:
        """Integrate the adjoint vector p from t back to `stop`; return it and int on_b dt."""
        total = np.zeros(self._problem.system.n_b)
        while t - stop > 1e-12 * self._t_end:
            before = [t - x for x in self._breakpoints]
            end = t - next_end(before, 0.0, t - stop)
            p, share = self._back_smoothly(t, end, p)
            total, t = total + share, end
        return p, total

    def _back_smoothly(self, t: float, stop: float, p: Array) -> tuple[Array, Array]:
        """Integrate as `_back` does, over a time span without a breakpoint of a law."""
        bindings, idas, check = self._bindings, self._bindings.idas, self._bindings.check
        y = p * self._scale
        yp = self._rates(t, *self._states_at_instant(t), p)[0] * self._scale
        self._set_up(t, y, yp)
        flag = idas.IDASolveB(self._memory, stop, idas.IDA_NORMAL)
        self._equations.guard.raise_kept()
        if flag < 0:
            raise PassFailed(verdict(flag))
        check(idas.IDAGetB(self._memory, self._which, self._y, self._yp)[0])
        check(idas.IDAGetQuadB(self._memory, self._which, self._quadrature)[0])
        p = bindings.array(self._y) / self._scale
        return p, bindings.array(self._quadrature) / self._b_scale

    def _set_up(self, t: float, y: Array, yp: Array) -> None:
        bindings, idas, check = self._bindings, self._bindings.idas, self._bindings.check
        core, context = bindings.core, self._equations.context
        call = self._equations.guard.callback
        if self._which is not None:
            for vector, values in ((self._y, y), (self._yp, yp), (self._quadrature, 0.0)):
                bindings.array(vector)[:] = values
            check(idas.IDAReInitB(self._memory, self._which, t, self._y, self._yp))
            check(idas.IDAQuadReInitB(self._memory, self._which, self._quadrature))
            return
        flag, which = idas.IDACreateB(self._memory)
        check(flag)
        self._which = which
        self._y, self._yp = bindings.vector(context, y), bindings.vector(context, yp)
        self._quadrature = bindings.vector(context, np.zeros(self._problem.system.n_b))
        check(idas.IDAInitB(self._memory, which, call(self._residual), t, self._y, self._yp))
        atol = _SMALL * self._rtol
        check(idas.IDASStolerancesB(self._memory, which, self._rtol, atol))
        check(idas.IDASetMaxNumStepsB(self._memory, which, self._max_steps))
        self._matrix = core.SUNDenseMatrix(self._n, self._n, context)
        self._solver = core.SUNLinSol_Dense(self._y, self._matrix, context)
        check(idas.IDASetLinearSolverB(self._memory, which, self._solver, self._matrix))
        check(idas.IDASetJacFnB(self._memory, which, call(self._jacobian)))
        check(idas.IDAQuadInitB(self._memory, which, call(self._integrand), self._quadrature))
        check(idas.IDAQuadSStolerancesB(self._memory, which, self._rtol, atol))
        check(idas.IDASetQuadErrConB(self._memory, which, 1))

    def _states_at_instant(self, t: float) -> tuple[Array, Array]:
        k = int(np.argmin(np.abs(self._solution.t - t)))
        return self._solution.q[k], self._solution.v[k]

    def _at(self, t: float, q: Array, v: Array) -> AccelerationsAdjoint:
        system, accelerations = self._problem.system, self._problem.accelerations
        state = InitialState(t, q, v, *accelerations.solve(t, q, v))
        return AccelerationsAdjoint(system, accelerations.factors(t, q), state)

    def _rates(self, t: float, q: Array, v: Array, p: Array) -> tuple[Array, Array]:
        """Return the rates of the adjoint vector p, (2 n_q,), and of the gradient, (n_b,)."""
        at, n_q = self._at(t, q, v), self._problem.system.n_q
        densities = self._seeds.density(np.array([t]), q[None], v[None], at.state.lam[None])
        H_q, H_v, H_lam = (H[0] for H in densities)
        on_q, on_v, on_b = at.pull_back(p[n_q:], H_lam)
        return np.concatenate([-on_q - H_q, -p[:n_q] - on_v - H_v]), on_b

    def _jump(self, instant: int) -> tuple[Array, Array]:
        """Return the jumps of the adjoint vector p and of the gradient at output time `instant`."""
        q, v, t = (x[instant] for x in (self._solution.q, self._solution.v, self._solution.t))
        on_q, on_v, on_lam = (x[instant] for x in self._seeds.rows)
        *through, on_b = self._at(float(t), q, v).pull_back(np.zeros_like(on_q), on_lam)
        return np.concatenate([on_q, on_v]) + np.concatenate(through), on_b

    def _residual(self, t: float, y: Any, yp: Any, z: Any, zp: Any, R: Any, _: Any) -> None:
        array = self._bindings.array
        rates, _ = self._rates(t, *self._form.coordinates(array(y)), array(z) / self._scale)
        value = array(zp) - rates * self._scale
        if not finite(value):
            raise NotFinite
        array(R)[:] = value

    def _integrand(self, t: float, y: Any, yp: Any, z: Any, zp: Any, out: Any, _: Any) -> None:
        array = self._bindings.array
        # IDAS calls this once or twice a step; its own limit counts from checkpoint to checkpoint.
        self._calls += 1
        verdict, limit = self._pace.ends_run(self._t_end - t), 2 * self._max_steps
        if verdict or self._calls > limit:
            raise PassFailed(verdict or Verdict.STEP_LIMIT)
        _, on_b = self._rates(t, *self._form.coordinates(array(y)), array(z) / self._scale)
        array(out)[:] = -on_b * self._b_scale  # Backward in time the integral counts negative.

    def _jacobian(
        self, t: float, c_j: float, y: Any, yp: Any, z: Any, zp: Any, R: Any, J: Any, *_: Any
    ) -> None:
        n_q = self._problem.system.n_q
        q, v = self._form.coordinates(self._bindings.array(y))
        on_q, on_v = self._at(t, q, v).matrices()
        rates = -np.block([[np.zeros((n_q, n_q)), on_q], [np.eye(n_q), on_v]])
        scaled = rates * self._scale[:, None] / self._scale
        self._bindings.core.SUNDenseMatrix_Data(J)[:] = c_j * np.eye(2 * n_q) - scaled


@final
@dataclass(frozen=True, repr=False)
class IDAS(SundialsIntegrator, AdjointIntegrator):
    """Variable-order BDF of SUNDIALS with the sensitivity analysis of IDAS.

    Needs the package sundials4py (Python 3.12 or newer) when it runs, or raises
    MissingPackageError. Parameters: see `HighOrder`, and `IndexReduction` for `form`.
    """

    def start(self, problem: InitialValueProblem, t_end: float, quadrature: Quadrature) -> March:
        """Set up a run by IDAS from the consistent start of the system."""
        return _IdasMarch(Bindings.load(), self, problem, t_end, quadrature)

    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient of an objective, (n_b,), by the adjoint with checkpoints (IDAA)."""
        t_end = float(solution.t[-1])
        problem = InitialValueProblem.of(system, t_end).differentiated()
        form = self.form.form(system, problem.scales)
        return BackwardRun(Bindings.load(), problem, form, self, solution, seeds).gradient()


@final
class _IdasMarch(March):
    """One forward run of IDAS, with sensitivities if the problem is differentiated."""

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

    def _steps(self, times: Array) -> list[float] | Verdict:
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
        """Return copies of y and y' after a step to t, with their sensitivities appended."""
        array = self._bindings.array
        y, yp = (array(x).copy() for x in (self._equations.y, self._equations.yp))
        if self._m == 0:
            return y, yp
        Y, Yp = self._sensitivities(t, 0), self._sensitivities(t, 1)
        return np.append(y, Y), np.append(yp, Yp)

    def _sensitivities(self, t: float, k: int) -> Array:
        """Return k-th time derivatives of the m scaled sensitivities at time t, shape (m, n)."""
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
