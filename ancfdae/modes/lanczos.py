"""Lowest modes of symmetric pencils by Lanczos's method, with a count that proves none is missing.

The inverse of F(shift) with the constraints maps every force to a motion that satisfies them. In
this module motions are rows, orthonormal in M. Of coinciding modes a Krylov space contains one, and
the others by round-off only, perhaps too late: the count shows whether one is missing.
"""

from __future__ import annotations

from typing import final

import numpy as np
import scipy

from ancfdae.modes.linearised import EPS, Linearised
from ancfdae.numerics.arrays import Array

# First shift, relative to the largest entry of K: round-off leaves zero at 1e-16 of it.
NEAR_ZERO = 1e-12
# A pair theta, x has converged where |F^-1 M x - theta x| is below _CONVERGED |theta|. _ENOUGH
# suffices to see whether a mode coincides with the last requested one, for relative differences
# above _NEXT_TO. At most _EACH rows are stored for each mode, and _BESIDE more.
_CONVERGED, _ENOUGH, _NEXT_TO, _EACH, _BESIDE = 1e-13, 1e-5, 0.01, 4, 120
# Modes are counted at this fraction of the distance from the last mode to the next, if round-off
# changes z by a fraction _TRUSTED of this distance at most.
BETWEEN, _TRUSTED = 0.25, 0.1
# A motion is orthogonalised again if less than this fraction of its length remained.
_LEFT = 0.5


