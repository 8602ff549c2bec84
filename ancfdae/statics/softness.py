"""Stability of an equilibrium, and the motions that meet the least stiffness.

Stiffness is measured against the diagonal of K, D = |diag K|: kappa = phi^T K phi / phi^T D phi
over motions that keep the constraints, Phi_q phi = 0. Measured against the mass the slowest
bending of a beam would be (h/L)^4, which round-off hides; against D it is (h/L)^2 / n^2, with n
elements.

Stable is an equilibrium without a motion of negative stiffness; all of them are counted
(`numerics/inertia.py`), for one that is far from zero is none of the softest. K of loads that turn
with the motion is not symmetric. Then real negative eigenvalues on the constraints are sought,
motions that leave without turning back (divergence): there is none where the symmetric part of K is
positive definite; there is one where the determinant is negative, and
else all eigenvalues that could be are looked at. They are those of K phi = omega^2 M phi there:
motions that diverge do so against their inertia, and which of an even number do depends on it.
Flutter, pairs of complex
omega^2, is judged where a search ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
import scipy

from ancfdae.equations.saddle_points import solve
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.inertia import ConstrainedMatrix
from ancfdae.statics.balance import Balance

# Motions looked for at once, and sweeps of the inverse iteration.
_MOTIONS, _SWEEPS = 8, 6
# Stiffness below this is round-off, which leaves up to 5e-16; a beam of 400 elements and
# h/L = 1e-4 has 9e-14. A negative one must be clear of it, and K is shifted by more than eps, so
# that it can be factorised.
_FREE, _SHIFT = 4e-15, 1e-14
# The trace of a stiffness that one without its own is measured against.
_TRACE, _EPS = 1e-8, float(np.finfo(float).eps)
# K is positive definite for certain if all stiffness is proven to exceed half of this.
_PROVEN = 1e-13
# A negative stiffness is larger in size than the first of these with which pivots can be trusted.
_CLEAR = tuple(1e-14 * 16.0**k for k in range(12))


@final
@dataclass(frozen=True)
class Softness:
    """Stiffness of a configuration on the motions that keep its constraints.

    K and Phi_q are values on the patterns of the system, D is the diagonal that stiffness is
    measured against, shape (n_q,).
    """

    balance: Balance
    K: Array
    Phi_q: Array
    D: Array

    @cached_property
    def definite(self) -> bool:
        """Whether K is proven to be positive definite; False where that takes motions."""
        self.balance.work.factorisations += self._matrix.pattern.wide
        return self._matrix.definite(_PROVEN)

    @cached_property
    def stable(self) -> bool:
        """Whether no motion meets a negative stiffness; of loads that turn see the module."""
        if self.definite:
            return True
        matrix = self._matrix
        if not negative_directions(matrix) and not np.any(self._values < -self.noise):
            return True
        if not self.follows:
            return False
        return not (matrix.is_odd(_CLEAR[0]) or matrix.has_negative(self._M))

    @property
    def flutter(self) -> complex | None:
        """Exponent of the vibration that loads which turn make grow, without damping; or None."""
        return self._matrix.growing(self._M) if self.follows else None

    @property
    def seen_whole(self) -> bool:
        """Whether all motions were searched for flutter, not some next to zero alone."""
        return not self.follows or self._matrix.seen_whole

    @cached_property
    def _M(self) -> Array:
        scale, pattern = 1.0 / np.sqrt(self.D), self.balance.system.pattern
        return self.balance.M_0.real * scale[pattern.rows] * scale[pattern.columns]

    @property
    def follows(self) -> bool:
        """Whether K is not symmetric, because loads turn with the motion: it may flutter."""
        return not self.balance.system.traits.symmetric and self._matrix.skewness > _CLEAR[0]

    @property
    def judged(self) -> bool:
        """Whether round-off leaves the sign of every stiffness; False where one may be neutral.

        All are counted down to the least number with which pivots can be trusted; between it and
        zero the softest motions decide.
        """
        matrix = self._matrix
        if matrix.below(_CLEAR[0]) is not None:
            return True
        if counted(matrix) is None:
            return False
        return bool(np.all(np.abs(self._values) > self.noise))

    @cached_property
    def _values(self) -> Array:
        """Ritz's values of the symmetric part in the softest motions: no lower than its own."""
        K = self.motions.T @ self.balance.system.pattern.dot(self.K, self.motions)
        return np.linalg.eigvalsh((K + K.T) / 2)

    @cached_property
    def noise(self) -> float:
        """Round-off of the stiffness x^T K x of the softest motions, with x^T D x = 1."""
        X = np.abs(self.motions)
        terms = np.sum(X * self.balance.system.pattern.dot(np.abs(self.K), X), axis=0)
        return _FREE * float(np.max(terms, initial=1.0))

    @property
    def kappa(self) -> Array:
        """Stiffness of the softest motions in size, rising, shape (k,)."""
        return self._softest[0]

    @property
    def motions(self) -> Array:
        """The softest motions, shape (n_q, k)."""
        return self._softest[1]

    @property
    def multipliers(self) -> Array:
        """Forces of constraints in these motions, with K x + Phi_q^T mu across all motions."""
        return self._softest[2]

    @property
    def free(self) -> Array:
        """Motions without stiffness, shape (n_q, number)."""
        return self.motions[:, self.kappa <= _FREE]

    @cached_property
    def _matrix(self) -> ConstrainedMatrix:
        return self.balance.matrices.constrained.scaled(self.K, self.Phi_q, self.D)

    @cached_property
    def _softest(self) -> tuple[Array, Array, Array]:
        """Stiffness, motions and multipliers by inverse iteration on a block."""
        balance, system, D = self.balance, self.balance.system, self.D
        root = np.sqrt(D)[:, None]
        count = min(_MOTIONS, system.n_q - system.n_lam)
        nothing = np.zeros(0), np.zeros((system.n_q, 0)), np.zeros((system.n_lam, 0))
        if count <= 0:
            return nothing
        shifted = self.K.copy()
        shifted[system.pattern.diagonal] += _SHIFT * D
        none = np.zeros((system.n_lam, count))
        X = np.random.default_rng(0).standard_normal((system.n_q, count)) / root
        try:
            factors = balance.factor(shifted, self.Phi_q)
            for _ in range(_SWEEPS):
                X, mu = solve(factors, D[:, None] * X, none)
                Q, R = _orthonormal(root * X)
                X = Q / root
        except SingularMatrix:  # Of K and Phi_q together: constraints that depend on each other.
            return nothing
        _, kappa, V = np.linalg.svd(X.T @ system.pattern.dot(self.K, X))
        mu = scipy.linalg.solve_triangular(R, mu.T, trans="T").T
        return kappa[::-1], X @ V.T[:, ::-1], mu @ V.T[:, ::-1]


