"""How shear and radial stress spread over a section."""

import numpy as np
import scipy

from ancfdae.numerics.arrays import Array

# exp(-23 pi/2) is round-off.
_ODD = np.arange(1, 24, 2)
_SIGN = np.array([1.0, -1.0] * 6)
# Just inside the unit circle: the slope of the series is logarithmic at corners.
_INSIDE = 1 - 1e-15


def rectangle_torsional_shear(h: Array, w: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Shear stresses along y and z at places in rectangles, over G and the rate of twist.

    With half sides a <= b along u and v, p = pi/2a and s_n = (-1)^((n-1)/2) (Timoshenko & Goodier,
    Theory of Elasticity, sec. 109)

        t_v = 2u - (16a/pi^2) sum_{n odd} s_n/n^2 sin(npu) cosh(npv)/cosh(npb),
        t_u =    - (16a/pi^2) sum_{n odd} s_n/n^2 cos(npu) sinh(npv)/cosh(npb).

    cosh(npv)/cosh(npb) = e^{-np(b-v)} + rest for v >= 0. The rest falls like e^{-npb}; the first
    part falls slowly near the short sides, where its sum is an inverse tangent integral.
    """
    upright = h.real >= w.real
    a, b = np.where(upright, (w, h), (h, w)) / 2
    u, v = np.where(upright, (z, y), (y, z))
    side = np.where(v.real < 0, -1.0, 1.0)
    v, p = v * side, np.pi / (2 * a)
    # Of no meaning beyond the rectangle, where it must not overflow.
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
    differential is arctan(z) d(rho + i phi): so go imaginary steps of rho and phi.
    """
    z = np.exp(rho.real + 1j * phi.real)
    total = (scipy.special.spence(1 - 1j * z) - scipy.special.spence(1 + 1j * z)) / 2j
    sine, cosine = total.imag, total.real
    if np.iscomplexobj(rho) or np.iscomplexobj(phi):
        moved = np.arctan(_INSIDE * z) * (rho.imag + 1j * phi.imag)
        sine, cosine = sine + 1j * moved.imag, cosine + 1j * moved.real
    return sine, cosine


def stepped_share(extent: Array, inner: Array, outer_b: Array, inner_b: Array, y: Array) -> Array:
    """Shear stress by Jourawski's formula over its mean, A Q/(I b), at a depth y of sections.

    Their width is b = inner_b for abs(y) <= inner, outer_b up to half the extent; Q is the first
    moment of what lies beyond y. Its mean over the section is 1. Radial stress in a curved beam
    spreads alike: what holds sigma = M y/I in balance is M Q/(I b R).
    """
    top = extent / 2
    A = 2 * (outer_b * (top - inner) + inner_b * inner)
    I = 2 / 3 * (outer_b * (top**3 - inner**3) + inner_b * inner**3)
    flange = (top**2 - y**2) / 2
    web = (outer_b / inner_b * (top**2 - inner**2) + inner**2 - y**2) / 2
    return A / I * np.where(in_web(y, inner), web, flange)


def in_web(y: Array, inner: Array) -> Array:
    """Whether abs(y) <= inner, by real parts."""
    return np.abs(y.real) <= inner.real
