"""Solid circular cross-section and tube."""

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.model.sections.section import ROUND_UP, Section, SectionPoints, require_smaller
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule

# Points of a circumference: the cosine of half the angle between them is 0.981.
_AROUND = 16


@dataclass(frozen=True)
class _Round(Section):
    """A section between two circles, of which the inner one may be a point."""

    shaped = True

    radius: float

    @abc.abstractmethod
    def inner(self, sizes: Array) -> Array:
        """Return the radius of the hole, shape (n,)."""

    @property
    def half_extents(self) -> tuple[float, float]:
        """Half height and half width, the outer radius; m."""
        return self.radius, self.radius

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Points at equal angles: of stresses linear in y and z none misses the largest by 2 %."""
        radius, angle = sizes[:, :1], 2 * np.pi * np.arange(_AROUND) / _AROUND
        return radius * np.cos(angle), radius * np.sin(angle)

    def contour(self, sizes: Array) -> tuple[Array, Array]:
        """Points at equal angles from the bottom on, none of them at the bottom itself."""
        radius, angle = sizes[:, :1], 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
        return -radius * np.cos(angle), -radius * np.sin(angle)

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Gauss points in the squared radius, equal angles; exact to degree 5 (fine: 11)."""
        radial, angular = (6, 12) if fine else (3, 6)
        corner, rule = box_rule((radial,))
        share, n = corner[:, 0], len(sizes)
        hole, whole = self.inner(sizes)[:, None] ** 2, sizes[:, :1] ** 2
        angle = 2 * np.pi * (np.arange(angular) + 0.5) / angular
        r = np.sqrt(hole * (1 - share) + whole * share)[:, :, None]
        dA = np.pi * (whole - hole) * np.repeat(rule / angular, angular)
        y, z = r * np.cos(angle), r * np.sin(angle)
        return y.reshape(n, -1), z.reshape(n, -1), dA

    def shear(self, sizes: Array, nu: Array) -> tuple[Array, Array]:
        """Cowper (1966); m is the ratio of inner to outer radius."""
        m = self.inner(sizes) / sizes[:, 0]
        round_trip = (1 + m**2) ** 2
        factor = 6 * (1 + nu) * round_trip / ((7 + 6 * nu) * round_trip + (20 + 12 * nu) * m**2)
        return factor, factor

    def torsion(self, sizes: Array) -> Array:
        """Polar moment of area: circles do not warp."""
        return np.pi / 2 * (sizes[:, 0] ** 4 - self.inner(sizes) ** 4)

    def torsional_shear(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Shear stresses along y and z per unit rate of twist and G, (n, n_f): -z and y; m."""
        return -z, y

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Jourawski's of circles, 4/3 in the middle, and of thin tubes, 2, and between them."""
        whole, hole = sizes[:, :1] ** 2, self.inner(sizes)[:, None] ** 2
        height = 4 / (3 * whole - hole)
        return height * (whole - y**2), height * (whole - z**2)

    def holds(self, y: float, z: float) -> bool:
        """Whether the point (y, z) lies between hole and outer circle."""
        inner = float(self.inner(np.array([self.sizes()]))[0])
        r = float(np.hypot(y, z))
        return inner <= r * ROUND_UP and r <= self.radius * ROUND_UP


@final
@dataclass(frozen=True)
class Circle(_Round):
    """Solid circular cross-section.

    Parameters
    ----------
    radius : float
        m.
    """

    def inner(self, sizes: Array) -> Array:
        """Return the radius of the hole: none, zero; m."""
        return 0.0 * sizes[:, 0]


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
    InvalidInputError
        If a size is not finite and positive, or the wall is as thick as the radius.
    """

    thickness: float

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = "must be less than the radius"
        require_smaller("Tube.thickness", self.thickness, self.radius, rule)

    def inner(self, sizes: Array) -> Array:
        """Return the radius of the hole, radius less wall thickness; m."""
        return np.asarray(sizes[:, 0] - sizes[:, 1])
