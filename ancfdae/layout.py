"""Where the coordinates and multipliers of beams and joints stand in q and lam.

Plain numbers only, so that a saved solution can be read without its scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.elements import BEAM_2D, BEAM_3D, BeamElement
from ancfdae.errors import InvalidInput, UnknownName
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class BeamLayout:
    """Place of a beam.

    Attributes
    ----------
    name : str
    first_node : int
        Number of its first node; a node has d n_s coordinates.
    first_element : int
        Number of its first element.
    fractions : tuple of float
        Arc-length fraction of each node, from 0 to 1.
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
        """Element of the beam and its xi at an arc-length fraction.

        Raises
        ------
        InvalidInput
            If the fraction lies outside [0, 1].
        """
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
    """Place of a joint: `rows` multipliers from `first_row` on."""

    name: str
    first_row: int
    rows: int


@final
@dataclass(frozen=True)
class Layout:
    """Places of all beams and joints of a scene.

    Attributes
    ----------
    d : int
        Dimension of space.
    beams : tuple of BeamLayout
    joints : tuple of JointLayout
    """

    d: int
    beams: tuple[BeamLayout, ...]
    joints: tuple[JointLayout, ...]

    @property
    def element(self) -> BeamElement:
        """The element of every beam."""
        return BEAM_2D if self.d == 2 else BEAM_3D

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return sum(len(beam.fractions) for beam in self.beams)

    @property
    def element_count(self) -> int:
        """Number of elements."""
        return sum(beam.element_count for beam in self.beams)

    def beam(self, name: str) -> BeamLayout:
        """Return the beam of this name.

        Raises
        ------
        UnknownName
        """
        for beam in self.beams:
            if beam.name == name:
                return beam
        raise UnknownName("beam", name, (beam.name for beam in self.beams))

    def joint(self, name: str) -> JointLayout:
        """Return the joint of this name.

        Raises
        ------
        UnknownName
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise UnknownName("joint", name, (joint.name for joint in self.joints))


@final
@dataclass(frozen=True)
class Naming:
    """What turns coordinates into vectors of named points.

    Attributes
    ----------
    layout : Layout
    lengths : array, shape (n_elements,)
        Element lengths.
    lengths_b : array, shape (n_elements, n_b)
        Their design derivatives; vectors of points between nodes depend on them.
    """

    layout: Layout
    lengths: Array
    lengths_b: Array
