"""A step of Radau IIA: of the motion and, if asked for, of its design derivatives.

The stages meet the constraints of positions. What velocities V miss of theirs, O(h^3), is removed
at every stage, and accelerations and multipliers follow from positions and velocities:

    M (v - V) + Phi_q^T sigma = 0,    Phi_q v = nu
    M a + Phi_q^T lam = Q,            Phi_q a = gamma.

So a step goes on from q and v, and all of q, v, a, lam have the order of the method at its end.

**Error of a step.** The embedded formula of order 3, filtered by the real matrix (Hairer & Wanner,
IV.8). With a_0 of the state before, e its weights and k = gamma, all in the scaled displacements x,

    r_q = h sum e_i x_i,    r_v = a_0 + sum (e^T A^-1)_i x_i
    [k^2 M + h k f_v + h^2 f_q   Phi_q^T] [dq]   [h^2 (M (r_v + k r_q/h) + f_v r_q)]
    [Phi_q                       0      ] [. ] = [0                                ],
    dv = k dq/h - r_q.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple, final

import numpy as np

from ancfdae.equations.held import acceleration_side
from ancfdae.equations.saddle_points import solve
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.radau.linear_passes import LinearSteps
from ancfdae.integrators.radau.newton import Solved, StageSolver
from ancfdae.integrators.radau.stages import Begin, StageMatrices
from ancfdae.integrators.radau.tableau import (
    BUTCHER,
    EMBEDDED,
    GAMMA,
    INVERSE,
    PLACES,
    at_stages,
    continued,
)
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.step_control.contracts import Failure, OneStepMethod, Record
from ancfdae.integrators.step_control.tolerance import Tolerance
from ancfdae.numerics.arrays import Array

# Parts of a run, each an eighth of the one before, that a first step is tried with.
_FIRST, _SHRINK = 1 / 20, 1 / 8


class State(NamedTuple):
    """What a step leaves: its size, and its start, stages and end as rows; the start of a run one.

    Derivatives q_b, v_b, a_b, lam_b have rows alike. Estimates are of q and v, and of q_b and v_b.
    """

    h: float
    rows: tuple[Array, Array, Array, Array, Array]
    derivatives: tuple[Array, ...] = ()
    estimate: tuple[Array, ...] = ()


@final
class Stepper(OneStepMethod[State]):
    """Takes the steps of a run, with derivatives where those of the start are given.

    Tolerances are those of positions and of velocities; none where nothing controls the error.
    """

    order: ClassVar[int] = 3

    def __init__(
        self,
        problem: Problem,
        newton: tuple[float, int],
        tolerances: tuple[Tolerance, ...],
        recorder: Recorder,
    ) -> None:
        self._problem, self._recorder, self._tolerances = problem, recorder, tolerances
        self._solver = StageSolver(problem, *newton, recorder)
        self._matrices = None if problem.derivative is None else StageMatrices(problem)

    def consistent(self) -> Record:
        """Return the start."""
        return *self._problem.initial, self._problem.derivative or ()

    def start(self, h: float) -> State:
        """Return the start, whatever the step."""
        t, *states = self._problem.initial
        q, v, a, lam = (x[None] for x in states)
        derivatives = tuple(x[None] for x in self._problem.derivative or ())
        return State(h, (np.array([t]), q, v, a, lam), derivatives)

    def resized(self, state: State, ratio: float) -> State:
        """Return the state, which serves any step."""
        return state

    def recorded(self, state: State) -> Record:
        """Return the stages, of which the last one is the end."""
        t, q, v, a, lam = (x[1:] for x in state.rows)
        return t, q, v, a, lam, tuple(x[1:] for x in state.derivatives)

    def advance(self, h: float, before: State, t: float) -> State | Failure:
        """Solve the equations of the step to t."""
        t_0, q, v, a, lam = (x[-1] for x in before.rows)
        begin = Begin(float(t_0), q, v, h)
        multipliers = np.tile(lam, (3, 1))
        still = np.multiply.outer(PLACES[:, 0] ** 2 / 2, a)
        guess = still
        if len(before.rows[0]) > 1:
            guess = at_stages(BUTCHER, continued(before.rows[2], h / before.h) - v) / h
        found = self._solver.solve(begin, (guess, multipliers))
        if isinstance(found, Failure) and not self._tolerances and guess is not still:
            found = self._solver.solve(begin, (still, multipliers))
        if isinstance(found, Failure):
            return found
        times = np.append(begin.t, begin.times)
        times[-1] = t
        stages = begin.stages(found.x, found.lam)
        ends = zip(times[1:].tolist(), stages.q, stages.v, strict=True)
        columns = zip((q, v, a, lam), zip(*(self._end(*x) for x in ends), strict=True), strict=True)
        rows = (times, *(np.array([first, *after]) for first, after in columns))
        return self._estimated(found, begin, before, State(h, rows))

    def _end(self, t: float, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Complete a position and a velocity that may miss the constraints by velocity, sigma."""
        system, accelerations = self._problem.system, self._problem.accelerations
        before = accelerations.factorisations
        factors = accelerations.factors(t, q)
        self._recorder.factorisations += accelerations.factorisations - before
        v = v - solve(factors, np.zeros_like(v), system.constraint(t, q, v))[0]
        a, lam = solve(factors, system.force(t, q, v), acceleration_side(system, t, q, v))
        return q, v, a, lam

    def _estimated(self, found: Solved, begin: Begin, before: State, after: State) -> State:
        """Add the estimated errors, and derivatives with theirs."""
        if not self._tolerances:
            return after
        estimate = self._embedded(found, begin.h, before.rows[3][-1].real, found.x.real)
        if not before.derivatives:
            return after._replace(estimate=estimate)
        assert self._matrices is not None
        self._recorder.factorisations += 1
        t, *states = (x[None] for x in after.rows)
        steps = LinearSteps.of(self._problem, np.array([begin.h]), t, tuple(states))
        first = [x[-1:] for x in before.derivatives]
        more, x_b = steps.advance(0, self._matrices, first[0][0], first[1][0])
        derivatives = tuple(map(np.concatenate, zip(first, more, strict=True)))
        estimate_b = self._embedded(found, begin.h, first[2][0], x_b)
        return after._replace(derivatives=derivatives, estimate=(*estimate, *estimate_b))

    def _embedded(self, found: Solved, h: float, a: Array, x: Array) -> tuple[Array, Array]:
        """Return dq and dv; columns of derivatives alike."""
        system, local = self._problem.system, found.matrix.local
        r_q = h * at_stages(EMBEDDED, x)[0]
        r_v = a + at_stages(EMBEDDED @ INVERSE, x)[0]
        dot = system.pattern.dot
        right = dot(local.M[0], r_v + GAMMA / h * r_q)
        if local.f_v is not None:
            right = right + dot(local.f_v[0], r_q)
        side = np.zeros((system.n_lam, *right.shape[1:]))
        dq = solve(found.matrix.real, h**2 * right, side)[0]
        return dq, GAMMA / h * dq - r_q

    def error(self, h: float, before: State, after: State) -> float:
        """Return the largest e, of positions, velocities and their derivatives."""
        if not self._tolerances:
            return 0.0
        largest = 0.0
        for k, tolerance in enumerate(self._tolerances):
            size = np.abs(after.rows[1 + k][[0, -1]].real).max(axis=0)
            errors = [tolerance.of_motion(h, after.estimate[k], size)]
            if after.derivatives:
                size_b = np.abs(after.derivatives[k][-1])
                errors.append(tolerance.of_derivatives(h, after.estimate[2 + k], size_b))
            largest = float(np.maximum(largest, np.max(errors)))  # NaN stays.
        return largest

    def start_error(self) -> float:
        """Return e of a first step, tried, for its size; zero if none can be solved."""
        if not self._tolerances:
            return 0.0
        h = self._tolerances[0].t_end * _FIRST
        start = self.start(h)
        for _ in range(8):
            after = self.advance(h, start, h)
            if not isinstance(after, Failure):
                return self.error(h, start, after) / h**self.order
            h *= _SHRINK
        return 0.0
