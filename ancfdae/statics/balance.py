"""The equations of equilibrium on the way to the full load, and Newton's method for them.

    Q(q) - Phi_q^T lam - mu M_0 (q - q_a) = (1 - s) (r_0 + P(q)),     Phi(q) = (1 - s) Phi_0

P are the loads that turn with the motion; r_0 = Q - Phi_q^T lam - P and Phi_0 are what is
unbalanced besides where the search starts, so that the start solves the equations at s = 0. From
a start free of stress s is the load factor. The term in mu is an implicit step of the motion
without inertia, M_0 q' = Q - Phi_q^T lam, from q_a.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput, SingularMatrix, Verdict
from ancfdae.kernels import finite, norm
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.protocol import MechanicalSystem, reaction
from ancfdae.protocol.saddle_points import saddle_point, solve

# Estimated error after the last iteration, relative to positions and to forces: near round-off.
_TOLERANCE = 1e-13
# Corrections that stop shrinking are round-off if they, and the forces left, are this small.
_ROUND_OFF = 1e-6
_ITERATIONS = 25
# A correction of so many times the size of the system, or growth so many times, is divergence.
_FAR, _GROWTHS = 100.0, 4


@final
@dataclass
class Work:
    """Counters of a search."""

    iterations: int = 0
    factorisations: int = 0
    residuals: int = 0
    steps: int = 0
    rejected: int = 0


@final
@dataclass(frozen=True)
class Solved:
    """A solution at the load fraction s, and the matrix of the last iteration."""

    s: float
    q: Array
    lam: Array
    factors: Factorization
    iterations: int


@final
@dataclass(frozen=True)
class Failure:
    """Why Newton's method found none, and the size of its last correction."""

    verdict: Verdict
    residual: float


