"""Mass matrix of a scene, its design derivatives, and gravity."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np

from ancfdae.ancf.block import ElementBlock
from ancfdae.ancf.numbering import Numbering
from ancfdae.ancf.parameters import ParameterMap
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern


@final
class Inertia:
    """M, M_b and the force of gravity.

    Parameters
    ----------
    block, numbering, mapping, n_b, pattern
        As in `ElasticForces`.
    gravity : (array, shape (d,), array, shape (d, n_b))
        Acceleration of gravity, and its design derivatives.

    Attributes
    ----------
    values : array
        M on the pattern.
    weights : array, shape (n_q,)
        Real diagonal of M.
    places : array, shape (n_q / d,)
        One for vectors that are positions, zero for slopes.
    """

    def __init__(
        self,
        block: ElementBlock,
        numbering: Numbering,
        mapping: ParameterMap,
        n_b: int,
        pattern: Pattern,
        gravity: tuple[Array, Array],
    ) -> None:
        self._n_b, self._numbering, self._block = n_b, numbering, block
        self._pair_element = mapping.elements[block.mass_pairs]
        self._pair_variable = mapping.variables[block.mass_pairs]
        n_q, element = numbering.n_q, numbering.element
        rows, columns, values = self._entries(block.m, numbering.vectors)
        self._pattern, self.values = pattern, pattern.gather(rows, columns, values)
        self.weights = self.values[pattern.index(np.arange(n_q), np.arange(n_q))].real
        (field, field_b), shape = gravity, (n_q // element.d, element.d)
        self.places = np.zeros(shape[0])
        self.places[:: element.n_s] = 1.0
        self._field = np.outer(self.places, field)
        # Rows of the variables that gravity depends on, to save memory.
        self._field_active = np.flatnonzero(np.any(field_b != 0, axis=0))
        self._field_b = np.zeros((len(self._field_active), *shape))
        self._field_b[:, :: element.n_s] = field_b[:, self._field_active].T[:, None]

    @cached_property
    def _M(self) -> LinearMap:
        return LinearMap(self._pattern.csr(self.values))

    @cached_property
    def _M_b(self) -> LinearMap:
        """Map from a to columns of a row-major (n_q, n_b) array."""
        element, n_q = self._numbering.element, self._numbering.n_q
        vectors = self._numbering.vectors[self._pair_element]
        rows, columns, values = self._entries(self._block.m_b, vectors)
        variable = np.repeat(self._pair_variable, element.d * element.n_a**2)
        shape = (n_q * self._n_b, n_q)
        return LinearMap.of(rows * self._n_b + variable, columns, values, shape)

    @cached_property
    def gravity(self) -> Array:
        """Q_e = M (field of unit translations times g): eq. (12) without an integral of its own."""
        return self._M(self._field.ravel())

    @cached_property
    def gravity_b(self) -> Array:
        """Its design partials, shape (n_q, n_b)."""
        Q_b = only(self.times_b(self._field.reshape(1, -1)))
        if len(self._field_active):
            fields = self._field_b.reshape(len(self._field_b), -1)
            Q_b = Q_b.copy()
            Q_b[:, self._field_active] += self.times(fields.T)
        return Q_b

    def times(self, x: Array) -> Array:
        """M x for a vector or for columns."""
        return self._M.columns(x)

    def times_b(self, a: Array) -> Array:
        """(M a)_b for rows of a, shape (k, n_q, n_b)."""
        return self._M_b.rows(a).reshape(len(a), self._numbering.n_q, self._n_b)

    def pull_back(self, a: Array, x: Array, gravity: bool = True) -> Array:
        """Sum over instants of (M a - gravity)_b^T x, shape (n_b,); a and x have shape (k, n_q)."""
        a = a - self._field.ravel() if gravity else a
        per_pair = np.sum(self._pair_products(a, x), axis=0)
        total = np.bincount(self._pair_variable, per_pair, minlength=self._n_b).astype(float)
        if gravity and len(self._field_active):
            fields = self._field_b.reshape(len(self._field_b), -1)
            total[self._field_active] -= fields @ self.times(np.sum(x, axis=0))
        return total

    def quadratic_b(self, v: Array, chosen: Array) -> Array:
        """Design partial of v^T M v over the chosen elements, shape (k, n_b)."""
        per_pair = self._pair_products(v, v) * chosen[self._pair_element]
        result = np.zeros((len(v), self._n_b), dtype=per_pair.dtype)
        np.add.at(result.T, self._pair_variable, per_pair.T)
        return result

    def chosen_times(self, v: Array, chosen: Array) -> Array:
        """M v with the masses of the chosen elements only, for rows of v, shape (k, n_q)."""
        coordinates = self._numbering.coordinates(self._numbering.vectors)
        products = np.einsum("n,nab,knbd->knad", chosen, self._block.m, v[:, coordinates])
        result = np.zeros(v.shape, dtype=products.dtype)
        np.add.at(result.T, coordinates.ravel(), products.reshape(len(v), -1).T)
        return result

    def _pair_products(self, a: Array, x: Array) -> Array:
        """x^T M_b a pair by pair, shape (k, n_pairs)."""
        coordinates = self._numbering.coordinates(self._numbering.vectors[self._pair_element])
        products: Array = np.einsum(
            "kpad,pab,kpbd->kp",
            x[:, coordinates],
            self._block.m_b,
            a[:, coordinates],
            optimize=True,
        )
        return products

    def _entries(self, m: Array, vectors: Array) -> tuple[Array, Array, Array]:
        """Rows, columns and values of m (x) I_d for every element."""
        coordinates = self._numbering.coordinates(vectors)
        rows, columns, values = np.broadcast_arrays(
            coordinates[:, :, None, :], coordinates[:, None, :, :], m[..., None]
        )
        return rows.ravel(), columns.ravel(), values.ravel()
