"""A beam through given node frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_array, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies.body import BeamBody, ReferenceShape
from ancfdae.model.bodies.curves import arc, through
from ancfdae.model.elements import BeamElement, StrainEnergyFunction
from ancfdae.model.elements.hermite import end_weight_xi, slope_weights_xi
from ancfdae.model.material import Material
from ancfdae.model.sections.section import Section
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule


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
        """The curved reference configuration: nodes, directions and fractions."""
        steps, slopes = np.diff(self.positions, axis=0), self.frames
        lengths = _arc_lengths(steps, slopes[:-1, 0], slopes[1:, 0])
        return ReferenceShape(lengths, slopes, steps / lengths[:, None], False)

    @property
    def place(self) -> Sequence[float]:
        """Position of the first node, shape (d,); m."""
        return tuple(self.positions[0].tolist())

    def with_place(self, place: Sequence[float]) -> CurvedBeam:
        """Return the same beam, moved to start at another place."""
        return replace(self, positions=self.positions - self.positions[0] + np.asarray(place))

    def with_length(self, length: float) -> CurvedBeam:
        """Return the beam with its centre line scaled about its start."""
        require_positive(f"{self.name}.length", length)
        first, factor = self.positions[0], length / self.length
        return replace(self, positions=first + factor * (self.positions - first))


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
