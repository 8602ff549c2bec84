"""Equations F of rigid motions that close the joints (see `assembly.py`), and their Jacobian.

F = 0 is solved by `LeastNorm`: the solution of smallest norm, where bodies can move freely.

Least-norm solutions of least squares with a matrix that may lack rank (pseudo-inverse).

Small matrices K are solved by their singular values, large sparse ones by

    [ a E    K  ] [ r ]   [ b ]
    [ K^T  -a E ] [ x ] = [ 0 ],     x = (K^T K + a^2 E)^-1 K^T b,

whose matrix is regular for any rank of K, and by iterative refinement. The error for a singular
value s falls by a^2 / (a^2 + s^2) in each iteration. The null space of K does not enter if b is in
the range of K; the part of b outside adds round-off from the null space, up to 1e-2 of that part.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias, final

import numpy as np
import scipy

from ancfdae.assembly.constraints import JointConstraints
from ancfdae.assembly.rigid_motions import RigidMotions
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.patterns import SparsityPattern

#: delta: weight of the motions relative to the gaps of joints, both over the size of the mechanism.
SOFT = 1e-3

#: Unknowns of a problem: a motion of all free bodies, and multipliers sigma and rho.
Unknowns: TypeAlias = tuple[Array, Array, Array]
#: An array, or for large problems a sparse array of SciPy.
Matrix: TypeAlias = Any


@final
@dataclass(frozen=True)
class Declared:
    """Joints, coordinates and velocities of a scene as declared, at one design.

    `velocities` returns v for the coordinates q and the rotations x that brought the bodies there.
    """

    constraints: JointConstraints
    Z: Array
    velocities: Callable[[Array, Array], Array]


@final
@dataclass(frozen=True, eq=False)
class Closing:
    """Equations F = 0 that close the joints in positions or in velocities.

    `pattern` is the sparsity pattern of the system's tangents, on which constraints place their
    curvature. The first `rows` equations change with rigid motions; the others keep bodies rigid.
    `free`, (n_bodies, n_x), is whether components of motions may change: not the rotations of a
    body that leads. `size` is the size of the mechanism, m, rounded to a power of two, so that it
    does not change with the design.
    """

    motions: RigidMotions
    declared: Declared
    pattern: SparsityPattern
    rows: int
    free: Array
    size: float

    @cached_property
    def _places(self) -> Array:
        return np.flatnonzero(self.free)

    @cached_property
    def shift(self) -> Array:
        """Whether each free component of the rigid motions is a displacement, shape (n_free,)."""
        d = self.declared.Z.shape[1]
        is_shift = np.broadcast_to(np.arange(self.motions.n_x) < d, self.free.shape)
        return is_shift.ravel()[self._places]

    @cached_property
    def _units(self) -> Array:
        return np.where(self.shift, self.size, 1.0)

    @cached_property
    def _small(self) -> bool:
        """Whether matrices are dense arrays: for small ones SciPy's sparse arrays are slower."""
        return len(self._places) + 2 * self.rows <= DENSE

    @cached_property
    def _freedom(self) -> Matrix:
        """Matrix from scaled free components of the rigid motions to all components."""
        place = self._places, np.arange(len(self._places))
        shape = self.motions.none.size, len(self._places)
        return scipy.sparse.csr_array((self._units, place), shape=shape)

    @cached_property
    def flat(self) -> Matrix:
        """The zero matrix, for problems without curvature of the constraints."""
        n = len(self._places)
        return np.zeros((n, n)) if self._small else scipy.sparse.csr_array((n, n))

    def _moving(self, T: Array) -> Matrix:
        """Return the derivative of the coordinates in free motions, shape (n_q, n_free)."""
        if self._small:
            return self.motions.array(T)[:, self._places] * self._units
        return self.motions.matrix(T) @ self._freedom

    @cached_property
    def weights(self) -> Array:
        """Scale of each equation, shape (n_lam,): 1/size for lengths, 1 for dimensionless ones.

        Equations that change with displacements are lengths. Formulas may have any unit: their
        scale is one over their change in a motion of the size of the mechanism.
        """
        Z, constraints = self.declared.Z.real, self.declared.constraints
        B = constraints.constraint_q(0.0, Z.ravel()).real
        T = self.motions.tangent(Z, self.motions.none)
        by_shifts, by_turns = self.motions.reach(constraints.structure.pattern, B, T).T
        # Shifts of a body change equations in slopes by round-off only, whatever their length.
        is_length = by_shifts > 1e-9 * by_turns
        weights = np.where(is_length, 1.0 / self.size, 1.0)
        change = np.maximum(self.size * by_shifts, by_turns)
        formulas = constraints.structure.by_formulas & (change > 0)
        weights[formulas] = 0.5 ** np.round(np.log2(change[formulas]))
        return weights

    def start(self, soft: bool) -> Unknowns:
        """Return the unknowns at zero motion; if `soft`, joints may open: without multipliers."""
        rows = np.zeros(0 if soft else self.rows)
        return np.zeros(len(self._places)), rows, rows

    def motion(self, x: Array) -> Array:
        """Return the motion of all bodies, shape (n_bodies, n_x), from its free components x."""
        none = self.motions.none
        motion = none.astype(x.dtype).ravel()
        motion[self._places] = self._units * x
        return motion.reshape(none.shape)

    def placed(self, declared: Declared, x: Array) -> Array:
        """Return the coordinates, (n_q,), after the motions x of the bodies of `declared`."""
        return self.motions.place(declared.Z, self.motion(x)).ravel()

    def all_left(self, declared: Declared, *motion: Array) -> Array:
        """Return the scaled residuals of all joint equations, or of their rates, shape (n_lam,)."""
        return self.weights * declared.constraints.constraint(0.0, *motion)

    def left(self, declared: Declared, *motion: Array) -> Array:
        """Return the scaled residuals of joint equations that rigid motions can change, (rows,)."""
        return self.all_left(declared, *motion)[: self.rows]

    def at(self, declared: Declared, y: Unknowns) -> Array:
        """Return the residual F of the closing equations at unknowns y, bodies as `declared`."""
        motion, q = self.motion(y[0]), self.placed(declared, y[0])
        T = self.motions.tangent(declared.Z, motion)
        return self.equations(declared, q, T, y, self.left(declared, q))

    def equations(self, declared: Declared, q: Array, T: Array, y: Unknowns, left: Array) -> Array:
        """Return the closing equations (F_1, F_2, F_3); `left` holds the joints' residuals."""

        def work(multipliers: Array) -> Array:
            force = declared.constraints.reaction(0.0, q, self._spread(multipliers))
            return np.asarray(self._units * self.motions.collect(T, force).ravel()[self._places])

        x, sigma, rho = y
        shift = self.shift
        if len(sigma) < len(left):
            return work(left) + SOFT * x
        F_1, F_2 = np.where(shift, 0.0, x) + work(sigma), work(left)
        return np.concatenate([F_1, F_2, x[shift] + work(rho)[shift]])

    def _spread(self, multipliers: Array) -> Array:
        """Return multipliers of all joint equations, (n_lam,), from the first, scaled ones."""
        lam = np.zeros(len(self.weights), dtype=multipliers.dtype)
        lam[: self.rows] = self.weights[: self.rows] * multipliers
        return lam

    def jacobian(self, q: Array, T: Array) -> Matrix:
        """Return J, the derivative of the scaled residuals in free motions, (n_rows, n_free)."""
        constraints, moving = self.declared.constraints, self._moving(T)
        pattern, values = constraints.structure.pattern, constraints.constraint_q(0.0, q).real
        if self._small:
            return (self.weights[:, None] * pattern.dot(values, moving))[: self.rows]
        rows = scipy.sparse.diags_array(self.weights[: self.rows])
        return (rows @ pattern.csr(values)[: self.rows] @ moving).tocsr()

    def matrix_at(self, y: Unknowns) -> Matrix:
        """Return the Jacobian of F of `at` in (x, sigma, rho), or in x for soft equations."""
        x, sigma, rho = (part.real for part in y)
        Z, motion, constraints = self.declared.Z.real, self.motion(x), self.declared.constraints
        q = self.motions.place(Z, motion).ravel()
        T = self.motions.tangent(Z, motion)
        Phi = self.left(self.declared, q).real
        loads = (sigma, Phi, rho) if len(sigma) == len(Phi) else (Phi,)
        moving = self._moving(T)

        def bend(multipliers: Array) -> Matrix:
            """Return (J^T s)_x at fixed s: the curvature of the joints and of the rotations."""
            lam = self._spread(multipliers)
            values = only(constraints.constraint_force_q(q[None], lam[None], np.zeros(1))).real
            force = constraints.reaction(0.0, q, lam).real
            turns, units = self.motions.curvature(Z, motion, force), self._units
            if self._small:
                free = self.motions.array_of_blocks(turns)[np.ix_(self._places, self._places)]
                of_joints = moving.T @ self.pattern.dot(values, moving)
                return of_joints + units[:, None] * free * units
            of_joints = moving.T @ (self.pattern.csr(values) @ moving)
            return of_joints + self._freedom.T @ self.motions.blocks(turns) @ self._freedom

        return self.matrix(self.jacobian(q, T), [bend(s) for s in loads])

    def matrix(self, J: Matrix, bends: Sequence[Matrix]) -> Matrix:
        """Return the Jacobian of F from J and the curvatures of its three equations, or of one."""
        (m, n), shift = J.shape, self.shift
        if self._small:
            if len(bends) == 1:
                return J.T @ J + bends[0] + SOFT * np.eye(n)
            on_1, on_2, on_3 = bends
            whole = np.zeros((2 * n + int(np.sum(shift)), n + 2 * m))
            whole[:n, :n], whole[:n, n : n + m] = np.diag(np.where(shift, 0.0, 1.0)) + on_1, J.T
            whole[n : 2 * n, :n] = J.T @ J + on_2
            whole[2 * n :, :n], whole[2 * n :, n + m :] = (np.eye(n) + on_3)[shift], J.T[shift]
            return whole
        if len(bends) == 1:
            return (J.T @ J + bends[0] + SOFT * scipy.sparse.eye_array(n)).tocsr()
        one, none = np.where(shift, 0.0, 1.0), scipy.sparse.csr_array((n, m))
        on_1, on_2, on_3 = bends
        rows = np.flatnonzero(shift)
        blocks = [
            [scipy.sparse.diags_array(one) + on_1, J.T, none],
            [J.T @ J + on_2, none, none],
            [(scipy.sparse.eye_array(n) + on_3).tocsr()[rows], none[rows], J.T.tocsr()[rows]],
        ]
        return scipy.sparse.block_array(blocks).tocsr()


