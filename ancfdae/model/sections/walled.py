"""Thin-walled cross-sections: rectangular box and I section."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.model.sections.section import (
    ROUND_UP,
    SectionPoints,
    columns,
    in_web,
    rectangle_torsional_shear,
    require_smaller,
    stepped_share,
)
from ancfdae.model.sections.shapes import (
    Rectangular,
    around,
    corners,
    rectangle_torsion,
    rectangles_points,
)
from ancfdae.numerics.arrays import Array


@dataclass(frozen=True)
class _Walled(Rectangular):
    """Base class of sections of two flanges of the full width, joined by webs."""

    webs: ClassVar[int] = 2

    web_thickness: float
    flange_thickness: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, walls, outer, extent in (
            ("flange_thickness", 2 * self.flange_thickness, self.height, "height"),
            ("web_thickness", self.webs * self.web_thickness, self.width, "width"),
        ):
            rule = f"the walls together must be thinner than the {extent}"
            require_smaller(f"{type(self).__name__}.{name}", walls, outer, rule)


@final
@dataclass(frozen=True)
class Box(_Walled):
    """Rectangular box, webs at both sides.

    Parameters
    ----------
    height, width : float
        Outer extents along y and z; m.
    web_thickness : float
        Thickness of each wall along y; m.
    flange_thickness : float
        Thickness of each wall along z; m.

    Raises
    ------
    InvalidInputError
        If a size is not finite and positive, or the walls leave no hole.
    """

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return Gauss points of flanges and webs: y, z, m, and areas, m^2."""
        h, w, t_w, t_f = sizes.T
        y, z, inner, none = (h - t_f) / 2, (w - t_w) / 2, h - 2 * t_f, 0.0 * h
        walls = [(t_f, w, s * y, none) for s in (-1, 1)]
        walls += [(inner, t_w, none, s * z) for s in (-1, 1)]
        return rectangles_points(walls, fine)

    def shear(self, sizes: Array, nu: Array) -> tuple[Array, Array]:
        """Return Cowper's (1966) shear factors for thin walls, either pair of walls as the webs."""
        h, w, t_w, t_f = sizes.T
        return _box_shear(h, w, t_w, t_f, nu), _box_shear(w, h, t_f, t_w, nu)

    def torsion(self, sizes: Array) -> Array:
        """Return J by Bredt's formula, 4 A^2 / int ds/t, shape (n,); m^4.

        The integral is along the middle line of the walls, which encloses the area A.
        """
        h, w, t_w, t_f = sizes.T
        a, b = h - t_f, w - t_w
        return 2 * (a * b) ** 2 / (a / t_w + b / t_f)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of the corners and of the outer ends of the webs, (n, 8) each; m."""
        h, w, _, t_f = sizes.T
        (y, z), (y_w, z_w) = corners(h, w), corners(h - 2 * t_f, w)
        return np.concatenate([y, y_w], axis=1), np.concatenate([z, z_w], axis=1)

    def torsional_shear(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return Bredt's shear stress J/(2 A t) along each wall; flanges have the full width."""
        h, w, t_w, t_f = columns(sizes)
        flow = self.torsion(sizes)[:, None] / (2 * (h - t_f) * (w - t_w))
        web = in_web(y, h / 2 - t_f)
        t_y = np.where(web, -np.sign(z.real) * flow / t_w, 0 * flow)
        return t_y, np.where(web, 0 * flow, np.sign(y.real) * flow / t_f)

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return Jourawski's local over mean shear stress, either pair of walls as the webs."""
        h, w, t_w, t_f = columns(sizes)
        along_y = stepped_share(h, h / 2 - t_f, w, 2 * t_w, y)
        return along_y, stepped_share(w, w / 2 - t_w, h, 2 * t_f, z)

    def holds(self, y: float, z: float) -> bool:
        """Whether the point (y, z) lies within the walls of the box."""
        hole_y, hole_z = (
            self.height / 2 - self.flange_thickness,
            self.width / 2 - self.web_thickness,
        )
        in_wall = abs(y) * ROUND_UP >= hole_y or abs(z) * ROUND_UP >= hole_z
        return in_wall and super().holds(y, z)


