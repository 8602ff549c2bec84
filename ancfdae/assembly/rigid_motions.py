"""Rigid motions of all bodies of a scene at once, and what they do to coordinates.

A motion of a body is x = (u, g): a displacement u of its middle c, and a turn about it by the Gibbs
vector g (`numerics/rotations.py`). Positions go to c + u + R(g) (r - c), slopes to R(g) r_k.
"""

from __future__ import annotations

from typing import final

import numpy as np
import scipy

from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.numerics.rotations import cayley, cayley_partials


@final
class RigidMotions:
    """Rigid motions of bodies, x of shape (n_bodies, n_x).

    n_x counts d displacements, and one turn in the plane or three in space. `owner` is the body
    that each vector of the scene belongs to, from 0 on, `positions` whether it is one or a slope.
    """

    def __init__(self, owner: Array, positions: Array, d: int) -> None:
        self._owner, self._d, self._count = owner, d, int(owner[-1]) + 1
        self._is_position = positions.astype(float)
        self._per_body = np.bincount(owner, self._is_position)
        self.n_x = d + (1 if d == 2 else 3)

    @property
    def none(self) -> Array:
        """The zero motion of all bodies, shape (n_bodies, n_x)."""
        return np.zeros((self._count, self.n_x))

    def place(self, Z: Array, x: Array) -> Array:
        """Return vectors Z, shape (n_vectors, d), moved by x."""
        arms, centres = self._split(Z)
        turned = np.einsum("vij,vj->vi", cayley(x[:, self._d :], self._d)[self._owner], arms)
        return turned + self._on_positions(centres + x[:, : self._d])

    def tangent(self, Z: Array, x: Array) -> Array:
        """Return the partials of `place` in the motion of each vector's body, (n_vectors, d, n_x).

        At x = 0 they are the rigid velocities: translations, and e_k x (r - c).
        """
        arms, _ = self._split(Z)
        partials = cayley_partials(x[:, self._d :], self._d)[:, self._owner]
        turns = np.einsum("kvij,vj->vik", partials, arms)
        shifts = self._is_position[:, None, None] * np.eye(self._d)
        return np.concatenate([shifts, turns], axis=2)

    def matrix(self, T: Array) -> scipy.sparse.csr_array:
        """Return a tangent as a matrix, shape (n_q, n_bodies n_x)."""
        n, d, n_x = T.shape
        rows = np.broadcast_to(np.arange(n * d).reshape(n, d, 1), T.shape)
        columns = np.broadcast_to(self._owner[:, None, None] * n_x + np.arange(n_x), T.shape)
        shape = (n * d, self._count * n_x)
        return scipy.sparse.csr_array((T.ravel(), (rows.ravel(), columns.ravel())), shape=shape)

    def array(self, T: Array) -> Array:
        """Return `matrix` as an array."""
        n, d, n_x = T.shape
        matrix = np.zeros((n, d, self._count, n_x), dtype=T.dtype)
        matrix[np.arange(n), :, self._owner] = T
        return matrix.reshape(n * d, -1)

    def velocities(self, T: Array, x: Array) -> Array:
        """Return the product of `matrix` with rates x, (n_bodies, n_x): shape (n_q,)."""
        return np.asarray(np.einsum("vix,vx->vi", T, x[self._owner]).ravel())

    def reach(self, pattern: SparsityPattern, B: Array, T: Array) -> Array:
        """Return how far rows of B go with displacements, and with turns, (n_rows, 2)."""
        vector, axis = np.divmod(pattern.columns, self._d)
        pair = pattern.rows.astype(np.int64) * self._count + self._owner[vector]
        order = np.argsort(pair, kind="stable")
        begins = np.flatnonzero(np.diff(pair[order], prepend=-1))
        moved = np.abs(np.add.reduceat((B[:, None] * T[vector, axis])[order], begins))
        sizes = np.stack([x.max(axis=1) for x in np.split(moved, [self._d], axis=1)], axis=1)
        reach = np.zeros((pattern.shape[0], 2))
        np.maximum.at(reach, pair[order][begins] // self._count, sizes)
        return reach

    def blocks(self, values: Array) -> scipy.sparse.csr_array:
        """Return matrices of each body, (n_bodies, n_x, n_x), as one matrix of all motions."""
        first = np.arange(self._count)[:, None, None] * self.n_x
        rows, columns = np.indices(values.shape[1:])
        at = [np.broadcast_to(first + x, values.shape).ravel() for x in (rows, columns)]
        size = self._count * self.n_x
        return scipy.sparse.csr_array((values.ravel(), tuple(at)), shape=(size, size))

    def array_of_blocks(self, values: Array) -> Array:
        """Return `blocks` as an array."""
        count, n_x, _ = values.shape
        matrix = np.zeros((count, n_x, count, n_x), dtype=values.dtype)
        matrix[np.arange(count), :, np.arange(count)] = values
        return matrix.reshape(count * n_x, -1)

    def collect(self, T: Array, f: Array) -> Array:
        """Return T^T f, shape (n_bodies, n_x): forces f, (n_q,), on the rigid motions."""
        work = np.einsum("vix,vi->vx", T, f.reshape(-1, self._d))
        total = np.zeros((self._count, self.n_x), dtype=work.dtype)
        np.add.at(total, self._owner, work)
        return total

    def curvature(self, Z: Array, x: Array, f: Array) -> Array:
        """Return the partial of T^T f in x with f held, (n_bodies, n_x, n_x): turns only."""
        result = np.zeros((self._count, self.n_x, self.n_x))
        for k in range(self._d, self.n_x):
            moved = x.astype(complex)
            moved[:, k] += 1j * STEP
            result[:, :, k] = self.collect(self.tangent(Z, moved), f).imag / STEP
        return result

    def _split(self, Z: Array) -> tuple[Array, Array]:
        """Return the vectors with positions taken from the middle of their body, and middles."""
        total = np.zeros((self._count, self._d), dtype=Z.dtype)
        np.add.at(total, self._owner, self._is_position[:, None] * Z)
        centres = total / self._per_body[:, None]
        return Z - self._on_positions(centres), centres

    def _on_positions(self, of_bodies: Array) -> Array:
        return self._is_position[:, None] * of_bodies[self._owner]
