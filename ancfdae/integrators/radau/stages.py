"""The equations of the three stages of a step, and their matrices.

With h^2 x the displacements of the stages from the motion at constant velocity,

    Q = q_0 + h c v_0 + h^2 x,     V = v_0 + h A^-1 x,     Q'' = A^-2 x,

the equations of a step are those of motion and the constraints at every stage,

    M(Q_i) Q_i'' + Phi_q^T lam_i - Q(t_i, Q_i, V_i) = 0,     Phi(t_i, Q_i) / h^2 = 0.

**Simplified matrix.** With M, f_q, f_v and Phi_q of one state for all stages, and A^-1 = T D T^-1,
D diagonal, Newton's method falls into three systems of the size of the mechanism,

    [ k^2 M + h k f_v + h^2 f_q    Phi_q^T ]      k = gamma, mu, conj(mu)
    [ Phi_q                        0       ]

one real, two complex ones that are conjugate. Multiplied with conj(mu)/|mu|, the complex matrix has
a positive definite real part where M and f_q have, as L D L^T without exchanges wants it.

**Exact matrix.** With the matrices of every stage at its own state block (i, j) of K is
(A^-2)_ij M_i + h (A^-1)_ij f_v,i, and h^2 f_q,i more for i = j.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import Linearisation, MechanicalSystem, reaction
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.radau.tableau import (
    COLUMN,
    GAMMA,
    INVERSE,
    MU,
    PLACES,
    REAL_COLUMN,
    REAL_ROW,
    ROW,
    SQUARED,
    at_stages,
)
from ancfdae.kernels import balance
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.coupled import CoupledFactors, CoupledSaddlePoints


class Stages(NamedTuple):
    """Positions, velocities, accelerations and multipliers of the stages, as rows."""

    q: Array
    v: Array
    a: Array
    lam: Array


class Begin(NamedTuple):
    """Where a step begins: time, position and velocity, and its size."""

    t: float
    q: Array
    v: Array
    h: float

    @property
    def times(self) -> Array:
        """Times of the stages."""
        return self.t + self.h * PLACES[:, 0]

    def stages(self, x: Array, lam: Array) -> Stages:
        """Return the stages of scaled displacements and multipliers."""
        h = self.h
        q = self.q + h * PLACES * self.v + h**2 * x
        return Stages(q, self.v + h * at_stages(INVERSE, x), at_stages(SQUARED, x), lam)

    def displacements(self, q: Array) -> Array:
        """Return x of the positions of stages; its round-off is that of q over h^2."""
        return np.asarray((q - self.q - self.h * PLACES * self.v) / self.h**2)


def residuals(system: MechanicalSystem, begin: Begin, stages: Stages) -> tuple[Array, Array]:
    """Return the residuals of the stages, (3, n_q + n_lam), and reactions and forces in them."""
    rows, forces = [], []
    for t, q, v, a, lam in zip(begin.times.tolist(), *stages, strict=True):
        pair = reaction(system, t, q, lam), system.force(t, q, v)
        Phi = system.constraint(t, q)
        rows.append(balance(system.mass_times(q, a), *pair, Phi, 1 / begin.h**2))
        forces.append(pair)
    return np.array(rows), np.array(forces).swapaxes(0, 1)


@final
class SimplifiedMatrix:
    """The real and the complex matrix of one state; `local` is linearised there, k = 1."""

    def __init__(self, problem: Problem, h: float, local: Linearisation) -> None:
        self.local, self._turn = local, np.conj(MU) / abs(MU)
        self._n_q, matrices = problem.system.n_q, problem.matrices
        M, f_q, Phi_q = local.M[0], local.f_q[0], local.Phi_q[0]
        terms: tuple[tuple[float, Array], ...] = (GAMMA**2, M), (h**2, f_q)
        K = (self._turn * MU**2) * M + (self._turn * h**2) * f_q
        if local.f_v is not None:
            terms = (*terms, (GAMMA * h, local.f_v[0]))
            K = K + (self._turn * MU * h) * local.f_v[0]
        self.real, self._complex = matrices.factor_sum(terms, Phi_q), matrices.factor(K, Phi_q)

    def solve(self, right: Array) -> Array:
        """Solve for right sides of the stages, (3, n_q + n_lam)."""
        # Transformed as complex numbers an imaginary perturbation would be lost in the real part.
        parts = [right.real, right.imag] if right.dtype.kind == "c" else [right]
        real = self.real.solve(np.array([REAL_ROW @ part for part in parts]).T)
        pair = np.array([ROW @ part for part in parts]).T
        pair[: self._n_q] *= self._turn
        pair = self._complex.solve(pair)
        pair[self._n_q :] /= self._turn
        x = np.multiply.outer(REAL_COLUMN, real) + 2 * np.multiply.outer(COLUMN, pair).real
        return np.asarray(x[..., 0] if len(parts) == 1 else x[..., 0] + 1j * x[..., 1])


def stage_matrices(problem: Problem) -> CoupledSaddlePoints:
    """Return the exact matrices; constraints are scaled by their rows at the start."""
    system, Phi_q = problem.system, problem.system.constraint_q(0.0, problem.initial.q)
    patterns = system.pattern, system.constraint_pattern
    return CoupledSaddlePoints(3, *patterns, system.weights, Phi_q)


def exact(matrices: CoupledSaddlePoints, h: float, local: Linearisation) -> CoupledFactors:
    """Factorise for what is linearised at the three stages."""
    M = local.M[:, None] if len(local.M) > 1 else local.M
    blocks = SQUARED[..., None] * M
    if local.f_v is not None:
        blocks = blocks + h * INVERSE[..., None] * local.f_v[:, None]
    blocks[range(3), range(3)] += h**2 * local.f_q
    return matrices.factor(blocks, local.Phi_q)
