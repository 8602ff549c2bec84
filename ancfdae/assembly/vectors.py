"""Vectors of material points, many at once: U = L q, and forces on them lifted to L^T F."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import final

import numpy as np
import scipy

from ancfdae.kernels import Csr
from ancfdae.model.bodies import Point
from ancfdae.model.elements import Quantity
from ancfdae.model.naming import Naming, PointVector
from ancfdae.model.parts import CentreLine, Direction, Normal
from ancfdae.model.parts import Vectors as Names
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.linear_map import LinearMap


@final
class Vectors:
    """A list of point vectors as one linear map with design derivatives.

    `matrix` is L, (n_v d, n_q): row d i + c is component c of vector i. `moves`, (n_b,), tells
    whether it depends on each design variable.
    """

    def __init__(self, vectors: Sequence[PointVector], d: int, n_q: int, n_b: int) -> None:
        self._d, self._n_b, self._count = d, n_b, len(vectors)
        rows, columns, values, values_b = [], [], [], []
        for number, vector in enumerate(vectors):
            used = (vector.weights != 0) | np.any(vector.weights_b != 0, axis=1)
            for axis in range(d):
                # U turned by a right angle is (-U_y, U_x).
                component, sign = (1 - axis, 2 * axis - 1) if vector.turned else (axis, 1)
                columns.append(vector.vectors[used] * d + component)
                rows.append(np.full(int(np.sum(used)), number * d + axis))
                values.append(sign * vector.weights[used])
                values_b.append(sign * vector.weights_b[used])
        empty = np.zeros(0, dtype=np.int64)
        self._row, self._column = np.concatenate([empty, *rows]), np.concatenate([empty, *columns])
        self._value = np.concatenate([np.zeros(0), *values])
        value_b = np.concatenate([np.zeros((0, n_b)), *values_b])
        self._at, self._variable = np.nonzero(value_b)
        self._change = value_b[self._at, self._variable]
        self.moves = np.bincount(self._variable, minlength=n_b) > 0
        self._shape, self._moved = (self._count * d, n_q), dict[int, Vectors]()
        self._set(self._value)

    def _set(self, value: Array) -> None:
        self.matrix = scipy.sparse.csr_array((value, (self._row, self._column)), shape=self._shape)
        self._L = LinearMap(self.matrix)

    @property
    def csr(self) -> Csr:
        """Arrays of L in compressed sparse rows."""
        return self._L.csr

    def moved_by(self, i: int) -> Array:
        """Tell which vectors depend on design variable i, shape (n_v,)."""
        touched = np.zeros(self._count, dtype=bool)
        touched[self._row[self._at[self._variable == i]] // self._d] = True
        return touched

    def moved(self, i: int) -> Vectors:
        """Return the vectors moved in design variable i by an imaginary step."""
        if not self.moves[i]:
            return self
        if i not in self._moved:
            chosen, value = self._variable == i, self._value.astype(complex)
            value[self._at[chosen]] += 1j * STEP * self._change[chosen]
            self._moved[i] = copy.copy(self)
            self._moved[i]._set(value)
        return self._moved[i]

    def of(self, q: Array) -> Array:
        """Return U for rows of q, shape (k, n_v, d)."""
        return self._L.rows(q).reshape(len(q), self._count, self._d)

    def of_b(self, q: Array) -> Array:
        """Return the design partial of U with q held, shape (k, n_v, d, n_b)."""
        result = np.zeros((len(q), self._count, self._d, self._n_b), dtype=q.dtype)
        for i in np.flatnonzero(self.moves):
            result[..., i] = self.moved(int(i)).of(q.real).imag / STEP
        return result

    def lift(self, F: Array) -> Array:
        """Return L^T F, shape (k, n_v, d) to (k, n_q)."""
        return self._L.rows_transposed(F.reshape(len(F), math.prod(F.shape[1:])))


def point_vectors(
    naming: Naming, names: Names, places: Mapping[Point, tuple[Array, Array]] | None = None
) -> list[PointVector]:
    """Return the vectors that a joint or load names; `places` of points as for `Naming.vector`."""
    own = []
    for name in names:
        if isinstance(name, CentreLine):
            own.append(naming.centre_line(name.beam))
        elif isinstance(name, Direction):
            own.append(naming.direction(name.body, name.number))
        elif isinstance(name, Normal):
            place = None if places is None else places[name.point]
            own.append(replace(naming.vector(name.point, Quantity.SLOPE_X, place), turned=True))
        else:
            own.append(naming.vector(*name, None if places is None else places[name[0]]))
    return own
