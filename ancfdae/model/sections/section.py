"""Base class of cross-sections: area, shear factors, torsion, stress distribution."""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import ClassVar, Self

import numpy as np
import scipy

from ancfdae.errors.checks import require_positive, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array

#: Factor that widens a section by round-off, so that its surface belongs to it.
ROUND_UP = 1 + 1e-12

#: Points of n sections: y, z, m, and the area that each point represents, m^2, (n, n_p) each.
SectionPoints = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Section(abc.ABC):
    """A cross-section in its axes y (height) and z (width), the beam's axis at y = z = 0.

    Positional fields are its sizes, each a design variable of the beam; at most four. Methods take
    sizes of many sections, shape (n, number of sizes), real or complex, and keep their dtype, so
    that complex steps through them are derivatives.

    Parameters
    ----------
    shear_factors : (float, float), optional
        Ratio of the area that carries shear along y and along z; by default a formula of the
        section. Like `torsion_constant` used by `EnhancedContinuum` only.
    torsion_constant : float, optional
        J in the torque G J kappa; m^4. By default a formula of the section.

    Raises
    ------
    InvalidInputError
        If a size or a property is not finite and positive.
    """

    #: Whether the section has `torsional_shear`.
    shaped: ClassVar[bool] = False

    shear_factors: Sequence[float] | None = field(default=None, kw_only=True)
    torsion_constant: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        where = type(self).__name__
        for name in self.size_names():
            require_positive(f"{where}.{name}", getattr(self, name))
        if self.shear_factors is not None:
            require_vector(f"{where}.shear_factors", self.shear_factors, (2,))
            for factor in self.shear_factors:
                require_positive(f"{where}.shear_factors", factor)
            object.__setattr__(self, "shear_factors", tuple(map(float, self.shear_factors)))
        if self.torsion_constant is not None:
            require_positive(f"{where}.torsion_constant", self.torsion_constant)

    @classmethod
    @cache
    def size_names(cls) -> tuple[str, ...]:
        """Return the names of the sizes of the section, its positional fields."""
        return tuple(each.name for each in fields(cls) if not each.kw_only)

    def sizes(self) -> tuple[float, ...]:
        """Return the sizes of the section; m, unless the class says otherwise."""
        return tuple(getattr(self, name) for name in self.size_names())

    def with_sizes(self, sizes: Mapping[str, float]) -> Self:
        """Return the same section with some sizes changed, all checked together."""
        return replace(self, **sizes)  # type: ignore[arg-type]  # sizes are numbers

    def form(self) -> tuple[object, ...]:
        """Return class and options: sections with equal forms differ in their sizes only."""
        options = (getattr(self, each.name) for each in fields(self) if each.kw_only)
        return (type(self), *options)

    @property
    @abc.abstractmethod
    def half_extents(self) -> tuple[float, float]:
        """Half of the height and half of the width that enclose the section; m."""

    def second_moments(self) -> Array:
        """Return the integrals of y y, y z and z z about the centroid, shape (2, 2); m^4."""
        y, z, dA = (x[0] for x in self.points(np.array([self.sizes()]), False))
        places = np.stack([y, z])
        centred = places - (places @ dA / np.sum(dA))[:, None]
        return (centred * dA) @ centred.T

    @abc.abstractmethod
    def points(self, sizes: Array, fine: bool) -> SectionPoints:
        """Return quadrature points of n sections, exact for polynomials of degree 5.

        Parameters
        ----------
        sizes : array, shape (n, n_sizes)
            Sizes of n sections in the order of `sizes`, each in its unit (m, m^2, m^4).
        fine : bool
            Whether the integrand is no polynomial (curved beams), so that more points are needed.
        """

    @abc.abstractmethod
    def outline(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of the contour points with the largest stresses, (n, n_o) each; m.

        Stresses of bending about both axes and of torsion, alone and together.
        """

    def contour(self, sizes: Array) -> tuple[Array, Array]:
        """Return y and z of the outer contour, for pictures, shape (n, n_c) each.

        Points run up in y on one side and down on the other; the i-th point and the i-th from the
        end have the same y, so that strips between them fill the section.
        """
        y, z = self.outline(sizes)
        bottom, top, left, right = y.min(axis=1), y.max(axis=1), z.min(axis=1), z.max(axis=1)
        # Points on the sides too: torsion has its largest stress there and none at corners.
        middle, quarter = (bottom + top) / 2, (right - left) / 4
        up = np.stack([bottom, bottom, middle, top, top], axis=1)
        across = np.stack([left + quarter, left, left, left, left + quarter], axis=1)
        back = (left + right)[:, None] - across[:, ::-1]
        return np.concatenate([up, up[:, ::-1]], axis=1), np.concatenate([across, back], axis=1)

    def shear(self, sizes: Array, nu: Array) -> tuple[Array, Array]:
        """Return shear factors along y and z for Poisson's ratio nu, (n,) each; 1 by default."""
        return np.ones_like(nu), np.ones_like(nu)

    @abc.abstractmethod
    def torsion(self, sizes: Array) -> Array:
        """Return the torsion constants J of n sections, shape (n,); m^4."""

    def twist_centre(self, sizes: Array, centroid: Array) -> Array:
        """Return y and z of the shear centre, shape (n, 1, 2), m; the centroid by default."""
        return centroid

    def torsional_shear(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return shear stresses along y and z in torsion, over G and the rate of twist; m.

        Warping is free, and the stresses are in equilibrium with the torque G J of `torsion`.

        Parameters
        ----------
        sizes : array, shape (n, n_sizes)
            Sizes of n sections in the order of `sizes`, each in its unit (m, m^2, m^4).
        y, z : array, shape (n, n_f)
            Coordinates of points of the section along height and width; m.

        Raises
        ------
        InvalidInputError
            If the section has no `torsional_shear`.
        """
        raise InvalidInputError(
            f"stress in a {type(self).__name__}",
            "a von Mises stress needs a section whose shear stresses in torsion are known",
            f"a {type(self).__name__}, which has no shape",
            "Use a shape such as Rectangle or Tube, or combine axial_force, bending_moment and "
            "torsional_moment.",
        )

    def shares(self, sizes: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Return the local over the mean shear stress along y and z, (n, n_f) each; 1 by default.

        The mean over the section is 1. Radial stress in curved beams is distributed in the same
        way.
        """
        one = np.ones_like(y * sizes[:, :1])
        return one, one

    def holds(self, y: float, z: float) -> bool:
        """Whether there is material at (y, z); by default within the half extents; m."""
        extents = self.half_extents
        return all(abs(x) <= half * ROUND_UP for x, half in zip((y, z), extents, strict=True))

    def properties(self, sizes: Array, nu: Array) -> tuple[Array, Array, Array]:
        """Return shear factors along y and z, and J, (n,) each: as declared, or by formula."""
        k_y, k_z = self.shear(sizes, nu)
        J = self.torsion(sizes)
        if self.shear_factors is not None:
            k_y, k_z = (np.full_like(J, factor) for factor in self.shear_factors)
        if self.torsion_constant is not None:
            J = np.full_like(J, self.torsion_constant)
        return k_y, k_z, J


def columns(sizes: Array) -> tuple[Array, ...]:
    """Return each size of n sections as a column, (n, 1), to combine with points, (n, n_f)."""
    return tuple(sizes.T[..., None])


def central_moments(y: Array, z: Array, dA: Array) -> tuple[Array, Array]:
    """Return the centroid, shape (n, 1, 2), and the integrals of y^2 and z^2 about it, (n, 2)."""
    places, areas = np.stack([y, z], axis=-1), dA[..., None]
    centroid = (places * areas).sum(axis=1, keepdims=True) / areas.sum(axis=1, keepdims=True)
    return centroid, ((places - centroid) ** 2 * areas).sum(axis=1)


def require_smaller(where: str, wall: float, outer: float, rule: str) -> None:
    """Raise InvalidInputError if a wall leaves no hole."""
    if not wall < outer:
        raise InvalidInputError(where, rule, f"{wall} against {outer}", "Use a thinner wall.")


# -- spread of stress --------------------------------------------------------------------------


# Odd n of the series of `rectangle_torsional_shear` and signs s_n; exp(-23 pi/2) is round-off.
_ODD = np.arange(1, 24, 2)
_SIGN = np.array([1.0, -1.0] * 6)
# Factor that keeps arguments inside the unit circle: the slope of the series is logarithmic at
# corners.
_INSIDE = 1 - 1e-15


def rectangle_torsional_shear(h: Array, w: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Return shear stresses along y and z in rectangles, over G and the rate of twist; m.

    With half sides a <= b along u and v, p = pi/2a and s_n = (-1)^((n-1)/2) (Timoshenko & Goodier,
    Theory of Elasticity, sec. 109)

        t_v = 2u - (16a/pi^2) sum_{n odd} s_n/n^2 sin(npu) cosh(npv)/cosh(npb),
        t_u =    - (16a/pi^2) sum_{n odd} s_n/n^2 cos(npu) sinh(npv)/cosh(npb).

    cosh(npv)/cosh(npb) = e^{-np(b-v)} + remainder for v >= 0. The remainder falls like e^{-npb};
    the first part falls slowly near the short sides, where its sum is an inverse tangent integral.
    """
    upright = h.real >= w.real
    a, b = np.where(upright, (w, h), (h, w)) / 2
    u, v = np.where(upright, (z, y), (y, z))
    side = np.where(v.real < 0, -1.0, 1.0)
    v, p = v * side, np.pi / (2 * a)
    # Points beyond the rectangle have no meaning; v is limited so that nothing overflows there.
    v = np.where(v.real < b.real, v, b)
    sine, cosine = _tangent_integral(-p * (b - v), p * u)
    for n, sign in zip(_ODD, _SIGN, strict=True):
        near, far, through = (np.exp(-n * p * x) for x in (b + v, 3 * b - v, 2 * b))
        weight = sign / n**2 / (1 + through)
        sine = sine + weight * (near - far) * np.sin(n * p * u)
        cosine = cosine - weight * (near + far) * np.cos(n * p * u)
    t_v, t_u = 2 * u - 16 * a / np.pi**2 * sine, -16 * a / np.pi**2 * side * cosine
    # (z, y, x) is left-handed, (y, z, x) right-handed.
    t_y, t_z = np.where(upright, (-t_v, -t_u), (t_u, t_v))
    return t_y, t_z


def _tangent_integral(rho: Array, phi: Array) -> tuple[Array, Array]:
    """Return sums over odd n of s_n e^(n rho)/n^2 times sin(n phi), and times cos(n phi).

    With z = e^(rho + i phi) they are the parts of Ti_2(z) = (Li_2(iz) - Li_2(-iz))/2i, whose
    differential is arctan(z) d(rho + i phi); imaginary parts of rho and phi (complex steps) use it.
    """
    z = np.exp(rho.real + 1j * phi.real)
    total = (scipy.special.spence(1 - 1j * z) - scipy.special.spence(1 + 1j * z)) / 2j
    sine, cosine = total.imag, total.real
    if np.iscomplexobj(rho) or np.iscomplexobj(phi):
        moved = np.arctan(_INSIDE * z) * (rho.imag + 1j * phi.imag)
        sine, cosine = sine + 1j * moved.imag, cosine + 1j * moved.real
    return sine, cosine


def stepped_share(extent: Array, inner: Array, outer_b: Array, inner_b: Array, y: Array) -> Array:
    """Return Jourawski's shear stress over its mean, A Q/(I b), at the coordinate y.

    The width is b = inner_b for abs(y) <= inner, outer_b up to half the extent; Q is the first
    moment of the area beyond y. The mean over the section is 1. Radial stress in a curved beam is
    distributed in the same way: M Q/(I b R) is in equilibrium with sigma = M y/I.
    """
    top = extent / 2
    A = 2 * (outer_b * (top - inner) + inner_b * inner)
    I = 2 / 3 * (outer_b * (top**3 - inner**3) + inner_b * inner**3)
    flange = (top**2 - y**2) / 2
    web = (outer_b / inner_b * (top**2 - inner**2) + inner**2 - y**2) / 2
    return A / I * np.where(in_web(y, inner), web, flange)


def in_web(y: Array, inner: Array) -> Array:
    """Return whether abs(y) <= inner, comparing real parts."""
    return np.abs(y.real) <= inner.real
