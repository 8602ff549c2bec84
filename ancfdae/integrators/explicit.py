"""Explicit Runge-Kutta of order 8 (DOP853, Hairer, Norsett & Wanner) on the index-1 form.

    q' = v,   v' = a(t, q, v),   q_b' = v_b,   v_b' = a_b(t, q, v, q_b, v_b)

with (a, lam) and (a_b, lam_b) from one factorised matrix per stage, which is one for the whole run
where M and Phi_q are constant. What positions, velocities and their derivatives drift from the
constraints is removed after each step and from the instants (`projection`).

The stages of a step make a quadrature of order 8 for functions of the states, with the error
estimate of the method; where that says that they are too few for an integrand, points within the
step come from its dense output.

The solver runs in the time s = t / t_end from 0 to 1: SciPy's guess of the first step contains
times in seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, final

import numpy as np
import scipy

from ancfdae.errors import SingularMatrix, Verdict
from ancfdae.integrators.high_order import HighOrder, March, NotFinite
from ancfdae.integrators.index_1 import State, project
from ancfdae.integrators.integrand import Points, Rule
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.quadrature import KRONROD, SHARES, Quadrature
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array

# SciPy raises smaller ones to 100 eps with a warning.
_LEAST_RTOL = 3e-14
# Absolute tolerance relative to the scales, per unit of rtol.
_SMALL = 1e-2
# Panels of a step whose stages are too few.
_PANELS = (1, 4, 16)
# Steps that are taken into the integrals together: an evaluation of observables costs half a step.
# Where stages are too few, these steps are repeated, and the next ones keep their dense output.
_TOGETHER = 8


@final
@dataclass(frozen=True)
class Explicit(HighOrder):
    """Explicit integration of order 8 with error control; for soft scenes.

    The step is bounded by the highest frequency, so stiff scenes need many steps; a small system
    takes 1,000 in a second. Parameters: see `HighOrder`.
    """

    def __post_init__(self) -> None:
        self.require_settings(_LEAST_RTOL)

    def start(self, problem: Problem, t_end: float, quadrature: Quadrature) -> March:
        """Set up DOP853."""
        return _ExplicitMarch(self, problem, t_end, quadrature)


@cache
def _stages() -> tuple[Array, Rule]:
    """Return which stages carry weight, the first is the state before, and their quadrature."""
    method = scipy.integrate.DOP853
    used = np.flatnonzero(method.B)
    return used, Rule(method.B[used], method.E5[used], method.E3[used])


class _Stage(NamedTuple):
    """A vector at which the rate was evaluated, with the multipliers there."""

    s: float
    y: Array
    lam: Array
    lam_b: Array | None


class _Step(NamedTuple):
    """A step from left to right, the vector before it, and its stages that carry weight."""

    left: float
    right: float
    y: Array
    stages: list[_Stage]
    between: scipy.integrate.DenseOutput | None


@final
class _ExplicitMarch(March):
    """One run; the vector y holds q and all q_b as rows, then v and all v_b, scaled."""

    def __init__(
        self, settings: Explicit, problem: Problem, t_end: float, quadrature: Quadrature
    ) -> None:
        super().__init__(t_end, settings.max_steps)
        self._quadrature, self._stages = quadrature, list[_Stage]()
        self._problem, self._trouble = problem, Verdict.ERROR_TEST
        system, s, b = problem.system, problem.scales, problem.derivative
        self._m = 0 if b is None else system.n_b
        own = np.stack([s.q, s.v])[:, None]
        self._size = np.concatenate([own, own / s.b[: self._m, None]], axis=1)
        first = problem.initial
        start = State(first.q, first.v, *(b or ())[:2])
        self._between: scipy.integrate.DenseOutput | None = None
        self._rtol, self._steps, self._dense = settings.rtol, list[_Step](), False
        self._solver = self._new_solver(0.0, self._vector(start), 1.0)
        self._first = self._stages[0]

    def _step(self) -> Verdict | None:
        solver, y = self._solver, self._solver.y
        self._trouble = Verdict.ERROR_TEST
        self._stages.clear()
        solver.step()
        if solver.status == "failed":
            return self._trouble
        self.steps += 1
        self._t, self._between = solver.t * self._t_end, None
        self._accept(y)
        return None

    def _state(self, t: float) -> State:
        solver, s = self._solver, t / self._t_end
        if solver.t == s:
            return self._point(solver.y)
        if self._between is None:
            self._between = solver.dense_output()
        return self._projected(s, self._between(s))

    def _accept(self, y: Array) -> None:
        """Project the end of a step from y, and keep its stages for the integrals."""
        solver = self._solver
        # The last twelve evaluations: stages 1 to 11, and the state after the step.
        stages = [self._first, *self._stages[-12:]]
        if self._problem.system.n_lam:
            solver.y = self._vector(self._projected(solver.t, solver.y))
            solver.f = self._rate(solver.t, solver.y)
        self._first = self._stages[-1]
        if not self._quadrature.wanted:
            return
        if self._dense:
            self._between = solver.dense_output()
        used = [stages[i] for i in _stages()[0]]
        self._steps.append(_Step(solver.t_old, solver.t, y, used, self._between))
        if len(self._steps) == _TOGETHER:
            self.finish()

    def finish(self) -> None:
        self._dense = False
        if self._steps:
            self._quadrature.add(self._choices(self._steps))
            self._steps = []

    def _choices(self, steps: list[_Step]) -> Iterator[Points]:
        """Points within steps: their stages, then their dense output on ever more panels."""
        h = np.array([x.right - x.left for x in steps]) * self._t_end
        used = [stage for x in steps for stage in x.stages]
        s, y = np.array([x.s for x in used]), np.array([x.y for x in used])
        points = self._points(_stages()[1], h, s, y)
        lam_b = [x.lam_b for x in used if x.lam_b is not None]
        yield replace(
            points, lam=np.array([x.lam for x in used]), lam_b=np.array(lam_b) if lam_b else None
        )
        self._dense = True
        dense = [x.between or self._repeated(x) for x in steps]
        for n in _PANELS:
            shares = (np.arange(n)[:, None] + SHARES).ravel() / n
            within = [np.minimum(x.left + shares * (x.right - x.left), x.right) for x in steps]
            rows = [between(times).T for between, times in zip(dense, within, strict=True)]
            yield self._points(
                KRONROD, np.repeat(h / n, n), np.concatenate(within), np.concatenate(rows)
            )

    def _repeated(self, step: _Step) -> scipy.integrate.DenseOutput:
        """Return the dense output of a step that was accepted before."""
        solver = self._new_solver(step.left, step.y, step.right, step.right - step.left)
        solver.step()
        return solver.dense_output()

    def _new_solver(
        self, s: float, y: Array, end: float, first: float | None = None
    ) -> scipy.integrate.DOP853:
        rtol = self._rtol
        atol = _SMALL * rtol
        return scipy.integrate.DOP853(self._rate, s, y, end, first_step=first, rtol=rtol, atol=atol)

    def _vector(self, point: State) -> Array:
        rows = np.empty(self._size.shape)
        rows[0, 0], rows[1, 0] = point.q, point.v
        if point.q_b is not None and point.v_b is not None:
            rows[0, 1:], rows[1, 1:] = point.q_b.T, point.v_b.T
        rows /= self._size
        return rows.ravel()

    def _point(self, y: Array) -> State:
        x = y.reshape(self._size.shape) * self._size
        q, v = x[0, 0], x[1, 0]
        return State(q, v) if self._m == 0 else State(q, v, x[0, 1:].T, x[1, 1:].T)

    def _points(self, rule: Rule, h: Array, s: Array, y: Array) -> Points:
        x = y.reshape(-1, *self._size.shape) * self._size
        q, v = x[:, 0], x[:, 1]
        own = (q[:, 1:].swapaxes(1, 2), v[:, 1:].swapaxes(1, 2)) if self._m else ()
        return Points(rule, h, s * self._t_end, q[:, 0], v[:, 0], *own)

    def _projected(self, s: float, y: Array) -> State:
        if not finite(y):
            raise NotFinite
        problem, t = self._problem, s * self._t_end
        return project(problem.system, problem.accelerations, t, self._point(y))

    def _rate(self, s: float, y: Array) -> Array:
        """Return dy/ds; NaN if there is none, from which the solver tries a shorter step."""
        self.residuals += 1
        try:
            return self._finite_rate(s, y)
        except NotFinite:
            self._trouble = Verdict.NOT_FINITE
        except SingularMatrix:
            self._trouble = Verdict.SINGULAR
        return np.full_like(y, np.nan)

    def _finite_rate(self, s: float, y: Array) -> Array:
        if not finite(y):
            raise NotFinite
        t, x, accelerations = s * self._t_end, self._point(y), self._problem.accelerations
        a, lam = accelerations.solve(t, x.q, x.v)
        rate, lam_b = State(x.v, a), None
        if x.q_b is not None and x.v_b is not None:
            a_b, lam_b = accelerations.solve_b(t, (x.q, x.v, a, lam), x.q_b, x.v_b)
            rate = State(x.v, a, x.v_b, a_b)
        vector = self._vector(rate) * self._t_end
        if not finite(vector):
            raise NotFinite
        self._stages.append(_Stage(s, y, lam, lam_b))
        return vector
