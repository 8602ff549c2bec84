"""Numbering of coordinates: vectors of d numbers, of all beams and rigid bodies in a row.

A beam has n_s vectors per node, what is rigid one frame of d + 1 vectors: its reference point and
its directions (docs/theory.md, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy import sparse

from ancfdae.ancf.rigid_motions import RigidMotions
from ancfdae.bodies import BeamBody, RigidBody
from ancfdae.elements import BeamElement
from ancfdae.naming import BeamLayout, BodyLayout, RigidNodes
from ancfdae.numerics.arrays import Array
from ancfdae.scene import Scene


@final
@dataclass(frozen=True)
class Numbering:
    """Coordinates of every body and every element that deforms.

    Attributes
    ----------
    element : BeamElement
    bodies : tuple of BodyLayout
        Of all beams and rigid bodies in the order of their vectors.
    beams : tuple of BeamLayout
    rigid : array of bool, shape (n_bodies,)
    elements : array of int, shape (n,)
        Scene-wide numbers of the elements that deform.
    vectors : array of int, shape (n, n_a)
        Scene-wide numbers of their node vectors; vector k has the coordinates d k to d k + d - 1.
    n_q : int
        Number of coordinates.
    """

    element: BeamElement
    bodies: tuple[BodyLayout, ...]
    beams: tuple[BeamLayout, ...]
    rigid: Array
    elements: Array
    vectors: Array
    n_q: int

    def rigid_motions(self) -> RigidMotions:
        """Return the rigid motions of all bodies."""
        owner = np.repeat(np.arange(len(self.bodies)), [body.count for body in self.bodies])
        is_position = np.zeros(len(owner), dtype=bool)
        for body in self.bodies:
            is_position[body.positions] = True
        return RigidMotions(owner, is_position, self.element.d)

    @property
    def owners(self) -> Array:
        """Place among the bodies of the beam of each element that deforms, shape (n,)."""
        counts = [0 if beam.rigid else beam.element_count for beam in self.beams]
        return np.repeat(np.arange(len(self.beams)), counts)

    @property
    def frames(self) -> Array:
        """Numbers of the vectors of everything rigid, shape (n_rigid, d + 1)."""
        rigid = [body.vectors for body, own in zip(self.bodies, self.rigid, strict=True) if own]
        return np.array(rigid, dtype=np.int64).reshape(len(rigid), self.element.d + 1)

    def coordinates(self, vectors: Array) -> Array:
        """Return coordinate numbers of node vectors; a trailing axis d is added."""
        return vectors[..., None] * self.element.d + np.arange(self.element.d)

    def couplings(self) -> tuple[Array, Array]:
        """Return rows and columns that couple coordinates of an element, or of a rigid body."""
        size = self.element.n_a * self.element.d
        own = self.coordinates(self.vectors).reshape(-1, size)
        frames = self.coordinates(self.frames)
        elements = np.broadcast_arrays(own[:, :, None], own[:, None, :])
        bodies = np.broadcast_arrays(frames[:, :, None], frames[:, None])
        rows, columns = (
            np.concatenate([a.ravel(), b.ravel()]) for a, b in zip(elements, bodies, strict=True)
        )
        return rows, columns

    def relative(self) -> sparse.csr_array:
        """Return R with Y.ravel() = R q for the relative node vectors Y of all elements."""
        rows, columns, signs = self.relative_entries()
        size = len(self.vectors) * self.element.n_y * self.element.d
        return sparse.csr_array((signs, (rows, columns)), shape=(size, self.n_q))

    def relative_entries(self) -> tuple[Array, Array, Array]:
        """Return rows, columns and signs of R: r_2 - r_1, then the slopes as they are."""
        n, n_y, n_s, d = len(self.vectors), self.element.n_y, self.element.n_s, self.element.d
        Y_rows = np.arange(n * n_y * d).reshape(n, n_y, d)
        coordinates = self.coordinates(self.vectors)
        slopes = [a for a in range(self.element.n_a) if a not in (0, n_s)]
        rows = [Y_rows[:, 0], Y_rows[:, 0], Y_rows[:, 1:]]
        columns = [coordinates[:, 0], coordinates[:, n_s], coordinates[:, slopes]]
        signs = [-np.ones(n * d), np.ones(n * d), np.ones(n * (n_y - 1) * d)]
        return (
            np.concatenate([r.ravel() for r in rows]),
            np.concatenate([c.ravel() for c in columns]),
            np.concatenate(signs),
        )


def number(scene: Scene) -> Numbering:
    """Assign numbers to the coordinates of a scene, body by body and node by node."""
    element, bodies, beams, vectors, elements = scene.element, [], [], [], []
    vector = first = 0
    for member in scene.members:
        own = _body_layout(member, vector, element)
        bodies.append(own)
        vector += own.count
        if isinstance(member, RigidBody):
            continue
        numbers = np.arange(member.element_count)
        if not member.rigid:
            starts = own.first_vector + numbers * element.n_s
            vectors.append(starts[:, None] + np.arange(element.n_a))
            elements.append(first + numbers)
        beams.append(_beam_layout(member, first))
        first += member.element_count
    empty = np.zeros(0, dtype=np.int64)
    return Numbering(
        element=element,
        bodies=tuple(bodies),
        beams=tuple(beams),
        rigid=np.array([isinstance(x, RigidBody) or x.rigid for x in scene.members]),
        elements=np.concatenate([empty, *elements]),
        vectors=np.concatenate([empty.reshape(0, element.n_a), *vectors]),
        n_q=vector * element.d,
    )


def _body_layout(member: BeamBody | RigidBody, first: int, element: BeamElement) -> BodyLayout:
    if isinstance(member, RigidBody):
        moments = member.moments(np.array(list(member.parameters().values())))
        size = float(np.sqrt(np.trace(moments[1:, 1:]) / moments[0, 0]))
    else:
        size = float(np.sum(member.reference().lengths))
        if not member.rigid:
            count = (member.element_count + 1) * element.n_s
            return BodyLayout(member.name, first, count, element.n_s, size)
    return BodyLayout(member.name, first, element.d + 1, element.d + 1, size)


def _beam_layout(beam: BeamBody, first: int) -> BeamLayout:
    shape, rigid = beam.reference(), None
    fractions = np.concatenate([[0.0], np.cumsum(shape.lengths) / np.sum(shape.lengths)])
    fractions[-1] = 1.0
    if beam.rigid:
        axes = beam.directions().T
        chords = tuple(map(tuple, (shape.chords @ axes).tolist()))
        slopes = tuple(tuple(map(tuple, node)) for node in (shape.slopes @ axes).tolist())
        rigid = RigidNodes(chords, slopes)
    return BeamLayout(beam.name, first, tuple(fractions.tolist()), rigid)
