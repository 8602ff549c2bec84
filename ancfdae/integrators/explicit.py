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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
from scipy.integrate import DOP853, DenseOutput

from ancfdae.errors import SingularMatrix, Verdict
from ancfdae.integrators.high_order import HighOrder, March, NotFinite
from ancfdae.integrators.index_1 import State, project
from ancfdae.integrators.integrand import Points, Rule
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.quadrature import KRONROD, SHARES, Quadrature
from ancfdae.numerics.arrays import Array, is_finite

# SciPy raises smaller ones to 100 eps with a warning.
_LEAST_RTOL = 3e-14
# Absolute tolerance relative to the scales, per unit of rtol.
_SMALL = 1e-2
# Stages that carry weight; the first is the state before the step.
_USED = np.flatnonzero(DOP853.B)
_STAGES = Rule(DOP853.B[_USED], DOP853.E5[_USED], DOP853.E3[_USED])
# Panels of a step whose stages are too few.
_PANELS = (1, 4, 16)
# Steps that are taken into the integrals together: an evaluation of observables costs half a step.
# Where stages are too few, these steps are repeated.
_TOGETHER = 8


@final
@dataclass(frozen=True)
class Explicit(HighOrder):
    """Explicit integration of order 8 with error control; for soft scenes.

    The step is bounded by the highest frequency, so stiff scenes need many steps; a small system
    takes 1,000 in a second. Parameters: see `HighOrder`.
    """

    max_steps: int = 20_000

    def __post_init__(self) -> None:
        self.require_settings(_LEAST_RTOL)

    def start(self, problem: Problem, t_end: float, quadrature: Quadrature) -> March:
        """Set up DOP853."""
        return _ExplicitMarch(self, problem, t_end, quadrature)


class _Stage(NamedTuple):
    """A state at which the rate was evaluated, with its multipliers."""

    t: float
    state: State
    lam: Array
    lam_b: Array | None


class _Step(NamedTuple):
    """A step from left to right, the vector before it, and its stages that carry weight."""

    left: float
    right: float
    y: Array
    stages: list[_Stage]


@final
class _ExplicitMarch(March):
    """One run; the vector y holds the columns (q, v) and (q_b, v_b) of every variable, scaled."""

    def __init__(
        self, settings: Explicit, problem: Problem, t_end: float, quadrature: Quadrature
    ) -> None:
        super().__init__(t_end, settings.max_steps)
        self._quadrature, self._stages = quadrature, list[_Stage]()
        self._problem, self._trouble = problem, Verdict.ERROR_TEST
        system, s, b = problem.system, problem.scales, problem.derivative
        self._m = 0 if b is None else system.n_b
        own = np.concatenate([s.q, s.v])[:, None]
        self._size = np.concatenate([own, own / s.b[: self._m]], axis=1)
        first = problem.initial
        start = State(first.q, first.v, *(b or ())[:2])
        self._between: DenseOutput | None = None
        self._rtol, self._steps = settings.rtol, list[_Step]()
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
        """Keep the stages of a step from y for the integrals, and project its end."""
        solver = self._solver
        # The last twelve evaluations: stages 1 to 11, and the state after the step.
        stages = [self._first, *self._stages[-12:]]
        self._first = stages[-1]
        if self._quadrature.wanted:
            used = [stages[i] for i in _USED]
            self._steps.append(_Step(solver.t_old, solver.t, y, used))
            if len(self._steps) == _TOGETHER:
                self.finish()
        if self._problem.system.n_lam:
            solver.y = self._vector(self._projected(solver.t, solver.y))
            solver.f = self._rate(solver.t, solver.y)
            self._first = self._stages[-1]

    def finish(self) -> None:
        if self._steps:
            self._quadrature.add(self._points(self._steps))
            self._steps = []

    def _points(self, steps: list[_Step]) -> Iterator[Points]:
        """Points within steps: their stages, then their dense output on ever more panels."""
        t_end, h = self._t_end, np.array([x.right - x.left for x in steps]) * self._t_end
        used = [stage for x in steps for stage in x.stages]
        points = _stacked(_STAGES, h, [x.t for x in used], [x.state for x in used])
        lam_b = [x.lam_b for x in used if x.lam_b is not None]
        yield replace(
            points, lam=np.array([x.lam for x in used]), lam_b=np.array(lam_b) if lam_b else None
        )
        dense = [self._repeated(x) for x in steps]
        for n in _PANELS:
            shares, states, times = (np.arange(n)[:, None] + SHARES).ravel() / n, [], []
            for x, between in zip(steps, dense, strict=True):
                s = np.minimum(x.left + shares * (x.right - x.left), x.right)
                states += [self._point(between(each)) for each in s]
                times += list(s * t_end)
            yield _stacked(KRONROD, np.repeat(h / n, n), times, states)

    def _repeated(self, step: _Step) -> DenseOutput:
        """Return the dense output of a step that was accepted before."""
        solver = self._new_solver(step.left, step.y, step.right, step.right - step.left)
        solver.step()
        return solver.dense_output()

    def _new_solver(self, s: float, y: Array, end: float, first: float | None = None) -> DOP853:
        rtol = self._rtol
        return DOP853(self._rate, s, y, end, first_step=first, rtol=rtol, atol=_SMALL * rtol)

    def residual(self) -> float:
        return 0.0  # An explicit step has no equations left over.

    def _vector(self, point: State) -> Array:
        n_q = self._problem.system.n_q
        columns = np.empty(self._size.shape)
        columns[:n_q, 0], columns[n_q:, 0] = point.q, point.v
        if point.q_b is not None and point.v_b is not None:
            columns[:n_q, 1:], columns[n_q:, 1:] = point.q_b, point.v_b
        return np.asarray((columns / self._size).ravel())

    def _point(self, y: Array) -> State:
        n_q = self._problem.system.n_q
        x = y.reshape(self._size.shape) * self._size
        if self._m == 0:
            return State(x[:n_q, 0], x[n_q:, 0])
        return State(x[:n_q, 0], x[n_q:, 0], x[:n_q, 1:], x[n_q:, 1:])

    def _projected(self, s: float, y: Array) -> State:
        if not is_finite(y):
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
        if not is_finite(y):
            raise NotFinite
        t, x, accelerations = s * self._t_end, self._point(y), self._problem.accelerations
        a, lam = accelerations.solve(t, x.q, x.v)
        rate, lam_b = State(x.v, a), None
        if x.q_b is not None and x.v_b is not None:
            a_b, lam_b = accelerations.solve_b(t, (x.q, x.v, a, lam), x.q_b, x.v_b)
            rate = State(x.v, a, x.v_b, a_b)
        vector = self._vector(rate) * self._t_end
        if not is_finite(vector):
            raise NotFinite
        self._stages.append(_Stage(t, x, lam, lam_b))
        return vector


def _stacked(rule: Rule, h: Array, t: Sequence[float] | Array, states: list[State]) -> Points:
    arrays = [
        np.array([getattr(x, name) for x in states])
        for name in (("q", "v") if states[0].q_b is None else ("q", "v", "q_b", "v_b"))
    ]
    return Points(rule, h, np.asarray(t), *arrays)