@final
@dataclass(frozen=True)
class Balance:
    """The equations of one search, which starts at q_0 and lam_0; see the module."""

    system: MechanicalSystem
    t: float
    q_0: Array
    lam_0: Array
    work: Work = field(default_factory=Work)

    @staticmethod
    def of(system: MechanicalSystem, t: float, q_0: Array, lam_0: Array) -> Balance:
        """Check the start and return the equations.

        Raises
        ------
        InvalidInput
            If start or forces are not finite; `RedundantConstraints` if constraints depend on
            each other.
        """
        balance = Balance(system, t, q_0, lam_0)
        with np.errstate(all="ignore"):
            good = all(finite(x) for x in (q_0, balance.r_0, balance.Phi_0))
        if not good:
            raise InvalidInput(
                "start of the equilibrium",
                "coordinates and forces must be finite",
                "NaN or infinity",
                "Check start and forces.",
            )
        return balance

    @cached_property
    def r_0(self) -> Array:
        """Unbalanced forces at the start, but for the loads that turn."""
        P, _ = self.system.following_load(self.t, self.q_0)
        return self.unbalanced(self.q_0, self.lam_0) - P

    @cached_property
    def Phi_0(self) -> Array:
        """Violation of the constraints at the start."""
        return self.system.constraint(self.t, self.q_0)

    @cached_property
    def M_0(self) -> Array:
        """Mass at the start, values on the pattern."""
        return self.system.mass(self.q_0)

    @cached_property
    def matrices(self) -> SaddlePoint:
        """Saddle-point matrices."""
        return saddle_point(self.system, self.t, self.q_0)

    def unbalanced(self, q: Array, lam: Array) -> Array:
        """Return Q - Phi_q^T lam at rest."""
        Q = self.system.force(self.t, q, np.zeros_like(q))
        return Q - reaction(self.system, self.t, q, lam)

    def held_back(self, q: Array) -> Array:
        """Return the forces that the equations lack at s = 0."""
        return self.r_0 + self.system.following_load(self.t, q)[0]

    def tangent(self, s: float, q: Array, lam: Array) -> Array:
        """Return K, minus the derivative of the forces in q, values on the pattern."""
        rest = np.zeros((1, len(q)))
        K = only(self.system.linearise(np.array([self.t]), q[None], rest, rest, lam[None]).f_q)
        if s < 1.0:
            K = K + (1.0 - s) * self.system.following_load(self.t, q)[1]
        return K

    def factor(self, K: Array, q: Array) -> Factorization:
        """Factorise [K, Phi_q^T; Phi_q, 0]; raises SingularMatrix."""
        self.work.factorisations += 1
        return self.matrices.factor(K, self.system.constraint_q(self.t, q))

    def solve(
        self,
        s: float,
        q: Array,
        lam: Array,
        mu: float = 0.0,
        anchor: Array | None = None,
    ) -> Solved | Failure:
        """Solve the equations by Newton's method from a guess q, lam; the anchor is q_a."""
        test = _Convergence(self)
        try:
            with np.errstate(all="ignore"):
                for iteration in range(1, _ITERATIONS + 1):
                    R, Phi = self._residual(s, q, lam, mu, anchor)
                    if not (finite(R) and finite(Phi)):
                        return Failure(Verdict.NOT_FINITE, test.size)
                    K = self.tangent(s, q, lam)
                    factors = self.factor(K if mu == 0.0 else K + mu * self.M_0, q)
                    dq, dlam = solve(factors, R, -Phi)
                    q, lam = q + dq, lam + dlam
                    if test.converged(q, lam, dq, dlam, R):
                        return Solved(s, q, lam, factors, iteration)
                    if test.diverged:
                        break
        except SingularMatrix:
            return Failure(Verdict.SINGULAR, test.size)
        return Failure(Verdict.NO_CONVERGENCE, test.size)

    def _residual(
        self, s: float, q: Array, lam: Array, mu: float, anchor: Array | None
    ) -> tuple[Array, Array]:
        self.work.residuals += 1
        self.work.iterations += 1
        R = self.unbalanced(q, lam)
        if s < 1.0:
            R = R - (1.0 - s) * self.held_back(q)
        if anchor is not None:
            R = R - mu * self.system.pattern.dot(self.M_0, q - anchor)
        return R, self.system.constraint(self.t, q) - (1.0 - s) * self.Phi_0

    def path_tangent(self, q: Array, factors: Factorization) -> tuple[Array, Array]:
        """Return dq/ds and dlam/ds of the path of solutions."""
        return solve(factors, self.held_back(q), -self.Phi_0)

    # -- natural sizes -------------------------------------------------------------------------

    def length(self, dq: Array) -> float:
        """Return the size of a change of coordinates."""
        return norm(dq, self.system.weights)

    @cached_property
    def position(self) -> float:
        """Size of the coordinates at the start."""
        return self.length(self.q_0)

    @cached_property
    def extent(self) -> float:
        """Size of the system: of its coordinates, or of coordinates of one where all vanish."""
        return self.position or float(np.sqrt(np.sum(self.system.weights)))

    def strength(self, Q: Array) -> float:
        """Return the size of generalised forces."""
        return norm(Q, 1 / self.system.weights)

    @cached_property
    def load(self) -> float:
        """Size of the load at the start, and no less than round-off tells."""
        least = self.system.traits.force_round_off / (0.1 * _ROUND_OFF)
        return max(self.strength(self.held_back(self.q_0)), least, float(np.finfo(float).tiny))


@final
class _Convergence:
    """The test of one solve: corrections against the sizes of positions and forces.

    The imaginary part of a complex step lags the real part by one iteration.
    """

    def __init__(self, balance: Balance) -> None:
        self._balance, self._last, self._growths, self._settled = balance, math.inf, 0, 0
        self.size, self.diverged = math.inf, False

    def converged(self, q: Array, lam: Array, dq: Array, dlam: Array, R: Array) -> bool:
        """Judge a correction that led to q and lam, from the unbalanced forces R."""
        b, system = self._balance, self._balance.system
        moved = b.length(dq)
        # Where all coordinates are zero at the start, the first correction tells their size.
        moved /= b.position or b.length(q - b.q_0) or 1.0
        reactions, change = (reaction(system, b.t, q, x) for x in (lam, dlam))
        force = max(b.load, b.strength(reactions))
        self.size = max(moved, b.strength(change) / force)
        rate = moved / self._last if 0 < self._last < math.inf else float(moved > 0)
        self._growths += rate > 1.0
        self.diverged = moved > _FAR or self._growths >= _GROWTHS
        self._last = moved
        left = self.size * min(1.0, rate * rate)
        stuck = rate > 0.5 and self.size <= _ROUND_OFF and b.strength(R) <= _ROUND_OFF * force
        if left <= _TOLERANCE or stuck:
            self._settled += 1
        return self._settled >= (3 if np.iscomplexobj(q) else 1)
