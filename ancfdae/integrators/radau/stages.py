"""The three stages of a step of Radau IIA: coefficients, equations, Newton's method.

Coefficients are those of Hairer & Wanner, Solving ODEs II, IV.5 and IV.8. With h^2 x the
displacements of the stages from the motion at constant velocity,

    Q = q_0 + h c v_0 + h^2 x,     V = v_0 + h A^-1 x,     Q'' = A^-2 x,

the equations of a step are those of motion and the constraints at every stage,

    M(Q_i) Q_i'' + Phi_q^T lam_i - Q(t_i, Q_i, V_i) = 0,     Phi(t_i, Q_i) / h^2 = 0.

**Matrix.** With the matrices of every stage at its own state block (i, j) of K is (A^-2)_ij M_i + h
(A^-1)_ij f_v,i, plus h^2 f_q,i for i = j.

Newton's method runs in `kernels/stages.h`.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import Linearisation, MechanicalSystem
from ancfdae.equations.saddle_points import Prepared
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.kernels import (
    RULES,
    STAGES_NOT_FINITE,
    STAGES_SINGULAR,
    STAGES_SOLVED,
    CoupledMatrix,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import coupled_arrays

_ROOT = np.sqrt(6.0)

#: Butcher matrix A.
BUTCHER = np.array(
    [
        [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
        [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
        [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
    ]
)
#: Nodes c of the stages as fractions of the step, as a column.
PLACES = np.array([[(4 - _ROOT) / 10], [(4 + _ROOT) / 10], [1.0]])
#: A^-1 and A^-2.
INVERSE = np.linalg.inv(BUTCHER)
SQUARED = INVERSE @ INVERSE
#: c, A^-1 and A^-2 in the layout of `StageTableau` of the kernel.
TABLEAU = np.concatenate([x.ravel() for x in (PLACES, INVERSE, SQUARED)])
#: Weights e, a row, of the embedded formula: err = (gamma/h - J)^-1 (f_0 + sum e_i (Y_i - y_0)/h).
EMBEDDED = np.array([[-13 - 7 * _ROOT, -13 + 7 * _ROOT, -1]]) / 3


#: The real eigenvalue of A^-1.
GAMMA = float(min(np.linalg.eigvals(INVERSE), key=lambda x: abs(x.imag)).real)


def at_stages(matrix: Array, x: Array) -> Array:
    """Return sums over j of matrix_ij x_j for arrays over the three stages, (3, ...)."""
    return np.asarray((matrix @ x.reshape(3, -1)).reshape(-1, *x.shape[1:]))


def continued(rows: Array, ahead: Array) -> Array:
    """Extrapolate rows at start and stages of a step, (4, n), by a cubic to times `ahead`.

    `ahead` is a column; its unit is the step size.
    """
    places, shares = np.append(0.0, PLACES), []
    for k, place in enumerate(places):
        others = np.delete(places, k)
        shares.append(np.prod((ahead - others) / (place - others), axis=1))
    return np.asarray(np.transpose(shares) @ rows)


class Stages(NamedTuple):
    """Positions, velocities, accelerations and multipliers of the stages of a step, a row each."""

    q: Array
    v: Array
    a: Array
    lam: Array


class Begin(NamedTuple):
    """The start of a step: its size h, s, the time, and the state."""

    h: float
    t: float
    q: Array
    v: Array
    a: Array
    lam: Array

    @property
    def state(self) -> tuple[Array, Array, Array, Array]:
        """Coordinates, velocities, accelerations and multipliers at the start of the step."""
        return self[2:]

    @property
    def times(self) -> Array:
        """Times of the three stages, shape (3,); s."""
        return self.t + self.h * PLACES[:, 0]

    def stages(self, x: Array, lam: Array) -> Stages:
        """Return the stages from scaled displacements x and multipliers."""
        h = self.h
        q = self.q + h * PLACES * self.v + h**2 * x
        return Stages(q, self.v + h * at_stages(INVERSE, x), at_stages(SQUARED, x), lam)


def linearised(system: MechanicalSystem, t: Array, *states: Array) -> Linearisation:
    """Return the linearisation of a system at the real parts of k states."""
    local = system.linearise(t, *map(np.real, states))
    f_v = None if local.f_v is None else local.f_v.real
    return Linearisation(local.M.real, local.f_q.real, f_v, local.Phi_q.real)


def stage_matrices(problem: InitialValueProblem) -> CoupledMatrix:
    """Return the coupled matrix of the stages for kernels.

    Constraints are scaled by their rows at the start.
    """
    system, Phi_q = problem.system, problem.system.constraint_q(0.0, problem.initial.q)
    patterns = system.pattern, system.constraint_pattern
    layout = problem.matrices.layout(band=False)
    return coupled_arrays(3, *patterns, system.weights, Phi_q, layout and layout.order)


# The iteration matrix is recomputed if more than _MORE further iterations are predicted.
_MORE = 4
# Forces above _JUMP times those at the start of the step come from wrong strains of the guess: a
# matrix made there is used once.
_JUMP = 10.0
# Corrections are measured against forces of the iterate, at most _MOST times those at the start of
# the step: a diverging iterate has huge forces.
_MOST = 100.0
# Corrections count as no longer shrinking if they shrink by less than this factor.
_SLOW = 0.5
# Corrections that stop shrinking count as round-off below _ROUND_OFF times the motion, or
# _POSITIONS times the round-off of positions.
_ROUND_OFF, _POSITIONS = 1e-6, 1e4
_TINY = float(np.finfo(float).tiny)


class SolvedStages(NamedTuple):
    """Scaled displacements x and multipliers of the stages of a solved step."""

    x: Array
    lam: Array


@final
class StageSolver:
    """Newton's method for the stages of steps, whose iterations the recorder counts."""

    def __init__(
        self,
        problem: InitialValueProblem,
        tolerance: float,
        max_iterations: int,
        recorder: SolutionRecorder,
    ) -> None:
        system, matrices = problem.system, problem.matrices
        least = max(10 * system.traits.force_round_off, _TINY)
        rules = tolerance, max_iterations, least, _MORE, _JUMP, _MOST, _SLOW, _ROUND_OFF
        self._rules, self._recorder = np.array([0.0, *rules, _POSITIONS]), recorder
        self._kernel = Prepared(system, matrices, np.zeros(RULES), recorder.dtype)
        self._coupled = stage_matrices(problem)

    def solve(self, begin: Begin, guess: tuple[Array, Array]) -> SolvedStages | Failure:
        """Return the solution of a step from a guess of x and lam, or why it failed."""
        plan, dtype = self._kernel.plan, self._kernel.dtype
        x, lam = (np.array(each, dtype=dtype) for each in guess)
        instants = np.append(begin.times, begin.t)
        joints, still = plan.joint_factors, np.ones((1, 1))
        factors = still if joints is None else joints(instants, 1)[0]
        tables = factors, plan.load_factors(instants), (TABLEAU, self._rules)
        self._rules[0] = begin.h
        ends, size, (iterations, factorisations, stuck) = self._kernel.model.solve_stages(
            self._coupled, begin.state, x, lam, *tables
        )
        self._recorder.residuals += 3 * iterations
        self._recorder.iterations += iterations
        self._recorder.factorisations += factorisations
        self._recorder.round_off_steps += stuck
        if ends == STAGES_SINGULAR:
            raise SingularMatrix("the matrix of the stages is singular")
        if ends == STAGES_SOLVED:
            return SolvedStages(x, lam)
        why = Verdict.NOT_FINITE if ends == STAGES_NOT_FINITE else Verdict.NO_CONVERGENCE
        return Failure(why, size)
