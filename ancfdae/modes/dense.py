"""Eigenvalues of small systems, in coordinates that keep the constraints.

With N a basis of the null space of Phi_q, orthonormal in M, motions x = N y satisfy

    y'' + D_N y' + K_N y = 0,     D_N = N^T D N,  K_N = N^T K N
"""

import numpy as np
import scipy

from ancfdae.errors import InvalidInput
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.numerics.arrays import Array


def undamped(small: Linearised, count: int, highest: bool) -> tuple[Array, Array]:
    """Return z = -s^2 in increasing order of its real part, and the shapes as columns."""
    N, K = _reduced(small, small.K)
    first = len(K) - count if highest else 0
    if small.symmetric:
        z, Y = scipy.linalg.eigh((K + K.T) / 2, subset_by_index=[first, first + count - 1])
        return z, N @ Y
    z, Y = scipy.linalg.eig(K)
    chosen = np.lexsort((z.imag, z.real))[first : first + count]
    return z[chosen], N @ Y[:, chosen]


def damped(small: Linearised, rigid: Array) -> tuple[Array, Array]:
    """Return the exponents s with Im s >= 0 other than those of rigid motions, and their shapes.

    Rigid motions R, K_N R = 0, have s = 0. They are split off, and with them the drift T t, T the
    part of R without damping: in bases [P R] of positions and [S T] of velocities, the other
    exponents belong to

        p' = P^T S w,     w' = -S^T (K_N P p + D_N S w)

    Where K or D is not symmetric shapes lack their part in T, which inverse iteration adds. The
    columns of `rigid` are orthonormal in M.
    """
    assert small.D is not None
    N, K = _reduced(small, small.K)
    D = N.T @ small.times(small.D, N)
    R = N.T @ small.times(small.M, rigid)
    P, S = _complement(R), _complement(_undamped_part(small, N, rigid, R))
    p = P.shape[1]
    force = -np.hstack([K @ P, D @ S])
    J = np.vstack([np.hstack([np.zeros((p, p)), P.T @ S]), S.T @ force])
    s, W = scipy.linalg.eig(J)
    # A pair of complex conjugate exponents is one motion.
    W, s = W[:, s.imag >= 0], s[s.imag >= 0]
    return s, N @ (S @ W[p:])


def _reduced(small: Linearised, values: Array) -> tuple[Array, Array]:
    """Return N and the matrix in its coordinates."""
    system = small.system
    scale = 1 / np.sqrt(system.weights)
    N = np.diag(scale)
    if system.n_lam:
        rows = system.constraint_pattern.dense(small.Phi_q) * scale
        Q, _ = scipy.linalg.qr(rows.T / np.linalg.norm(rows, axis=1))
        N = scale[:, None] * Q[:, system.n_lam :]
    try:
        L = scipy.linalg.cholesky(N.T @ small.times(small.M, N), lower=True)
    except scipy.linalg.LinAlgError as error:
        raise InvalidInput(
            "mass matrix",
            "must give inertia to every motion that the joints leave",
            "a motion without inertia",
            "Give every coordinate inertia.",
        ) from error
    N = scipy.linalg.solve_triangular(L, N.T, lower=True).T
    return N, N.T @ small.times(values, N)


def _undamped_part(small: Linearised, N: Array, rigid: Array, R: Array) -> Array:
    """Return the rigid motions that meet no damping."""
    assert small.D is not None
    sizes = np.abs(N).T @ small.times(np.abs(small.D), np.abs(rigid))
    force = N.T @ small.times(small.D, rigid)
    _, left, Vt = scipy.linalg.svd(force)
    still = np.zeros(R.shape[1], dtype=bool)
    still[: len(left)] = left <= ROUND_OFF * EPS * scipy.linalg.norm(sizes)
    part: Array = R @ Vt[still].T
    return part


def _complement(R: Array) -> Array:
    """Return an orthonormal basis of what is orthogonal to orthonormal columns."""
    if R.shape[1] == 0:
        return np.eye(len(R))
    full: Array = scipy.linalg.qr(R)[0]
    return full[:, R.shape[1] :]
