"""Solid circular cross-section and tube."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule
from ancfdae.sections.section import Section, SectionPoints, require_smaller

# Points of a circumference: the cosine of half the angle between them is 0.981.
_AROUND = 16


@dataclass(frozen=True)
class _Round(Section):
    """A section with a circular contour."""

    radius: float

    @property
    def half_extents(self) -> tuple[float, float]:
        """The outer radius."""
        return self.radius, self.radius

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Points at equal angles: of stresses linear in y and z none misses the largest by 2 %."""
        radius, angle = sizes[:, :1], 2 * np.pi * np.arange(_AROUND) / _AROUND
        return radius * np.cos(angle), radius * np.sin(angle)

    def contour(self, sizes: Array) -> tuple[Array, Array]:
        """Points at equal angles from the bottom on, none of them at the bottom itself."""
        radius, angle = sizes[:, :1], 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
        return -radius * np.cos(angle), -radius * np.sin(angle)


@final
@dataclass(frozen=True)
class Circle(_Round):
    """Solid circular cross-section.

    Parameters
    ----------
    radius : float
        m.

    Raises
    ------
    InvalidInput
        If the radius is not finite and positive.
    """

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Points of an annulus without a hole."""
        return _annulus(0.0 * sizes[:, 0], sizes[:, 0], fine)

    def shear(self, sizes: Array, nu: Array) -> tuple[Array, Array]:
        """Cowper (1966)."""
        factor = 6 * (1 + nu) / (7 + 6 * nu)
        return factor, factor

    def torsion(self, sizes: Array) -> Array:
        """Polar moment of area: circles do not warp."""
        J: Array = np.pi / 2 * sizes[:, 0] ** 4
        return J


@final
@dataclass(frozen=True)
class Tube(_Round):
    """Circular tube.

    Parameters
    ----------
    radius : float
        Outer radius; m.
    thickness : float
        Of the wall; m.

    Raises
    ------
    InvalidInput
        If a size is not finite and positive, or the wall is as thick as the radius.
    """

    thickness: float

    def __post_init__(self) -> None:
        """Validate."""
        super().__post_init__()
        rule = "must be less than the radius"
        require_smaller("Tube.thickness", self.thickness, self.radius, rule)

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Points of the annulus."""
        radius, thickness = sizes.T
        return _annulus(radius - thickness, radius, fine)

    def shear(self, sizes: Array, nu: Array) -> tuple[Array, Array]:
        """Cowper (1966); m is the ratio of inner to outer radius."""
        m = 1 - sizes[:, 1] / sizes[:, 0]
        round_trip = (1 + m**2) ** 2
        factor = 6 * (1 + nu) * round_trip / ((7 + 6 * nu) * round_trip + (20 + 12 * nu) * m**2)
        return factor, factor

    def torsion(self, sizes: Array) -> Array:
        """Polar moment of area."""
        radius, thickness = sizes.T
        J: Array = np.pi / 2 * (radius**4 - (radius - thickness) ** 4)
        return J


def _annulus(inner: Array, outer: Array, fine: bool) -> SectionPoints:
    """Gauss points in the squared radius, equal angles; exact to degree 5 (fine: 11)."""
    radial, angular = (6, 12) if fine else (3, 6)
    corner, rule = box_rule((radial,))
    share = corner[:, 0]
    squared = inner[:, None] ** 2 * (1 - share) + outer[:, None] ** 2 * share
    angle = 2 * np.pi * (np.arange(angular) + 0.5) / angular
    r, n = np.sqrt(squared)[:, :, None], len(inner)
    area = np.pi * (outer**2 - inner**2)
    dA = area[:, None, None] * np.broadcast_to((rule / angular)[:, None], (radial, angular))
    return (
        (r * np.cos(angle)).reshape(n, -1),
        (r * np.sin(angle)).reshape(n, -1),
        dA.reshape(n, -1),
    )
