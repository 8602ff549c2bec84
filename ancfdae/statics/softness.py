"""Motions that meet the least stiffness, and those that meet none.

Stiffness is measured against the diagonal of K, D = |diag K|: kappa = phi^T K phi / phi^T D phi
over motions that keep the constraints, Phi_q phi = 0. Measured against the mass the slowest
bending of a beam would be (h/L)^4, which round-off hides; against D it is (h/L)^2 / n^2, with n
elements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from ancfdae.equations.saddle_points import solve
from ancfdae.errors import SingularMatrix
from ancfdae.numerics.arrays import Array
from ancfdae.statics.balance import Balance

# Motions looked for at once, and sweeps of the inverse iteration.
_MOTIONS, _SWEEPS = 8, 6
# Stiffness below this is round-off, which leaves up to 5e-16; a beam of 400 elements and
# h/L = 1e-4 has 9e-14. A negative one must be clear of it, and K is shifted by more than eps, so
# that it can be factorised.
_FREE, _NEGATIVE, _SHIFT = 4e-15, -1e-14, 1e-14


@final
@dataclass(frozen=True)
class Softness:
    """Softest motions of a configuration, (n_q, k), with the stiffness kappa of each, rising.

    It is stable if none of these motions meets a negative stiffness.
    """

    kappa: Array
    motions: Array
    stable: bool

    @property
    def free(self) -> Array:
        """Motions without stiffness, shape (n_q, number)."""
        return self.motions[:, self.kappa <= _FREE]


def softest(balance: Balance, s: float, q: Array, lam: Array, mu: float = 0.0) -> Softness:
    """Return the softest motions, at the load fraction s, by inverse iteration on a block.

    With mu, of K + mu M_0.
    """
    system, q, lam = balance.system, q.real, lam.real
    K = balance.tangent(s, q, lam).real + mu * balance.M_0.real
    D = stiffness_of_coordinates(balance, K)
    root = np.sqrt(D)[:, None]
    count = min(_MOTIONS, system.n_q - system.n_lam)
    if count <= 0:
        return Softness(np.zeros(0), np.zeros((system.n_q, 0)), True)
    shifted = K.copy()
    shifted[balance.system.pattern.diagonal] += _SHIFT * D
    none = np.zeros((system.n_lam, count))
    X = np.random.default_rng(0).standard_normal((system.n_q, count)) / root
    try:
        factors = balance.factor(shifted, balance.Phi_q(q))
        for _ in range(_SWEEPS):
            X = solve(factors, D[:, None] * X, none)[0].real
            X = _orthonormal(root * X) / root
    except SingularMatrix:  # Of K and Phi_q together: constraints that depend on each other here.
        return Softness(np.zeros(0), np.zeros((system.n_q, 0)), True)
    projected = X.T @ system.pattern.dot(K, X)
    _, kappa, V = np.linalg.svd(projected)
    stable = bool(np.all(np.linalg.eigvals(projected).real > _NEGATIVE))
    return Softness(kappa[::-1], X @ V.T[:, ::-1], stable)


def _orthonormal(X: Array) -> Array:
    """Return an orthonormal basis of columns; without the checks that cost a small one more."""
    reflectors, tau, *_ = scipy.linalg.lapack.dgeqrf(X)
    return scipy.linalg.lapack.dorgqr(reflectors, tau)[0]


def stiffness_of_coordinates(balance: Balance, K: Array) -> Array:
    """|diag K|; where it vanishes a trace of the stiffest one, by weight."""
    w, D = balance.system.weights, np.abs(K[balance.system.pattern.diagonal])
    return np.asarray(np.maximum(D, 1e-8 * np.max(D / w) * w) if np.any(D) else w)
