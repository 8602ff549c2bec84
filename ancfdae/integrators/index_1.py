"""Index-1 form: accelerations and multipliers of a state, and the state back on the constraints.

    [ M      Phi_q^T ] [ a   ]   [ Q     ]
    [ Phi_q  0       ] [ lam ] = [ gamma ],

and the same matrix for their design derivatives.

Positions and velocities that drift are moved onto the constraints in the norm of M,

    M dq + Phi_q^T sigma = 0,   Phi_q dq = -Phi,
    M dv + Phi_q^T sigma = 0,   Phi_q dv = nu - Phi_q v,

by one Newton step: the drift of one integration step is small, and its square is round-off. The
matrix is that at the state before, the right side of the second line is at the moved q. The
design derivatives of the state are moved onto the derivatives of the constraints in the same way.
"""

from collections.abc import Callable
from typing import Any, TypeAlias, final

import numpy as np

from ancfdae.equations import ListedSystem, MechanicalSystem, reaction
from ancfdae.equations.held import acceleration_side, held_totals
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.kernels import SINGULAR, index_1
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint

# Up to this size a product with the inverse takes a third of the time of a band solve (measured:
# 106 unknowns, six columns, 6 against 27 us).
_INVERTED_SIZE = 200

# Solves for rows of right sides, (..., n_q) and (..., n_lam); None for zeros, not for both.
Solve: TypeAlias = Callable[[Array | None, Array | None], Array]


def stacked(q: Array, v: Array, q_b: Array | None = None, v_b: Array | None = None) -> Array:
    """Return a state and its design derivatives as one array, shape (2, 1 + n_b, n_q).

    q and v have the shape (n_q,), q_b and v_b (n_q, n_b); without these n_b is zero. Entry [0]
    of the result holds q and below it the columns of q_b as rows, entry [1] holds v and the columns
    of v_b.
    """
    states = np.stack([q, v])[:, None]
    if q_b is None or v_b is None:
        return states
    return np.concatenate([states, np.stack([q_b.T, v_b.T])], axis=1)


