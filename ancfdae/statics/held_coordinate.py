"""Equilibria with one coordinate fixed: tau(a, p), the force that fixes coordinate q_i at a.

A coordinate q_i that moves where stiffness is lost is fixed at a by one more constraint. With it
the matrix is regular at a critical point of the parameter p, and equilibria of the system itself
are tau = 0:

    Q - Phi_q^T lam + tau e_i = 0,     Phi = 0,     q_i = a

With z = (q, lam, -tau), A z_c = F_c for a change of c = a or a parameter, A the matrix of the
constrained system and F_c the partial derivative of the equations, and y = A^-T e, e the row of
tau:

    tau_c = -y^T F_c,    tau_cd = -y^T F_cd,

where F_cd is the second derivative of F along z_c and in c, and along z_d and in d: exact for c = a
by the second derivatives of the system, by differences of five points for two parameters
(docs/theory/11-statics.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.saddle_points import force_total, held_q, held_total, solve, solve_transposed
from ancfdae.equations.system import StateDirection, constraint_q_along
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.statics.balance import Balance
from ancfdae.statics.exact_products import ExactProducts, Parts, refined
from ancfdae.statics.softness import negative_directions, stiffness_of_coordinates

_ITERATIONS = 25
# Newton's method has converged at corrections below this fraction of the largest one.
_CONVERGED = 1e-7
# Step of a parameter in its second derivatives, relative to its change so far.
_STEP = 3e-3
# Weights, by step, of a derivative from five values, exact for polynomials of degree four.
_CENTRAL = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
_BACKWARD = {-4: 1 / 4, -3: -4 / 3, -2: 3.0, -1: -4.0, 0: 25 / 12}
# A variable does no work on the motion if the cosine between its forces and the motion is below
# _NONE. Number and size, relative to the system, of random changes of the coordinates that estimate
# round-off.
_NONE, _SAMPLES, _SEEN = 1e-7, 4, 1e-8
_EPS, _ROUNDINGS = float(np.finfo(float).eps), 64


@final
@dataclass(frozen=True)
class HeldPoint:
    """A solution with q_i fixed at a, and tau with its derivatives in a and the design variables.

    `motion` and `paths` are z_a and z_b, as (q, lam); `left` is (y_q, y_lam). `reach`, (n_b,), is
    the product of the norms of y_q and of the forces of a variable, with which tau_b is compared.
    `held` is True if no motion that keeps q_i has a negative stiffness.
    """

    system: MechanicalSystem
    i: int
    q: Array
    lam: Array
    tau: float
    tau_a: float
    tau_b: Array
    reach: Array
    motion: Parts
    paths: Parts
    left: Parts
    held: bool

    @cached_property
    def in_a(self) -> tuple[float, Array]:
        """Second derivatives tau_aa, and tau_ab, (n_b,), of the fixing force tau."""
        system, (q_a, lam_a), (y_q, y_lam) = self.system, self.motion, self.left
        rest = np.zeros_like(q_a)
        ahead, states = StateDirection(0.0, q_a, rest), (self.q, rest, rest, self.lam)
        on_q, _, _ = system.along_pull_back(0.0, states, ahead, y_q)
        bent = system.pattern.dot(held_q(system, 0.0, self.q, rest, lam_a), q_a)
        turned = constraint_q_along(system, 0.0, self.q, ahead)
        side = system.constraint_pattern.dot(turned, q_a)
        tau_aa = float(on_q @ q_a + 2.0 * (y_q @ bent) + y_lam @ side)
        force, side_b = stiffness_total(system, (self.q, self.lam), self.motion, self.paths)
        return tau_aa, np.asarray(y_q @ force + y_lam @ side_b)

    def in_p(self, k: int, begin: float, to: float) -> Array:
        """Return tau_pb, (n_b,), p the design variable k, by differences of five points.

        The points lie on both sides of p, or toward `begin` if there is no room up to `to`, because
        beyond these two values there may be no system.
        """
        p = float(self.system.b[k])
        step = _STEP * (p - begin)
        weights = _CENTRAL if abs(to - p) >= 2 * abs(step) else _BACKWARD
        values = [weight * self._tau_b(k, x * step) for x, weight in weights.items()]
        return np.asarray(np.sum(values, axis=0) / step)

    def bend(self, k: int, step: float) -> float:
        """Return tau_pp, p the design variable k, by a one-sided difference over `step`."""
        return float((self._tau_b(k, step)[k] - self.tau_b[k]) / step)

    def _tau_b(self, k: int, step: float) -> Array:
        """Return tau_b, with y of this point, where variable k has changed by `step`."""
        b, (q_p, lam_p) = np.asarray(self.system.b), (x[:, k] for x in self.paths)
        moved = self.system.with_values(b + step * np.eye(len(b))[k])
        return self._forces(moved, step * q_p, step * lam_p)

    def parted(self) -> Array:
        """Return which design variables change tau, and so separate crossing paths, (n_b,).

        A variable whose forces do no work on y does not. Nor does one whose part of tau is
        round-off and vanishes within the digits of q, such as the stiffness of an unstretched
        spring.
        """
        system, y_q = self.system, self.left[0]
        parts = np.abs(self.tau_b) > _NONE * self.reach
        unseen = parts & (np.abs(self.tau_b * system.b) <= self.round_off)
        if not np.any(unseen):
            return parts
        s_b, size = system.start_b()[0], Balance(system, 0.0, self.q, self.lam).extent
        digits = _SEEN * size / np.sqrt(np.sum(system.weights)) + _ROUNDINGS * _EPS * np.abs(self.q)
        rng, here = np.random.default_rng(0), y_q @ _totals(system, self.q, self.lam, s_b)[0]
        seen = np.zeros_like(self.tau_b)
        for _ in range(_SAMPLES):
            moved = self.q + digits * rng.choice((-1.0, 1.0), len(digits))
            force, _ = _totals(system, moved, self.lam, s_b)
            seen = np.maximum(seen, np.abs(y_q @ force - here))
        return np.asarray(parts & ~(unseen & (np.abs(self.tau_b) <= seen)))

    @cached_property
    def round_off(self) -> float:
        """Round-off of tau from rounding of coordinates and sums of forces."""
        system, y, q = self.system, np.abs(self.left[0]), self.q
        balance = Balance(system, 0.0, q, self.lam)
        blur = system.pattern.dot(np.abs(balance.tangent(1.0, q, self.lam)), np.abs(q))
        reactions = np.abs(balance.reactions(balance.Phi_q(q), self.lam))
        force = np.abs(system.force(0.0, q, np.zeros_like(q)))
        elastic = system.traits.force_round_off * norm(y, system.weights)
        return float(
            max(elastic, _EPS * (y @ blur)) + _ROUNDINGS * _EPS * (y @ (force + reactions))
        )

    def _forces(self, system: MechanicalSystem, dq: Array, dlam: Array) -> Array:
        """Return -y^T F_b along z_b in a changed state and system, shape (n_b,)."""
        q, lam, (q_b, lam_b) = self.q + dq, self.lam + dlam, self.paths
        force, side = _totals(system, q, lam, q_b)
        Phi_q = system.constraint_q(0.0, q)
        force = force - system.constraint_pattern.dot_transposed(Phi_q, lam_b)
        return -(self.left[0] @ force + self.left[1] @ side)


def stiffness_total(
    system: MechanicalSystem, state: Parts, motion: Parts, state_b: Parts
) -> tuple[Array, Array]:
    """Return total design derivatives of K x + Phi_q^T mu and Phi_q x for a fixed motion (x, mu).

    The state is (q, lam), with derivatives (n_q, n_b) and (n_lam, n_b).
    """
    (q, lam), (x, mu), (q_b, lam_b) = state, motion, state_b
    rest, still = np.zeros_like(x), np.zeros_like(q_b)
    states, ahead = (q, rest, rest, lam), StateDirection(0.0, x, rest)
    states_b = q_b, still, still, lam_b
    force = system.along_total(0.0, states, ahead, states_b, (still, still))
    force = force + held_total(system, 0.0, q, rest, mu, q_b)
    side, of_time = (system.constraint_total(0.0, (q, v), (q_b, still)) for v in (x, rest))
    return force, side - of_time


def _totals(system: MechanicalSystem, q: Array, lam: Array, q_b: Array) -> tuple[Array, Array]:
    """Return total design derivatives of Q - Phi_q^T lam at fixed lam, (n_q, n_b), and of -Phi."""
    rest, still = np.zeros_like(q), np.zeros_like(q_b)
    force = force_total(system, 0.0, q, rest, q_b, still)
    force = force - held_total(system, 0.0, q, rest, lam, q_b)
    return force, -system.constraint_total(0.0, (q,), (q_b,))


@final
class HeldSystem:
    """A system with coordinate i fixed by an additional constraint."""

    def __init__(self, system: MechanicalSystem, i: int, q: Array) -> None:
        self._system, self._i, B = system, i, system.constraint_pattern
        rows, columns = np.append(B.rows, B.shape[0]), np.append(B.columns, i)
        pattern = SparsityPattern((B.shape[0] + 1, B.shape[1]), rows, columns)
        values = np.append(system.constraint_q(0.0, q), np.sqrt(system.weights[i]))
        self._matrices = SaddlePoint(system.pattern, pattern, system.weights, values)

    def solve(self, a: float, q: Array, lam: Array, tau: float = 0.0) -> HeldPoint | None:
        """Return the equilibrium with q_i = a by Newton's method; None without convergence."""
        system, i, last, most = self._system, self._i, np.inf, 0.0
        balance = Balance(system, 0.0, q, lam)
        try:
            for _ in range(_ITERATIONS):
                R = balance.unbalanced(q, lam)
                R[i] += tau
                factors = self._factors(balance, q, lam)
                side = np.append(-system.constraint(0.0, q), a - q[i])
                dq, dlam = solve(factors, R, side)
                size = balance.length(dq)
                if not np.isfinite(size):
                    return None
                # Corrections that stop halving are round-off if they, or the forces, are small.
                K, most = balance.tangent(1.0, q, lam), max(most, size)
                small = size <= _CONVERGED * most or balance.is_round_off(R, K, q, lam, dq)
                if size >= 0.5 * last and small:
                    exact = ExactProducts(system, 0.0, q, lam, K, dq)
                    return self._point(factors, exact, tau)
                q, lam, tau, last = q + dq, lam + dlam[:-1], tau - float(dlam[-1]), size
        except SingularMatrix:
            pass
        return None

    def _factors(self, balance: Balance, q: Array, lam: Array) -> Factorization:
        B = np.append(balance.Phi_q(q), 1.0)
        return self._matrices.factor(balance.tangent(1.0, q, lam), B)

    def _point(self, factors: Factorization, exact: ExactProducts, tau: float) -> HeldPoint:
        system, i, q, lam = self._system, self._i, exact.q, exact.lam
        q_a, lam_a = self._along(factors, exact.times, exact, solve)
        y_q, y_lam = self._along(factors, exact.transposed_times, exact, solve_transposed)
        # Along the change of the start, which contains most of a stretch, so that round-off of y is
        # not multiplied by the force of that stretch.
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
        held = self._holds(Balance(system, 0.0, q, lam), q, lam)
        return HeldPoint(system, i, q, lam, *point, motion, paths, left, held)

    def _along(
        self,
        factors: Factorization,
        times: Callable[[Array], Array],
        exact: ExactProducts,
        solver: Callable[[Factorization, Array, Array], Parts],
    ) -> Parts:
        """Return the solution of A z = e, e the row of tau, refined; of A^T z = e alike."""
        system, i, B = self._system, self._i, self._system.constraint_pattern
        Phi_q, none = system.constraint_q(0.0, exact.q), np.zeros(system.n_lam + 1)

        def left(x: Array, mu: Array) -> Parts:
            force = -times(x) - B.dot_transposed(Phi_q, mu[:-1])
            force[i] -= mu[-1]
            return force, np.append(-B.dot(Phi_q, x), 1.0 - x[i])

        return refined(system, factors, (0 * exact.q, none), left, solver)

    def _holds(self, balance: Balance, q: Array, lam: Array) -> bool:
        K = balance.tangent(1.0, q, lam)
        D = stiffness_of_coordinates(balance, K)
        B = np.append(balance.Phi_q(q), 1.0)
        matrix = self._matrices.constrained.scaled(K, B, D)
        return not negative_directions(matrix)
