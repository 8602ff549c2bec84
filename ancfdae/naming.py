"""Where the coordinates and multipliers of beams and joints stand in q and lam.

Plain numbers only, so that a saved solution can be read without its scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar, final

import numpy as np

from ancfdae.bodies import Point, Quantity
from ancfdae.elements import ALL_ELEMENTS, BeamElement
from ancfdae.errors import InvalidInput, UnknownName
from ancfdae.numerics.arrays import STEP, Array


@final
@dataclass(frozen=True)
class BeamLayout:
    """Place of a beam: its first node, of d n_s coordinates, and its first element.

    `fractions` has the arc-length fraction of each node, from 0 to 1.
    """

    name: str
    first_node: int
    first_element: int
    fractions: tuple[float, ...]

    @property
    def element_count(self) -> int:
        """Number of elements."""
        return len(self.fractions) - 1

    def locate(self, fraction: float) -> tuple[int, float]:
        """Element of the beam and its xi at an arc-length fraction; refuse one beyond [0, 1]."""
        if not 0.0 <= fraction <= 1.0:
            raise InvalidInput(
                f"point of {self.name!r}",
                "the fraction along the beam must lie in [0, 1]",
                fraction,
                "0 is the start of the beam and 1 its end.",
            )
        nodes = np.asarray(self.fractions)
        element = min(int(np.searchsorted(nodes, fraction, side="right")) - 1, len(nodes) - 2)
        xi = (fraction - nodes[element]) / (nodes[element + 1] - nodes[element])
        # A fraction such as 1/3 of three elements means the node, not a point 1e-16 beside it.
        near = 4 * np.finfo(float).eps * len(nodes)
        if xi < near:
            return element, 0.0
        return element, 1.0 if xi > 1.0 - near else float(xi)


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
    """Places of all beams and joints of a scene, and the name of the element of all beams."""

    element_name: str
    beams: tuple[BeamLayout, ...]
    joints: tuple[JointLayout, ...]

    @property
    def element(self) -> BeamElement:
        """The element of every beam."""
        return next(each for each in ALL_ELEMENTS if each.name == self.element_name)

    @property
    def d(self) -> int:
        """Dimension of space."""
        return self.element.d

    @property
    def element_count(self) -> int:
        """Number of elements."""
        return sum(beam.element_count for beam in self.beams)

    def beam(self, name: str) -> BeamLayout:
        """Return the beam of this name, or raise UnknownName."""
        return _named("beam", name, self.beams)

    def joint(self, name: str) -> JointLayout:
        """Return the joint of this name, or raise UnknownName."""
        return _named("joint", name, self.joints)


_Place = TypeVar("_Place", BeamLayout, JointLayout)


def _named(kind: str, name: str, places: Sequence[_Place]) -> _Place:
    for place in places:
        if place.name == name:
            return place
    raise UnknownName(kind, name, (place.name for place in places))


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
        """Return how a vector of a material point is made of node vectors.

        `place` has the numbers of the point, (n,), and their design derivatives, (n, n_b), where
        the design may move it.

        Raises UnknownName for its beam, InvalidInput if points of its element have no such vector.
        """
        beam = self.layout.beam(point.beam)
        numbers = np.array(list(point.numbers().values())) if place is None else place[0]
        fraction, y, z = numbers
        local, at = beam.locate(float(fraction.real))
        span = beam.fractions[local + 1] - beam.fractions[local]
        xi = at + 1j * fraction.imag / span if np.iscomplexobj(numbers) else at
        element = beam.first_element + local
        kind, where = self.layout.element, f"point of {point.beam!r}"
        kind.require(where, quantity, point.y, point.z)
        n_s = kind.n_s
        w, p = kind.vector_weights(quantity, xi, y, z)
        l = self.lengths[element]
        s, s_l = w * l**p, w * p * l ** (p - 1)
        s_b = s_l[:, None] * self.lengths_b[element]
        if place is not None and np.any(place[1]):
            for k, steps in enumerate(STEP * np.diag([1 / span, 1.0, 1.0])):
                moved = (x.real + 1j * step for x, step in zip((xi, y, z), steps, strict=True))
                w_k = kind.vector_weights(quantity, *moved)[0].imag / STEP
                s_b = s_b + np.outer(w_k * l**p, place[1][k])
        first = (beam.first_node + local) * n_s
        return PointVector(first + np.arange(2 * n_s), s, s_b)

    def centre_line(self, beam: str) -> PointVector:
        """Return the integral of the position along the centre line of a beam.

        Per element int r dx = l (r_1 + r_2)/2 + l^2 (r_x1 - r_x2)/12.
        """
        place, n_s = self.layout.beam(beam), self.layout.element.n_s
        count = place.element_count
        elements = place.first_element + np.arange(count)
        l, l_b = self.lengths[elements], self.lengths_b[elements]
        weights = np.zeros((count + 1, n_s), dtype=l.dtype)
        weights_b = np.zeros((count + 1, n_s, l_b.shape[1]), dtype=l.dtype)
        for end, sign in ((slice(None, -1), 1.0), (slice(1, None), -1.0)):
            weights[end, 0] += l / 2
            weights[end, 1] += sign * l**2 / 12
            weights_b[end, 0] += l_b / 2
            weights_b[end, 1] += sign * l[:, None] * l_b / 6
        vectors = place.first_node * n_s + np.arange((count + 1) * n_s)
        return PointVector(vectors, weights.ravel(), weights_b.reshape(len(vectors), -1))


@final
@dataclass(frozen=True)
class PointVector:
    """A position or slope vector of a material point as a combination of node vectors.

    `vectors`, (n_a,), has their numbers in the scene; vector k has the coordinates d k to
    d k + d - 1. `weights` is (n_a,), with design derivatives (n_a, n_b).
    """

    vectors: Array
    weights: Array
    weights_b: Array

    def of(self, states: Array, d: int) -> Array:
        """Return the vector in states of shape (..., n_q), shape (..., d)."""
        X = states.reshape(*states.shape[:-1], -1, d)[..., self.vectors, :]
        result: Array = np.einsum("a,...ad->...d", self.weights, X)
        return result
