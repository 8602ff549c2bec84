"""Eigenvalues of small systems by dense matrices, in independent coordinates.

!With N a basis of the null space of Phi_q, orthonormal in M, motions x = N y satisfy

    y'' + D_N y' + K_N y = 0,     D_N = N^T D N,  K_N = N^T K N
"""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
import scipy

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.modes.eigenpairs import undamped_part
from ancfdae.modes.linearised import Linearised
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.inertia import shifted_back, shifted_inverse


def undamped(small: Linearised, count: int, highest: bool) -> tuple[Array, Array]:
    """Return z = -s^2 of symmetric K, increasing, and the shapes as columns, (n_q, count)."""
    first = small.n_free - count if highest else 0
    within = _Within(small)
    L = _cholesky(within.matrix(small.M))
    K, _ = scipy.linalg.lapack.dsygst(within.matrix(small.K), L, lower=True)
    last = [first, first + count - 1]
    z, Y = scipy.linalg.eigh(K, subset_by_index=last, check_finite=False)
    return z, within.motions(scipy.linalg.lapack.dtrtrs(L, Y, lower=True, trans=1)[0])


def asymmetric(small: Linearised, rigid: Array) -> tuple[Array, Array, Array]:
    """Return z = -s^2 of an asymmetric K, relative errors of z, and shapes, (n_q, k).

    The rigid motions R, orthonormal in M, are left out. P, orthogonal to R, reduces K_N to P^T K_N
    P. The shapes lack their components in R, which inverse iteration adds.
    """
    N, K = _reduced(small, small.K)
    P = _complement(N.T @ small.times(small.M, rigid))
    inverse, g = shifted_inverse(P.T @ K @ P)
    theta, W = scipy.linalg.eig(inverse)
    return *shifted_back(theta, g), N @ (P @ W)


def damped(small: Linearised, rigid: Array, size: float) -> tuple[Array, Array]:
    """Return all exponents s with Im s >= 0, except zeros of rigid motions, and shapes.

    Exponents near `size`, 1/s, have most digits. Let sigma = size, or more where F(sigma) is not
    positive definite, F = sigma^2 + sigma D_N + K_N and F + F^T = 2 L L^T. The matrix

        [ -A    -Q ]     Q = sigma^2 G^-1 L^-1 L^-T,     A = Q + sigma G^-1 L^-1 D_N L^-T
        [ 1-A   -Q ]     G = L^-1 F L^-T

    acts on [L^T x, L^T v/sigma] and has the eigenvalues theta = sigma/(s - sigma). Where K and D
    are symmetric G = 1, and no block has a norm above 1, however stiff the bodies and however
    strong the damping. In x' = v, v' = -K x - D v round-off of D exceeds the low exponents s.

    Rigid motions R, K_N R = 0, have s = 0 and are left out, and so is the drift T t, with T the
    undamped motions in R. The matrix is restricted to the complement of L^T R in positions and of
    L^T T in velocities, from which shapes are taken. Shapes lack their component in T, which
    inverse iteration adds. The columns of `rigid` are orthonormal in M.
    """
    assert small.D is not None
    N, K = _reduced(small, small.K)
    D = N.T @ small.times(small.D, N)
    while True:
        F = size**2 * np.eye(len(K)) + size * D + K
        L, failed = scipy.linalg.lapack.dpotrf((F + F.T) / 2, lower=True)
        if not failed:
            break
        size *= 4.0

    def scaled(matrix: Array) -> Array:
        half = scipy.linalg.solve_triangular(L, matrix, lower=True)
        return np.asarray(scipy.linalg.solve_triangular(L, half.T, lower=True).T)

    parts = scaled(size**2 * np.eye(len(K))), scaled(size * D)
    if not small.symmetric:
        G = scipy.linalg.lu_factor(scaled(F))
        parts = scipy.linalg.lu_solve(G, parts[0]), scipy.linalg.lu_solve(G, parts[1])
    Q, A = parts[0], parts[0] + parts[1]
    P, S = (
        _complement(scipy.linalg.qr(L.T @ (N.T @ small.times(small.M, R)), mode="economic")[0])
        for R in (rigid, undamped_part(small, rigid))
    )
    J = np.block([[-P.T @ A @ P, -P.T @ Q @ S], [S.T @ P - S.T @ A @ P, -S.T @ Q @ S]])
    theta, W = scipy.linalg.eig(J)
    W, theta = W[:, theta.imag <= 0], theta[theta.imag <= 0]
    # Zero is an exponent at infinity.
    W, theta = W[:, theta != 0], theta[theta != 0]
    X = scipy.linalg.solve_triangular(L, S @ W[P.shape[1] :], lower=True, trans=1)
    return size + size / theta, N @ X


@final
@dataclass(frozen=True)
class _Within:
    """Motions that satisfy the constraints, in a basis orthonormal in the weights.

    The basis is the last columns of the Q of Phi_q^T = Q R, stored as a product of reflections: few
    constraints then cost little.
    """

    small: Linearised

    @cached_property
    def _scale(self) -> Array:
        return np.asarray(1 / np.sqrt(self.small.system.weights))

    @cached_property
    def _reflections(self) -> tuple[Array, Array]:
        rows = self.small.system.constraint_pattern.dense(self.small.Phi_q) * self._scale
        reflections, sizes, _, _ = scipy.linalg.lapack.dgeqrf(rows.T / np.linalg.norm(rows, axis=1))
        return reflections, sizes

    def _turned(self, x: Array, side: str, transposed: str) -> Array:
        """Return the product of x with Q, or its transpose, from the left or right."""
        if not self.small.system.n_lam:
            return x
        args = side, transposed, *self._reflections
        turned: Array = scipy.linalg.lapack.dormqr(*args, x, 64 * len(x), overwrite_c=True)[0]
        return turned

    def matrix(self, values: Array) -> Array:
        """Return M, or a symmetric K, in this basis, (n_q - n_lam,) * 2."""
        system = self.small.system
        # Transposed it lies in memory as LAPACK wants it.
        scaled = (self._scale[:, None] * system.pattern.dense(values) * self._scale).T
        turned = self._turned(self._turned(scaled, "L", "T"), "R", "N")
        return turned[system.n_lam :, system.n_lam :]

    def motions(self, Y: Array) -> Array:
        """Return coordinate changes, (n_q, k), of motions Y given in this basis, as columns."""
        held = np.zeros((self.small.system.n_lam, Y.shape[1]))
        return self._scale[:, None] * self._turned(np.concatenate([held, Y]), "L", "N")


def _cholesky(M: Array) -> Array:
    L, failed = scipy.linalg.lapack.dpotrf(M, lower=True)
    if failed:
        raise InvalidInputError(
            "mass matrix",
            "must give inertia to every motion that the joints leave",
            "a motion without inertia",
            "Give every coordinate inertia.",
        )
    return np.asarray(L)


def _reduced(small: Linearised, values: Array) -> tuple[Array, Array]:
    """Return N, (n_q, n_q - n_lam), and N^T A N for the matrix A of the given values."""
    within = _Within(small)
    L = _cholesky(within.matrix(small.M))
    N = within.motions(scipy.linalg.lapack.dtrtrs(L, np.eye(len(L)), lower=True, trans=1)[0])
    return N, N.T @ small.times(values, N)


def _complement(R: Array) -> Array:
    """Return an orthonormal basis, as columns, of the complement of the orthonormal columns R."""
    if R.shape[1] == 0:
        return np.eye(len(R))
    full: Array = scipy.linalg.qr(R)[0]
    return full[:, R.shape[1] :]
