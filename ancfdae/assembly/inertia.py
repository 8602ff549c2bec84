"""Mass matrix of a scene, its design derivatives, and gravity."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.mass_blocks import MassBlocks
from ancfdae.assembly.numbering import Numbering
from ancfdae.kernels import Csr
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern

# Part of the largest moment of a rigid body that moments below it count as.
_LEAST = 1e-12


@final
class Inertia:
    """M, M_b and the force of gravity.

    Parameters
    ----------
    blocks : sequence of MassBlocks
    numbering : Numbering
    n_b : int
        Number of design variables.
    pattern : Pattern
        Pattern of the system's matrices; must hold the entries of every block.
    gravity : (array, shape (d,), array, shape (d, n_b))
        Acceleration of gravity, and its design derivatives.

    Attributes
    ----------
    values : array
        M on the pattern.
    weights : array, shape (n_q,)
        Real diagonal of M, of rigid bodies a least part of their largest moment.
    places : array, shape (n_q / d,)
        One for vectors that are positions, zero for slopes.
    """

    def __init__(
        self,
        blocks: Sequence[MassBlocks],
        numbering: Numbering,
        n_b: int,
        pattern: Pattern,
        gravity: tuple[Array, Array],
    ) -> None:
        self._n_b, self._n_q, self._d, self._blocks = (
            n_b,
            numbering.n_q,
            numbering.d,
            blocks,
        )
        n_q, d = self._n_q, self._d
        rows, columns, values = self._entries([(x.vectors, x.m) for x in blocks])
        self._pattern, self.values = pattern, pattern.gather(rows, columns, values)
        self.weights = self.values[pattern.index(np.arange(n_q), np.arange(n_q))].real.copy()
        # A direction of a rigid body may have no inertia of its own: a straight cable has none
        # across its axis, and what its integral leaves is round-off.
        directions = numbering.coordinates(numbering.frames[:, 1:])
        weights = self.weights[directions]
        self.weights[directions] = np.maximum(
            weights, _LEAST * np.max(weights, axis=1, keepdims=True)
        )
        (field, field_b), shape = gravity, (n_q // d, d)
        positions = np.concatenate([body.positions for body in numbering.bodies])
        self.places = np.zeros(shape[0])
        self.places[positions] = 1.0
        self._field = np.outer(self.places, field)
        # Rows of the variables that gravity depends on, to save memory.
        self._field_active = np.flatnonzero(np.any(field_b != 0, axis=0))
        self._field_b = np.zeros((len(self._field_active), *shape))
        self._field_b[:, positions] = field_b[:, self._field_active].T[:, None]

    @cached_property
    def _M(self) -> LinearMap:
        # Two of three entries of a spatial element are zero: masses do not couple directions.
        kept, pattern = np.flatnonzero(self.values), self._pattern
        return LinearMap.of(
            pattern.rows[kept], pattern.columns[kept], self.values[kept], pattern.shape
        )

    @cached_property
    def _M_b(self) -> LinearMap:
        """Map from a to columns of a row-major (n_b, n_q) array."""
        paired = [(x.vectors[x.pair_block], x.m_b) for x in self._blocks]
        rows, columns, values = self._entries(paired)
        counts = [self._d * x.vectors.shape[1] ** 2 for x in self._blocks]
        variables = zip((x.pair_variable for x in self._blocks), counts, strict=True)
        variable = np.concatenate([np.repeat(numbers, count) for numbers, count in variables])
        shape = (self._n_q * self._n_b, self._n_q)
        return LinearMap.of(variable * self._n_q + rows, columns, values, shape)

    @cached_property
    def gravity(self) -> Array:
        """Q_e = M (field of unit translations times g): eq. (12) without an integral of its own."""
        return self._M(self._field.ravel())

    @cached_property
    def gravity_b(self) -> Array:
        """Its design partials, shape (n_q, n_b)."""
        Q_b = self.times_b(self._field.ravel())
        if len(self._field_active):
            fields = self._field_b.reshape(len(self._field_b), -1)
            Q_b = Q_b.copy()
            Q_b[:, self._field_active] += self.times(fields.T)
        return Q_b

    @cached_property
    def gravity_rows(self) -> Array:
        """Gravity and its design partials as rows, shape (1 + n_b, n_q)."""
        return np.concatenate([self.gravity[None], self.gravity_b.T])

    @property
    def csr(self) -> Csr:
        """Arrays of M in compressed sparse rows."""
        return self._M.csr

    def times(self, x: Array) -> Array:
        """M x for a vector or for columns."""
        return self._M(x.T).T

    def times_b(self, a: Array) -> Array:
        """(M a)_b for one a or for rows, shape (..., n_q, n_b)."""
        return self._M_b(a).reshape((*a.shape[:-1], self._n_b, self._n_q)).mT

    def pull_back(self, a: Array, x: Array, gravity: bool = True) -> Array:
        """Sum over instants of (M a - gravity)_b^T x, shape (n_b,); a and x have shape (k, n_q)."""
        a = a - self._field.ravel() if gravity else a
        total = np.zeros(self._n_b, dtype=np.result_type(a, x))
        A, X = (y.reshape(len(y), -1, self._d) for y in (a, x))
        for block in self._blocks:
            # Sums over instants and axes first: x^T M_b a = M_b : (x a^T).
            at = block.vectors[block.pair_block]
            left, right = X[:, at].transpose(1, 2, 0, 3), A[:, at].transpose(1, 0, 3, 2)
            (n_pairs, n_a), inner = at.shape, len(a) * self._d
            sums = left.reshape(n_pairs, n_a, inner) @ right.reshape(n_pairs, inner, n_a)
            np.add.at(total, block.pair_variable, np.sum(block.m_b * sums, axis=(1, 2)))
        if gravity and len(self._field_active):
            fields = self._field_b.reshape(len(self._field_b), -1)
            total[self._field_active] -= fields @ self.times(np.sum(x, axis=0))
        return total

    def quadratic_b(self, v: Array, owner: int | None) -> Array:
        """Design partial of v^T M v of one owner or of all, shape (k, n_b)."""
        result = np.zeros((len(v), self._n_b), dtype=v.dtype)
        for block, products in self._pair_products(v, v):
            chosen = products * block.chosen(owner)[block.pair_block]
            np.add.at(result.T, block.pair_variable, chosen.T)
        return result

    def owner_times(self, v: Array, owner: int) -> Array:
        """M v with the masses of one owner only, for rows of v, shape (k, n_q)."""
        X = v.reshape(len(v), -1, self._d)
        # Vectors first: entries that come twice are added along the first axis.
        result = np.zeros((X.shape[1], len(v), self._d), dtype=np.result_type(v, self.values))
        for block in self._blocks:
            chosen = np.flatnonzero(block.chosen(owner))
            products = np.einsum("nab,knbd->nakd", block.m[chosen], X[:, block.vectors[chosen]])
            np.add.at(result, block.vectors[chosen], products)
        return result.swapaxes(0, 1).reshape(v.shape)

    def _pair_products(self, a: Array, x: Array) -> Iterator[tuple[MassBlocks, Array]]:
        """Yield x^T M_b a pair by pair, shape (k, n_pairs), of all blocks."""
        A, X = (y.reshape(len(y), -1, self._d) for y in (a, x))
        for block in self._blocks:
            at = block.vectors[block.pair_block]
            yield (
                block,
                np.einsum("kpad,pab,kpbd->kp", X[:, at], block.m_b, A[:, at], optimize=True),
            )

    def _entries(self, blocks: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, Array]:
        """Rows, columns and values of m (x) I_d for vectors (n, k) and m (n, k, k) of each."""
        lists: tuple[list[Array], ...] = ([], [], [])
        for vectors, m in blocks:
            coordinates = vectors[..., None] * self._d + np.arange(self._d)
            parts = np.broadcast_arrays(
                coordinates[:, :, None, :], coordinates[:, None, :, :], m[..., None]
            )
            for store, part in zip(lists, parts, strict=True):
                store.append(part.ravel())
        rows, columns, values = map(np.concatenate, lists)
        return rows, columns, values
