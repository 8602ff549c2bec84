"""Solid and hollow circles, rectangles and their sums, sections given by moments or by points."""

import abc
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np

from ancfdae.errors.checks import require_array, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.sections.section import (
    ROUND_UP,
    Section,
    SectionPoints,
    central_moments,
    columns,
    rectangle_torsional_shear,
    require_smaller,
    stepped_share,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import box_rule

# Number of points on a circle; the cosine of half the angle between them is 0.981.
_AROUND = 16


@dataclass(frozen=True)
class _Round(Section):
    """A section between two concentric circles; the inner one may have radius zero."""

    shaped = True

    radius: float

    @abc.abstractmethod
    def inner(self, sizes: Array) -> Array:
        """Return the radius of the hole, shape (n,); m."""

    @property
    def half_extents(self) -> tuple[float, float]:
        """Half height and half width, the outer radius; m."""
        return self.radius, self.radius

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of points at equal angles, (n, 16) each; m.

        Stresses linear in y and z exceed the largest at these points by less than 2 %.
        """
        radius, angle = sizes[:, :1], 2 * np.pi * np.arange(_AROUND) / _AROUND
        return radius * np.cos(angle), radius * np.sin(angle)

    def contour(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of points at equal angles, half a step beside the bottom, (n, 16); m."""
        radius, angle = sizes[:, :1], 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
        return -radius * np.cos(angle), -radius * np.sin(angle)

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return Gauss points in squared radius and angle; exact to degree 5 (fine: 11)."""
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
        """Return Cowper's (1966) shear factors; m is the ratio of inner to outer radius."""
        m = self.inner(sizes) / sizes[:, 0]
        round_trip = (1 + m**2) ** 2
        factor = 6 * (1 + nu) * round_trip / ((7 + 6 * nu) * round_trip + (20 + 12 * nu) * m**2)
        return factor, factor

    def torsion(self, sizes: Array) -> Array:
        """Return the polar moments of area, (n,), m^4: circular sections do not warp."""
        return np.pi / 2 * (sizes[:, 0] ** 4 - self.inner(sizes) ** 4)

    def torsional_shear(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Shear stresses along y and z per unit rate of twist and G, (n, n_f): -z and y; m."""
        return -z, y

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return Jourawski's local over mean shear stress, (n, n_f): 4/3 at the centre of a disc.

        At the centre line of a thin tube it is 2.
        """
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
        Radius; m.
    """

    def inner(self, sizes: Array) -> Array:
        """Return the radius of the hole, zero for a solid circle, shape (n,); m."""
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
        Thickness of the wall; m.

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


# -- rectangles --------------------------------------------------------------------------------


# Gauss points per side: 3 integrate the degree 5 of straight beams. Curved beams have a rational
# integrand; with a radius of curvature R the error of A falls like (height / 4R)^(2 n): measured
# with 6 points, 1e-15 at height = R / 10, 6e-14 at R / 5, 4e-9 at R / 2.
_COARSE, _FINE = 3, 6


@dataclass(frozen=True)
class Rectangular(Section):
    """Base class of sections with outer dimensions: height along y and width along z."""

    shaped = True

    height: float
    width: float

    @property
    def half_extents(self) -> tuple[float, float]:
        """Half height and half width; m."""
        return self.height / 2, self.width / 2


@final
@dataclass(frozen=True)
class Rectangle(Rectangular):
    """Rectangular cross-section.

    Parameters
    ----------
    height : float
        Extent along y (in the plane of a planar scene); m.
    width : float
        Extent along z (the thickness of a planar scene); m.
    """

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return Gauss points of the section: y and z, (n, n_f), and areas; m, m^2."""
        h, w = sizes.T
        return rectangles_points([(h, w, 0.0 * h, 0.0 * h)], fine)

    def shear(self, sizes: Array, nu: Array) -> tuple[Array, Array]:
        """Return Cowper's (1966) shear factors along y and z, (n,) each; dimensionless."""
        factor = 10 * (1 + nu) / (12 + 11 * nu)
        return factor, factor

    def torsion(self, sizes: Array) -> Array:
        """Return the torsion constants J by Saint-Venant's series, shape (n,); m^4."""
        return rectangle_torsion(*sizes.T)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of the points of `around`: corners, middles of sides, and near corners."""
        return around(*sizes.T)

    def torsional_shear(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return the shear stresses over G and rate of twist by Saint-Venant's series; m."""
        h, w = columns(sizes)
        return rectangle_torsional_shear(h, w, y, z)

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return the local over mean shear stress, (n, n_f) each: parabolas, 3/2 in the middle."""
        h, w = columns(sizes)
        return stepped_share(h, h / 2, w, w, y), stepped_share(w, w / 2, h, h, z)


def around(h: Array, w: Array) -> tuple[Array, Array]:
    """Return y and z of points on the four sides of rectangles, shape (n, 16) each; m.

    Bending has its largest stress at corners and torsion in the middle of the long sides. But most
    of the torsional stress persists up to about the thickness from the corners, near which points
    are placed, best with the factor 0.4. Stresses linear along the sides, together with torsional
    stresses, exceed the largest at these points by less than 3.5 %
    (tests/sensitivity/test_stress.py).
    """
    zero = 0.0 * h
    y_near = h / 2 * (1 - w / (w + 0.4 * h))
    z_near = w / 2 * (1 - h / (h + 0.4 * w))
    y = [s * h / 2 for s in (-1, 1) for _ in range(5)] + [s * y_near for s in (-1, -1, 1, 1)]
    z = [t for _ in (-1, 1) for t in (-w / 2, -z_near, zero, z_near, w / 2)]
    z += [s * w / 2 for s in (-1, 1, -1, 1)]
    return np.stack([*y, zero, zero], axis=1), np.stack([*z, -w / 2, w / 2], axis=1)


def corners(h: Array, w: Array) -> tuple[Array, Array]:
    """Return y and z of the corners of rectangles centred at the axis, shape (n, 4) each; m."""
    y, z = np.array([-0.5, -0.5, 0.5, 0.5]), np.array([-0.5, 0.5, 0.5, -0.5])
    return h[:, None] * y, w[:, None] * z


def rectangles_points(
    rectangles: Sequence[tuple[Array, Array, Array, Array]], fine: bool
) -> SectionPoints:
    """Return Gauss points of sections composed of rectangles.

    A rectangle is given by height, width, and y and z of its centre, shape (n,) each; m.
    """
    corner, rule = box_rule((1,) + 2 * (_FINE if fine else _COARSE,))
    eta, zeta = corner[:, 1], corner[:, 2]
    y = [h[:, None] * eta + y_c[:, None] for h, _, y_c, _ in rectangles]
    z = [w[:, None] * zeta + z_c[:, None] for _, w, _, z_c in rectangles]
    dA = [(h * w)[:, None] * rule for h, w, _, _ in rectangles]
    return np.concatenate(y, axis=1), np.concatenate(z, axis=1), np.concatenate(dA, axis=1)


def rectangle_torsion(h: Array, w: Array) -> Array:
    """Return the torsion constants of rectangles with sides h and w, shape (n,); m^4.

    J = a b^3 (1/3 - (64/pi^5) (b/a) sum_{n odd} tanh(n pi a / 2b) / n^5), b the shorter side
    (Timoshenko & Goodier, Theory of Elasticity, sec. 109). With tanh x = 1 - 2/(e^{2x} + 1) and sum
    1/n^5 = 31/32 zeta(5) the remaining terms fall like e^{-n pi}: below round-off after n = 11.
    """
    a, b = np.where(h.real >= w.real, (h, w), (w, h))
    n = np.arange(1, 13, 2)[:, None]
    # e^{-2x} instead of e^{2x}, which overflows for thin strips.
    decay = np.exp(-n * np.pi * a / b)
    series = 31 / 32 * 1.0369277551433699 - np.sum(2 * decay / (1 + decay) / n**5, axis=0)
    return a * b**3 * (1 / 3 - 64 / np.pi**5 * (b / a) * series)


# -- general sections --------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class GeneralSection(Section):
    """A doubly symmetric section given by its area, second moments and torsion constant.

    It is modelled by four points, which also give the higher moments; these matter for large
    curvatures only.

    Parameters
    ----------
    area : float
        Area; m^2.
    second_moment_y : float
        Integral of y^2, which resists bending along the height; m^4.
    second_moment_z : float
        Integral of z^2, which resists bending along the width; m^4.
    torsion_moment : float
        Torsion constant J in the torque G J kappa; m^4. It has no effect in the plane.
    shear_factors : (float, float), optional
        Shear factors along y and z; 1 by default.
    """

    area: float
    second_moment_y: float
    second_moment_z: float
    torsion_moment: float

    @property
    def half_extents(self) -> tuple[float, float]:
        """Half height and half width of the rectangle with the same area and second moments; m."""
        moments = (self.second_moment_y, self.second_moment_z)
        return tuple(float(np.sqrt(3 * I / self.area)) for I in moments)  # type: ignore[return-value]

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return four points at the radii of gyration, each with a quarter of the area."""
        area, I_y, I_z, _ = sizes.T[..., None]
        y, z = (np.sqrt(I / area) for I in (I_y, I_z))
        sign = np.array([-1.0, 1.0])
        return y * np.repeat(sign, 2), z * np.tile(sign, 2), area * np.full(4, 0.25)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Return the corners of the rectangle with the same area and second moments; m."""
        area, I_y, I_z, _ = sizes.T
        h, w = (np.sqrt(12 * I / area) for I in (I_y, I_z))
        return corners(h, w)

    def torsion(self, sizes: Array) -> Array:
        """Return the torsion constants as declared, shape (n,); m^4."""
        return sizes[:, 3]

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return local over mean shear stress along y and z, (n, n_f) each; dimensionless.

        They are computed for the rectangle with the same area and second moments of area.
        """
        area, I_y, I_z, _ = columns(sizes)
        h, w = (np.sqrt(12 * I / area) for I in (I_y, I_z))
        return stepped_share(h, h / 2, w, w, y), stepped_share(w, w / 2, h, h, z)


@final
@dataclass(frozen=True)
class QuadratureSection(Section):
    """A section of any shape, given by quadrature points and areas, with two scale factors.

    Parameters
    ----------
    height_factor, width_factor : float
        Scale factors of the coordinates y and z of the points; areas scale with their product.
    places : sequence of (float, float)
        Coordinates y and z of the points from the beam's axis; m.
    areas : sequence of float
        Area that each point represents; m^2.
    shear_factors : (float, float), optional
        Shear factors along y and z; 1 by default.
    torsion_constant : float, optional
        Torsion constant J; by default the polar moment about the centroid, as if the section did
        not warp; m^4.
    shear_centre : (float, float), optional
        Coordinates y and z of the shear centre: forces through it do not twist the beam. By default
        the centroid; scaled with the points; m.

    Raises
    ------
    InvalidInputError
        If numbers are missing, not finite, or the area or a factor is not positive.
    """

    height_factor: float = 1.0
    width_factor: float = 1.0
    places: Sequence[Sequence[float]] = field(kw_only=True)
    areas: Sequence[float] = field(kw_only=True)
    shear_centre: Sequence[float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        areas = require_array("QuadratureSection.areas", self.areas)
        if areas.ndim != 1 or not np.sum(areas) > 0:
            raise InvalidInputError(
                "QuadratureSection.areas",
                "must be a list of numbers with a positive sum",
                self.areas,
                "Give the area of every point.",
            )
        places = require_array("QuadratureSection.places", self.places, (len(areas), 2))
        object.__setattr__(self, "areas", tuple(areas.tolist()))
        object.__setattr__(self, "places", tuple(map(tuple, places.tolist())))
        if self.shear_centre is not None:
            require_vector("QuadratureSection.shear_centre", self.shear_centre, (2,))
            object.__setattr__(self, "shear_centre", tuple(map(float, self.shear_centre)))

    @property
    def half_extents(self) -> tuple[float, float]:
        """Largest |y| and |z| of the scaled points; m."""
        y, z = np.max(np.abs(self.places), axis=0)
        return float(self.height_factor * y), float(self.width_factor * z)

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return the quadrature points, y and z times the factors, and the areas; m, m^2."""
        (y, z), f = np.transpose(self.places), sizes[:, :, None]
        return f[:, 0] * y, f[:, 1] * z, f[:, 0] * f[:, 1] * np.asarray(self.areas)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of all points: the quadrature rule has no contour."""
        y, z, _ = self.points(sizes, False)
        return y, z

    def twist_centre(self, sizes: Array, centroid: Array) -> Array:
        """Return the declared shear centre times the scale factors, shape (n, 1, 2); m."""
        if self.shear_centre is None:
            return centroid
        return np.asarray(sizes[:, None] * np.asarray(self.shear_centre))

    def torsion(self, sizes: Array) -> Array:
        """Return the polar moments of the points about the centroid, shape (n,); m^4."""
        _, moments = central_moments(*self.points(sizes, False))
        return moments.sum(axis=1)
