"""Stability of an equilibrium, and the motions with the lowest stiffness.

Stiffness is relative to the diagonal of K, D = |diag K|: kappa = phi^T K phi / phi^T D phi over
motions that keep the constraints, Phi_q phi = 0. Relative to the mass the slowest bending of a
beam would be of the order (h/L)^4, which round-off hides; relative to D it is (h/L)^2 / n^2, with
n elements.

An equilibrium is stable if no motion has negative stiffness; all negative ones are counted
(`numerics/inertia.py`), because one far from zero is not among the lowest in magnitude. With
follower loads K is not symmetric. Then real negative eigenvalues on the constraints are sought,
motions that leave without returning (divergence): there is none where the symmetric part of K is
positive definite; there is one where the determinant is negative, and else all candidates are
computed. They are eigenvalues of K phi = omega^2 M phi on the constraints: motions that diverge do
so against their inertia, and which of an even number do depends on it. Flutter, pairs of complex
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

# Number of motions in a block, and number of sweeps of the inverse iteration.
_MOTIONS, _SWEEPS = 8, 6
# Stiffness kappa below _FREE is round-off, which is up to 5e-16; a beam of 400 elements and
# h/L = 1e-4 has 9e-14. Negative stiffness must exceed it in magnitude. K is shifted by _SHIFT, more
# than eps, so that it can be factorised.
_FREE, _SHIFT = 4e-15, 1e-14
# Fraction of a coupled stiffness to which a coordinate without stiffness of its own is relative.
_TRACE, _EPS = 1e-8, float(np.finfo(float).eps)
# K is proven to be positive definite if all stiffness exceeds half of this.
_PROVEN = 1e-13
# Thresholds of negative stiffness; the first at which pivots can be trusted is used.
_CLEAR = tuple(1e-14 * 16.0**k for k in range(12))


@final
@dataclass(frozen=True)
class Softness:
    """Stiffness of a configuration on the motions that keep its constraints.

    K and Phi_q are entries on the patterns of the system, D, (n_q,), is the diagonal to which the
    stiffness is relative.
    """

    balance: Balance
    K: Array
    Phi_q: Array
    D: Array

    @cached_property
    def definite(self) -> bool:
        """Whether K is proven to be positive definite; False if only its motions could show it."""
        self.balance.work.factorisations += self._matrix.pattern.wide
        return self._matrix.definite(_PROVEN)

    @cached_property
    def stable(self) -> bool:
        """Whether no motion has negative stiffness; with follower loads, whether none diverges."""
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
        """Exponent, 1/s, of the vibration that follower loads let grow without damping; or None."""
        return self._matrix.growing(self._M) if self.follows else None

    @property
    def seen_whole(self) -> bool:
        """Whether all motions were searched for flutter, not only some nearest to zero."""
        return not self.follows or self._matrix.seen_whole

    @cached_property
    def _M(self) -> Array:
        scale, pattern = 1.0 / np.sqrt(self.D), self.balance.system.pattern
        return self.balance.M_0.real * scale[pattern.rows] * scale[pattern.columns]

    @property
    def follows(self) -> bool:
        """Whether K is not symmetric because of follower loads, so that the system may flutter."""
        return not self.balance.system.traits.symmetric and self._matrix.skewness > _CLEAR[0]

    @property
    def judged(self) -> bool:
        """Whether the sign of every stiffness is certain; False if one may be round-off.

        Negative ones are counted down to the least threshold at which pivots can be trusted;
        between it and zero the softest motions decide.
        """
        matrix = self._matrix
        if matrix.below(_CLEAR[0]) is not None:
            return True
        if counted(matrix) is None:
            return False
        return bool(np.all(np.abs(self._values) > self.noise))

    @cached_property
    def _values(self) -> Array:
        """Ritz values of the symmetric part of K in the space of the softest motions, ascending."""
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
        """Relative stiffness of the softest motions by magnitude, rising, shape (k,)."""
        return self._softest[0]

    @property
    def motions(self) -> Array:
        """Motions with the lowest stiffness, shape (n_q, k)."""
        return self._softest[1]

    @property
    def multipliers(self) -> Array:
        """Multipliers mu, (n_lam, k), of the motions x: K x + Phi_q^T mu = +-kappa D x."""
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

    It is zero where `counted` cannot count them.
    """
    return counted(matrix) or 0


def counted(matrix: ConstrainedMatrix) -> int | None:
    """Return the number of motions with negative stiffness; None if no pivots can be trusted."""
    counts = map(matrix.below, _CLEAR)
    count = next((count for count in counts if count is not None), None)
    return matrix.below_densely(_CLEAR[0]) if count is None else count


def softest(balance: Balance, s: float, q: Array, lam: Array, mu: float = 0.0) -> Softness:
    """Return the stiffness of a state at load factor s; with mu, of K + mu M_0."""
    q, lam = q.real, lam.real
    K = balance.tangent(s, q, lam).real + mu * balance.M_0.real
    return Softness(balance, K, balance.Phi_q(q).real, stiffness_of_coordinates(balance, K))


def _orthonormal(X: Array) -> tuple[Array, Array]:
    """Return the QR factors of the columns of X, without SciPy's checks, which cost more."""
    reflectors, tau, *_ = scipy.linalg.lapack.dgeqrf(X)
    R = np.triu(reflectors[: X.shape[1]])
    return scipy.linalg.lapack.dorgqr(reflectors, tau)[0], R


def stiffness_of_coordinates(balance: Balance, K: Array) -> Array:
    """Return |diag K|, (n_q,); a small fraction of a coupled stiffness where it vanishes.

    A coordinate without stiffness of its own may be coupled to others, as by a load. Parts that no
    element or joint connects do not affect each other: a strip of foil has its own scale of
    stiffness, whatever stands beside it.
    """
    pattern, w = balance.system.pattern, balance.system.weights
    D, root = np.abs(K[pattern.diagonal]), np.sqrt(w)
    if not np.any(D):
        return w
    # The pattern contains the diagonal of every row.
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
