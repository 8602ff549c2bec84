"""Beams: reference shape, section and material of each element, and points on them."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import final

import numpy as np

from ancfdae.elements import BEAM_2D, BEAM_3D, BeamElement, ElementParameter
from ancfdae.elements.hermite import end_weight_xi, slope_weights_xi
from ancfdae.errors import (
    InvalidInput,
    UnknownName,
    require_array,
    require_count,
    require_finite,
    require_kind,
    require_positive,
    require_sequence,
    require_vector,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule
from ancfdae.sections import Material, Rectangle

#: Parameter names of a beam as a user writes them, e.g. ``"rod.height"``.
PARAMETER_NAMES = {
    "youngs_modulus": ElementParameter.YOUNGS_MODULUS,
    "poisson_ratio": ElementParameter.POISSON_RATIO,
    "density": ElementParameter.DENSITY,
    "height": ElementParameter.HEIGHT,
    "width": ElementParameter.WIDTH,
    "length": ElementParameter.LENGTH,
    "damping_time": ElementParameter.DAMPING_TIME,
}


class Quantity(IntEnum):
    """A vector of a material point; slopes are derivatives along the section's axes."""

    POSITION = 0
    SLOPE_X = 1
    SLOPE_Y = 2
    SLOPE_Z = 3


@final
@dataclass(frozen=True)
class Point:
    """A material point of a beam.

    Parameters
    ----------
    beam : str
        Name of the beam.
    fraction : float
        Arc-length fraction along the beam, 0 at the start, 1 at the end.
    y, z : float
        Offset from the centre line along the section's axes; m.

    Raises
    ------
    InvalidInput
        If the fraction lies outside [0, 1] or a number is not finite.
    """

    beam: str
    fraction: float
    y: float = 0.0
    z: float = 0.0

    def __post_init__(self) -> None:
        """Validate."""
        where = f"point of {self.beam!r}"
        for value in (self.fraction, self.y, self.z):
            require_finite(where, value)
        if not 0.0 <= self.fraction <= 1.0:
            raise InvalidInput(
                where,
                "the fraction along the beam must lie in [0, 1]",
                self.fraction,
                "0 is the start of the beam and 1 its end.",
            )


def require_point(where: str, point: object, dimension: int = 3) -> None:
    """Refuse what is no point, and a point off the plane of a planar beam.

    Raises
    ------
    InvalidInput
    """
    require_kind(where, point, (Point,), "Write beam.at_start, beam.at_end or beam.at(fraction).")
    assert isinstance(point, Point)
    if dimension == 2 and point.z != 0.0:
        raise InvalidInput(where, "a planar beam has no z axis", f"z = {point.z}", "Leave z out.")


def name_at(kind: str, point: Point) -> str:
    """Return the default name of a joint or load on a point, ``kind(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If `point` is no point.
    """
    require_point(kind, point)
    return f"{kind}({point.beam}@{point.fraction:g})"


@final
@dataclass(frozen=True)
class ReferenceShape:
    """Reference configuration of a beam of n elements.

    Attributes
    ----------
    start : array, shape (d,)
        Position of the first node.
    lengths : array, shape (n,)
        Element lengths.
    slopes : array, shape (n + 1, d, d)
        Node frames; row k is the slope along the section's k-th axis.
    chords : array, shape (n, d)
        (r_2 - r_1) / length of each element.
    straight : bool
        Whether dr_o/dx is the same at every point of the beam.
    """

    start: Array
    lengths: Array
    slopes: Array
    chords: Array
    straight: bool


