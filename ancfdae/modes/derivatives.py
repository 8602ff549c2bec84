"""Design derivatives of modes, direct and transposed.

With R_b the derivative of [F(z) x + Phi_q^T mu, Phi_q x] at z, x and mu held, and a solution
[y, nu] of the transposed equations (itself [x, mu] where K and D are symmetric),

    z_b = -[y, nu]^T R_b / y^T F' x

Where modes coincide, X and Y are bases of theirs and the derivatives along one design variable
are the eigenvalues of -(Y^T F' X)^{-1} [Y, N]^T R_b: each mode moves apart by its own. They are
infinite where the shapes coincide too.

Shapes follow from the derivative of F(z) x + Phi_q^T mu = 0, singular along x: with the largest
entry k of x held and equation k left out it is regular and keeps its pattern (Nelson 1976). The
rest, c x, follows from the norm.

**Totals.** With f = M a + Phi_q^T lam - Q at rest, K x and D x are its derivatives along the
directions (0, x, 0) and (0, 0, x) of (t, q, v).

**Transposed**, without a design variable until the end: the product of an adjoint vector [y, nu]
with the derivative of [F(z) x + Phi_q^T mu, Phi_q x], z, x and mu held, is linear in q_b and lam_b:
on_q . q_b + on_lam . lam_b + on_b. Its parts are the transposed rates of f along motions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np
import scipy

from ancfdae.equations import StateDirection
from ancfdae.equations.saddle_points import held_pull_back, held_q, held_total
from ancfdae.equations.system import constraint_q_along
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.modes.eigenpairs import Eigenpairs, largest_entries
from ancfdae.modes.linearised import EPS, Linearised, split
from ancfdae.modes.precise import NoModes
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization


@final
@dataclass(frozen=True)
class Totals:
    """Total design derivatives of K x, D x and M x along q_b and lam_b of a configuration."""

    small: Linearised

    def stiffness(self, x: Array) -> Array:
        """Return the design derivative of K x at fixed x, shape (n_q, n_b)."""
        still = np.zeros(self.small.system.n_q)
        return split(lambda x: self._along(StateDirection(0.0, x, still)), x)

    def damping(self, x: Array) -> Array:
        """Return the design derivative of D x at fixed x, shape (n_q, n_b)."""
        still = np.zeros(self.small.system.n_q)
        return split(lambda x: self._along(StateDirection(0.0, still, x)), x)

    def _along(self, direction: StateDirection) -> Array:
        small, at = self.small, self.small.at
        still, held = np.zeros(small.system.n_q), np.zeros_like(small.q_b)
        states, states_b = (at.q, still, still, at.lam), (small.q_b, held, held, small.lam_b)
        return small.system.along_total(at.t, states, direction, states_b, (held, held))

    def mass(self, x: Array) -> Array:
        """Return the design derivative of M x at fixed x, shape (n_q, n_b)."""
        none = np.zeros(self.small.system.n_lam)
        return split(lambda x: self._held(x, none), x)

    def _held(self, a: Array, lam: Array) -> Array:
        small, at = self.small, self.small.at
        return held_total(small.system, at.t, at.q, a, lam, small.q_b)

    def pencil(self, z: complex, x: Array, mu: Array) -> tuple[Array, Array]:
        """Return design derivatives of F(z) x + Phi_q^T mu and Phi_q x at fixed z, x and mu."""
        system = self.small.system
        force, mass = self.stiffness(x), self.mass(x)
        if self.small.D is None:
            force = force - z * mass
        else:
            force = force + z * z * mass + z * self.damping(x)
        still = np.zeros(system.n_q)
        reactions = split(lambda mu: self._held(still, mu), mu)
        return force + reactions, split(lambda x: self._rate(x) - self._rate(0 * x), x)

    def _rate(self, x: Array) -> Array:
        """Return the design derivative of Phi' at a fixed velocity x, shape (n_lam, n_b)."""
        small, at = self.small, self.small.at
        motion_b = small.q_b, np.zeros_like(small.q_b)
        return small.system.constraint_total(at.t, (at.q, x), motion_b)


# -- transposed --------------------------------------------------------------------------------


# Function of covectors on q, lam and b that returns the design derivative, shape (n_b,).
PullBack: TypeAlias = Callable[[Array, Array, Array], Array]


