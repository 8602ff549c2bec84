"""Vectors of material points, many at once: U = L q, and forces on them lifted to L^T F."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.naming import PointVector, SceneNaming
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.elements import Quantity
from ancfdae.model.parts import CentreLine, FrameDirection, LineVector, Normal, StateVector
from ancfdae.model.parts import Vectors as Names
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import LinearMap


@final
@dataclass(frozen=True, eq=False)
class Vectors:
    """A list of point vectors as one linear map U = L q with design derivatives.

    Row d i + c of L is component c of vector i. Its entries stand row by row, those of row r are
    first[r] to first[r + 1] - 1; `change` are partials of the entries `changed`, in variables each.
    """

    d: int
    n_q: int
    n_b: int
    first: Array
    column: Array
    value: Array
    changed: Array
    variable: Array
    change: Array

    @staticmethod
    def of_points(vectors: Sequence[PointVector], d: int, n_q: int, n_b: int) -> Vectors:
        """Return the map of vectors."""
        place = np.concatenate([np.zeros(0, dtype=np.int64), *(x.vectors for x in vectors)])
        weight = np.concatenate([np.zeros(0), *(x.weights for x in vectors)])
        weight_b = np.concatenate([np.zeros((0, n_b)), *(x.weights_b for x in vectors)])
        owner = np.repeat(np.arange(len(vectors)), [len(x.weights) for x in vectors])
        used = np.flatnonzero((weight != 0) | (weight_b != 0).any(axis=1))
        turned = np.array([x.turned for x in vectors], dtype=bool)[owner[used]]
        axes = np.arange(d)[:, None]
        # U turned by a right angle is (-U_y, U_x).
        component = np.where(turned, 1 - axes, axes)
        sign = np.where(turned, 2 * axes - 1, np.ones_like(axes))
        # Vector by vector, and of each axis by axis.
        order = np.argsort((owner[used] * d + axes).ravel(), kind="stable")
        column = (place[used] * d + component).ravel()[order]
        value = (sign * weight[used]).ravel()[order]
        value_b = (sign[..., None] * weight_b[used]).reshape(len(order), n_b)[order]
        at, variable = np.nonzero(value_b)
        sizes = np.repeat(np.bincount(owner[used], minlength=len(vectors)), d)
        first = np.concatenate([[0], np.cumsum(sizes)])
        return Vectors(d, n_q, n_b, first, column, value, at, variable, value_b[at, variable])

    def couplings(self, which: slice) -> tuple[Array, Array]:
        """Return rows and columns of L_i^T L_j for all pairs of rows of L of some vectors.

        By pairs of rows, and of each by pairs of their entries.
        """
        first = self.first[which.start * self.d : which.stop * self.d + 1]
        row = np.repeat(np.arange(len(first) - 1), np.diff(first))
        column = self.column[first[0] : first[-1]]
        i, j = (x.ravel() for x in np.indices((len(row), len(row))))
        order = np.lexsort((j, i, row[j], row[i]))
        return column[i[order]], column[j[order]]

    def is_like(self, other: Vectors) -> bool:
        """Whether L has its entries where that of the other has them."""
        places = (self.first, other.first), (self.column, other.column)
        return all(np.array_equal(x, y) for x, y in places)

    @property
    def count(self) -> int:
        """Number of vectors of points."""
        return (len(self.first) - 1) // self.d

    @cached_property
    def _L(self) -> LinearMap:
        return LinearMap((self.first, self.column, self.value), self.n_q)

    @cached_property
    def moves(self) -> Array:
        """Whether L depends on each design variable, (n_b,)."""
        return np.asarray(np.bincount(self.variable, minlength=self.n_b) > 0)

    def moved(self, i: int) -> Vectors:
        """Return the vectors moved in design variable i by an imaginary step."""
        if not self.moves[i]:
            return self
        chosen, value = self.variable == i, self.value.astype(complex)
        value[self.changed[chosen]] += 1j * STEP * self.change[chosen]
        return replace(self, value=value)

    def of(self, q: Array) -> Array:
        """Return U for rows of q, shape (k, n_v, d)."""
        return self._L(q).reshape(len(q), self.count, self.d)

    def of_b(self, q: Array) -> Array:
        """Return the design partial of U with q held, shape (k, n_v, d, n_b)."""
        result = np.zeros((len(q), self.count, self.d, self.n_b), dtype=q.dtype)
        for i in np.flatnonzero(self.moves):
            result[..., i] = self.moved(int(i)).of(q.real).imag / STEP
        return result

    def lift(self, F: Array) -> Array:
        """Return L^T F, shape (k, n_v, d) to (k, n_q)."""
        return self._L.transposed(F.reshape(len(F), math.prod(F.shape[1:])))


def point_vectors(
    naming: SceneNaming,
    names: Names,
    places: Mapping[MaterialPoint, tuple[Array, Array]] | None = None,
) -> list[PointVector]:
    """Return the vectors that a joint or load names; `places` of points as for `Naming.vector`."""
    vectors = []
    on_lines = {x: naming.on_line(x) for x in {x for x in names if isinstance(x, LineVector)}}
    for name in names:
        if isinstance(name, CentreLine):
            vectors.append(naming.centre_line(name.beam))
        elif isinstance(name, LineVector):
            vectors.append(on_lines[name])
        elif isinstance(name, FrameDirection):
            vectors.append(naming.direction(name.body, name.number))
        elif isinstance(name, StateVector):
            vectors.append(naming.state(name.controller, name.number))
        elif isinstance(name, Normal):
            place = None if places is None else places[name.point]
            vectors.append(replace(naming.vector(name.point, Quantity.SLOPE_X, place), turned=True))
        else:
            vectors.append(naming.vector(*name, None if places is None else places[name[0]]))
    return vectors