class BeamBody(abc.ABC):
    """What the rest of the package needs to know about a beam.

    Attributes
    ----------
    name : str
    section : Rectangle or sequence of Rectangle
        One for the beam or one per element.
    material : Material or sequence of Material
        One for the beam or one per element.
    """

    name: str
    section: Rectangle | Sequence[Rectangle]
    material: Material | Sequence[Material]

    @property
    @abc.abstractmethod
    def element_count(self) -> int:
        """Number of elements."""

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""

    @abc.abstractmethod
    def reference(self) -> ReferenceShape:
        """Return the reference configuration."""

    @abc.abstractmethod
    def with_length(self, length: float) -> BeamBody:
        """Return the same beam, stretched from its start to another total length."""

    @abc.abstractmethod
    def with_parts(
        self, section: Rectangle | Sequence[Rectangle], material: Material | Sequence[Material]
    ) -> BeamBody:
        """Return the same beam with another section and material."""

    @property
    def element(self) -> BeamElement:
        """The element that models this beam."""
        return BEAM_2D if self.dimension == 2 else BEAM_3D

    @property
    def at_start(self) -> Point:
        """The point at the start of the centre line."""
        return Point(self.name, 0.0)

    @property
    def at_end(self) -> Point:
        """The point at the end of the centre line."""
        return Point(self.name, 1.0)

    def at(self, fraction: float, y: float = 0.0, z: float = 0.0) -> Point:
        """Return the point at an arc-length fraction, offset in the section by y and z."""
        return Point(self.name, fraction, y, z)

    def element_parameters(self) -> Array:
        """Parameters of every element, shape (n, 7), columns as in `ElementParameter`."""
        sections, materials = self._per_element()
        rows = [
            (m.youngs_modulus, m.poisson_ratio, m.density, s.height, s.width, l, m.damping_time)
            for s, m, l in zip(sections, materials, self.reference().lengths, strict=True)
        ]
        return np.array(rows, dtype=float)

    def with_value(self, parameter: str, element: int | None, value: float) -> BeamBody:
        """Return the same beam with one parameter changed, everywhere or in one element.

        Raises
        ------
        InvalidInput
            If the value is not admissible for the parameter or the element does not exist.
        UnknownName
            If there is no such parameter.
        """
        self.check_target(parameter, element)
        which = PARAMETER_NAMES[parameter]
        if which is ElementParameter.LENGTH:
            return self.with_length(value)
        sections, materials = self._per_element()
        chosen = range(self.element_count) if element is None else [element]
        for k in chosen:
            if which in (ElementParameter.HEIGHT, ElementParameter.WIDTH):
                sections[k] = replace(sections[k], **{parameter: value})
            else:
                materials[k] = replace(materials[k], **{parameter: value})
        return self.with_parts(tuple(sections), tuple(materials))

    def check_target(self, parameter: str, element: int | None) -> None:
        """Refuse a design target that this beam does not have.

        Raises
        ------
        InvalidInput, UnknownName
        """
        if parameter not in PARAMETER_NAMES:
            known = (f"{self.name}.{name}" for name in PARAMETER_NAMES)
            raise UnknownName("design target", f"{self.name}.{parameter}", known)
        if element is None:
            return
        where = f"design target {self.name}.{parameter}[{element}]"
        if not 0 <= element < self.element_count:
            raise InvalidInput(
                where,
                f"the beam has elements 0 to {self.element_count - 1}",
                element,
                "Name an element that exists.",
            )
        if PARAMETER_NAMES[parameter] is ElementParameter.LENGTH:
            raise InvalidInput(
                where,
                "length is a property of the whole beam",
                f"[{element}]",
                f"Use {self.name}.length.",
            )

    def _per_element(self) -> tuple[list[Rectangle], list[Material]]:
        n = self.element_count
        sections = [self.section] * n if isinstance(self.section, Rectangle) else list(self.section)
        materials = (
            [self.material] * n if isinstance(self.material, Material) else list(self.material)
        )
        return sections, materials

    def _check_parts(self) -> None:
        name: object = self.name
        if not isinstance(name, str) or not name or "." in name or "[" in name:
            raise InvalidInput(
                "Beam.name",
                "must be a non-empty string without '.' and '['",
                repr(name),
                "Names appear in design targets such as 'rod.height[2]'.",
            )
        self._check_part(self.section, Rectangle)
        self._check_part(self.material, Material)

    def _check_part(self, part: object, kind: type) -> None:
        if isinstance(part, kind):
            return
        listed = part if isinstance(part, Sequence) else ()
        if len(listed) != self.element_count or not all(isinstance(x, kind) for x in listed):
            raise InvalidInput(
                f"beam {self.name!r}",
                f"needs one {kind.__name__} or a sequence of {self.element_count}, one per element",
                repr(part),
                f"Give one {kind.__name__}, or as many as there are elements.",
            )