@final
@dataclass(frozen=True)
class Transposed:
    """Covectors times design derivatives of the pencil; each (on_q, on_lam, on_b) in one array."""

    small: Linearised

    def pencil(self, y: Array, z: complex, x: Array, mu: Array) -> Array:
        """Return the gradient of [y, nu]^T [F(z) x + Phi_q^T mu, Phi_q x] at fixed z, x and mu."""
        n = self.small.system.n_q
        force, nu = y[:n], y[n:]
        total = _bilinear(self._stiffness, force, x)
        if self.small.D is None:
            total = total - z * _bilinear(self._mass, force, x)
        else:
            total = total + z * z * _bilinear(self._mass, force, x)
            total = total + z * _bilinear(self._damping, force, x)
        return total + _bilinear(self._joints, force, mu) + _bilinear(self._joints, x, nu)

    def _stiffness(self, y: Array, x: Array) -> Array:
        """Return the gradient of y^T K x in q, lam and b, at fixed y and x."""
        still = np.zeros(self.small.system.n_q)
        return self._along(y, StateDirection(0.0, x, still))

    def _damping(self, y: Array, x: Array) -> Array:
        """Return the gradient of y^T D x in q, lam and b, at fixed y and x."""
        still = np.zeros(self.small.system.n_q)
        return self._along(y, StateDirection(0.0, still, x))

    def _along(self, y: Array, direction: StateDirection) -> Array:
        system, at = self.small.system, self.small.at
        still = np.zeros(system.n_q)
        states = at.q, still, still, at.lam
        on_q, _, on_b = system.along_pull_back(at.t, states, direction, y)
        on_lam = system.constraint_pattern.dot(constraint_q_along(system, at.t, at.q, direction), y)
        return np.concatenate([on_q, on_lam, on_b])

    def _mass(self, y: Array, x: Array) -> Array:
        return self._held(y, x, np.zeros(self.small.system.n_lam))

    def _joints(self, x: Array, mu: Array) -> Array:
        """Return the gradient of x^T Phi_q^T mu in q, lam and b, at fixed x and mu."""
        return self._held(x, np.zeros(self.small.system.n_q), mu)

    def _held(self, y: Array, a: Array, lam: Array) -> Array:
        """Return the gradient of y^T (M a + Phi_q^T lam) in q, lam and b, at fixed y, a and lam."""
        system, at = self.small.system, self.small.at
        on_b = held_pull_back(system, at.t, at.q, a, lam, y)
        on_q = system.pattern.dot_transposed(held_q(system, at.t, at.q, a, lam), y)
        return np.concatenate([on_q, np.zeros(system.n_lam), on_b])


def pulled_back(small: Linearised, pull_back: PullBack, total: Array) -> Array:
    """Return the design derivative of a covector (on_q, on_lam, on_b), real or complex, (n_b,)."""
    n, m = small.system.n_q, small.system.n_lam
    return split(lambda on: pull_back(on[:n], on[n : n + m], on[n + m :]), total)


def _bilinear(product: Callable[[Array, Array], Array], y: Array, x: Array) -> Array:
    """Return a product of complex vectors that is bilinear over the real numbers."""
    return split(lambda y: split(lambda x: product(y, x), x), y)


# -- derivatives of modes ----------------------------------------------------------------------


#: z_b, shape (count, n_b), and X_b of each mode, shape (n_q, n_b); None where a mode coincides with
#: another, so that its shape is not unique, and by adjoints.
Derivatives: TypeAlias = tuple[Array, tuple[Array | None, ...]]


def differentiate(
    small: Linearised, pairs: Eigenpairs, mu: Array, groups: list[list[int]]
) -> Derivatives:
    """Return design derivatives of eigenvalues and shapes, by direct differentiation."""
    z_b = np.zeros((len(pairs.z), small.system.n_b), dtype=pairs.z.dtype)
    X_b: list[Array | None] = [None] * len(pairs.z)
    for group in groups:
        changes = [Totals(small).pencil(pairs.z[j], pairs.X[:, j], mu[:, j]) for j in group]
        R_b = np.stack([np.concatenate(change) for change in changes], axis=1)
        if not _drifts(small, pairs, group):
            Y = left_vectors(small, pairs, mu, group)
            z_b[group] = _values_b(small, pairs, group, Y, np.einsum("ki,kjb->bij", Y, R_b))
        # A motion at zero beside the integrals of states, at zero too, has no shape of its own.
        if len(group) == 1 and not (len(small.idle) and pairs.z[group[0]] == 0):
            j = group[0]
            X_b[j] = _shape_b(small, pairs.z[j], pairs.X[:, j], z_b[j], R_b[:, 0])
    return z_b, tuple(X_b)