@final
class Lanczos:
    """Ritz values of F(shift)^-1 M in a growing Krylov space, of which `count` are sought.

    The space is orthogonal in M to known motions, given as columns. Without a shift the matrix is
    M^-1 K, whose largest values are the highest z.
    """

    def __init__(
        self, small: Linearised, shift: float | None, count: int, known: Array | None = None
    ) -> None:
        self._small, self.shift, self._count = small, shift, count
        self.factors = (
            small.mass_factors
            if shift is None
            else small.saddle.factor(small.K - shift * small.M, small.Phi_q)
        )
        n = small.system.n_q
        self._known = np.zeros((0, n)) if known is None else np.ascontiguousarray(known.T)
        self._M_known = small.times(small.M, self._known.T).T
        self._most = min(small.n_free - len(self._known), _EACH * count + _BESIDE)
        self._V, self._MV = np.empty((2, self._most, n))
        self._T, self._m = np.zeros((self._most, self._most)), 0
        root = np.sqrt(small.system.weights)
        # A new start: an earlier one has no component in further copies of the modes it found.
        push = np.random.default_rng(1 + len(self._known)).standard_normal(n) * root
        self._next = self._solved(push)
        self._left = self._size(self._next)

    def converge(self, asked: int) -> bool:
        """Extend the space until `asked` values converge, others roughly; whether they do."""
        look = min(2 * self._count + 2, self._most)
        while self._m < self._most:
            self._extend()
            if self._m < look:
                continue
            # The Ritz values of a large space are not computed in every step.
            look = min(self._m + max(2, self._m // 8), self._most)
            theta, S = np.linalg.eigh(self._T[: self._m, : self._m])
            order = np.argsort(-theta if self.shift is None else -np.abs(theta))
            self._theta, self._S = theta[order], S[:, order]
            size = np.abs(self._theta[: self._count])
            residuals = self._left * np.abs(self._S[-1, : self._count])
            near = (
                size >= (1.0 - _NEXT_TO) * size[asked - 1] if asked else np.zeros(len(size), bool)
            )
            if np.all(residuals <= np.where(near, _CONVERGED, _ENOUGH) * size):
                return True
        return False

    @property
    def z(self) -> Array:
        """Sought eigenvalues z and the next one, by distance from the shift, shape (count + 1,)."""
        theta = self._theta[: self._count + 1]
        return np.asarray(theta if self.shift is None else self.shift + 1.0 / theta)

    @property
    def X(self) -> Array:
        """Shapes of the `count` sought eigenvalues z, as columns, shape (n_q, count)."""
        return np.asarray((self._S[:, : self._count].T @ self._V[: self._m]).T)

    def _extend(self) -> None:
        """Extend the Krylov space by one motion."""
        m, self._m = self._m, self._m + 1
        self._V[m], self._MV[m] = self._normal(m)
        K, far = self._small.K, self.shift is None
        y = self._solved(self._small.times(K, self._V[m]) if far else self._MV[m])
        along = self._MV[: m + 1] @ y
        self._T[m, : m + 1] = self._T[: m + 1, m] = along
        self._next = y - along @ self._V[: m + 1]
        self._left = self._size(self._next)

    def _normal(self, m: int) -> tuple[Array, Array]:
        """Return the next motion x of unit length, orthogonal to the first m motions, and M x."""
        x, before = self._next, self._left
        for _ in range(3):
            x = x - (self._MV[:m] @ x) @ self._V[:m]
            if len(self._known):
                x = x - (self._M_known @ x) @ self._known
            Mx = self._small.times(self._small.M, x)
            size = float(np.sqrt(x @ Mx))
            # The remainder of a dependent motion is round-off, as good a motion as any.
            x, Mx = x / size, Mx / size
            if size >= _LEFT * before:
                break
            before = 1.0
        return x, Mx

    def _size(self, x: Array) -> float:
        return float(np.sqrt(x @ self._small.times(self._small.M, x)))

    def _solved(self, force: Array) -> Array:
        """Return F(shift)^-1 times a force, (n_q,); its constraint error may exceed round-off."""
        right = np.zeros(self._small.saddle.size)
        right[: len(force)] = force
        return self.factors.solve_roughly(right)[: len(force)]


def lowest(small: Linearised, count: int, asked: int) -> tuple[Array, Array, Array] | None:
    """Return the lowest z = -s^2 of a symmetric pencil, increasing, shapes, and errors left in z.

    None unless no motion is rigid; the first `asked` modes, and all that coincide with them, have
    converged to all digits; and a count of negative eigenvalues shows that none of these is
    missing.
    """
    near = NEAR_ZERO * small.size
    space = Lanczos(small, -near, count)
    # Beside rigid motions the other modes would lose all digits.
    if not space.converge(0) or np.min(space.z) <= near or not space.converge(asked):
        return None
    z, X = space.z, space.X
    # The widest gap after the requested modes: a group of coinciding modes is not split.
    known = asked + int(np.argmax(np.diff(z[asked - 1 :]) / np.abs(z[asked:])))
    if not all_below(small, z[known - 1], z[known], X[:, :known]):
        return None
    found = ritz(small, small.constrained(space.factors, X))
    return None if found is None else (*found, np.abs(found[0] - z[:-1]))


def all_below(small: Linearised, last: float, beyond: float, X: Array) -> bool:
    """Whether X has as many columns as there are modes with z below a cut after `last`.

    The cut lies between z = `last` and the next z, `beyond`; False, too, if round-off hides it.
    """
    z = last + BETWEEN * (beyond - last)
    count = Count(small, z)
    return count.number == X.shape[1] and count.is_certain(X, z - last)


@final
class Count:
    """Number of modes below z, or above z; no fewer than there are.

    By Sylvester's law of inertia K - z M has a negative eigenvalue for each mode below z.
    """

    def __init__(self, small: Linearised, z: float, above: bool = False) -> None:
        diagonal = small.system.pattern.diagonal
        K, M = small.K, small.M
        self._D = np.abs(K[diagonal]) + np.abs(z) * M[diagonal]
        F = z * M - K if above else K - z * M
        self.number, self._growth = small.saddle.constrained.scaled(
            F, small.Phi_q, self._D
        ).negative()

    @property
    def fails(self) -> bool:
        """Whether pivots vanish, so that the count proves nothing."""
        return not np.isfinite(self._growth)

    def is_certain(self, X: Array, distance: float) -> bool:
        """Whether round-off changes z of the motions X, columns, by far less than a distance."""
        size = np.max(np.einsum("ij,i,ij->j", X, self._D, X), initial=0.0)
        return bool(EPS * self._growth * size <= _TRUSTED * distance)


def ritz(small: Linearised, Z: Array) -> tuple[Array, Array] | None:
    """Return values and shapes of a symmetric pencil in the span of the columns Z, increasing."""
    Z = Z / np.sqrt(small.squares(Z))
    K, M = (Z.T @ small.times(values, Z) for values in (small.K, small.M))
    # LAPACK itself: `eigh` takes four times as long for a few shapes.
    _, W, failed = scipy.linalg.lapack.dsygv((K + K.T) / 2, (M + M.T) / 2)
    if failed:
        return None
    X = Z @ W
    return np.einsum("ij,ij->j", X, small.times(small.K, X)) / small.squares(X), X