@final
@dataclass(frozen=True)
class Beam(BeamBody):
    """A straight beam of equal elements.

    Parameters
    ----------
    name : str
    start, end : sequence of float
        End points of the centre line, two components for a planar and three for a spatial
        scene; m.
    elements : int
        Number of equal elements.
    section : Rectangle or sequence of Rectangle
    material : Material or sequence of Material
    height_axis : sequence of float, optional
        Spatial beams: direction of the section's height; its part along the beam is removed.
        By default the direction that makes (beam, height, width) right-handed with the width
        along global z, or along global y if the beam itself runs along z.

    Raises
    ------
    InvalidInput
        If the ends coincide, the number of elements is not a positive integer, or the height
        axis is parallel to the beam.
    """

    name: str
    start: Sequence[float]
    end: Sequence[float]
    elements: int
    section: Rectangle | Sequence[Rectangle]
    material: Material | Sequence[Material]
    height_axis: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Validate."""
        where = f"beam {self.name!r}"
        require_vector(f"{where}, start", self.start)
        require_vector(f"{where}, end", self.end, (len(tuple(self.start)),))
        require_count(f"{where}, elements", self.elements, "Use at least one element.")
        if not np.any(np.subtract(self.end, self.start)):
            raise InvalidInput(
                where,
                "start and end must differ",
                tuple(self.start),
                "A beam needs a length.",
            )
        self._check_parts()
        self._frame()

    @property
    def element_count(self) -> int:
        """Number of elements."""
        return int(self.elements)

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return len(tuple(self.start))

    @property
    def length(self) -> float:
        """Length of the centre line."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    def reference(self) -> ReferenceShape:
        """Return the straight reference configuration."""
        n, frame = self.element_count, self._frame()
        return ReferenceShape(
            start=np.array(self.start, dtype=float),
            lengths=np.full(n, self.length / n),
            slopes=np.repeat(frame[None], n + 1, axis=0),
            chords=np.repeat(frame[None, 0], n, axis=0),
            straight=True,
        )

    def with_length(self, length: float) -> Beam:
        """Return the same beam with its end moved along its axis."""
        require_positive(f"{self.name}.length", length)
        start = np.asarray(self.start, dtype=float)
        return replace(self, end=tuple((start + length * self._frame()[0]).tolist()))

    def with_parts(
        self, section: Rectangle | Sequence[Rectangle], material: Material | Sequence[Material]
    ) -> Beam:
        """Return the same beam with another section and material."""
        return replace(self, section=section, material=material)

    def _frame(self) -> Array:
        axis = np.subtract(self.end, self.start).astype(float)
        axis = axis / np.linalg.norm(axis)
        if self.dimension == 2:
            if self.height_axis is not None:
                raise InvalidInput(
                    f"beam {self.name!r}, height_axis",
                    "is a choice of spatial beams only",
                    tuple(self.height_axis),
                    "Leave it out: the height of a planar beam lies in the plane.",
                )
            return np.array([axis, [-axis[1], axis[0]]])
        if self.height_axis is None:
            along_z = abs(axis[2]) > 1.0 - 1e-8
            across = np.cross((0.0, 1.0, 0.0) if along_z else (0.0, 0.0, 1.0), axis)
        else:
            require_vector(f"beam {self.name!r}, height_axis", self.height_axis, (3,))
            given = np.asarray(self.height_axis, dtype=float)
            across = given - (given @ axis) * axis
            # 1e-8: below the square root of round-off the direction left over is noise.
            if np.linalg.norm(across) <= 1e-8 * np.linalg.norm(given):
                raise InvalidInput(
                    f"beam {self.name!r}, height_axis",
                    "must not be parallel to the beam",
                    tuple(self.height_axis),
                    "Give a direction across the beam.",
                )
        across = across / np.linalg.norm(across)
        return np.array([axis, across, np.cross(axis, across)])


