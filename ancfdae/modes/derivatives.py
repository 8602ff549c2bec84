"""Design derivatives of modes.

With R_b the derivative of [F(z) x + Phi_q^T mu, Phi_q x] at z, x and mu held, and a solution
[y, nu] of the transposed equations (itself [x, mu] where K and D are symmetric),

    z_b = -[y, nu]^T R_b / y^T F' x

Where modes coincide, X and Y are bases of theirs and the derivatives along one design variable
are the eigenvalues of -(Y^T F' X)^{-1} [Y, N]^T R_b: each mode moves apart by its own. They are
infinite where the shapes coincide too.

Shapes follow from the derivative of F(z) x + Phi_q^T mu = 0, singular along x: with the largest
entry k of x held and equation k left out it is regular and keeps its pattern (Nelson 1976). The
rest, c x, follows from the norm.
"""

from typing import TypeAlias

import numpy as np
import scipy

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.modes.adjoint import PullBack, Transposed, pulled_back
from ancfdae.modes.linearised import EPS, Linearised
from ancfdae.modes.pairs import Eigenpairs, largest_entries
from ancfdae.modes.precise import NoModes
from ancfdae.modes.totals import Totals
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

#: z_b, shape (count, n_b), and for each mode X_b, shape (n_q, n_b): None for a mode that coincides
#: with another, whose shape is not unique, and by adjoints.
Derivatives: TypeAlias = tuple[Array, tuple[Array | None, ...]]


def differentiate(
    small: Linearised, pairs: Eigenpairs, mu: Array, groups: list[list[int]]
) -> Derivatives:
    """Differentiate eigenvalues and shapes, along the derivatives of the configuration."""
    z_b = np.zeros((len(pairs.z), small.system.n_b), dtype=pairs.z.dtype)
    X_b: list[Array | None] = [None] * len(pairs.z)
    for group in groups:
        changes = [Totals(small).pencil(pairs.z[j], pairs.X[:, j], mu[:, j]) for j in group]
        R_b = np.stack([np.concatenate(change) for change in changes], axis=1)
        if not _drifts(small, pairs, group):
            Y = left_vectors(small, pairs, mu, group)
            z_b[group] = _values_b(small, pairs, group, Y, np.einsum("ki,kjb->bij", Y, R_b))
        if len(group) == 1:
            j = group[0]
            X_b[j] = _shape_b(small, pairs.z[j], pairs.X[:, j], z_b[j], R_b[:, 0])
    return z_b, tuple(X_b)


def differentiate_back(
    small: Linearised, pairs: Eigenpairs, mu: Array, groups: list[list[int]], pull_back: PullBack
) -> Derivatives:
    """Differentiate eigenvalues by adjoints, through all that the configuration depends on."""
    z_b = np.zeros((len(pairs.z), small.system.n_b), dtype=pairs.z.dtype)
    for group in groups:
        if _drifts(small, pairs, group):
            continue
        Y = left_vectors(small, pairs, mu, group)
        products = [[_product(small, y, pairs, mu[:, j], j, pull_back) for j in group] for y in Y.T]
        z_b[group] = _values_b(small, pairs, group, Y, np.moveaxis(np.array(products), -1, 0))
    return z_b, (None,) * len(pairs.z)


def _product(
    small: Linearised, y: Array, pairs: Eigenpairs, mu: Array, j: int, pull_back: PullBack
) -> Array:
    total = Transposed(small).pencil(y, pairs.z[j], pairs.X[:, j], mu)
    return pulled_back(small, pull_back, total)


def _drifts(small: Linearised, pairs: Eigenpairs, group: list[int]) -> bool:
    """Whether modes are rigid motions among damped ones, which stay at s = 0."""
    return small.D is not None and bool(pairs.z[group[0]] == 0)


def left_vectors(small: Linearised, pairs: Eigenpairs, mu: Array, group: list[int]) -> Array:
    """Return solutions [y, nu] of the transposed equations as columns.

    Where they are not [x, mu], one step of inverse iteration: z is known to round-off, which is
    the part of other modes that it leaves.
    """
    X, n = pairs.X[:, group], small.system.n_q
    if small.symmetric:
        return np.concatenate([X, mu[:, group]])
    right = np.zeros((n + small.system.n_lam, len(group)), dtype=X.dtype)
    right[:n] = np.conj(small.times(small.M, X))
    try:
        factors = small.factor_beside(pairs.z[group[0]])[0]
    except SingularMatrix as error:
        raise NoModes(
            f"mode {group[0]}: its exponent {pairs.z[group[0]]:.6g} is a double root with one "
            "shape, which has no derivative with respect to the design. Change the load, the "
            "damping or the design by more than a millionth of itself."
        ) from error
    Y = factors.solve_transposed(right)
    return np.asarray(Y / np.max(np.abs(Y), axis=0))


def _values_b(
    small: Linearised, pairs: Eigenpairs, group: list[int], Y: Array, products: Array
) -> Array:
    """Return z_b of a group from the products Y^T R_b, (n_b, g, g); shape (g, n_b)."""
    z, g = pairs.z[group[0]], len(group)
    G = Y[: small.system.n_q].T @ small.slope_times(z, pairs.X[:, group])
    if g == 1:
        return np.asarray(-products[:, 0].T / G)
    if small.symmetric and small.D is None:
        return np.array([scipy.linalg.eigvalsh((a + a.T) / 2) for a in products]).reshape(-1, g).T
    if _is_defective(small, z, pairs.X[:, group], Y, G):
        return np.full((g, len(products)), np.inf)
    values = [np.sort_complex(scipy.linalg.eigvals(scipy.linalg.solve(G, -a))) for a in products]
    return np.array(values).reshape(-1, g).T


def _is_defective(small: Linearised, z: complex, X: Array, Y: Array, G: Array) -> bool:
    """Whether modes coincide in shape too, as at critical damping: they part like a root.

    Y^T F' X is then singular: zero to the root of round-off, to which such eigenvalues are known.
    """
    Y = np.abs(Y[: small.system.n_q])
    size = Y.T @ small.times(np.abs(small.slope(abs(z))), np.abs(X))
    return bool(scipy.linalg.svdvals(G)[-1] <= EPS**0.5 * scipy.linalg.norm(size))


def _shape_b(small: Linearised, z: complex, x: Array, z_b: Array, R_b: Array) -> Array:
    """Return x_b of a simple eigenvalue, shape (n_q, n_b)."""
    n = small.system.n_q
    k = int(largest_entries(small, x[:, None])[0])
    right = -R_b.astype(np.result_type(R_b, z_b))
    right[:n] -= np.outer(small.slope_times(z, x), z_b)
    right[k] = 0.0
    x_b = _held(small, z, k).solve(right)[:n]
    # x^H M x = 1 with the entry that is the largest real: c is real.
    Mx = small.times(small.M, x)
    change = np.real(np.conj(x) @ Totals(small).mass(x))
    shape_b: Array = x_b - np.outer(x, np.real(np.conj(Mx) @ x_b) + change / 2)
    return shape_b


def _held(small: Linearised, z: complex, k: int) -> Factorization:
    """Factorise F(z) with coordinate k held."""
    system = small.system
    F, B = small.matrix(z).copy(), small.Phi_q.copy()
    rows, columns = system.pattern.rows, system.pattern.columns
    F[(rows == k) | (columns == k)] = 0.0
    # Any number serves; one of the size of the others keeps the pivots alike.
    F[system.pattern.index(np.array([k]), np.array([k]))] = small.size * system.weights[k]
    B[system.constraint_pattern.columns == k] = 0.0
    return small.saddle.factor(F, B)
