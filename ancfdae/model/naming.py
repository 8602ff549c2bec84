"""Where the coordinates and multipliers of beams, bodies and joints stand in q and lam.

Plain numbers only, so that a saved solution can be read without its scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput, UnknownName, named
from ancfdae.model.bodies import Point, Quantity, locate, require_fraction
from ancfdae.model.elements import BeamElement
from ancfdae.numerics.arrays import STEP, Array


@final
@dataclass(frozen=True)
class BodyLayout:
    """Place of a beam or a rigid body: its vectors, `count` in a row from `first_vector` on.

    Every `stride`-th of them is a position, the others are directions: per node of a beam, or of
    the one frame of what is rigid. `kinks` are the inner nodes where the slope along the beam may
    jump: that of the element which ends there comes after all nodes. Vector k has the coordinates
    d k to d k + d - 1. `size` is the length of a beam, the radius of gyration of a body, as
    declared.
    """

    name: str
    first_vector: int
    count: int
    stride: int
    size: float
    kinks: tuple[int, ...] = ()

    @property
    def vectors(self) -> Array:
        """Numbers of its vectors."""
        return self.first_vector + np.arange(self.count)

    @property
    def nodes(self) -> Array:
        """Numbers of the vectors of every node, shape (n_nodes, stride).

        Of a kink those of the element that begins there.
        """
        return self.vectors[: self.count - len(self.kinks)].reshape(-1, self.stride)

    @property
    def positions(self) -> Array:
        """Numbers of those that are positions."""
        return self.nodes[:, 0]

    @cached_property
    def ends(self) -> Array:
        """Numbers of the vectors of both ends of every element, shape (n, 2 stride)."""
        nodes = self.nodes
        ends = np.concatenate([nodes[:-1], nodes[1:]], axis=1)
        kinks = np.array(self.kinks, dtype=np.int64)
        ends[kinks - 1, self.stride + Quantity.SLOPE_X] = self.vectors[nodes.size :]
        return ends

    def of_ends(self, X: Array) -> Array:
        """Return its vectors from those of both ends of every element, (n, 2, stride, d)."""
        vectors = np.zeros((self.count, X.shape[-1]), dtype=X.dtype)
        vectors[self.ends - self.first_vector] = X.reshape(*self.ends.shape, -1)
        return vectors


@final
@dataclass(frozen=True)
class RigidNodes:
    """Nodes of a rigid beam in its axes: chords over lengths, (n, d), and slopes, (n + 1, d, d)."""

    chords: tuple[tuple[float, ...], ...]
    slopes: tuple[tuple[tuple[float, ...], ...], ...]

    def weights(self, lengths: Array, n_s: int) -> Array:
        """Return W: node vectors as combinations of those of the body, (n + 1, n_s, d + 1)."""
        chords, slopes = np.asarray(self.chords), np.asarray(self.slopes)
        n, d = chords.shape
        W = np.zeros((n + 1, n_s, d + 1), dtype=np.result_type(lengths, float))
        W[:, 0, 0] = 1.0
        W[1:, 0, 1:] = np.cumsum(lengths[:, None] * chords, axis=0)
        W[:, 1:, 1:] = slopes[:, : n_s - 1]
        return W

    def positions_b(self, lengths_b: Array) -> Array:
        """Return the partial of W[:, 0, 1:], which depends on lengths alone, (n + 1, d, n_b)."""
        moved = np.cumsum(np.asarray(self.chords)[..., None] * lengths_b[:, None], axis=0)
        return np.concatenate([np.zeros((1, *moved.shape[1:])), moved])


@final
@dataclass(frozen=True)
class BeamLayout:
    """A beam: its element, the number of its first one, arc-length fractions of nodes.

    `rigid` is what makes it so.
    """

    name: str
    element: BeamElement
    first_element: int
    fractions: tuple[float, ...]
    rigid: RigidNodes | None

    @property
    def element_count(self) -> int:
        """Number of elements."""
        return len(self.fractions) - 1

    @property
    def elements(self) -> slice:
        """Its elements among those of the scene."""
        return slice(self.first_element, self.first_element + self.element_count)

    def locate(self, fraction: float | None, before: bool = False) -> tuple[int, float]:
        """Element of the beam and its xi at an arc-length fraction; refuse one beyond [0, 1]."""
        fraction = require_fraction(f"point of {self.name!r}", fraction)
        return locate(np.asarray(self.fractions), fraction, before)


@final
@dataclass(frozen=True)
class JointLayout:
    """Place of a joint: `rows` multipliers from `first_row` on.

    `holds_position` tells whether the first d of them are minus the force on its first point.
    """

    name: str
    first_row: int
    rows: int
    holds_position: bool


@final
@dataclass(frozen=True)
class Layout:
    """Places of all parts of a scene of dimension d.

    `bodies` are beams and rigid bodies in the order of their coordinates, `masses` the names of
    the point masses.
    """

    d: int
    bodies: tuple[BodyLayout, ...]
    beams: tuple[BeamLayout, ...]
    masses: tuple[str, ...]
    joints: tuple[JointLayout, ...]

    @property
    def owners(self) -> tuple[str, ...]:
        """Names of all that has a mass."""
        return (*(body.name for body in self.bodies), *self.masses)

    def owner(self, name: str) -> int:
        """Return the place of a name among the `owners`, or raise UnknownName."""
        if name not in self.owners:
            raise UnknownName("beam or body", name, self.owners)
        return self.owners.index(name)

    def body(self, name: str) -> BodyLayout:
        """Return the vectors of the beam or rigid body of this name, or raise UnknownName."""
        return named("beam or body", name, self.bodies)

    def beam(self, name: str) -> BeamLayout:
        """Return the beam of this name, or raise UnknownName."""
        return named("beam", name, self.beams)

    def joint(self, name: str) -> JointLayout:
        """Return the joint of this name, or raise UnknownName."""
        return named("joint", name, self.joints)


@final
@dataclass(frozen=True)
class Naming:
    """What turns coordinates into vectors of named points.

    Vectors of points between nodes depend on the lengths of elements, (n_elements,), and so on the
    design through `lengths_b`, (n_elements, n_b).
    """

    layout: Layout
    lengths: Array
    lengths_b: Array

    def vector(
        self, point: Point, quantity: Quantity, place: tuple[Array, Array] | None = None
    ) -> PointVector:
        """Return how a vector of a material point is made of vectors of its body.

        `place` has the `Point.numbers`, (3,), and their design derivatives, (3, n_b), where the
        design may move the point.

        Raises UnknownName for its body, InvalidInput if its points have no such vector.
        """
        body, beam = self.layout.body(point.beam), self._beam(point.beam)
        numbers, numbers_b = self._place(point) if place is None else place
        if beam is None:
            return self._of_body(point, quantity, body, numbers, numbers_b)
        fraction, y, z = numbers
        along = None if point.fraction is None else float(fraction.real)
        local, at = beam.locate(along, point.before)
        span = beam.fractions[local + 1] - beam.fractions[local]
        xi = at + 1j * fraction.imag / span if np.iscomplexobj(numbers) else at
        element = beam.first_element + local
        kind = beam.element
        kind.require(f"point of {point.beam!r}", quantity, point.y, point.z)
        w, p = kind.vector_weights(quantity, xi, y, z)
        l = self.lengths[element]
        s, s_l = w * l**p, w * p * l ** (p - 1)
        s_b = s_l[:, None] * self.lengths_b[element]
        if np.any(numbers_b):
            for k, steps in enumerate(STEP * np.diag([1 / span, 1.0, 1.0])):
                moved = (x.real + 1j * step for x, step in zip((xi, y, z), steps, strict=True))
                w_k = kind.vector_weights(quantity, *moved)[0].imag / STEP
                s_b = s_b + np.outer(w_k * l**p, numbers_b[k])
        return self._of_elements(beam, np.array([local]), s, s_b)

    def nodes(self, states: Array, name: str) -> Array:
        """Return the node vectors of a beam or a rigid body in states of shape (k, n_q).

        Shape (k, n_nodes, n_s, d); a rigid body has one node, of d + 1 vectors.
        """
        body, beam = self.layout.body(name), self._beam(name)
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
        """Return the integral of the position along the centre line of a beam.

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
        """Return a direction of the axes of something rigid, counted from 1 on."""
        at = self.layout.body(body).vectors[[number]]
        return PointVector(at, np.ones(1), np.zeros((1, self.lengths_b.shape[1])))

    def _beam(self, name: str) -> BeamLayout | None:
        return next((beam for beam in self.layout.beams if beam.name == name), None)

    def _place(self, point: Point) -> tuple[Array, Array]:
        numbers = np.array(list(point.numbers().values()))
        return numbers, np.zeros((len(numbers), self.lengths_b.shape[1]))

    def _of_body(
        self,
        point: Point,
        quantity: Quantity,
        body: BodyLayout,
        numbers: Array,
        numbers_b: Array,
    ) -> PointVector:
        """Return r + x d_1 + y d_2 + z d_3, or one of these directions."""
        if point.fraction is not None:
            raise InvalidInput(
                f"point of {point.beam!r}",
                "a rigid body has no fractions",
                point.fraction,
                "Write body.at(x, y).",
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
        """Return a combination of the vectors of both ends of elements, (m n_a,) in a row.

        Those of a rigid beam are combinations of the vectors of its frame.
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
@dataclass(frozen=True)
class PointVector:
    """A position or slope vector of a material point as a combination of vectors of its body.

    `vectors`, (n_a,), has their numbers in the scene; vector k has the coordinates d k to
    d k + d - 1. `weights` is (n_a,), with design derivatives (n_a, n_b). A vector
    that is `turned` is this combination turned by a right angle, from x to y, as the constraints
    take it.
    """

    vectors: Array
    weights: Array
    weights_b: Array
    turned: bool = False

    def of(self, states: Array, d: int) -> Array:
        """Return the vector in states of shape (..., n_q), shape (..., d)."""
        X = states.reshape(*states.shape[:-1], -1, d)[..., self.vectors, :]
        result: Array = np.einsum("a,...ad->...d", self.weights, X)
        return result
