"""A step of Radau IIA: the motion and, if requested, its design derivatives.

The stages satisfy the constraints of positions. The violation of constraints by their velocities,
O(h^3), is removed, and accelerations and multipliers follow (`linear_passes`); so a step continues
from q and v.

**Error of a step.** The embedded formula of order 3, filtered by the real matrix (Hairer & Wanner,
IV.8). With a_0 of the state before, e its weights and k = gamma, in the scaled displacements x

    r_q = h sum e_i x_i,    r_v = a_0 + sum (e^T A^-1)_i x_i
    [k^2 M + h k f_v + h^2 f_q   Phi_q^T] [dq]   [h^2 (M (r_v + k r_q/h) + f_v r_q)]
    [Phi_q                       0      ] [. ] = [0                                ],
    dv = k dq/h - r_q,

applied twice, the second time to r_q = k dq/h, r_v = k dv/h: stiff vibrations in a_0 must not pass.
The motion that joints prescribe, across the free directions, is known at the stages, and is not
filtered: with the completed velocities v_i

    Phi_q dq = (h/k) Phi_q h sum e_i x_i,    Phi_q dv = (h/k) Phi_q (a_0 + sum e_i (v_i - v_0)/h)

are added, with K dq + Phi_q^T [.] = 0 for the matrix K above: bodies follow quasi-statically.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple, final

import numpy as np

from ancfdae.equations import Linearisation, MechanicalSystem
from ancfdae.equations.saddle_points import acceleration_side, solve
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.integrators.prescribed_motion import turn_error
from ancfdae.integrators.problem import InitialValueProblem, vector_sizes
from ancfdae.integrators.radau.linear_passes import LinearStages, StageKernel
from ancfdae.integrators.radau.stages import (
    BUTCHER,
    EMBEDDED,
    GAMMA,
    INVERSE,
    PLACES,
    Begin,
    SolvedStages,
    StageSolver,
    at_stages,
    continued,
    linearised,
)
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Failure, OneStepMethod, Record, Tolerance
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

# Fractions of a run that are tried as first step, each an eighth of the one before.
_FIRST = [0.05 * 8.0**-k for k in range(8)]
_EPS = float(np.finfo(float).eps)
# Shortest fraction of a step by way of which it is solved.
_SHORTEST = 1e-3


def completed(
    system: MechanicalSystem, factors: Factorization, t: float, q: Array, V: Array
) -> tuple[Array, Array, Array]:
    """Return v, a and lam from q and rough velocities V; `factors` belong to M and Phi_q."""
    v = V - solve(factors, np.zeros_like(V), system.constraint(t, q, V))[0]
    return v, *solve(factors, system.force(t, q, v), acceleration_side(system, t, q, v))


class State(NamedTuple):
    """State after a step: its size h, s, and start, stages and end as rows (t, q, v, a, lam).

    The start of a run is one row. Derivatives q_b, v_b, a_b, lam_b have the same rows; `errors` are
    estimates for q and v, q_b and v_b.
    """

    h: float
    rows: tuple[Array, ...]
    derivatives: tuple[Array, ...] = ()
    errors: tuple[Array, ...] = ()


@final
class RadauStepper(OneStepMethod[State]):
    """Takes the steps of a Radau run, with derivatives if those of the start are given.

    There are tolerances of positions and of velocities; none without error control.
    """

    order: ClassVar[int] = 4
    bears_jumps: ClassVar[bool] = True
    # A step of a small mechanism takes 3 to 30 ms.
    many: ClassVar[int] = 5_000
    remedy: ClassVar[str] = (
        "Radau under error control follows every wave that its tolerance sees. HHT(step=...) steps "
        "over those that do not matter (docs/howto/integrator.md)."
    )

    def __init__(
        self,
        problem: InitialValueProblem,
        newton: tuple[float, int],
        tolerances: tuple[Tolerance, ...],
        recorder: SolutionRecorder,
    ) -> None:
        self._problem, self._recorder, self._tolerances = problem, recorder, tolerances
        self._solver = StageSolver(problem, *newton, recorder)
        self.system = problem.system
        self._kernel = None if problem.derivative is None else StageKernel(problem)

    def consistent(self) -> Record:
        """Return the consistent start as a row of the solution, with derivatives if present."""
        return *self._problem.initial, self._problem.derivative or ()

    def start(self, h: float) -> State:
        """Return the consistent start, which does not depend on the step size."""
        rows = (np.asarray(x)[None] for x in self._problem.initial)
        return State(h, tuple(rows), tuple(x[None] for x in self._problem.derivative or ()))

    def resized(self, state: State, ratio: float) -> State:
        """Return the state unchanged, because it suits any step size."""
        return state

    def recorded(self, state: State) -> Record:
        """Return the stages of a step as rows of the solution; the last one is its end."""
        t, q, v, a, lam = (x[1:] for x in state.rows)
        return t, q, v, a, lam, tuple(x[1:] for x in state.derivatives)

    def advance(self, h: float, before: State, t: float) -> State | Failure:
        """Return the state after the step to t, with completed stages, or a Failure."""
        t_0, *last = (x[-1] for x in before.rows)
        begin = Begin(h, float(t_0), *last)
        solved = self._solved(begin, before)
        if isinstance(solved, Failure):
            return solved
        system, accelerations = self._problem.system, self._problem.accelerations
        times = np.append(begin.times[:2], t)
        counted, rows = accelerations.factorisations, []
        stages = begin.stages(solved.x, solved.lam)
        for s, q, v in zip(times.tolist(), stages.q, stages.v, strict=True):
            rows.append((q, *completed(system, accelerations.factors(s, q), s, q, v)))
        self._recorder.factorisations += accelerations.factorisations - counted
        columns = (np.array(x) for x in zip(last, *rows, strict=True))
        after = State(h, (np.append(t_0, times), *columns))
        return self._controlled(solved.x, before, after) if self._tolerances else after

    def _solved(self, begin: Begin, before: State) -> SolvedStages | Failure:
        """Return the stages of a step, if necessary by way of shorter steps from its start."""
        h, v, part = begin.h, begin.v, 1.0
        still = np.multiply.outer(PLACES[:, 0] ** 2 / 2, before.rows[3][-1])
        x, lam = still, np.tile(before.rows[4][-1], (3, 1))
        if len(before.rows[0]) > 1:
            x = at_stages(BUTCHER, continued(before.rows[2], 1 + h / before.h * PLACES) - v) / h
        solved = self._solver.solve(begin, (x, lam))
        # Under error control a smaller step is the better remedy.
        while isinstance(solved, Failure) and part > _SHORTEST and not self._tolerances:
            part /= 4
            solved = self._solver.solve(begin._replace(h=part * h), (still, lam))
        self._recorder.continued += part < 1 and not isinstance(solved, Failure)
        while part < 1 and not isinstance(solved, Failure):
            V = begin._replace(h=part * h).stages(solved.x, solved.lam).v
            part *= 2
            ahead = continued(np.concatenate([v[None], V]), 2 * PLACES)
            guess = at_stages(BUTCHER, ahead - v) / (part * h), solved.lam
            solved = self._solver.solve(begin._replace(h=part * h), guess)
        return solved

    def _controlled(self, x: Array, before: State, after: State) -> State:
        """Return the state `after` with its estimated errors and, if requested, derivatives."""
        middle = linearised(self._problem.system, *(row[2:3] for row in after.rows))
        rates = after.rows[2].real, before.rows[3][-1].real
        errors = self._embedded(middle, after.h, rates, x.real)
        if self._kernel is None:
            return after._replace(errors=errors)
        self._recorder.factorisations += 1
        t, *states = (x[None] for x in after.rows)
        *first, lam = (x[-1].T for x in before.derivatives)
        rows, lam_b = (np.zeros((4, *x.shape)) for x in (np.array(first), lam))
        rows[0], lam_b[0] = first, lam
        steps = LinearStages.of(self._kernel, np.array([after.h]), t, states)
        taken, x_b = steps.forward(rows, lam_b)
        if not taken:
            raise SingularMatrix("the matrix of the stages is singular")
        derivatives = *rows.transpose(1, 0, 3, 2), lam_b.transpose(0, 2, 1)
        given = (derivatives[1], first[2].T), x_b.transpose(0, 2, 1)
        errors += self._embedded(middle, after.h, *given)
        return after._replace(derivatives=derivatives, errors=errors)

    def _embedded(
        self, local: Linearisation, h: float, rates: tuple[Array, Array], x: Array
    ) -> tuple[Array, ...]:
        """Return the error estimates dq and dv of a step, also for columns of derivatives.

        `rates` are velocities at start and stages, and a at the start.
        """
        system, (M, f_q, f_v) = self._problem.system, (local.M[0], local.f_q[0], local.f_v)
        (v, a), e = rates, at_stages(EMBEDDED, x)[0]
        terms: tuple[tuple[float, Array], ...] = (GAMMA**2, M), (h**2, f_q)
        if f_v is not None:
            terms = (*terms, (GAMMA * h, f_v[0]))
        self._recorder.factorisations += 1
        factors = self._problem.matrices.factor_sum(terms, local.Phi_q[0])
        dq, dv = h * e, a + at_stages(EMBEDDED @ INVERSE, x)[0]
        prescribed = dq, a + at_stages(EMBEDDED, (v[1:] - v[0]) / h)[0]
        side = np.zeros((system.n_lam, *dq.shape[1:]))
        for share in (1.0, GAMMA / h):
            r_q, r_v = share * dq, share * dv
            right = system.pattern.dot(M, r_v + GAMMA / h * r_q)
            if f_v is not None:
                right = right + system.pattern.dot(f_v[0], r_q)
            dq = solve(factors, h**2 * right, side)[0]
            dv = GAMMA / h * dq - r_q
        across = (system.constraint_pattern.dot(local.Phi_q[0], x) for x in prescribed)
        none = np.zeros_like(dq)
        lifted = (solve(factors, none, h / GAMMA * x)[0] for x in across)
        return tuple(x + y for x, y in zip((dq, dv), lifted, strict=True))

    def error(self, h: float, before: State, after: State) -> float:
        """Return the largest e, of positions, velocities, their derivatives and rotations."""
        if not self._tolerances:
            return 0.0
        errors = [turn_error(self.system, float(after.rows[0][-1]), h, self.order)]
        for k, tolerance in enumerate(self._tolerances):
            # The tolerance divides by the share of the step in the run; here it is the whole error.
            T, ends = tolerance.t_end, after.rows[1 + k][[0, -1]].real
            if k == 0:
                ends = ends - self._problem.scales.place
            size = vector_sizes(ends, self.system.vector_size).max(axis=0)
            blur = self._round_off(h, k, after.rows[1][-1].real, 1.0)
            errors.append(tolerance.of_motion(T, after.errors[k], size, blur))
            if after.derivatives:
                size_b = vector_sizes(after.derivatives[k][-1].T, self.system.vector_size).T
                blur_b = self._round_off(h, k, after.derivatives[0][-1], tolerance.sizes_b)
                errors.append(tolerance.of_derivatives(T, after.errors[2 + k], size_b, blur_b))
        return float(np.max(errors))  # NaN if one is.

    def _round_off(self, h: float, k: int, q: Array, sizes: Array | float) -> Array:
        """Return the round-off of the estimate for positions (k = 0) or velocities (k = 1).

        x has the round-off of positions over h^2. Infinite sizes of derivatives are not known yet.
        """
        least = np.multiply.outer(self._problem.scales.q, np.where(np.isfinite(sizes), sizes, 0.0))
        return np.asarray(_EPS * (np.abs(q) + least) / h**k)

    def start_error(self) -> float:
        """Return e of the first step that can be solved, divided by its size^order."""
        for part in _FIRST if self._tolerances else ():
            h = part * self._tolerances[0].t_end
            after = self.advance(h, self.start(h), h)
            if not isinstance(after, Failure):
                return self.error(h, self.start(h), after) / h**self.order
        return 0.0
