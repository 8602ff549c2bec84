"""Equilibria with one coordinate held: tau(a, p), the force that holds coordinate q_i at a.

A coordinate q_i that moves where stiffness is lost is held at a by one constraint more. With it
the matrix is regular at a critical point of the parameter p, and tau = 0 are the equilibria of the
system itself:

    Q - Phi_q^T lam + tau e_i = 0,     Phi = 0,     q_i = a

With z = (q, lam, -tau), A z_c = F_c for a change of c = a or a parameter, A the matrix of the held
system and F_c the partial derivative of the equations, and y = A^-T e, e the row of tau:

    tau_c = -y^T F_c,    tau_cd = -y^T F_cd,

where F_cd is the derivative along z_d, and in d, of what F changes along z_c, and in c; the second
by differences of five points (docs/theory/11-statics.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.held import force_total, held_total
from ancfdae.equations.saddle_points import solve, solve_transposed
from ancfdae.errors import SingularMatrix
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.patterns import Pattern
from ancfdae.statics.balance import Balance

_ITERATIONS = 25
# Part of the size of the system by which second derivatives move it: forces are polynomials of the
# coordinates of low degree, or near to one.
_STEP = 3e-3
# Corrections of this part of the size of the system are followed by more; once they stop to halve
# they are round-off.
_CONVERGED = 1e-7


@final
@dataclass(frozen=True)
class HeldPoint:
    """A solution with q_i held, and tau with its derivatives in a and in the design variables b.

    `motion` and `paths` are z_a and z_b, as (q, lam); `left` is (y_q, y_lam). tau_b is that part of
    `reach` that does work on y.
    """

    system: MechanicalSystem
    i: int
    q: Array
    lam: Array
    tau: float
    tau_a: float
    tau_b: Array
    reach: Array
    motion: tuple[Array, Array]
    paths: tuple[Array, Array]
    left: tuple[Array, Array]

    @cached_property
    def in_a(self) -> tuple[float, Array]:
        """tau_aa, and tau_ab, shape (n_b,)."""
        q_a, lam_a = (self.size * x for x in self.motion)
        slopes = _slope(lambda x: self._forces(self.system, x * q_a, x * lam_a)) / self.size
        return float(slopes[-1]), slopes[:-1]

    def in_p(self, k: int) -> Array:
        """Return tau_pb, shape (n_b,), p the design variable k."""
        b, (q_p, lam_p) = np.asarray(self.system.b), (x[:, k] for x in self.paths)
        # Changes that are as large as the system, or as the parameter.
        far = self._balance.length(q_p)
        size = min(self._balance.extent / far if far else np.inf, abs(b[k]) or np.inf)

        def forces(x: float) -> Array:
            p = x * size
            moved = self.system.with_values(b + p * np.eye(len(b))[k])
            return self._forces(moved, p * q_p, p * lam_p)

        return np.asarray(_slope(forces)[:-1] / size)

    @cached_property
    def size(self) -> float:
        """The change of a with which the motion is as large as the system."""
        return self._balance.extent / self._balance.length(self.motion[0])

    @property
    def _balance(self) -> Balance:
        return Balance(self.system, 0.0, self.system.start()[0], self.lam)

    def _forces(self, system: MechanicalSystem, dq: Array, dlam: Array) -> Array:
        """Return -y^T F_b along z_b, and -y^T F_a along z_a, in a changed state and system."""
        q, lam, y = self.q + dq, self.lam + dlam, self.left
        q_d, lam_d = (np.column_stack(x) for x in zip(self.paths, self.motion, strict=True))
        force, side = _totals(system, q, lam, q_d[:, :-1])
        balance, pattern = Balance(system, 0.0, q, lam), system.constraint_pattern
        Phi_q, K = balance.Phi_q(q), balance.tangent(1.0, q, lam)
        force = np.column_stack([force, -system.pattern.dot(K, q_d[:, -1])])
        side = np.column_stack([side, -pattern.dot(Phi_q, q_d[:, -1])])
        return -(y[0] @ (force - pattern.dot_transposed(Phi_q, lam_d)) + y[1] @ side)


def _slope(f: Callable[[float], Array]) -> Array:
    """Return the derivative at zero by five points, exact for polynomials of degree four."""
    near, far = (f(x) - f(-x) for x in (_STEP, 2 * _STEP))
    return np.asarray((8 * near - far) / (12 * _STEP))


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
        strength = np.sqrt((force**2).T @ (1 / system.weights))
        reach = np.sqrt(system.weights @ y_q**2) * strength
        point = tau, -float(lam_a[-1]), tau_b, reach
        return HeldPoint(system, i, q, lam, *point, motion, paths, left)