#: Most columns for which singular values cost less than refinement (measured on chains of bodies).
DENSE = 150
# Singular values below _RANK times the largest count as zero.
_RANK = 1e-10
# a over the largest entry of K: far below singular values that are not zero, far above round-off.
_SHIFT = 1e-7
_PASSES = 20


@final
class LeastNorm:
    """The pseudo-inverse of a real matrix K, which is sparse or has few columns."""

    def __init__(self, matrix: scipy.sparse.csr_array | Array) -> None:
        self._matrix, self._pinv = matrix, None
        if matrix.shape[1] <= DENSE:
            small = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
            self._pinv = np.linalg.pinv(small, rcond=_RANK)
        else:
            self._lu = _augmented(matrix)

    def solve(self, b: Array) -> Array:
        """Return the least-norm solution K^+ b, (n,), for a real or complex vector b, (m,)."""
        if self._pinv is not None:
            product: Array = self._pinv @ b
            return product
        if b.dtype.kind == "c":
            return self.solve(b.real) + 1j * self.solve(b.imag)
        x, last = np.zeros(self._matrix.shape[1]), np.inf
        for _ in range(_PASSES):
            right = np.concatenate([b - self._matrix @ x, np.zeros_like(x)])
            dx = self._lu.solve(right)[len(b) :]
            x, change = x + dx, float(np.max(np.abs(dx), initial=0.0))
            if change >= 0.5 * last or change <= _RANK**2 * np.max(np.abs(x)):
                break
            last = change
        return x

    def leaves_open(self, count: int) -> Array:
        """Return how far solutions may move in each of the first `count` unknowns.

        It is a generic vector less its part that K determines: zero where solutions are unique.
        """
        x = np.zeros(self._matrix.shape[1])
        x[:count] = np.cos(1.0 + np.arange(count) ** 2)
        return np.abs(x - self.solve(self._matrix @ x))[:count]


def _augmented(matrix: scipy.sparse.csr_array) -> scipy.sparse.linalg.SuperLU:
    rows, columns = matrix.shape
    shift = _SHIFT * float(np.max(np.abs(matrix.data), initial=0.0))
    diagonal = np.concatenate([np.full(rows, shift), np.full(columns, -shift)])
    entries = matrix.tocoo()
    i = np.concatenate([np.arange(rows + columns), entries.row, entries.col + rows])
    j = np.concatenate([np.arange(rows + columns), entries.col + rows, entries.row])
    values = np.concatenate([diagonal, entries.data, entries.data])
    whole = scipy.sparse.csc_array((values, (i, j)), shape=(rows + columns, rows + columns))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return scipy.sparse.linalg.splu(whole)
        except (RuntimeError, Warning) as error:
            raise SingularMatrix(str(error)) from error
