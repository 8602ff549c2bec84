"""Beams: a straight one of equal elements, and one through given node frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_array, require_count, require_positive, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies.body import BeamBody, ReferenceShape
from ancfdae.model.bodies.curves import arc, through
from ancfdae.model.bodies.point import MaterialPoint
from ancfdae.model.elements import BeamElement, StrainEnergyFunction
from ancfdae.model.elements.element import end_weight_xi, slope_weights_xi
from ancfdae.model.material import Material
from ancfdae.model.sections.section import Section
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import box_rule
from ancfdae.numerics.vector_formulas import cross

_SOME = "Use at least one element; 100 are many."
# Indices of matrix entries are numbers of 32 bits; a spatial element has 24^2 entries.
_MOST_ELEMENTS = 2**31 // 24**2


@final
@dataclass(frozen=True)
class Beam(BeamBody):
    """A straight beam of equal elements.

    Parameters
    ----------
    name : str
    start, end : sequence of float
        End points of the centre line, two components for a planar and three for a spatial
        scene; m. With a point of another beam as the start, such as ``crank.at_end``, the beam
        starts there at every design, and `end` is the vector from that point to the end, not a
        position.
    elements : int
        Number of equal elements.
    section : Section or sequence of Section
        One section for the whole beam, or one per element; these may differ in their sizes.
    material : Material or sequence of Material
    height_axis : sequence of float, optional
        Spatial beams: direction of the section's height; its part along the beam is removed.
        By default the direction that makes (beam, height, width) right-handed with the width
        along global z, or along global y if the beam itself runs along z.
    element : BeamElement, optional
        By default the beam of the dimension, BEAM_2D or BEAM_3D; CABLE_2D and CABLE_3D
        have no shear, no torsion and no deformation of the section.
    energy : StrainEnergyFunction, optional
        By default `EnhancedContinuum`, which bends, stretches, shears and twists as beams do.
    turn : float or sequence of float, optional
        Rotation of the whole beam about its start, a number in the plane and in space a vector
        along the axis; rad. Design targets: ``turn``, in space ``turn_x`` ..., and ``start_x`` ...
    rigid : bool, optional
        Whether the beam does not deform: it then has the coordinates of a rigid body of its mass.
    kinks : sequence of float, optional
        Fractions of the length, at inner nodes, where the slope along the beam may jump
        (dimensionless): the elements on either side have slopes of their own there and share
        position and section. Nodes that a joint, load or point mass acts on always are kinks: shear
        and axial forces jump there, and the error of the deflection is of second order in the
        element length or better. Declare further kinks where sections or materials change from one
        element to the next, or to have the same coordinates with and without such a load. Forces
        between nodes are smeared over elements: the error of the deflection is of first order. Must
        be empty for a cable, whose slopes carry bending.
    initial_strain : float, optional
        Strain along the axis that the beam has in the reference configuration already, as if it had
        been stretched to its length there: positive in tension, N = E A initial_strain. A change of
        temperature that would stretch it by alpha dT is an initial strain of -alpha dT.

    Raises
    ------
    InvalidInputError
        If the ends coincide, the number of elements is not a positive integer, or the height
        axis is parallel to the beam.
    """

    name: str
    start: Sequence[float] | MaterialPoint
    end: Sequence[float]
    elements: int
    section: Section | Sequence[Section]
    material: Material | Sequence[Material]
    height_axis: Sequence[float] | None = None
    element: BeamElement = None  # type: ignore[assignment]  # the default of the dimension
    energy: StrainEnergyFunction | None = None
    turn: float | Sequence[float] = 0.0
    rigid: bool = False
    kinks: Sequence[float] = ()
    initial_strain: float = 0.0

    def __post_init__(self) -> None:
        """Check the fields; raise InvalidInputError."""
        where = f"beam {self.name!r}"
        if isinstance(self.start, MaterialPoint):
            require_vector(f"{where}, end", self.end)
        else:
            require_vector(f"{where}, start", self.start)
            require_vector(f"{where}, end", self.end, (len(tuple(self.start)),))
        require_count(f"{where}, elements", self.elements, _SOME, _MOST_ELEMENTS)
        if not np.any(self._span):
            raise InvalidInputError(
                where,
                "start and end must differ",
                tuple(self.end),
                "A beam needs a length.",
            )
        self._check_parts()
        self._frame()

    @property
    def element_count(self) -> int:
        """Number of elements of the beam, all of equal length."""
        return int(self.elements)

    @property
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""
        return len(tuple(self.end))

    @property
    def place(self) -> Sequence[float] | MaterialPoint:
        """Start of the centre line: a position, shape (d,), m, or the point of another beam."""
        return self.start

    @property
    def length(self) -> float:
        """Length of the centre line in the reference configuration; m."""
        return float(np.linalg.norm(self._span))

    @cached_property
    def _reference(self) -> ReferenceShape:
        """Straight reference configuration: element lengths, node slopes and chords."""
        n, frame = self.element_count, self._frame()
        return ReferenceShape(
            lengths=np.full(n, self.length / n),
            slopes=np.repeat(frame[None], n + 1, axis=0),
            chords=np.repeat(frame[None, 0], n, axis=0),
            straight=True,
        )

    def with_length(self, length: float) -> Beam:
        """Return the same beam with another length, m: its end moves along its axis."""
        require_positive(f"{self.name}.length", length)
        end = self._origin + length * self._frame()[0]
        return replace(self, end=tuple(end.tolist()))

    def with_place(self, place: Sequence[float]) -> Beam:
        """Return the same beam moved so that its start is at `place`, shape (d,); m."""
        end = np.asarray(place, float) + self._span
        return replace(self, start=tuple(place), end=tuple(end.tolist()))

    def with_elements(self, count: int) -> Beam:
        """Return the same beam with `count` equal elements.

        Each new element takes section and material of the old elements that it covers. Raises
        InvalidInputError if those differ within one new element.
        """
        require_count(f"beam {self.name!r}, elements", count, _SOME, _MOST_ELEMENTS)
        ends = [k * self.element_count for k in range(count + 1)]
        places = [slice(a // count, -(-b // count)) for a, b in pairwise(ends)]
        sections, materials = self._per_element()
        if any(len({x.sizes() for x in sections[k]}) > 1 for k in places) or any(
            len(set(materials[k])) > 1 for k in places
        ):
            rule = "an element has one section and one material"
            repair = f"Use a multiple of {self.element_count} elements."
            raise InvalidInputError(f"beam {self.name!r}, elements", rule, count, repair)
        if count == self.element_count:
            return self
        return replace(
            self,
            elements=count,
            section=tuple(sections[k.start] for k in places),
            material=tuple(materials[k.start] for k in places),
        )

    @property
    def _origin(self) -> Array:
        """Position that `end` is relative to, (d,): `start`, or zero if `start` is a point."""
        return (
            np.zeros(self.dimension)
            if isinstance(self.start, MaterialPoint)
            else np.array(self.start)
        )

    @property
    def _span(self) -> Array:
        return np.subtract(self.end, self._origin).astype(float)

    def _frame(self) -> Array:
        axis = self._span
        axis = axis / np.linalg.norm(axis)
        if self.dimension == 2:
            if self.height_axis is not None:
                raise InvalidInputError(
                    f"beam {self.name!r}, height_axis",
                    "must be left out for a planar beam",
                    tuple(self.height_axis),
                    "The height of a planar beam lies in the plane.",
                )
            return np.array([axis, [-axis[1], axis[0]]])
        if self.height_axis is None:
            along_z = abs(axis[2]) > 1.0 - 1e-8
            across = cross(np.array((0.0, 1.0, 0.0) if along_z else (0.0, 0.0, 1.0)), axis)
        else:
            require_vector(f"beam {self.name!r}, height_axis", self.height_axis, (3,))
            given = np.asarray(self.height_axis, dtype=float)
            across = given - (given @ axis) * axis
            # 1e-8: below the square root of round-off the remaining direction is only round-off.
            if np.linalg.norm(across) <= 1e-8 * np.linalg.norm(given):
                raise InvalidInputError(
                    f"beam {self.name!r}, height_axis",
                    "must not be parallel to the beam",
                    tuple(self.height_axis),
                    "Give a direction across the beam.",
                )
        across = across / np.linalg.norm(across)
        return np.array([axis, across, cross(axis, across)])


# -- curved beams ------------------------------------------------------------------------------


@final
@dataclass(frozen=True, eq=False)
class CurvedBeam(BeamBody):
    """A beam that is curved in its reference configuration, through given node frames (eq. 16).

    ``CurvedBeam.arc(...)`` and ``CurvedBeam.through(...)`` make the frames of a circular arc and of
    a smooth curve through points.

    The length of an element is the arc length of the cubic through its nodes, so that unit tangents
    stay unit tangents.

    Parameters
    ----------
    name : str
    positions : array, shape (n + 1, d)
        Positions of the nodes; m.
    frames : array, shape (n + 1, d, d)
        Slope vectors of the nodes, row k along the section's k-th axis (tangent first);
        right-handed.
    section, material, element, energy, rigid, kinks, initial_strain
        As in `Beam`.
    turn : float or sequence of float, optional
        Rotation of the whole beam about its first node, as in `Beam`; rad.

    Raises
    ------
    InvalidInputError
        If shapes disagree, nodes coincide or a frame is not right-handed.
    """

    name: str
    positions: Array
    frames: Array
    section: Section | Sequence[Section]
    material: Material | Sequence[Material]
    element: BeamElement = None  # type: ignore[assignment]  # the default of the dimension
    energy: StrainEnergyFunction | None = None
    turn: float | Sequence[float] = 0.0
    rigid: bool = False
    kinks: Sequence[float] = ()
    initial_strain: float = 0.0

    @classmethod
    def arc(
        cls,
        name: str,
        start: Sequence[float],
        middle: Sequence[float],
        end: Sequence[float],
        elements: int,
        section: Section | Sequence[Section],
        material: Material | Sequence[Material],
        *,
        height_axis: Sequence[float] | None = None,
        **others: Any,
    ) -> CurvedBeam:
        """Return a beam along the circular arc from start to end through a third point.

        Parameters
        ----------
        name, section, material
            As in `CurvedBeam`.
        start, middle, end : sequence of float
            Points of the arc, two or three components; m.
        elements : int
            Number of equal elements. One that turns by 0.4 rad is 1 % too light.
        height_axis : sequence of float, optional
            Spatial beams: direction of the section's height at the start; its part along the beam
            is removed. It keeps its angle to the plane of the arc. By default towards the centre.
        others
            element, energy, turn, rigid, kinks and initial_strain, as in `Beam`.

        Raises
        ------
        InvalidInputError
            If the points lie in one line, or the height axis along the beam.
        """
        points = start, middle, end
        positions, frames = arc(f"beam {name!r}", points, elements, height_axis)
        return cls(name, positions, frames, section, material, **others)

    @classmethod
    def through(
        cls,
        name: str,
        points: Array | Sequence[Sequence[float]],
        section: Section | Sequence[Section],
        material: Material | Sequence[Material],
        *,
        elements: int | None = None,
        height_axis: Sequence[float] | None = None,
        **others: Any,
    ) -> CurvedBeam:
        """Return a beam along a smooth curve through points: a cubic spline over their chords.

        Parameters
        ----------
        name, section, material
            As in `CurvedBeam`.
        points : array, shape (k, 2) or (k, 3)
            Points of the centre line in their order, two or more; m.
        elements : int, optional
            Number of elements, of equal length; by default one between neighbouring points.
        height_axis : sequence of float, optional
            Spatial beams: direction of the section's height at the start, as in `Beam`. The section
            does not turn about the tangent along the beam.
        others
            element, energy, turn, rigid, kinks and initial_strain, as in `Beam`.

        Raises
        ------
        InvalidInputError
            If there are fewer than two points, two neighbours are one, or the height axis lies
            along the beam.
        """
        positions, frames = through(f"beam {name!r}", points, elements, height_axis)
        return cls(name, positions, frames, section, material, **others)

    def __post_init__(self) -> None:
        where = f"beam {self.name!r}"
        positions = require_array(f"{where}, positions", self.positions)
        if positions.ndim != 2 or positions.shape[0] < 2 or positions.shape[1] not in (2, 3):
            raise InvalidInputError(
                f"{where}, positions",
                "must have shape (n + 1, 2) or (n + 1, 3) with n >= 1",
                positions.shape,
                "Give one row per node.",
            )
        frame_shape = (*positions.shape, positions.shape[1])
        frames = require_array(f"{where}, frames", self.frames, frame_shape)
        if not np.all(np.any(np.diff(positions, axis=0) != 0.0, axis=1)):
            raise InvalidInputError(
                f"{where}, positions",
                "neighbouring nodes must differ",
                "an element of length zero",
                "Remove the repeated node.",
            )
        if not np.all(np.linalg.det(frames) > 0):
            raise InvalidInputError(
                f"{where}, frames",
                "must be right-handed",
                f"smallest determinant {np.min(np.linalg.det(frames)):.3g}",
                "Order the rows tangent, height axis(, width axis).",
            )
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "frames", frames)
        self._check_parts()

    @property
    def element_count(self) -> int:
        """Number of elements of the beam."""
        return len(self.positions) - 1

    @property
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.positions.shape[1])

    @property
    def length(self) -> float:
        """Length of the centre line in the reference configuration; m."""
        return float(np.sum(self.reference().lengths))

    @cached_property
    def _reference(self) -> ReferenceShape:
        """Curved reference configuration: element lengths, node slopes and chords."""
        steps, slopes = np.diff(self.positions, axis=0), self.frames
        lengths = _arc_lengths(steps, slopes[:-1, 0], slopes[1:, 0])
        return ReferenceShape(lengths, slopes, steps / lengths[:, None], False)

    @property
    def place(self) -> Sequence[float]:
        """Position of the first node, shape (d,); m."""
        return tuple(self.positions[0].tolist())

    def with_place(self, place: Sequence[float]) -> CurvedBeam:
        """Return the same beam moved so that its first node is at `place`, shape (d,); m."""
        return replace(self, positions=self.positions - self.positions[0] + np.asarray(place))

    def with_length(self, length: float) -> CurvedBeam:
        """Return the same beam scaled about its first node to another arc length; m."""
        require_positive(f"{self.name}.length", length)
        first, factor = self.positions[0], length / self.length
        return replace(self, positions=first + factor * (self.positions - first))


def _arc_lengths(steps: Array, tangents_1: Array, tangents_2: Array) -> Array:
    """Return the element lengths, shape (n,), m, equal to the arc length of the cubic they define.

    Fixed-point iteration of l = int |r,x| l dxi with r,x = s5'(xi)/l (r_2 - r_1) + s2' r_x1 + s6'
    r_x2. The map contracts by about the squared turning angle of the element over 30, so that a few
    sweeps reach round-off.
    """
    points, weights = box_rule((12,))
    xi = points[:, 0]
    p2, p6 = slope_weights_xi(xi)
    lengths: Array = np.linalg.norm(steps, axis=1)
    for _ in range(60):
        speed = (
            (end_weight_xi(xi) / lengths[:, None])[..., None] * steps[:, None]
            + p2[:, None] * tangents_1[:, None]
            + p6[:, None] * tangents_2[:, None]
        )
        new = lengths * (np.linalg.norm(speed, axis=2) @ weights)
        done = np.all(np.abs(new - lengths) <= 4 * np.finfo(float).eps * new)
        lengths = new
        if done:
            break
    return lengths
