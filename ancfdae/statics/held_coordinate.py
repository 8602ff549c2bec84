"""Equilibria with one coordinate held: tau(a, p), the force that holds coordinate q_i at a.

A coordinate q_i that moves where stiffness is lost is held at a by one constraint more. With it
the matrix is regular at a critical point of the parameter p, and tau = 0 are the equilibria of the
system itself:

    Q - Phi_q^T lam + tau e_i = 0,     Phi = 0,     q_i = a

With z = (q, lam, -tau), A z_c = F_c for a change of c = a or a parameter, A the matrix of the held
system and F_c the partial derivative of the equations, and y = A^-T e, e the row of tau:

    tau_c = -y^T F_c,    tau_cd = -y^T F_cd,

where F_cd is the derivative along z_d, and in d, of what F changes along z_c, and in c
(docs/theory/11-statics.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.held import force_total, held_total
from ancfdae.equations.saddle_points import solve, solve_transposed
from ancfdae.errors import SingularMatrix
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.patterns import Pattern
from ancfdae.statics.balance import Balance

_ITERATIONS = 25
# Corrections of this part of the size of the system are followed by more; once they stop to halve
# they are round-off.
_CONVERGED = 1e-7


@final
@dataclass(frozen=True)
class HeldPoint:
    """A solution with q_i held, and tau with its derivatives in a and in the design variables b.

    `motion` and `paths` are z_a and z_b, as (q, lam); `left` is (y_q, y_lam).
    """

    system: MechanicalSystem
    i: int
    q: Array
    lam: Array
    tau: float
    tau_a: float
    tau_b: Array
    motion: tuple[Array, Array]
    paths: tuple[Array, Array]
    left: tuple[Array, Array]

    def seconds(self, k: int) -> tuple[float, Array, Array]:
        """Return tau_aa, tau_ab and tau_pb, p the design variable k; shapes (), (n_b,), (n_b,)."""
        path = tuple(x[:, k] for x in self.paths)
        b = np.asarray(self.system.b) + 1j * STEP * np.eye(self.system.n_b)[k]
        with_a = self._changed(self.system, *self.motion)
        with_p = self._changed(self.system.with_values(b), *path)
        return float(with_a[-1]), with_a[:-1], with_p[:-1]

    def _changed(self, system: MechanicalSystem, q_c: Array, lam_c: Array) -> Array:
        """Return -y^T F_db and -y^T F_da for a change d of the state, and of the system given."""
        q, lam = self.q + 1j * STEP * q_c, self.lam + 1j * STEP * lam_c
        balance, rest = Balance(system, 0.0, q, lam), np.zeros((1, len(q)))
        states = q[None], rest, rest, lam[None]
        partials = system.design_partials(np.array([0.0]), *states)
        q_d, lam_d = (np.column_stack(x) for x in zip(self.paths, self.motion, strict=True))
        Phi_q, y_q, y_lam = balance.Phi_q(q), *self.left
        force = system.pattern.dot(balance.tangent(1.0, q, lam), q_d)
        force = force + system.constraint_pattern.dot_transposed(Phi_q, lam_d)
        side = system.constraint_pattern.dot(Phi_q, q_d)
        force[:, :-1] += only(partials.f_b)
        side[:, :-1] += only(partials.Phi_b)
        return np.asarray((y_q @ force.imag + y_lam @ side.imag) / STEP)


def _totals(system: MechanicalSystem, q: Array, lam: Array, q_b: Array) -> tuple[Array, Array]:
    """Return the total derivatives of Q - Phi_q^T lam and of -Phi in the design, lam held."""
    rest, still = np.zeros_like(q), np.zeros_like(q_b)
    force = force_total(system, 0.0, q, rest, q_b, still)
    force = force - held_total(system, 0.0, q, rest, lam, q_b)
    return force, -system.constraint_total(0.0, (q,), (q_b,))


@final
class HeldSystem:
    """A system with coordinate i held."""

    def __init__(self, system: MechanicalSystem, i: int, q: Array) -> None:
        self._system, self._i, B = system, i, system.constraint_pattern
        rows, columns = np.append(B.rows, B.shape[0]), np.append(B.columns, i)
        pattern = Pattern((B.shape[0] + 1, B.shape[1]), rows, columns)
        values = np.append(system.constraint_q(0.0, q), np.sqrt(system.weights[i]))
        self._matrices = SaddlePoint(system.pattern, pattern, system.weights, values)

    def solve(self, a: float, q: Array, lam: Array, tau: float = 0.0) -> HeldPoint | None:
        """Solve by Newton's method from a guess; None where it does not converge."""
        system, i, last = self._system, self._i, np.inf
        balance = Balance(system, 0.0, q, lam)
        try:
            for _ in range(_ITERATIONS):
                R = balance.unbalanced(q, lam)
                R[i] += tau
                factors = self._factors(balance, q, lam)
                side = np.append(-system.constraint(0.0, q), a - q[i])
                dq, dlam = solve(factors, R, side)
                size = balance.length(dq) / balance.extent
                if not np.isfinite(size) or (size >= 0.5 * last and last <= _CONVERGED):
                    break
                q, lam, tau, last = q + dq, lam + dlam[:-1], tau - float(dlam[-1]), size
            if not last <= _CONVERGED:
                return None
            return self._point(self._factors(balance, q, lam), q, lam, tau)
        except SingularMatrix:
            return None

    def _factors(self, balance: Balance, q: Array, lam: Array) -> Factorization:
        B = np.append(balance.Phi_q(q), 1.0)
        return self._matrices.factor(balance.tangent(1.0, q, lam), B)

    def _point(self, factors: Factorization, q: Array, lam: Array, tau: float) -> HeldPoint:
        system, i = self._system, self._i
        last = np.append(np.zeros_like(lam), 1.0)
        q_a, lam_a = solve(factors, 0 * q, last)
        y_q, y_lam = solve_transposed(factors, 0 * q, last)
        # Along the change of the start: of a stretch little is left that round-off could meet.
        s_b = system.start_b()[0]
        force, side = _totals(system, q, lam, s_b)
        side = np.vstack([side, -s_b[i]])
        q_b, lam_b = solve(factors, force, side)
        tau_b = -(y_q @ force + y_lam @ side)
        paths, motion = (q_b + s_b, lam_b[:-1]), (q_a, lam_a[:-1])
        left = y_q, y_lam[:-1]
        return HeldPoint(system, i, q, lam, tau, -float(lam_a[-1]), tau_b, motion, paths, left)
