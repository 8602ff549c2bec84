"""Cross-sections given by their moments or by points."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np

from ancfdae.errors.checks import require_array, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.sections.rectangle import corners
from ancfdae.model.sections.section import Section, SectionPoints, central_moments, columns
from ancfdae.model.sections.spread import stepped_share
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class GeneralSection(Section):
    """A doubly symmetric section of which only the moments are known.

    Modelled by four points; higher moments than the second, which only count for large curvatures,
    are those of these points.

    Parameters
    ----------
    area : float
        m^2.
    second_moment_y : float
        Integral of y^2, which resists bending along the height; m^4.
    second_moment_z : float
        Integral of z^2, which resists bending along the width; m^4.
    torsion_moment : float
        J in the torque G J kappa; m^4. It has no effect in the plane.
    shear_factors : (float, float), optional
        1 by default.
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
        """Four points at the radii of gyration."""
        area, I_y, I_z, _ = sizes.T[..., None]
        y, z = (np.sqrt(I / area) for I in (I_y, I_z))
        sign = np.array([-1.0, 1.0])
        return y * np.repeat(sign, 2), z * np.tile(sign, 2), area * np.full(4, 0.25)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Corners of the rectangle with the same area and second moments; m."""
        area, I_y, I_z, _ = sizes.T
        h, w = (np.sqrt(12 * I / area) for I in (I_y, I_z))
        return corners(h, w)

    def torsion(self, sizes: Array) -> Array:
        """Torsion constants as declared, shape (n,); m^4."""
        return sizes[:, 3]

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return local over mean shear stress along y and z, (n, n_f) each; dimensionless.

        They are those of the rectangle with the same area and second moments of area.
        """
        area, I_y, I_z, _ = columns(sizes)
        h, w = (np.sqrt(12 * I / area) for I in (I_y, I_z))
        return stepped_share(h, h / 2, w, w, y), stepped_share(w, w / 2, h, h, z)


@final
@dataclass(frozen=True)
class QuadratureSection(Section):
    """A section of any shape, given by a quadrature rule; its sizes stretch it along y and z.

    Parameters
    ----------
    height_factor, width_factor : float
        What the coordinates y and z of the points are multiplied by; areas by the product.
    places : sequence of (float, float)
        Coordinates y and z of the points from the beam's axis; m.
    areas : sequence of float
        Area that each stands for; m^2.
    shear_factors : (float, float), optional
        1 by default.
    torsion_constant : float, optional
        By default the polar moment about the centroid, as if the section did not warp; m^4.
    shear_centre : (float, float), optional
        Its coordinates y and z: forces through it do not twist the beam. By default the centroid;
        stretched with the points.

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
        """Largest |y| and |z| of the points; m."""
        y, z = np.max(np.abs(self.places), axis=0)
        return float(self.height_factor * y), float(self.width_factor * z)

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return the quadrature points, y and z times the factors, and the areas; m, m^2."""
        (y, z), f = np.transpose(self.places), sizes[:, :, None]
        return f[:, 0] * y, f[:, 1] * z, f[:, 0] * f[:, 1] * np.asarray(self.areas)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """All points: the rule knows no contour."""
        y, z, _ = self.points(sizes, False)
        return y, z

    def twist_centre(self, sizes: Array, centroid: Array) -> Array:
        """Shear centre as declared, times the factors; m."""
        if self.shear_centre is None:
            return centroid
        return np.asarray(sizes[:, None] * np.asarray(self.shear_centre))

    def torsion(self, sizes: Array) -> Array:
        """Polar moments of the points about the centroid, shape (n,); m^4."""
        _, moments = central_moments(*self.points(sizes, False))
        return moments.sum(axis=1)