@final
@dataclass(frozen=True)
class ISection(_Walled):
    """I section with one web in the middle; parameters and errors as in `Box`."""

    webs = 1

    def contour(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of the twelve corners and of points between, shape (n, n_p) each; m."""
        h, w, t_w, t_f = sizes.T
        top, inner = h / 2, h / 2 - t_f
        y = np.stack([-top, -top, -inner, -inner, 0 * h, inner, inner, top, top], axis=1)
        z = -np.stack([w / 2, w, w, t_w, t_w, t_w, w, w, w / 2], axis=1) / 2
        return np.concatenate([y, y[:, ::-1]], axis=1), np.concatenate([z, -z[:, ::-1]], axis=1)

    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return Gauss points of flanges and web: y, z, m, and areas, m^2."""
        h, w, t_w, t_f = sizes.T
        y, none = (h - t_f) / 2, 0.0 * h
        walls = [(t_f, w, s * y, none) for s in (-1, 1)]
        return rectangles_points([*walls, (h - 2 * t_f, t_w, none, none)], fine)

    def shear(self, sizes: Array, nu: Array) -> tuple[Array, Array]:
        """Return shear factors: along y Cowper (1966) for thin walls, along z two rectangles."""
        h, w, t_w, t_f = sizes.T
        a = h - t_f
        m, n = 2 * w * t_f / (a * t_w), w / a
        bottom = _cowper(m, nu) + 30 * n**2 * (m + m**2) + 5 * nu * n**2 * (8 * m + 9 * m**2)
        flanges = 2 * w * t_f / (2 * w * t_f + (h - 2 * t_f) * t_w)
        return 10 * (1 + nu) * (1 + 3 * m) ** 2 / bottom, 10 * (1 + nu) / (12 + 11 * nu) * flanges

    def torsion(self, sizes: Array) -> Array:
        """Return J as the sum over the three rectangles, shape (n,), m^4; warping is free."""
        h, w, t_w, t_f = sizes.T
        return 2 * rectangle_torsion(w, t_f) + rectangle_torsion(h - 2 * t_f, t_w)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of points on the outer sides of flanges and the sides of the web, m."""
        h, w, t_w, t_f = sizes.T
        (y_f, z_f), (y_w, z_w) = around(t_f, w), around(h - 2 * t_f, t_w)
        shift = ((h - t_f) / 2)[:, None]
        low, high, sides = slice(0, 5), slice(5, 10), slice(10, 16)
        y = [y_f[:, low] - shift, y_f[:, high] + shift, y_w[:, sides]]
        return np.concatenate(y, axis=1), np.concatenate(
            [z_f[:, low], z_f[:, high], z_w[:, sides]], axis=1
        )

    def torsional_shear(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return the shear stresses of three rectangles with one rate of twist, (n, n_f); m."""
        h, w, t_w, t_f = columns(sizes)
        flange = y - np.sign(y.real) * (h - t_f) / 2
        walls = (
            rectangle_torsional_shear(h - 2 * t_f, t_w, y, z),
            rectangle_torsional_shear(t_f, w, flange, z),
        )
        web = in_web(y, h / 2 - t_f)
        t_y, t_z = (np.where(web, *pair) for pair in zip(*walls, strict=True))
        return t_y, t_z

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return Jourawski's local over mean shear stress, (n, n_f) each; dimensionless."""
        h, w, t_w, t_f = columns(sizes)
        along_y = stepped_share(h, h / 2 - t_f, w, t_w, y)
        return along_y, stepped_share(w, t_w / 2, 2 * t_f, h, z)

    def holds(self, y: float, z: float) -> bool:
        """Whether the point (y, z) lies within the web or a flange."""
        inner, half = self.height / 2 - self.flange_thickness, self.web_thickness / 2
        in_wall = abs(y) * ROUND_UP >= inner or abs(z) <= half * ROUND_UP
        return in_wall and super().holds(y, z)


def _box_shear(h: Array, w: Array, t_w: Array, t_f: Array, nu: Array) -> Array:
    a, b = h - t_f, w - t_w
    m, n = b * t_f / (a * t_w), b / a
    bottom = _cowper(m, nu) + 10 * n**2 * ((3 + nu) * m + 3 * m**2)
    return 10 * (1 + nu) * (1 + 3 * m) ** 2 / bottom


def _cowper(m: Array, nu: Array) -> Array:
    """Return the terms common to Cowper's shear factors of boxes and I sections."""
    plain = 12 + 72 * m + 150 * m**2 + 90 * m**3
    return plain + nu * (11 + 66 * m + 135 * m**2 + 90 * m**3)
