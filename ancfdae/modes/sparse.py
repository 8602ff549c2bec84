"""A few eigenvalues of large systems by ARPACK, with the factorised saddle-point matrix.

The inverse of F(shift) with the constraints maps every force to a motion that satisfies them, so
all Krylov vectors do. Shifts have the magnitude of the requested eigenvalues, from a rough
computation at a shift near zero. Symmetric systems without damping are left to `lanczos`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import scipy

from ancfdae.modes.eigenpairs import undamped_part
from ancfdae.modes.linearised import Linearised
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

# Map of positions and scaled velocities to others.
Advance: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]

# First shift, relative to the largest eigenvalue: round-off leaves zero at 1e-16 of it.
_NEAR_ZERO = 1e-9
# Tolerance of a rough computation, for magnitudes only.
_ROUGH = 1e-2
_SHIFTS = 6
# Restarts of Arnoldi's method for damped motions; three where exponents do not crowd.
_RESTARTS = 60


def undamped(
    small: Linearised, count: int, highest: bool, known: Array | None = None
) -> tuple[Array, Array]:
    """Return z = -s^2 of a K that is not symmetric, by real part, and the shapes as columns.

    The columns of `known`, orthonormal in M, are left out.
    """
    if highest:
        z, X = _highest(small, count, known)
        return z[::-1], X[:, ::-1]
    shift = -_NEAR_ZERO * small.size
    z, _ = _near(small, shift, count, _ROUGH, known)
    for _ in range(_SHIFTS):
        # A shift below all z: a growing motion may lie below the first one.
        shift = -1.5 * float(np.max(np.abs(z)))
        z, X = _near(small, shift, count, 0.0, known)
        if np.min(z.real) > shift:
            break
    return z, X


def damped(
    small: Linearised, count: int, size: float, highest: bool, rigid: Array
) -> tuple[Array, Array]:
    """Return exponents s with Im s >= 0, nearest to zero or farthest, and their shapes as columns.

    !Exponents of rigid motions are left out, as in `dense.damped`.

    With u = v / size the first-order form maps [x, u] to

        size u,   -M^{-1} (K x / size + D u)                                 of farthest exponents s
        x' = -F(size)^{-1} (size M u + (D + size M) x),   u' = x' + x / size            1/(s - size)

    `size` is the magnitude of the requested exponents, for example their natural frequencies; 1/s.
    """
    n, root = small.system.n_q, np.sqrt(small.system.weights)
    advance, factors = (_outwards if highest else _inwards)(small, size)
    drifting = undamped_part(small, rigid)

    def step(y: Array) -> Array:
        x, u = advance(y[:n] / root, y[n:] / root)
        x, u = _beside(small, x, rigid), _beside(small, u, drifting)
        return np.concatenate([root * x, root * u])

    start = root * _start(small, factors)
    OP = scipy.sparse.linalg.LinearOperator((2 * n, 2 * n), matvec=step, dtype=float)
    # ARPACK finds both exponents of a complex conjugate pair.
    theta, Y = scipy.sparse.linalg.eigs(
        OP, k=2 * count, v0=np.concatenate([start, start]), maxiter=_RESTARTS
    )
    s, X = theta if highest else size + 1 / theta, Y[:n] / root[:, None]
    return s[s.imag >= 0], X[:, s.imag >= 0]


def _outwards(small: Linearised, size: float) -> tuple[Advance, Factorization]:
    def advance(x: Array, u: Array) -> tuple[Array, Array]:
        assert small.D is not None
        force = small.times(small.K, x) / size + small.times(small.D, u)
        return size * u, -small.solve(small.mass_factors, force)

    return advance, small.mass_factors


def _inwards(small: Linearised, size: float) -> tuple[Advance, Factorization]:
    assert small.D is not None
    D, M = small.D + size * small.M, size * small.M
    factors = small.saddle.factor(small.matrix(size), small.Phi_q)

    def advance(x: Array, u: Array) -> tuple[Array, Array]:
        moved = -small.solve(factors, small.times(M, u) + small.times(D, x))
        return moved, moved + x / size

    return advance, factors


def _near(
    small: Linearised, shift: float, count: int, tolerance: float, known: Array | None = None
) -> tuple[Array, Array]:
    """Return eigenvalues z of K - z M near a shift, and shapes, without `known` modes."""
    factors = small.saddle.factor(small.K - shift * small.M, small.Phi_q)
    options = {"sigma": shift, "OPinv": _inverse(small, factors, known)}
    return _sorted(small, count, tolerance, factors, options)


def _highest(small: Linearised, count: int, known: Array | None = None) -> tuple[Array, Array]:
    """Return eigenvalues z of largest real part, and shapes, without `known` modes."""
    factors = small.mass_factors
    options = {"which": "LR", "Minv": _inverse(small, factors, known)}
    return _sorted(small, count, 0.0, factors, options)


def _sorted(
    small: Linearised,
    count: int,
    tolerance: float,
    factors: Factorization,
    options: dict[str, Any],
) -> tuple[Array, Array]:
    """Return sorted eigenvalues, (count,), and shapes, (n_q, count), by ARPACK.

    The start satisfies the constraints and has, whatever the symmetry of the system, a component in
    every mode.
    """
    n, M = small.system.n_q, small.system.pattern.csr(small.M)
    K = _operator(n, lambda x: small.times(small.K, x))
    start = _start(small, factors)
    z, X = scipy.sparse.linalg.eigs(K, count, M, v0=start, tol=tolerance, **options)
    order = np.argsort(z.real, kind="stable")
    return z[order], X[:, order]


def _inverse(
    small: Linearised, factors: Factorization, known: Array | None
) -> scipy.sparse.linalg.LinearOperator:
    """Return the inverse as an operator on motions orthogonal in M to known vectors."""

    def solve(force: Array) -> Array:
        x = small.solve(factors, force)
        return x if known is None else _beside(small, x, known)

    return _operator(small.system.n_q, solve)


def _beside(small: Linearised, x: Array, known: Array) -> Array:
    """Return x without its components in known vectors, orthogonal to them in M."""
    part: Array = x - known @ (known.T @ small.times(small.M, x))
    return part


def _start(small: Linearised, factors: Factorization) -> Array:
    """Return a random motion that satisfies the constraints, shape (n_q,)."""
    generator = np.random.default_rng(1)
    push = generator.standard_normal(small.system.n_q) * np.sqrt(small.system.weights)
    return small.solve(factors, push)


def _operator(n: int, times: Callable[[Array], Array]) -> scipy.sparse.linalg.LinearOperator:
    return scipy.sparse.linalg.LinearOperator((n, n), matvec=times, dtype=float)