def negative_directions(matrix: ConstrainedMatrix) -> int:
    """Return the number of motions with a negative stiffness, of the symmetric part of K.

    Zero where none can be counted (`counted`).
    """
    return counted(matrix) or 0


def counted(matrix: ConstrainedMatrix) -> int | None:
    """Return this number; None of a large matrix with which no pivots can be trusted."""
    counts = map(matrix.below, _CLEAR)
    count = next((count for count in counts if count is not None), None)
    return matrix.below_densely(_CLEAR[0]) if count is None else count


def softest(balance: Balance, s: float, q: Array, lam: Array, mu: float = 0.0) -> Softness:
    """Return the stiffness of a state at the load fraction s; with mu, of K + mu M_0."""
    q, lam = q.real, lam.real
    K = balance.tangent(s, q, lam).real + mu * balance.M_0.real
    return Softness(balance, K, balance.Phi_q(q).real, stiffness_of_coordinates(balance, K))


def _orthonormal(X: Array) -> tuple[Array, Array]:
    """Return Q and R of columns; without the checks that cost a small one more."""
    reflectors, tau, *_ = scipy.linalg.lapack.dgeqrf(X)
    R = np.triu(reflectors[: X.shape[1]])
    return scipy.linalg.lapack.dorgqr(reflectors, tau)[0], R


def stiffness_of_coordinates(balance: Balance, K: Array) -> Array:
    """|diag K|; where it vanishes a trace of the stiffest one that it is joined to, by weight.

    A coordinate without stiffness of its own may be coupled to others, as by a load; it is
    measured against a trace of that. Parts that nothing joins do not know each other: a strip of
    foil is as stiff as it is, whatever stands beside it.
    """
    pattern, w = balance.system.pattern, balance.system.weights
    D, root = np.abs(K[pattern.diagonal]), np.sqrt(w)
    if not np.any(D):
        return w
    # Every row has its diagonal.
    first, columns = pattern.places
    coupled = root * np.maximum.reduceat(np.abs(K) / root[columns], first[:-1])
    D = np.maximum(D, _TRACE * coupled)
    if np.all(_EPS * np.max(D / w) * w < D):
        return D
    count, part = balance.matrices.parts
    stiffest = np.zeros(count)
    np.maximum.at(stiffest, part, D / w)
    # A part without any stiffness is measured against the softest other one.
    stiffest[stiffest == 0] = np.min(stiffest[stiffest > 0])
    least = stiffest[part] * w
    return np.asarray(np.where(_EPS * least < D, D, _TRACE * least))
