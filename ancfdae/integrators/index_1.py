"""Index-1 form: accelerations and multipliers of a state, and the state back on the constraints.

    [ M      Phi_q^T ] [ a   ]   [ Q     ]
    [ Phi_q  0       ] [ lam ] = [ gamma ],

and the same matrix for their design derivatives.

Positions and velocities that drift are moved onto the constraints in the norm of M,

    M dq + Phi_q^T sigma = 0,   Phi_q dq = -Phi,
    M dv + Phi_q^T sigma = 0,   Phi_q dv = nu - Phi_q v,

by one Newton step: the drift of one integration step is small, and its square is round-off. The
matrix is that at the state before, the right side of the second line is at the moved q. The
design derivatives of the state are moved onto the derivatives of the constraints in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.total_derivatives import acceleration_totals

# Up to this size a product with the inverse takes a third of the time of a band solve (measured:
# 106 unknowns, six columns, 6 against 27 us).
_INVERTED_SIZE = 200


@final
@dataclass(frozen=True)
class State:
    """Coordinates and velocities with their design derivatives, or None without."""

    q: Array
    v: Array
    q_b: Array | None = None
    v_b: Array | None = None


@final
class Accelerations:
    """Solves for (a, lam) and keeps the factorised matrix while it does not change.

    For a constant mass and constant Phi_q it is factorised once in a whole run.
    """

    def __init__(self, system: MechanicalSystem, matrices: SaddlePoint) -> None:
        self._system, self._matrices = system, matrices
        self._Phi_q: Array | None = None
        self._factors: Factorization | None = None
        self._inverse: Array | None = None
        self.factorisations = 0

    def factors(self, t: float, q: Array) -> Factorization:
        """Return the factorised matrix at q."""
        Phi_q = self._system.constraint_q(q, t)
        if self._factors is None or not self._unchanged(Phi_q):
            self._factors = self._matrices.factor(self._system.mass(q), Phi_q)
            self._Phi_q, self._inverse = Phi_q, None
            self.factorisations += 1
        return self._factors

    def _unchanged(self, Phi_q: Array) -> bool:
        if not self._system.constant_mass or self._Phi_q is None:
            return False
        return Phi_q is self._Phi_q or np.array_equal(Phi_q, self._Phi_q)

    def _solved(self, t: float, q: Array, right: Array) -> Array:
        """Solve; by the inverse, which is formed when a matrix is met again."""
        before = self._factors
        factors = self.factors(t, q)
        if factors is not before or len(right) > _INVERTED_SIZE:
            return factors.solve(right)
        if self._inverse is None:
            self._inverse = factors.solve(np.eye(len(right)))
        return self._inverse @ right

    def solve(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return a and lam."""
        system = self._system
        right = np.concatenate([system.force(q, v, t), system.acceleration_side(q, v, t)])
        x = self._solved(t, q, right)
        return x[: system.n_q], x[system.n_q :]

    @property
    def weights(self) -> Array:
        """Least masses of the coordinates, shape (n_q,)."""
        return self._system.weights

    def reaction_size(self, t: float, q: Array, lam: Array) -> float:
        """Weighted norm of Phi_q^T lam, as that of an acceleration a is of weights**0.5 * a."""
        force = self._system.constraint_force(q, lam, t) / np.sqrt(self._system.weights)
        return float(np.linalg.norm(force))

    def solve_b(
        self, t: float, state: tuple[Array, Array, Array, Array], q_b: Array, v_b: Array
    ) -> tuple[Array, Array]:
        """Return a_b and lam_b at the state (q, v, a, lam)."""
        right = np.concatenate(acceleration_totals(self._system, t, state, q_b, v_b))
        x = self._solved(t, state[0], right)
        return x[: self._system.n_q], x[self._system.n_q :]


def project(
    system: MechanicalSystem, accelerations: Accelerations, t: float, state: State
) -> State:
    """Return the state moved onto the constraints."""
    factors = accelerations.factors(t, state.q)
    q = state.q - _nearest(factors, system.n_q, system.constraint(state.q, t))
    B, pattern = system.constraint_q(q, t), system.constraint_pattern
    v = state.v - _nearest(
        factors, system.n_q, pattern.dot(B, state.v) - system.velocity_side(q, t)
    )
    if state.q_b is None or state.v_b is None:
        return State(q, v)
    defect = pattern.dot(B, state.q_b) + system.constraint_b(q, t)
    q_b = state.q_b - _nearest(factors, system.n_q, defect)
    defect = system.constraint_q_times_total(q, v, t, q_b) + pattern.dot(B, state.v_b)
    defect = defect - system.velocity_side_total(q, t, q_b)
    return State(q, v, q_b, state.v_b - _nearest(factors, system.n_q, defect))


def _nearest(factors: Factorization, n_q: int, defect: Array) -> Array:
    """Smallest change x with Phi_q x = defect; also for columns."""
    zero = np.zeros((n_q, *defect.shape[1:]))
    return factors.solve(np.concatenate([zero, defect]))[:n_q]
