"""Strains of a continuum beam as linear functions of the Gram matrix.

In node vectors with the chord divided by the length, and with section coordinates divided by it,
the components B of the metric r_,alpha . r_,beta at a point (xi, y, z) are

    B_xx = a.a + 2 y a.b_2 + 2 z a.b_3 + y^2 b_2.b_2 + 2 y z b_2.b_3 + z^2 b_3.b_3
    B_xy = c_2.a + y c_2.b_2 + z c_2.b_3,     B_xz = c_3.a + y c_3.b_2 + z c_3.b_3
    B_yy = c_2.c_2,     B_zz = c_3.c_3,     B_yz = c_2.c_3

with a the coefficients of r_x on the axis, c_2 and c_3 those of the section slopes r_y and r_z, and
b = dc/dxi; u.v stands for the coefficients of (sum u_i Y_i) . (sum v_j Y_j) in g. These scalar
products are the strains s = beta(xi) g of the section, with beta independent of every parameter;
`fibre_strains` says what a fibre makes of them.

Assumed strains. The section slopes are linear in xi, r cubic: where the beam turns, c.c sags
between the nodes, and the curvature a.b is constant along an element although the axis can bend
linearly. So c.c is taken at the nodes and linear between them, and so are the shears S = c.a:
the section of the axis then turns, for small strains, by r_x - S, not by the linear r_y, and its
curvature is that of this rotation. With the chord X, the mean of a, with w = a'(0) - a'_m and with
a'_m and c_m at mid-element it is

    a.b  ->  X.b - (1 - 2 xi) w.c_m + ((1 - 2 xi)^2 - 1/3) w.b/2:

the mean and a wave, what bending changes along the element. The wave has a factor of its own. What
a twist changes, for it turns the curvature against the section,

    (1 - 2 xi) a'_m.b/2,

is a product of kinks as well, and fades where elements are shorter than the radius of gyration.
In the thin limit the bending part is that of the cubic Hermite beam. c_2.b_2 is half the derivative
of c_2.c_2 and becomes half the difference of its values at the nodes; c_2.b_3 + c_3.b_2 likewise,
and c_2.b_3 - c_3.b_2, the twist, is constant anyway.

Two terms in the squares of curvatures and twist, which are linear in g too (`_squares`), follow.
Turns: what a finite turn of the element takes off curvature and twist is put back as further rows
of strain, l kappa^2 times the radius of gyration, with a stiffness of their own. Stretch: the axial
strain of a straight beam is lowered by 3/2 of the squared curvature times the squared radius of
gyration, so that bending neither shortens the axis nor softens the beam. It fades likewise
(`volume.fibres`). Derivations: docs/theory/02-strain-energy.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from ancfdae.kernels import strain
from ancfdae.model.elements.hermite import curvature_weights, end_weight_xi, slope_weights_xi
from ancfdae.numerics.arrays import Array


@lru_cache(maxsize=8)
def upper_triangle(n_y: int) -> tuple[Array, Array]:
    """Row and column of each packed entry."""
    rows, columns = np.triu_indices(n_y)
    return rows, columns


def packed_gram(Y: Array) -> Array:
    """Packed Y Y^T; Y of shape (..., n_y, d), result (..., n_g)."""
    return strain(None, Y, Y, None) / 2


@final
@dataclass(frozen=True)
class StrainPlaces:
    """Index of each strain of a section in the vector of strains; the first is a.a of the axis.

    Indices i and j run over y and z. What stands behind `thickness` is of assumed strains only.
    """

    bending: Array  # a.b_i, the mean of assumed ones
    squares: Array  # b_i.b_j
    shears: Array  # c_i.a
    slopes: Array  # c_i.b_j
    thickness: Array  # c_i.c_j
    turns: Array  # squares of curvatures and twist
    waves: Array  # assumed curvatures less their means, as bending changes them
    turned: Array  # and as a twist does

    def count(self, assumed: bool) -> int:
        """Return the number of strains of a section, with or without the assumed ones."""
        return int(self.turned[-1] + 1 if assumed else self.turns[0])


@lru_cache(maxsize=2)
def strain_places(d: int) -> StrainPlaces:
    """Return the places of the strains of sections in d dimensions."""
    m = d - 1
    pairs = np.zeros((m, m), dtype=int)
    rows, columns = np.triu_indices(m)
    pairs[rows, columns] = pairs[columns, rows] = np.arange(len(rows))
    bending, slopes = 1 + np.arange(m), np.arange(m * m).reshape(m, m)
    squares = np.max(bending) + 1 + pairs
    shears = np.max(squares) + bending
    slopes = np.max(shears) + 1 + slopes
    thickness = np.max(slopes) + 1 + pairs
    turns = np.max(thickness) + 1 + np.arange(turn_count(d))
    waves = np.max(turns) + bending
    turned = np.max(waves) + bending
    return StrainPlaces(bending, squares, shears, slopes, thickness, turns, waves, turned)


@lru_cache(maxsize=16)
def section_strains(d: int, xi: tuple[float, ...], assumed: bool) -> Array:
    """Return beta, shape (n_xi, n_s, n_g), with which strains of sections are beta g."""
    place, axis, at = np.array(xi), Axis.of(d, np.array(xi)), strain_places(d)
    beta = np.zeros((len(place), at.count(assumed), (2 * d + 1) * (d + 1)))
    fields: _Exact | _Assumed = _Exact(axis)
    if assumed:
        fields = without_locking = _Assumed(d, place, axis)
        beta[:, at.turns] = _squares(d)
        for i in range(1, d):
            beta[:, at.waves[i - 1]] = without_locking.wave(i)
            beta[:, at.turned[i - 1]] = without_locking.turned(i)
    beta[:, 0] = _gram(axis.a, axis.a)
    for i in range(1, d):
        beta[:, at.bending[i - 1]] = fields.curvature(i)
        beta[:, at.shears[i - 1]] = fields.shear(i)
        for j in range(1, d):
            beta[:, at.squares[i - 1, j - 1]] = _gram(axis.b[i], axis.b[j])
            beta[:, at.slopes[i - 1, j - 1]] = fields.slope(i, j)
            beta[:, at.thickness[i - 1, j - 1]] = fields.thickness(i, j)
    beta.setflags(write=False)
    return beta


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
class Axis:
    """Coefficients of r_x, its derivative, the section slopes and theirs, shape (n_xi, n_y) each.

    Lists are by axis of the section; entry 0 is not used.
    """

    a: Array
    a_xi: Array
    c: tuple[Array, ...]
    b: tuple[Array, ...]

    @classmethod
    def of(cls, d: int, xi: Array) -> Axis:
        """Return those of beams in d dimensions at places xi."""
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

    axis: Axis

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

    def __init__(self, d: int, xi: Array, axis: Axis) -> None:
        self._axis, self._xi = axis, xi[:, None]
        self._ends = _Exact(Axis.of(d, np.array([0.0, 1.0])))
        self._middle = Axis.of(d, np.array([0.5]))

    def curvature(self, i: int) -> Array:
        """Return the mean of the assumed curvature: a . b_i at the middle of the element."""
        return _gram(np.eye(1, self._middle.a.shape[-1]), self._middle.b[i])

    def wave(self, i: int) -> Array:
        """Return the part of the curvature that varies along the element with bending."""
        middle, s = self._middle, 1 - 2 * self._xi
        bent = self._ends.axis.a_xi[0] - middle.a_xi
        wave = 0.5 * (s**2 - 1 / 3) * _gram(bent, middle.b[i]) - s * _gram(bent, middle.c[i])
        return np.asarray(wave)

    def turned(self, i: int) -> Array:
        """Return the change of the curvature along the element by a twist."""
        change = _gram(self._middle.a_xi, self._middle.b[i])
        return np.asarray((0.5 - self._xi) * change)

    def shear(self, i: int) -> Array:
        return self._linear(self._ends.shear(i))

    def slope(self, i: int, j: int) -> Array:
        twist = _gram(self._axis.c[i], self._axis.b[j]) - _gram(self._axis.c[j], self._axis.b[i])
        return np.asarray(0.5 * (np.diff(self._ends.thickness(i, j), axis=0) + twist))

    def thickness(self, i: int, j: int) -> Array:
        return self._linear(self._ends.thickness(i, j))

    def _linear(self, ends: Array) -> Array:
        return ends[0] * (1 - self._xi) + ends[1] * self._xi


def _squares(d: int) -> Array:
    """Coefficients of (l kappa)^2 about z, in space about y too and of the twist, in g.

    At mid-element a'.a' = kappa_z^2 + kappa_y^2, b_2.b_2 = kappa_z^2 + tau^2 and
    b_3.b_3 = kappa_y^2 + tau^2.
    """
    middle = Axis.of(d, np.array([0.5]))
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
    return product * np.where(rows == columns, 0.5, 1.0)
