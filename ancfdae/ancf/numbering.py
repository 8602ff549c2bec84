"""Numbering of coordinates: nodes of all beams in a row, each with n_s vectors of d numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy import sparse

from ancfdae.ancf.rigid_motions import RigidMotions
from ancfdae.elements import BeamElement
from ancfdae.naming import BeamLayout
from ancfdae.numerics.arrays import Array
from ancfdae.scene import Scene


@final
@dataclass(frozen=True)
class Numbering:
    """Coordinates of every element.

    Attributes
    ----------
    element : BeamElement
    beams : tuple of BeamLayout
    vectors : array of int, shape (n, n_a)
        Scene-wide numbers of the node vectors of each element; vector k has the coordinates
        d k to d k + d - 1.
    n_q : int
        Number of coordinates.
    """

    element: BeamElement
    beams: tuple[BeamLayout, ...]
    vectors: Array
    n_q: int

    def rigid_motions(self) -> RigidMotions:
        """Return the rigid motions of all beams."""
        n_s, counts = self.element.n_s, [beam.element_count + 1 for beam in self.beams]
        owner = np.repeat(np.arange(len(counts)), np.array(counts) * n_s)
        return RigidMotions(owner, np.arange(len(owner)) % n_s == 0, self.element.d)

    def coordinates(self, vectors: Array) -> Array:
        """Return coordinate numbers of node vectors; a trailing axis d is added."""
        return vectors[..., None] * self.element.d + np.arange(self.element.d)

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
    """Assign numbers to the coordinates of a scene, beam by beam and node by node."""
    element = scene.beams[0].element
    beams, vectors, node, first = [], [], 0, 0
    for beam in scene.beams:
        lengths = beam.reference().lengths
        fractions = np.concatenate([[0.0], np.cumsum(lengths) / np.sum(lengths)])
        fractions[-1] = 1.0
        beams.append(BeamLayout(beam.name, node, first, tuple(fractions.tolist())))
        starts = (node + np.arange(beam.element_count)) * element.n_s
        vectors.append(starts[:, None] + np.arange(element.n_a))
        node += beam.element_count + 1
        first += beam.element_count
    return Numbering(
        element=element,
        beams=tuple(beams),
        vectors=np.concatenate(vectors),
        n_q=node * element.n_s * element.d,
    )
