"""Vectors of named points as linear maps of coordinates, U = L q, and names in results.

A `SceneNaming` maps coordinates to vectors of named points, and lam to the multipliers of a joint.
`Vectors` holds the vectors of many points; L^T F are the generalised forces of forces F on them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np

from ancfdae.assembly.layout import BeamLayout, BodyLayout, Layout
from ancfdae.assembly.rigid_motions import deforms, motions_in_words
from ancfdae.equations.naming import Naming
from ancfdae.errors.checks import named, require_index
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.model.parts import CentreLine, FrameDirection, LineVector, Normal, StateVector
from ancfdae.model.parts import Vectors as Names
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import LinearMap

# Largest number of cached vectors of points.
_KEPT = 64


@final
@dataclass(frozen=True)
class PointVector:
    """A position or slope vector of a material point as a combination of vectors of its body.

    `vectors`, (n_a,), are their indices in the scene; vector k has the coordinates d k to d k + d -
    1. `weights` is (n_a,), with design derivatives (n_a, n_b). If `turned`, the vector is this
    combination rotated by a right angle from x to y, which `Vectors` takes into account.
    """

    vectors: Array
    weights: Array
    weights_b: Array
    turned: bool = False

    def of(self, states: Array, d: int) -> Array:
        """Return the position or slope vector, (..., d), at coordinates q, (..., n_q)."""
        X = states.reshape(*states.shape[:-1], -1, d)[..., self.vectors, :]
        return np.einsum("a,...ad->...d", self.weights, X)


@final
@dataclass(frozen=True)
class SceneNaming(Naming):
    """Maps from coordinates to vectors of named points, and from joints to their multipliers.

    Vectors of points between nodes depend on the lengths of elements, (n_elements,), m, and so on
    the design by `lengths_b`, (n_elements, n_b).
    """

    layout: Layout
    lengths: Array
    lengths_b: Array

    @cached_property
    def _known(self) -> dict[tuple[MaterialPoint, Quantity], PointVector]:
        """Cache of the position and slope vectors of points."""
        return {}

    def vector(
        self, point: MaterialPoint, quantity: Quantity, place: tuple[Array, Array] | None = None
    ) -> PointVector:
        """Return a vector of a material point as a combination of vectors of its body.

        `place` holds the `MaterialPoint.numbers`, (3,), and their design derivatives, (3, n_b), if
        the design may move the point; vectors of other points are cached.

        Raises UnknownNameError if the scene has no body of that name, InvalidInputError if the
        points of the body do not have the vector.
        """
        if place is None:
            known = self._known.get((point, quantity))
            if known is None:
                numbers = np.array(list(point.numbers().values()))
                fixed = numbers, np.zeros((len(numbers), self.lengths_b.shape[1]))
                known = self.vector(point, quantity, fixed)
                if len(self._known) < _KEPT:
                    self._known[point, quantity] = known
            return known
        (numbers, numbers_b), beam = place, self.layout.beams_by_name.get(point.beam)
        if beam is None:
            return self._of_body(point, quantity, self.layout.body(point.beam), *place)
        fraction, y, z = numbers
        along = None if point.fraction is None else float(fraction.real)
        local, at = beam.locate(along, point.before)
        span = beam.fractions[local + 1] - beam.fractions[local]
        xi = at + 1j * fraction.imag / span if np.iscomplexobj(numbers) else at
        kind = beam.element
        kind.require(f"point of {point.beam!r}", quantity, point.y, point.z)
        s, s_b = self._weights(beam, local, quantity, (xi, y, z))
        if np.any(numbers_b):
            l, p = self.lengths[beam.elements][local], kind.vector_weights(quantity, xi, y, z)[1]
            for k, steps in enumerate(STEP * np.diag([1 / span, 1.0, 1.0])):
                moved = (x.real + 1j * step for x, step in zip((xi, y, z), steps, strict=True))
                w_k = kind.vector_weights(quantity, *moved)[0].imag / STEP
                s_b = s_b + np.outer(w_k * l**p, numbers_b[k])
        return self._of_elements(beam, np.array([local]), s, s_b)

    def on_line(self, at: LineVector) -> PointVector:
        """Return a vector on the centre line of a beam as a combination of its node vectors."""
        beam = self.layout.beam(at.beam)
        weights = self._weights(beam, at.element, at.quantity, (at.xi, 0.0, 0.0))
        return self._of_elements(beam, np.array([at.element]), *weights)

    def _weights(
        self, beam: BeamLayout, element: int, quantity: Quantity, place: tuple[Any, Any, Any]
    ) -> tuple[Array, Array]:
        """Return weights of node vectors in a vector at (xi, y, z), and length derivatives."""
        w, p = beam.element.vector_weights(quantity, *place)
        at = beam.first_element + element
        l = self.lengths[at]
        s_l = w * p * l ** (p - 1)
        return w * l**p, s_l[:, None] * self.lengths_b[at]

    def position(self, states: Array, point: Any) -> Array:
        """Return the position of a point in states of shape (k, n_q), shape (k, d); m."""
        return self._in_states(states, point, Quantity.POSITION)

    def slope(self, states: Array, point: Any, along: int) -> Array:
        """Return the slope vector of a point along an axis of its section, shape (k, d)."""
        require_index("slope, along", along, self.layout.d, "0 is along the beam.")
        return self._in_states(states, point, Quantity(along + 1))

    def _in_states(self, states: Array, point: MaterialPoint, quantity: Quantity) -> Array:
        require_point("point", point, self.layout.d)
        return self.vector(point, quantity).of(states, self.layout.d)

    def rows(self, joint: str) -> slice:
        """Return the slice of the multipliers of a joint in lam."""
        place = self.layout.joint(joint)
        return slice(place.first_row, place.first_row + place.rows)

    def reaction(self, lam: Array, joint: str) -> Array:
        """Return the force of a joint on its first point, minus its multipliers, (k, d); N."""
        if not self.layout.joint(joint).holds_position:
            raise InvalidInputError(
                f"reaction of {joint!r}",
                "must belong to a joint that holds its point in all directions",
                "a joint that lets it slide or holds an angle",
                "Call solution.multipliers(name), whose rows the docstring of the joint explains.",
            )
        return -lam[:, self.rows(joint)][:, : self.layout.d]

    def coordinate_names(self) -> list[str]:
        """Return a name for each coordinate, n_q in all."""
        return self.layout.coordinate_names()

    def centred(self, q: Array, weights: Array) -> Array:
        """Return the coordinates translated so that the weighted mean of positions is zero."""
        X, w = (x.reshape(-1, self.layout.d) for x in (q, weights))
        places = np.concatenate([body.positions for body in self.layout.bodies])
        X = X.copy()
        X[places] -= np.average(X[places], axis=0, weights=w[places])
        return X.ravel()

    def stepped(self, variable: int, step: complex) -> SceneNaming:
        """Return the naming with a design variable increased by a step, real or complex."""
        return replace(self, lengths=self.lengths + step * self.lengths_b[:, variable])

    def motions_in_words(self, q: Array, motions: Array) -> str:
        """Return a text on which bodies move, and how, in motions without stiffness."""
        return motions_in_words(self.layout, q.real, motions)

    def deforms(self, q: Array, motions: Array) -> bool:
        """Return whether motions without stiffness, (n_q, k), change the shape of a body."""
        return deforms(self.layout, q.real, motions)

    def packed(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Return the arrays and JSON data from which `load_solution` restores the naming."""
        return {"lengths": self.lengths, "lengths_b": self.lengths_b}, self.layout.plain()

    def nodes(self, states: Array, name: str) -> Array:
        """Return the node vectors of a beam or a rigid body in states of shape (k, n_q).

        Shape (k, n_nodes, n_s, d); a rigid body has one node, of d + 1 vectors.
        """
        body, beam = self.layout.body(name), self.layout.beams_by_name.get(name)
        X = states.reshape(len(states), -1, self.layout.d)[:, body.nodes]
        if beam is None or beam.rigid is None:
            return X
        W = beam.rigid.weights(self.lengths[beam.elements], beam.element.n_s)
        return np.asarray(W @ X)

    def ends(self, states: Array, name: str) -> Array:
        """Return the node vectors of both ends of every element of a beam, (k, n, 2, n_s, d)."""
        beam, body = self.layout.beam(name), self.layout.body(name)
        if beam.rigid is not None:
            X = self.nodes(states, name)
            return np.stack([X[:, :-1], X[:, 1:]], axis=2)
        d = self.layout.d
        X = states.reshape(len(states), -1, d)[:, body.ends]
        return X.reshape(len(states), -1, 2, body.stride, d)

    def centre_line(self, beam: str) -> PointVector:
        """Return the integral of the position along a beam as a combination of node vectors.

        Per element int r dx = l (r_1 + r_2)/2 + l^2 (r_x1 - r_x2)/12.
        """
        place = self.layout.beam(beam)
        n_s = place.element.n_s
        l, l_b = self.lengths[place.elements], self.lengths_b[place.elements]
        weights = np.zeros((len(l), 2, n_s), dtype=l.dtype)
        weights_b = np.zeros((*weights.shape, l_b.shape[1]), dtype=l.dtype)
        for end, sign in ((0, 1.0), (1, -1.0)):
            weights[:, end, 0] = l / 2
            weights[:, end, 1] = sign * l**2 / 12
            weights_b[:, end, 0] = l_b / 2
            weights_b[:, end, 1] = sign * l[:, None] * l_b / 6
        by_vector = weights.ravel(), weights_b.reshape(weights.size, -1)
        return self._of_elements(place, np.arange(len(l)), *by_vector)

    def direction(self, body: str, number: int) -> PointVector:
        """Return an axis direction of a rigid body as a vector, counted from 1."""
        at = self.layout.body(body).vectors[[number]]
        return PointVector(at, np.ones(1), np.zeros((1, self.lengths_b.shape[1])))

    def state(self, owner: str, number: int) -> PointVector:
        """Return the vector of a state of a controller or joint, counted from 0."""
        with_states = (*self.layout.sliders, *self.layout.controllers)
        states = named("joint or controller with states", owner, with_states)
        at = np.array([states.first_vector + number])
        return PointVector(at, np.ones(1), np.zeros((1, self.lengths_b.shape[1])))

    def _of_body(
        self,
        point: MaterialPoint,
        quantity: Quantity,
        body: BodyLayout,
        numbers: Array,
        numbers_b: Array,
    ) -> PointVector:
        """Return r + x d_1 + y d_2 + z d_3 of a rigid body, or one of its directions d_i."""
        if point.fraction is not None:
            raise InvalidInputError(
                f"point of {point.beam!r}",
                "points of a rigid body must be given by their coordinates in it",
                f"the fraction {point.fraction:g} of a length",
                f"Write {point.beam}.at(x, y), in space {point.beam}.at(x, y, z).",
            )
        weights = np.zeros(body.count, dtype=numbers.dtype)
        weights_b = np.zeros((body.count, self.lengths_b.shape[1]))
        if quantity is Quantity.POSITION:
            weights[0], weights[1:] = 1.0, numbers[: body.count - 1]
            weights_b[1:] = numbers_b[: body.count - 1]
        else:
            weights[quantity] = 1.0
        return PointVector(body.vectors, weights, weights_b)

    def _of_elements(
        self, beam: BeamLayout, elements: Array, weights: Array, weights_b: Array
    ) -> PointVector:
        """Return a combination of the vectors of both ends of elements, given as (m n_a,).

        For a rigid beam it is converted into a combination of the vectors of its frame.
        """
        n_s, body = beam.element.n_s, self.layout.body(beam.name)
        if beam.rigid is None:
            if len(elements) == 1:  # each vector stands once
                return PointVector(body.ends[elements[0]], weights, weights_b)
            vectors, at = np.unique(body.ends[elements], return_inverse=True)
            combined = np.zeros(len(vectors), dtype=weights.dtype)
            combined_b = np.zeros((len(vectors), weights_b.shape[1]), dtype=weights_b.dtype)
            np.add.at(combined, at.ravel(), weights)
            np.add.at(combined_b, at.ravel(), weights_b)
            return PointVector(vectors, combined, combined_b)
        W = beam.rigid.weights(self.lengths[beam.elements], n_s)
        at = (elements[:, None] * n_s + np.arange(2 * n_s)).ravel()
        W = W.reshape(-1, W.shape[-1])[at]
        moved = beam.rigid.positions_b(self.lengths_b[beam.elements])
        combined_b = W.T @ weights_b
        combined_b[1:] += np.einsum("k,kdb->db", weights[::n_s], moved[at[::n_s] // n_s])
        return PointVector(body.first_vector + np.arange(W.shape[1]), W.T @ weights, combined_b)


@final
@dataclass(frozen=True, eq=False)
class Vectors:
    """Vectors of points as one linear map U = L q with design derivatives.

    Row d i + c of L is component c of vector i. Its entries are stored row by row, those of row r
    being first[r] to first[r + 1] - 1; `change` are the partials of the entries `changed` with
    respect to the variables `variable`.
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
        """Return the map U = L q of a sequence of point vectors."""
        place = np.concatenate([np.zeros(0, dtype=np.int64), *(x.vectors for x in vectors)])
        weight = np.concatenate([np.zeros(0), *(x.weights for x in vectors)])
        weight_b = np.concatenate([np.zeros((0, n_b)), *(x.weights_b for x in vectors)])
        owner = np.repeat(np.arange(len(vectors)), [len(x.weights) for x in vectors])
        used = np.flatnonzero((weight != 0) | (weight_b != 0).any(axis=1))
        turned = np.array([x.turned for x in vectors], dtype=bool)[owner[used]]
        axes = np.arange(d)[:, None]
        # U rotated by a right angle is (-U_y, U_x).
        component = np.where(turned, 1 - axes, axes)
        sign = np.where(turned, 2 * axes - 1, np.ones_like(axes))
        # Ordered by vector, then by axis.
        order = np.argsort((owner[used] * d + axes).ravel(), kind="stable")
        column = (place[used] * d + component).ravel()[order]
        value = (sign * weight[used]).ravel()[order]
        value_b = (sign[..., None] * weight_b[used]).reshape(len(order), n_b)[order]
        at, variable = np.nonzero(value_b)
        sizes = np.repeat(np.bincount(owner[used], minlength=len(vectors)), d)
        first = np.concatenate([[0], np.cumsum(sizes)])
        return Vectors(d, n_q, n_b, first, column, value, at, variable, value_b[at, variable])

    def couplings(self, which: slice) -> tuple[Array, Array]:
        """Return rows and columns of the products L_i^T L_j for all rows of L of some vectors.

        They are ordered by pairs of rows, and within a pair by pairs of their entries.
        """
        first = self.first[which.start * self.d : which.stop * self.d + 1]
        row = np.repeat(np.arange(len(first) - 1), np.diff(first))
        column = self.column[first[0] : first[-1]]
        i, j = (x.ravel() for x in np.indices((len(row), len(row))))
        order = np.lexsort((j, i, row[j], row[i]))
        return column[i[order]], column[j[order]]

    def is_like(self, other: Vectors) -> bool:
        """Whether the matrix L of `other` has its entries at the same indices."""
        places = (self.first, other.first), (self.column, other.column)
        return all(np.array_equal(x, y) for x, y in places)

    @property
    def count(self) -> int:
        """Number of vectors in the map."""
        return (len(self.first) - 1) // self.d

    @cached_property
    def _L(self) -> LinearMap:
        return LinearMap((self.first, self.column, self.value), self.n_q)

    @cached_property
    def moves(self) -> Array:
        """Whether L depends on each design variable, shape (n_b,)."""
        return np.asarray(np.bincount(self.variable, minlength=self.n_b) > 0)

    def moved(self, i: int) -> Vectors:
        """Return the vectors with design variable i perturbed by an imaginary step."""
        if not self.moves[i]:
            return self
        chosen, value = self.variable == i, self.value.astype(complex)
        value[self.changed[chosen]] += 1j * STEP * self.change[chosen]
        return replace(self, value=value)

    def of(self, q: Array) -> Array:
        """Return the vectors U, shape (k, n_v, d), for rows of q, shape (k, n_q)."""
        return self._L(q).reshape(len(q), self.count, self.d)

    def lift(self, F: Array) -> Array:
        """Return the generalised forces L^T F, shape (k, n_q), of forces F, shape (k, n_v, d)."""
        return self._L.transposed(F.reshape(len(F), math.prod(F.shape[1:])))


def point_vectors(
    naming: SceneNaming,
    names: Names,
    places: Mapping[MaterialPoint, tuple[Array, Array]] | None = None,
) -> list[PointVector]:
    """Return the vectors declared by a joint or load as combinations of body vectors.

    `places` are coordinates of points and their derivatives, as for `SceneNaming.vector`.
    """
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
            vectors.append(naming.state(name.owner, name.number))
        elif isinstance(name, Normal):
            place = None if places is None else places[name.point]
            vectors.append(replace(naming.vector(name.point, Quantity.SLOPE_X, place), turned=True))
        else:
            vectors.append(naming.vector(*name, None if places is None else places[name[0]]))
    return vectors