class Accelerations:
    """Solves for (a, lam) and keeps the factorised matrix while it does not change.

    For a constant mass and constant Phi_q it is factorised once in a whole run.
    """

    def __init__(self, system: MechanicalSystem, matrices: SaddlePoint) -> None:
        self._system, self._matrices = system, matrices
        self._Phi_q: Array | None = None
        self._factors: Factorization | None = None
        self._by_inverse: Solve | None = None
        self._constant = system.traits.constant_mass and system.traits.constant_constraints
        self.factorisations = 0

    def factors(self, t: float, q: Array) -> Factorization:
        """Return the factorised matrix at q."""
        Phi_q = self._system.constraint_q(t, q)
        if self._factors is None or not self._unchanged(Phi_q):
            self._factors = self._matrices.factor(self._system.mass(q), Phi_q)
            self._Phi_q, self._by_inverse = Phi_q, None
            self.factorisations += 1
        return self._factors

    def _unchanged(self, Phi_q: Array) -> bool:
        if not self._system.traits.constant_mass or self._Phi_q is None:
            return False
        return Phi_q is self._Phi_q or np.array_equal(Phi_q, self._Phi_q)

    def _solver(self, t: float, q: Array) -> Solve:
        """Return how to solve at q: by the inverse where a matrix is met again."""
        if self._by_inverse is not None and self._constant:
            return self._by_inverse
        before, size, n = self._factors, self._matrices.size, len(q)
        factors = self.factors(t, q)
        if factors is before and self._by_inverse is None and size <= _INVERTED_SIZE:
            self._by_inverse = _by_inverse(factors.solve(np.eye(size)).T, n)
        return self._by_inverse or (
            lambda force, side: factors.solve(_joined(force, side, n, size).T).T
        )

    def solve(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return accelerations a, (n_q,), and multipliers lam, (n_lam,), of a state."""
        x, n = self.rows(t, q[None], v[None])[0], self._system.n_q
        return x[:n], x[n:]

    def rows(self, t: float, q: Array, v: Array) -> Array:
        """Return (a, lam), and below it design derivatives if q and v have those as rows."""
        system, side = self._system, None
        if not system.traits.constant_constraints:
            side = acceleration_side(system, t, q[0], v[0])
        solve = self._solver(t, q[0])
        if len(q) == 1:
            return solve(system.force(t, q[0], v[0]), side)[None]
        Q = system.force_and_total(t, q, v)
        x = np.empty((len(q), self._matrices.size))
        first = x[0] = solve(Q[0], side)
        force, side_b = held_totals(system, t, q, v, first)
        x[1:] = solve(Q[1:] - force, None if side_b is None else -side_b)
        return x

    def projected(self, t: float, rows: Array) -> Array:
        """Return the rows of a state moved onto the constraints."""
        system, n, dot = self._system, self._system.n_q, self._system.constraint_pattern.dot
        solve = self._solver(t, rows[0, 0])

        def nearest(defect: Array) -> Array:
            """Smallest changes x with Phi_q x = defect, one row for each column."""
            return solve(None, defect.T)[..., :n]

        if system.traits.constant_constraints:
            all_rows = rows.reshape(-1, n)
            defect = dot(system.constraint_q(t, rows[0, 0]), all_rows.T)
            defect[:, 0] = system.constraint(t, rows[0, 0])
            return (all_rows - nearest(defect)).reshape(rows.shape)
        q, v = rows = rows.copy()
        q[0] -= nearest(system.constraint(t, q[0]))
        v[0] -= nearest(system.constraint(t, q[0], v[0]))
        if len(q) > 1:
            q_b, v_b = q[1:].T, v[1:].T
            q[1:] -= nearest(system.constraint_total(t, (q[0],), (q_b,)))
            v[1:] -= nearest(system.constraint_total(t, (q[0], v[0]), (q_b, v_b)))
        return rows

    def rows_of(self, t: Array, states: Array) -> Array:
        """Return `rows` of k states, (k, 2, rows, n_q)."""
        return np.array([self.rows(s, *state) for s, state in zip(t.tolist(), states, strict=True)])

    def projected_of(self, t: Array, states: Array) -> Array:
        """Return `projected` of k states."""
        pairs = zip(t.tolist(), states, strict=True)
        return np.array([self.projected(s, state) for s, state in pairs])

    #: Steps that a kernel takes at once: here every evaluation calls Python.
    steps_at_once: int = 1

    def for_kernel(self, rows: int) -> tuple[Any, ...]:
        """Return the equations as `explicit_march` takes them for states of some rows."""

        def told(
            function: Callable[[float, Array], Array],
        ) -> Callable[[float, Array], Array | int]:
            def call(t: float, state: Array) -> Array | int:
                try:
                    return function(t, state)
                except SingularMatrix:
                    return SINGULAR

            return call

        found = told(lambda t, state: self.rows(t, *state))
        return found, told(self.projected), self._system.n_lam

    def count(self, evaluations: int, projections: int) -> None:
        """Count what a kernel did; here the functions that it calls do."""

    @property
    def weights(self) -> Array:
        """Least masses of the coordinates, shape (n_q,)."""
        return self._system.weights

    def reaction_size(self, t: float, q: Array, lam: Array) -> float:
        """Weighted norm of Phi_q^T lam, as that of an acceleration a is of weights**0.5 * a."""
        force = reaction(self._system, t, q, lam) / np.sqrt(self._system.weights)
        return float(np.linalg.norm(force))


@final
class ListedAccelerations(Accelerations):
    """Accelerations of a system whose lists of operations a kernel evaluates."""

    steps_at_once = 64

    def __init__(self, system: ListedSystem, matrices: SaddlePoint) -> None:
        super().__init__(system, matrices)
        self._lists, self._others = system.index_1, (system.b, matrices.scale)

    def rows(self, t: float, q: Array, v: Array) -> Array:
        """Return (a, lam), and below it design derivatives if q and v have those as rows."""
        return only(self.rows_of(np.array([t]), np.stack([q, v])[None]))

    def rows_of(self, t: Array, states: Array) -> Array:
        """Return `rows` of k states, (k, 2, rows, n_q)."""
        lists, b, scale = self.for_kernel(states.shape[2])
        found = index_1(lists, b, scale, False, t, states)
        return self._found(found, t, states, self._matrices.size)

    def projected(self, t: float, rows: Array) -> Array:
        """Return the rows of a state moved onto the constraints."""
        return only(self.projected_of(np.array([t]), rows[None]))

    def projected_of(self, t: Array, states: Array) -> Array:
        """Return `projected` of k states."""
        lists, b, scale = self.for_kernel(states.shape[2])
        found = index_1(lists, b, scale, True, t, states)
        return self._found(found, t, states, states.shape[3])

    def _found(self, found: Array | int, t: Array, states: Array, size: int) -> Array:
        """Return what a kernel found: no numbers where a value is not finite."""
        self.factorisations += len(t)
        if not isinstance(found, int):
            return found
        if found == SINGULAR:
            raise SingularMatrix
        return np.full((*states.shape[:-1], size), np.nan)

    def for_kernel(self, rows: int) -> tuple[Any, ...]:
        """Return the equations as `explicit_march` takes them for states of some rows."""
        return self._lists(rows > 1), *self._others

    def count(self, evaluations: int, projections: int) -> None:
        """Count the matrices that a kernel factorised."""
        self.factorisations += evaluations + (projections if self._system.n_lam else 0)


def accelerations(system: MechanicalSystem, matrices: SaddlePoint) -> Accelerations:
    """Return what solves for the accelerations of a system."""
    if isinstance(system, ListedSystem):
        return ListedAccelerations(system, matrices)
    return Accelerations(system, matrices)


def _by_inverse(inverse: Array, n: int) -> Solve:
    """Solve by the inverse of the transposed matrix."""
    on_force, on_side = inverse[:n], inverse[n:]

    def solve(force: Array | None, side: Array | None) -> Array:
        if side is None:
            assert force is not None
            x: Array = np.dot(force, on_force)
            return x
        x = np.dot(side, on_side)
        return x if force is None else x + np.dot(force, on_force)

    return solve


def _joined(force: Array | None, side: Array | None, n: int, size: int) -> Array:
    """Return right sides as rows; zeros for None."""
    known = force if force is not None else side
    assert known is not None
    right = np.zeros((*known.shape[:-1], size), dtype=known.dtype)
    if force is not None:
        right[..., :n] = force
    if side is not None:
        right[..., n:] = side
    return right
