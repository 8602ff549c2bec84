"""Strains of a continuum beam as linear functions of the Gram matrix.

In node vectors with the chord divided by the length, and with section coordinates divided by it,
the components B of the metric r_,alpha . r_,beta at a point (xi, y, z) are

    B = sum_k phi_k(y, z) beta_k(xi) g,

with beta independent of every parameter. With a the coefficients of r_x on the axis, c_2 and c_3
those of the section slopes r_y and r_z, and b = dc/dxi,

    B_xx = a.a + 2 y a.b_2 + 2 z a.b_3 + y^2 b_2.b_2 + 2 y z b_2.b_3 + z^2 b_3.b_3
    B_xy = c_2.a + y c_2.b_2 + z c_2.b_3,     B_xz = c_3.a + y c_3.b_2 + z c_3.b_3
    B_yy = c_2.c_2,     B_zz = c_3.c_3,     B_yz = c_2.c_3

where u.v stands for the coefficients of (sum u_i Y_i) . (sum v_j Y_j) in g.

Assumed strains. The section slopes are linear in xi, r cubic: where the beam turns, c.c sags
between the nodes, and the curvature a.b is constant along an element although the axis can bend
linearly. So c.c is taken at the nodes and linear between them, and so are the shears S = c.a:
the section of the axis then turns, for small strains, by r_x - S, not by the linear r_y, and its
curvature is that of this rotation,

    a.b  ->  S(1) - S(0) - a'.c + a'_m.(c - c_m)

with a'_m and c_m those at mid-element. The mean is that of a.b, the chord times b; the last term,
no part of a curvature, takes the product of kinks out that -a'.c has (docs/theory.md, section 2).
In the thin limit the bending part is that of the cubic Hermite beam. c_2.b_2 is half the derivative
of c_2.c_2 and becomes half the difference of its values at the nodes; c_2.b_3 + c_3.b_2 likewise,
and c_2.b_3 - c_3.b_2, the twist, is constant anyway.

Two terms in the squares of curvatures and twist, which are linear in g too (`_squares`), follow.
Turns: what a finite turn of the element takes off curvature and twist is put back as further rows
of strain, l kappa^2 times the radius of gyration, with a stiffness of their own. Stretch: the axial
strain of a straight beam is lowered by 3/2 of the squared curvature times the squared radius of
gyration, so that bending neither shortens the axis nor softens the beam. Both fade where elements
are shorter than the radius of gyration (`volume.fibres`). Derivations: docs/theory.md, section 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from ancfdae.elements.hermite import curvature_weights, end_weight_xi, slope_weights_xi
from ancfdae.elements.packing import upper_triangle
from ancfdae.numerics.arrays import Array

# Places of the phi_k: 1, y, z, y^2, y z, z^2; those of shear along y and z; those of torsion, y, z;
# the squared radii of gyration; these radii and that of twist.
_ONE, _Y, _Z, _YY, _YZ, _ZZ, _SHEAR_Y, _SHEAR_Z, _TWIST_Y, _TWIST_Z = range(10)
_I_Y, _I_Z, _R_Y, _R_Z, _R_TWIST = range(10, 15)


def section_functions(offsets: Array, factors: Array, radii: Array) -> Array:
    """Return the phi_k, shape (n, n_s, 15).

    Parameters
    ----------
    offsets : array, shape (n, n_s, 2)
        y and z over the length.
    factors : array, shape (n, 3)
        What shears along y, along z and twist are multiplied by.
    radii : array, shape (n, 3)
        Radii of gyration along y and z, and that of twist, over the length.
    """
    y, z = offsets[..., 0], offsets[..., 1]
    one = np.ones_like(y)
    shear_y, shear_z, twist = factors.T[:, :, None]
    products = [one, y, z, y * y, y * z, z * z, one * shear_y, one * shear_z, y * twist, z * twist]
    products += [one * r for r in (*(radii[:, :2] ** 2).T[:, :, None], *radii.T[:, :, None])]
    return np.stack(products, axis=-1)


def twist_shears(beta: Array, shear: Array, radii: Array) -> Array:
    """Return B of shears along y and z per rate of twist, shape (n, n_s, n_xi, n_v, n_g).

    r_y turns by c_3.b_2 and r_z by -c_2.b_3. Where they differ, the torque is that of their mean
    with the weights I_y and I_z.

    Parameters
    ----------
    beta : array
        As `axial_functions` returns it in space.
    shear : array, shape (n, n_s, 2)
    radii : array, shape (n, 2)
        Radii of gyration along y and z.
    """
    rows = [components(3).index((0, i)) for i in (1, 2)]
    turns = np.stack([beta[_TWIST_Y, :, rows[1]], -beta[_TWIST_Z, :, rows[0]]])
    weights = radii**2 / np.sum(radii**2, axis=1, keepdims=True)
    rate = np.einsum("ni,ixg->nxg", weights, turns)
    B = np.zeros((*shear.shape[:2], *beta.shape[1:]), dtype=np.result_type(shear, radii))
    for i, row in enumerate(rows):
        B[:, :, :, row] = shear[:, :, None, None, i] * rate[:, None]
    return B


@lru_cache(maxsize=16)
def axial_functions(d: int, xi: tuple[float, ...], assumed: bool, straight: bool) -> Array:
    """Return the beta_k, shape (15, n_xi, n_v, n_g); components in the order of `components`."""
    place, axis = np.array(xi), _Axis.of(d, np.array(xi))
    index = {pair: v for v, pair in enumerate(components(d))}
    n_y = 2 * d + 1
    extra = turn_count(d) if assumed else 0
    beta = np.zeros((15, len(place), len(index) + extra, n_y * (n_y + 1) // 2))
    own = ((1, _Y, _YY, _SHEAR_Y), (2, _Z, _ZZ, _SHEAR_Z))
    fields = _Assumed(d, place, axis) if assumed else _Exact(axis)
    beta[_ONE, :, index[0, 0]] = _gram(axis.a, axis.a)
    for i, first, second, shear in own[: d - 1]:
        beta[first, :, index[0, 0]] = 2 * fields.curvature(i)
        beta[second, :, index[0, 0]] = _gram(axis.b[i], axis.b[i])
        beta[shear, :, index[0, i]] = fields.shear(i)
        beta[first, :, index[0, i]] = fields.slope(i, i)
        beta[_ONE, :, index[i, i]] = fields.thickness(i, i)
    if d == 3:
        beta[_YZ, :, index[0, 0]] = 2 * _gram(axis.b[1], axis.b[2])
        beta[_TWIST_Z, :, index[0, 1]] = fields.slope(1, 2)
        beta[_TWIST_Y, :, index[0, 2]] = fields.slope(2, 1)
        beta[_ONE, :, index[1, 2]] = fields.thickness(1, 2)
    if assumed:
        squares = _squares(d)
        if straight:
            beta[[_I_Y, _I_Z][: d - 1], :, index[0, 0]] = -3 * squares[: d - 1, None]
        own_turns = (_R_Y,) if d == 2 else (_R_Y, _R_Z, _R_TWIST)
        for row, (function, square) in enumerate(zip(own_turns, squares, strict=True), len(index)):
            beta[function, :, row] = square
    beta.setflags(write=False)
    return beta


@lru_cache(maxsize=64)
def frame_products(d: int, xi: float, assumed: bool, straight: bool) -> Array:
    """Return the scalar products of r_x, r_y(, r_z) with these and b_2(, b_3) in g.

    As the strains have them; shape (d, 2 d - 1, n_g).
    """
    beta = axial_functions(d, (xi,), assumed, straight)[:, 0]
    index = {pair: v for v, pair in enumerate(components(d))}
    products = np.zeros((d, 2 * d - 1, beta.shape[-1]))
    ends, slopes = (_SHEAR_Y, _SHEAR_Z), ((_Y, _TWIST_Z), (_TWIST_Y, _Z))
    products[0, 0] = beta[_ONE, index[0, 0]]
    for i in range(1, d):
        products[0, i] = products[i, 0] = beta[ends[i - 1], index[0, i]]
        products[0, d - 1 + i] = 0.5 * beta[(_Y, _Z)[i - 1], index[0, 0]]
        for j in range(1, d):
            products[i, j] = beta[_ONE, index[min(i, j), max(i, j)]]
            products[i, d - 1 + j] = beta[slopes[i - 1][j - 1], index[0, i]]
    products.setflags(write=False)
    return products


def turn_count(d: int) -> int:
    """Return how many rows of turns follow the components of strain."""
    return 1 if d == 2 else 3


def turn_stiffness(d: int, E: Array, nu: Array, straight: bool) -> Array:
    """Stiffness of the turns: the diagonal of what follows C, shape (n, turn_count).

    What is missing is (k - k_o)^2 (k^2 + k k_o + k_o^2) of a curvature or twist k, what is added
    (k^2 - k_o^2)^2: the same for k_o = 0, and 4/3 of it near the reference of a curved beam, whose
    volume is short by phi^2/12 of it, too: 1 - phi^2/12 - phi^2/2 + 2/3 share phi^2 = 1.
    """
    share, G = 1.0 if straight else 7 / 8, E / (2 * (1 + nu))
    turns = [E / 6] if d == 2 else [E / 6, E / 6, G / 3]
    return share * np.stack(turns, axis=-1)


def components(d: int) -> tuple[tuple[int, int], ...]:
    """Index pairs of the components of strain, normal ones first."""
    return ((0, 0), (1, 1), (0, 1)) if d == 2 else ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@final
@dataclass(frozen=True)
class _Axis:
    """Coefficients of r_x, its derivative, the section slopes and theirs, shape (n_xi, n_y) each.

    Lists are by axis of the section; entry 0 is not used.
    """

    a: Array
    a_xi: Array
    c: tuple[Array, ...]
    b: tuple[Array, ...]

    @classmethod
    def of(cls, d: int, xi: Array) -> _Axis:
        shape, second = (len(xi), 2 * d + 1), d
        a, a_xi = np.zeros(shape), np.zeros(shape)
        a[:, 0] = end_weight_xi(xi)
        a[:, 1], a[:, 1 + second] = slope_weights_xi(xi)
        a_xi[:, 0], a_xi[:, 1], a_xi[:, 1 + second] = curvature_weights(xi)
        c, b = [np.zeros(shape) for _ in range(d)], [np.zeros(shape) for _ in range(d)]
        for i in range(1, d):
            c[i][:, 1 + i], c[i][:, 1 + second + i] = 1 - xi, xi
            b[i][:, 1 + i], b[i][:, 1 + second + i] = -1.0, 1.0
        return cls(a, a_xi, tuple(c), tuple(b))


@final
@dataclass(frozen=True)
class _Exact:
    """Strains as the position field has them."""

    axis: _Axis

    def curvature(self, i: int) -> Array:
        return _gram(self.axis.a, self.axis.b[i])

    def shear(self, i: int) -> Array:
        return _gram(self.axis.c[i], self.axis.a)

    def slope(self, i: int, j: int) -> Array:
        return _gram(self.axis.c[i], self.axis.b[j])

    def thickness(self, i: int, j: int) -> Array:
        return _gram(self.axis.c[i], self.axis.c[j])


@final
class _Assumed:
    """Strains that do not lock; see the module description."""

    def __init__(self, d: int, xi: Array, axis: _Axis) -> None:
        self._axis, self._xi = axis, xi[:, None]
        self._ends = _Exact(_Axis.of(d, np.array([0.0, 1.0])))
        self._middle = _Axis.of(d, np.array([0.5]))

    def curvature(self, i: int) -> Array:
        axis, middle, turn = self._axis, self._middle, np.diff(self._ends.shear(i), axis=0)
        change = _gram(axis.a_xi - middle.a_xi, axis.c[i] - middle.c[i])
        return np.asarray(turn - _gram(axis.a_xi, middle.c[i]) - change)

    def shear(self, i: int) -> Array:
        return self._linear(self._ends.shear(i))

    def slope(self, i: int, j: int) -> Array:
        twist = _gram(self._axis.c[i], self._axis.b[j]) - _gram(self._axis.c[j], self._axis.b[i])
        return np.asarray(0.5 * (np.diff(self._ends.thickness(i, j), axis=0) + twist))

    def thickness(self, i: int, j: int) -> Array:
        return self._linear(self._ends.thickness(i, j))

    def _linear(self, ends: Array) -> Array:
        linear: Array = ends[0] * (1 - self._xi) + ends[1] * self._xi
        return linear


def _squares(d: int) -> Array:
    """Coefficients of (l kappa)^2 about z, in space about y too and of the twist, in g.

    At mid-element a'.a' = kappa_z^2 + kappa_y^2, b_2.b_2 = kappa_z^2 + tau^2 and
    b_3.b_3 = kappa_y^2 + tau^2.
    """
    middle = _Axis.of(d, np.array([0.5]))
    bent = _gram(middle.a_xi, middle.a_xi)[0]
    if d == 2:
        return np.asarray(0.5 * (bent + _gram(middle.b[1], middle.b[1])[0]))[None]
    first, second = (_gram(b, b)[0] for b in middle.b[1:])
    squares = np.stack([bent + first - second, bent - first + second, first + second - bent])
    return np.asarray(0.5 * squares)


def _gram(u: Array, v: Array) -> Array:
    """Coefficients of (sum u_i Y_i) . (sum v_j Y_j) in g."""
    rows, columns = upper_triangle(u.shape[-1])
    product = u[..., rows] * v[..., columns] + u[..., columns] * v[..., rows]
    twice: Array = product * np.where(rows == columns, 0.5, 1.0)
    return twice
