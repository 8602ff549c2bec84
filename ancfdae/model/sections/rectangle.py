"""Rectangular cross-section, and sums of rectangles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.model.sections.section import Section, SectionPoints, columns
from ancfdae.model.sections.spread import (
    rectangle_torsional_shear,
    stepped_share,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule

# Points a side: 3 integrate the degree 5 of straight beams. Curved ones have a rational integrand;
# with a radius of curvature R the error of A falls like (height / 4R)^(2 n): measured with 6
# points, 1e-15 at height = R / 10, 6e-14 at R / 5, 4e-9 at R / 2.
_COARSE, _FINE = 3, 6


@dataclass(frozen=True)
class Rectangular(Section):
    """A section with a rectangle around it: height along y and width along z."""

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
        """Shear correction factors by Cowper (1966), dimensionless."""
        factor = 10 * (1 + nu) / (12 + 11 * nu)
        return factor, factor

    def torsion(self, sizes: Array) -> Array:
        """Torsion constants J, shape (n,), by Saint-Venant's series; m^4."""
        return rectangle_torsion(*sizes.T)

    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Corners, middles of the sides, and near corners on the sides; see `around`."""
        return around(*sizes.T)

    def torsional_shear(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Shear stresses of unit twist rate over G by Saint-Venant's series; m."""
        h, w = columns(sizes)
        return rectangle_torsional_shear(h, w, y, z)

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Local over mean shear stress, (n, n_f): parabolas, 3/2 in the middle."""
        h, w = columns(sizes)
        return stepped_share(h, h / 2, w, w, y), stepped_share(w, w / 2, h, h, z)


def around(h: Array, w: Array) -> tuple[Array, Array]:
    """Places on the four sides of rectangles about the axis, 16 of each.

    Bending has its largest stress at corners and torsion in the middle of the long sides, but it
    keeps most of it up to about the thickness from the corners: so places there come in, which the
    number 0.4 puts best. Stresses linear along the sides, together with those of torsion, exceed
    the largest at these places by less than 3.5 % (tests/sensitivity/test_stress.py).
    """
    zero = 0.0 * h
    y_near = h / 2 * (1 - w / (w + 0.4 * h))
    z_near = w / 2 * (1 - h / (h + 0.4 * w))
    y = [s * h / 2 for s in (-1, 1) for _ in range(5)] + [s * y_near for s in (-1, -1, 1, 1)]
    z = [t for _ in (-1, 1) for t in (-w / 2, -z_near, zero, z_near, w / 2)]
    z += [s * w / 2 for s in (-1, 1, -1, 1)]
    return np.stack([*y, zero, zero], axis=1), np.stack([*z, -w / 2, w / 2], axis=1)


def corners(h: Array, w: Array) -> tuple[Array, Array]:
    """Corners of rectangles of these heights and widths about the axis."""
    y, z = np.array([-0.5, -0.5, 0.5, 0.5]), np.array([-0.5, 0.5, 0.5, -0.5])
    return h[:, None] * y, w[:, None] * z


def rectangles_points(
    rectangles: Sequence[tuple[Array, Array, Array, Array]], fine: bool
) -> SectionPoints:
    """Gauss points of rectangles (height, width, y and z of the centre), shape (n,) each."""
    corner, rule = box_rule((1,) + 2 * (_FINE if fine else _COARSE,))
    eta, zeta = corner[:, 1], corner[:, 2]
    y = [h[:, None] * eta + y_c[:, None] for h, _, y_c, _ in rectangles]
    z = [w[:, None] * zeta + z_c[:, None] for _, w, _, z_c in rectangles]
    dA = [(h * w)[:, None] * rule for h, w, _, _ in rectangles]
    return np.concatenate(y, axis=1), np.concatenate(z, axis=1), np.concatenate(dA, axis=1)


def rectangle_torsion(h: Array, w: Array) -> Array:
    """Torsion constant of rectangles.

    J = a b^3 (1/3 - (64/pi^5) (b/a) sum_{n odd} tanh(n pi a / 2b) / n^5), b the shorter side
    (Timoshenko & Goodier, Theory of Elasticity, sec. 109). With tanh x = 1 - 2/(e^{2x} + 1) and
    sum 1/n^5 = 31/32 zeta(5) what is summed falls like e^{-n pi}: below round-off after n = 11.
    """
    a, b = np.where(h.real >= w.real, (h, w), (w, h))
    n = np.arange(1, 13, 2)[:, None]
    # e^{-2x} instead of e^{2x}, which overflows for thin strips.
    decay = np.exp(-n * np.pi * a / b)
    series = 31 / 32 * 1.0369277551433699 - np.sum(2 * decay / (1 + decay) / n**5, axis=0)
    return a * b**3 * (1 / 3 - 64 / np.pi**5 * (b / a) * series)