@final
@dataclass(frozen=True, eq=False)
class CurvedBeam(BeamBody):
    """A beam through given node frames (curved reference shape, eq. 16).

    Parameters
    ----------
    name : str
    positions : array, shape (n + 1, d)
        Positions of the nodes; m.
    frames : array, shape (n + 1, d, d)
        Slope vectors of the nodes, row k along the section's k-th axis (tangent first);
        right-handed.
    section : Rectangle or sequence of Rectangle
    material : Material or sequence of Material
    element_lengths : sequence of float, optional
        Range of the axial coordinate of each element. By default the arc length of the cubic
        through its nodes, so that unit tangents stay unit tangents.

    Raises
    ------
    InvalidInput
        If shapes disagree, nodes coincide or a frame is not right-handed.
    """

    name: str
    positions: Array
    frames: Array
    section: Rectangle | Sequence[Rectangle]
    material: Material | Sequence[Material]
    element_lengths: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Validate."""
        where = f"beam {self.name!r}"
        positions = require_array(f"{where}, positions", self.positions)
        if positions.ndim != 2 or positions.shape[0] < 2 or positions.shape[1] not in (2, 3):
            raise InvalidInput(
                f"{where}, positions",
                "must have shape (n + 1, 2) or (n + 1, 3) with n >= 1",
                positions.shape,
                "Give one row per node.",
            )
        frame_shape = (*positions.shape, positions.shape[1])
        frames = require_array(f"{where}, frames", self.frames, frame_shape)
        if not np.all(np.any(np.diff(positions, axis=0) != 0.0, axis=1)):
            raise InvalidInput(
                f"{where}, positions",
                "neighbouring nodes must differ",
                "an element of length zero",
                "Remove the repeated node.",
            )
        if not np.all(np.linalg.det(frames) > 0):
            raise InvalidInput(
                f"{where}, frames",
                "must be right-handed",
                f"smallest determinant {np.min(np.linalg.det(frames)):.3g}",
                "Order the rows tangent, height axis(, width axis).",
            )
        if self.element_lengths is not None:
            self._check_lengths(f"{where}, element_lengths", self.element_lengths)
        self._check_parts()

    @property
    def element_count(self) -> int:
        """Number of elements."""
        return len(self.positions) - 1

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return int(np.shape(self.positions)[1])

    @property
    def length(self) -> float:
        """Length of the centre line."""
        return float(np.sum(self.reference().lengths))

    def reference(self) -> ReferenceShape:
        """Return the curved reference configuration."""
        positions, slopes = np.asarray(self.positions, float), np.asarray(self.frames, float)
        steps = np.diff(positions, axis=0)
        if self.element_lengths is None:
            lengths = _arc_lengths(steps, slopes[:-1, 0], slopes[1:, 0])
        else:
            lengths = np.asarray(self.element_lengths, float)
        return ReferenceShape(positions[0], lengths, slopes, steps / lengths[:, None], False)

    def with_length(self, length: float) -> CurvedBeam:
        """Return the beam with its centre line scaled about its start."""
        require_positive(f"{self.name}.length", length)
        shape, positions = self.reference(), np.asarray(self.positions, float)
        factor = length / self.length
        return replace(
            self,
            positions=positions[0] + factor * (positions - positions[0]),
            element_lengths=tuple((factor * shape.lengths).tolist()),
        )

    def with_parts(
        self, section: Rectangle | Sequence[Rectangle], material: Material | Sequence[Material]
    ) -> CurvedBeam:
        """Return the same beam with another section and material."""
        return replace(self, section=section, material=material)

    def _check_lengths(self, where: str, given: object) -> None:
        rule, repair = f"must have {self.element_count} entries", "Give one length per element."
        lengths = require_sequence(where, given, rule, repair)
        if len(lengths) != self.element_count:
            raise InvalidInput(where, rule, len(lengths), repair)
        for length in lengths:
            require_positive(where, length)


def _arc_lengths(steps: Array, tangents_1: Array, tangents_2: Array) -> Array:
    """Lengths l that equal the arc length of the cubic they define, by fixed-point iteration.

    r,x = s5'(xi)/l (r_2 - r_1) + s2' r_x1 + s6' r_x2 and l = int |r,x| l dxi. The map contracts
    by about the squared turning angle of the element over 30, so a few sweeps reach round-off.
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