def differentiate_back(
    small: Linearised, pairs: Eigenpairs, mu: Array, groups: list[list[int]], pull_back: PullBack
) -> Derivatives:
    """Return design derivatives of eigenvalues, by adjoints of the configuration."""
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
    """Whether the modes of a group are rigid motions of a damped system, with s = 0."""
    return small.D is not None and bool(pairs.z[group[0]] == 0)


# Shift for left vectors of coinciding modes, over the distance between these modes, and number of
# sweeps that remove components of other modes.
_ASIDE, _LEFT = 16.0, 2


def left_vectors(small: Linearised, pairs: Eigenpairs, mu: Array, group: list[int]) -> Array:
    """Return left vectors [y, nu] of coinciding modes as columns, (n_q + n_lam, k).

    They solve the transposed equations. With K or D asymmetric they come from inverse iteration at
    a shift farther from z than the modes of the group are from each other: at z the nearest mode
    would displace the rest of its group.
    """
    X, n = pairs.X[:, group], small.system.n_q
    if small.symmetric:
        return np.concatenate([X, mu[:, group]])
    right = np.zeros((n + small.system.n_lam, len(group)), dtype=X.dtype)
    right[:n] = np.conj(small.times(small.M, X))
    z, spread = pairs.z[group[0]], np.max(np.abs(pairs.z[group] - pairs.z[group[0]]))
    beside = 0.0 if len(group) == 1 else _ASIDE * max(spread, np.max(pairs.noise[group]))
    try:
        factors = small.factor_beside(z + beside)[0]
    except SingularMatrix as error:
        raise NoModes(
            f"mode {group[0]}: its exponent {z:.6g} is a double root with one "
            "shape, which has no derivative with respect to the design. Change the load, the "
            "damping or the design by more than a millionth of itself."
        ) from error
    Y = factors.solve_transposed(right)
    for _ in range(_LEFT if beside else 0):
        right[:n] = np.conj(small.times(small.M, np.linalg.qr(np.conj(Y[:n]))[0]))
        Y = factors.solve_transposed(right)
    return np.asarray(Y / np.max(np.abs(Y), axis=0))


def _values_b(
    small: Linearised, pairs: Eigenpairs, group: list[int], Y: Array, products: Array
) -> Array:
    """Return z_b of a group of g modes, shape (g, n_b), from products Y^T R_b, (n_b, g, g)."""
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
    """Whether coinciding modes also share their shape, as at critical damping; z_b is infinite.

    Y^T F' X is then singular, to the root of round-off, the accuracy of such eigenvalues. Each mode
    is measured by its own terms: of motions that creep at -1 over the retardation time, stiff and
    soft ones coincide, with shapes of their own.
    """
    Y = np.abs(Y[: small.system.n_q])
    size = Y.T @ small.times(np.abs(small.slope(abs(z))), np.abs(X))
    scale = 1 / np.sqrt(np.diag(size))
    G, size = (matrix * scale * scale[:, None] for matrix in (G, size))
    return bool(scipy.linalg.svdvals(G)[-1] <= EPS**0.5 * scipy.linalg.norm(size))


def _shape_b(small: Linearised, z: complex, x: Array, z_b: Array, R_b: Array) -> Array:
    """Return x_b of a simple eigenvalue by Nelson's method, shape (n_q, n_b)."""
    n = small.system.n_q
    k = int(largest_entries(small, x[:, None])[0])
    right = -R_b.astype(np.result_type(R_b, z_b))
    right[:n] -= np.outer(small.slope_times(z, x), z_b)
    right[k] = 0.0
    x_b = _held(small, z, k).solve(right)[:n]
    # x^H M x = 1 and the largest entry of x is real, so c is real.
    Mx = small.times(small.M, x)
    change = np.real(np.conj(x) @ Totals(small).mass(x))
    shape_b: Array = x_b - np.outer(x, np.real(np.conj(Mx) @ x_b) + change / 2)
    return shape_b


def _held(small: Linearised, z: complex, k: int) -> Factorization:
    """Return the factors of F(z) with Phi_q and coordinate k fixed."""
    system = small.system
    F, B = small.matrix(z).copy(), small.Phi_q.copy()
    rows, columns = system.pattern.rows, system.pattern.columns
    F[(rows == k) | (columns == k)] = 0.0
    # Any number will do; one as large as other entries gives pivots of similar size.
    F[system.pattern.index(np.array([k]), np.array([k]))] = small.size * system.weights[k]
    B[system.constraint_pattern.columns == k] = 0.0
    return small.saddle.factor(F, B)
