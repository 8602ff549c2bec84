"""Strains of a continuum beam as linear functions of the Gram matrix: points, strains, integrals.

The energy is integrated over fibres of the section times points along the axis. Lengths are divided
by the element length l, and the chord r_2 - r_1 with them, so that the length enters through the
fibres only.

**Strains of a section.** In node vectors with the chord divided by the length, and with section
coordinates divided by it, the components B of the metric r_,alpha . r_,beta at a point (xi, y, z)
are

    B_xx = a.a + 2 y a.b_2 + 2 z a.b_3 + y^2 b_2.b_2 + 2 y z b_2.b_3 + z^2 b_3.b_3
    B_xy = c_2.a + y c_2.b_2 + z c_2.b_3,     B_xz = c_3.a + y c_3.b_2 + z c_3.b_3
    B_yy = c_2.c_2,     B_zz = c_3.c_3,     B_yz = c_2.c_3

with a the coefficients of r_x on the axis, c_2 and c_3 those of the section slopes r_y and r_z, and
b = dc/dxi; u.v stands for the coefficients of (sum u_i Y_i) . (sum v_j Y_j) in g. These scalar
products are the strains s = beta(xi) g of the section, with beta independent of every parameter;
strains at the fibres follow below.

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

Two further terms are squares of curvatures and twist, also linear in g (`_squares`). Turns: a
finite rotation of the element lowers its interpolated curvature and twist; this is compensated by
further rows of strain, l kappa^2 times the radius of gyration, with a stiffness of their own.
Stretch: the axial strain of a straight beam is lowered by 3/2 of the squared curvature times the
squared radius of gyration, so that bending neither shortens the axis nor softens the beam. This
term fades in short elements, too (`fibres`). Derivations: docs/theory/02-strain-energy.md.

**Strains at the fibres** are linear functions of the strains s of the section. At a point (xi, y,
z), with dr_o/dx = (r_ox + y b_o2 + z b_o3, r_oy, r_oz) in the axes of the reference section (its
normal, r_oy over its length, and what is across both), let j be the normal component of the first
column, p the two others of it, J_s those of r_oy and r_oz, and q = -J_s^-1 p/j. Green and
Lagrange's strain E = J_o^-T (B - B_o)/2 J_o^-1 is then

    E_xx = D(B_xx)/2j^2 + q.h - q.D(B_ss) q/2,    2 E_xs = J_s^-T h,
    E_ss = J_s^-T D(B_ss)/2 J_s^-1,

    h_i = (g_i + sum_j y_j G_ij)/j,    g_i = c_i.(a - a^k c_k),    G_ij = c_i.(b_j - b_j^k c_k),

summed over k, with a^k and b_j^k the components of r_ox and b_oj along r_ok: the shears g_i of the
axis and the slopes G_ij of the shears over the section vanish in the reference. Written so, each of
them can bear a factor of its own. With the centroid y_c, the shear centre y_s and the factors f_i,
that of twist f_t where i is not j and 1 where it is,

    h_i = (f_i (g_i + sum_j y_sj G_ij) + sum_j f_ij (y_j - y_cj) G_ij)/j

has the energy k G A/2 of the shear at the shear centre and G J/2 of the twist, f^2 = k or J/I_p. In
E_xx, that is where the fibres of a pretwisted beam are oblique to its section, h is the shear of
the material itself, and has the factors k and J/I_p in full (docs/theory/02-strain-energy.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import strain
from ancfdae.model.elements.element import (
    Batch,
    Quantity,
    curvature_weights,
    end_weight_xi,
    shape_weights,
    slope_weights_xi,
)
from ancfdae.model.sections.section import central_moments
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.time_grid import box_rule

# Number of integration points on the axis. Poisson's effect couples stretch, quadratic in xi, with
# thickness strains, linear in xi: at two points the thickness strains can follow the stretch.
AXIS_POINTS = 2
# Share of the compliance in shear between the chord of an element and the tangents of its nodes.
_SHARE = 0.01


def fibres(batch: Batch) -> Fibres:
    """Return the quadrature points of the sections of elements, as fibres along them."""
    l, kind, sizes = batch.lengths, batch.kind, batch.sizes
    y, z, dA = kind.section.points(sizes, not kind.straight)
    centroid, moments = central_moments(y, z, dA)
    polar = moments.sum(axis=1)
    factors = np.ones((len(l), 3), dtype=batch.parameters.dtype)
    if kind.energy is not None and kind.energy.corrected:
        k_y, k_z, J = kind.section.properties(sizes, batch.moduli[1])
        factors = np.sqrt(np.stack([k_y, k_z, J / polar], axis=1))
    twist = factors[:, 2] ** 2 * polar
    squares = np.column_stack([moments, twist]) / np.sum(dA, axis=1)[:, None]
    shear_centre = kind.section.twist_centre(sizes, centroid)
    radii = np.sqrt(squares) / l[:, None]
    waves = np.ones((len(l), 2), dtype=factors.dtype)
    if kind.energy is not None and kind.energy.assumed_strains:
        # The fraction _SHARE of the shear compliance acts on waves of the section.
        nu = batch.moduli[1]
        C = batch.energy.stiffness(batch.d, np.ones_like(nu), nu)[0]
        compliance = (C[:, 0, 0] / C[:, -1, -1])[:, None] * (radii / factors)[:, :2] ** 2
        waves = 1 / np.sqrt(1 + 12 * _SHARE * compliance)
        factors = factors / np.sqrt([1 - _SHARE, 1 - _SHARE, 1.0])
    factors = np.concatenate([factors, waves], axis=1)
    places = (x / l[:, None, None] for x in (np.stack([y, z], axis=-1), centroid, shear_centre))
    offsets, centroid, shear_centre = places
    ratio = radii[:, :2] ** 2
    fade = 1 / (1 + ratio**2)
    sizes_of_terms = radii, 1.5 * ratio * fade, fade
    return Fibres(offsets, dA * l[:, None], factors, *sizes_of_terms, centroid, shear_centre)


def gauss_rule(count: int) -> tuple[Array, Array]:
    """Return `count` Gauss points on [0, 1] along an element, and their weights, (count,) each."""
    corner, rule = box_rule((count,))
    return corner[:, 0], rule


def along(function: Callable[..., Array], at: Sequence[Array], b: Sequence[Array]) -> Array:
    """Return the derivative of `function` at `at` in the direction `b`, by a complex step."""
    moved = (x.real + 1j * STEP * x_b.real for x, x_b in zip(at, b, strict=True))
    return np.asarray(function(*moved).imag / STEP)


def change(moved: Array, at: Array, step: Array) -> Array:
    """Return the derivative from a value at `Batch.moved` parameters and at the parameters.

    An imaginary part that the unperturbed value has in a complex-step run is subtracted.
    """
    return np.asarray((np.imag(moved) - np.imag(at)) / step.reshape(-1, *[1] * (at.ndim - 1)))


@final
class Region:
    """Section strains and their energy at the locations xi where an energy is integrated.

    The locations along the axis and their weights have shape (n_xi,) each. `beta`, (n_xi, n_s,
    n_g), maps the Gram matrix of the scaled node vectors to the strains of the section; `R`, (n,
    n_xi or 1, n_f, n_v, n_s), maps these to strains at the fibres, one for all locations in
    straight elements; `volume` is (n, n_xi or 1, n_f). InvalidInputError names the owner of an
    element, (n,), whose reference configuration folds (det dr_o/dx <= 0 somewhere).
    """

    def __init__(
        self, batch: Batch, fibres: Fibres, along: tuple[Array, Array], owners: Array
    ) -> None:
        self._xi, self.rule = along
        self._d, self._fibres = batch.d, fibres
        assumed = batch.kind.energy is not None and batch.energy.assumed_strains
        self._turns = len(strain_places(batch.d).turns) if assumed else 0
        self.beta = section_strains(batch.d, tuple(self._xi.tolist()), assumed)
        straight = batch.kind.straight
        self._frames = Frames.straight(batch.d) if straight else Frames.of(batch.Y_unit, self._xi)
        self.volume = self._measure(fibres)
        if not straight:
            _refuse_folds(self._frames.stretch(fibres.offsets), owners)

    @cached_property
    def R(self) -> Array:
        """Matrices from section strains to fibre strains, shape (n, n_xi or 1, n_f, n_v, n_s)."""
        return self._strains(self._fibres)

    def stiffness(self, C: Array) -> Array:
        """Return the integral of R^T C R over the sections, shape (n, n_xi or 1, n_s, n_s)."""
        return self._integral(self.R, C, self.volume, self.R)

    def stiffness_partial(self, C: Array, fibres_b: Fibres) -> Array:
        """Return the derivative of `stiffness` for the derivative `fibres_b` of the fibres."""
        R_b, volume_b = (self._along(of, fibres_b) for of in (self._strains, self._measure))
        cross = self._integral(R_b, C, self.volume, self.R)
        return cross + cross.swapaxes(-1, -2) + self._integral(self.R, C, volume_b, self.R)

    def total(self, K: Array) -> Array:
        """Return the integral of beta^T K beta along the axis by quadrature, (n, n_g, n_g)."""
        right = self.rule[:, None, None] * (K @ self.beta)
        n_g = self.beta.shape[-1]
        return np.asarray(self.beta.reshape(-1, n_g).T @ right.reshape(len(K), -1, n_g))

    def true_strains(self, twist: Array | None) -> Array:
        """Return the matrices `R` for engineering shear strains; `twist` as in `Frames.strains`."""
        return self._frames.strains(self._fibres, self._turns, 2, twist)

    def mass(self, rho: Array) -> Array:
        """Return the integral of rho s s^T (eq. 10), shape (n, n_a, n_a)."""
        s = self._shape(self._fibres.offsets)
        return _product(rho, self.rule[:, None] * self.volume, s, s)

    def mass_partial(self, rho: Array, fibres_b: Fibres) -> Array:
        """Return the derivative of `mass` for the derivative `fibres_b` of the fibres."""
        offsets, offsets_b = self._fibres.offsets, fibres_b.offsets
        s, s_b = self._shape(offsets), along(self._shape, (offsets,), (offsets_b,))
        volume_b = self._along(self._measure, fibres_b)
        dV, dV_b = (self.rule[:, None] * x for x in (self.volume, volume_b))
        cross = _product(rho, dV, s_b, s)
        return cross + cross.swapaxes(-1, -2) + _product(rho, dV_b, s, s)

    def _strains(self, fibres: Fibres) -> Array:
        return self._frames.strains(fibres, self._turns, 1)

    def _measure(self, fibres: Fibres) -> Array:
        j = self._frames.stretch(fibres.offsets) * self._frames.det[..., None]
        return np.asarray(fibres.volume[:, None] * j)

    def _along(self, function: Callable[[Fibres], Array], fibres_b: Fibres) -> Array:
        names = [each.name for each in fields(Fibres)]
        parts = [[getattr(x, name) for name in names] for x in (self._fibres, fibres_b)]
        return along(lambda *moved: function(Fibres(*moved)), *parts)

    def _integral(self, R_1: Array, C: Array, volume: Array, R_2: Array) -> Array:
        weighted = volume[..., None, None] * (C[:, None, None] @ R_2)
        left, right = (x.reshape(*x.shape[:2], -1, x.shape[-1]) for x in (R_1, weighted))
        return np.asarray(left.swapaxes(-1, -2) @ right)

    def _shape(self, offsets: Array) -> Array:
        """Return the shape functions at the fibres, shape (n, n_xi, n_f, n_a)."""
        y, z = np.moveaxis(offsets[:, None], -1, 0)
        weights = shape_weights(self._d, Quantity.POSITION, self._xi[:, None], y, z)
        return weights


def _product(rho: Array, dV: Array, s_1: Array, s_2: Array) -> Array:
    weighted = (rho[:, None, None] * dV)[..., None] * s_2
    left, right = (s.reshape(len(s), -1, s.shape[-1]) for s in (s_1, weighted))
    return np.asarray(left.swapaxes(-1, -2) @ right)


def section_stiffness(batch: Batch) -> tuple[Array, ...]:
    """Return section stiffnesses C of the volume, and of the axis if the energy needs them.

    With assumed strains the stiffness of the turns, which the axis lacks, follows on the diagonal.
    """
    if not batch.energy.assumed_strains:
        return batch.stiffness
    turns = turn_stiffness(batch.d, *batch.moduli, batch.kind.straight)
    whole = []
    for C, share in zip(batch.stiffness, (1.0, 0.0), strict=False):
        n_v, size = C.shape[1], C.shape[1] + turns.shape[1]
        whole.append(np.zeros((len(C), size, size), dtype=C.dtype))
        whole[-1][:, :n_v, :n_v] = C
        rows = np.arange(n_v, size)
        whole[-1][:, rows, rows] = turns * share
    return tuple(whole)


def _refuse_folds(stretch: Array, owners: Array) -> None:
    worst = np.min(stretch.real, axis=(1, 2))
    if not np.all(worst > 0):
        k = int(np.argmin(worst))
        raise InvalidInputError(
            str(owners[k]),
            "dr_o/dx of the reference configuration must have a positive determinant everywhere",
            f"{float(worst[k]):.3g} at the worst point",
            "Use right-handed node frames, more elements along the curve or a thinner section.",
        )


# -- strains of sections -----------------------------------------------------------------------


@lru_cache(maxsize=8)
def upper_triangle(n_y: int) -> tuple[Array, Array]:
    """Return row and column indices of the entries of a packed symmetric matrix, (n_g,) each."""
    rows, columns = np.triu_indices(n_y)
    return rows, columns


def packed_gram(Y: Array) -> Array:
    """Return the packed upper triangle of Y Y^T, shape (..., n_g), of Y, shape (..., n_y, d)."""
    return strain(None, Y, Y, None) / 2


@final
@dataclass(frozen=True)
class StrainPlaces:
    """Indices of the strains of a section in their vector; entry 0 is a.a of the axis.

    Indices i and j run over y and z. The fields after `thickness` exist for assumed strains only.
    """

    bending: Array  # a.b_i; for assumed strains its mean along the element
    squares: Array  # b_i.b_j
    shears: Array  # c_i.a
    slopes: Array  # c_i.b_j
    thickness: Array  # c_i.c_j
    turns: Array  # squares of curvatures and twist
    waves: Array  # assumed curvatures minus their means, the part due to bending
    turned: Array  # assumed curvatures minus their means, the part due to twist

    def count(self, assumed: bool) -> int:
        """Return the number of strains of a section, with or without the assumed strains."""
        return int(self.turned[-1] + 1 if assumed else self.turns[0])


@lru_cache(maxsize=2)
def strain_places(d: int) -> StrainPlaces:
    """Return the indices of the strains of sections in d dimensions."""
    m = d - 1
    pairs = np.zeros((m, m), dtype=int)
    rows, columns = np.triu_indices(m)
    pairs[rows, columns] = pairs[columns, rows] = np.arange(len(rows))
    bending, slopes = 1 + np.arange(m), np.arange(m * m).reshape(m, m)
    squares = np.max(bending) + 1 + pairs
    shears = np.max(squares) + bending
    slopes = np.max(shears) + 1 + slopes
    thickness = np.max(slopes) + 1 + pairs
    # One squared curvature in the plane; two, and the squared twist, in space.
    turns = np.max(thickness) + 1 + np.arange(1 if d == 2 else 3)
    waves = np.max(turns) + bending
    turned = np.max(waves) + bending
    return StrainPlaces(bending, squares, shears, slopes, thickness, turns, waves, turned)


@lru_cache(maxsize=16)
def section_strains(d: int, xi: tuple[float, ...], assumed: bool) -> Array:
    """Return beta, shape (n_xi, n_s, n_g): the strains of sections at xi are beta g.

    Assumed strains do not lock; see the module docstring.
    """
    x, axis, at = np.array(xi)[:, None], Axis.of(d, np.array(xi)), strain_places(d)
    ends, middle = Axis.of(d, np.array([0.0, 1.0])), Axis.of(d, np.array([0.5]))
    chord, bent = np.eye(1, axis.a.shape[-1]), ends.a_xi[0] - middle.a_xi
    beta = np.zeros((len(x), at.count(assumed), (2 * d + 1) * (d + 1)))

    def linear(at_ends: Array) -> Array:
        return at_ends[0] * (1 - x) + at_ends[1] * x

    beta[:, 0] = _gram(axis.a, axis.a)
    for i in range(1, d):
        c, b, k = axis.c[i], axis.b[i], i - 1
        if assumed:
            beta[:, at.bending[k]] = _gram(chord, middle.b[i])
            beta[:, at.shears[k]] = linear(_gram(ends.c[i], ends.a))
            # The parts of the curvature that vary along the element, by bending and by twist.
            s, wave = 1 - 2 * x, _gram(bent, middle.b[i])
            beta[:, at.waves[k]] = 0.5 * (s**2 - 1 / 3) * wave - s * _gram(bent, middle.c[i])
            beta[:, at.turned[k]] = (0.5 - x) * _gram(middle.a_xi, middle.b[i])
        else:
            beta[:, at.bending[k]], beta[:, at.shears[k]] = _gram(axis.a, b), _gram(c, axis.a)
        for j in range(1, d):
            beta[:, at.squares[k, j - 1]] = _gram(b, axis.b[j])
            slope, thickness = _gram(c, axis.b[j]), _gram(c, axis.c[j])
            if assumed:
                at_ends = _gram(ends.c[i], ends.c[j])
                twist = slope - _gram(axis.c[j], b)
                slope = 0.5 * (np.diff(at_ends, axis=0) + twist)
                thickness = linear(at_ends)
            beta[:, at.slopes[k, j - 1]], beta[:, at.thickness[k, j - 1]] = slope, thickness
    if assumed:
        beta[:, at.turns] = _squares(d)
    beta.setflags(write=False)
    return beta


def turn_stiffness(d: int, E: Array, nu: Array, straight: bool) -> Array:
    """Return the stiffness of the turns, a diagonal appended to C, shape (n, 1 or 3); Pa.

    The energy lacks (k - k_o)^2 (k^2 + k k_o + k_o^2) of a curvature or twist k, and turns add (k^2
    - k_o^2)^2: the same for k_o = 0, and 4/3 of it near the reference of a curved beam, whose
    volume also lacks the fraction phi^2/12: 1 - phi^2/12 - phi^2/2 + 2/3 share phi^2 = 1.
    """
    share, G = 1.0 if straight else 7 / 8, E / (2 * (1 + nu))
    turns = [E / 6] if d == 2 else [E / 6, E / 6, G / 3]
    return share * np.stack(turns, axis=-1)


def components(d: int) -> tuple[tuple[int, int], ...]:
    """Return the index pairs of the strain components, normal strains first."""
    return ((0, 0), (1, 1), (0, 1)) if d == 2 else ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@final
@dataclass(frozen=True)
class Axis:
    """Coefficients of r_x, r_xx, r_y, r_z and their xi derivatives in Y, (n_xi, n_y) each.

    Tuples are by axis of the section; entry 0 is not used.
    """

    a: Array
    a_xi: Array
    c: tuple[Array, ...]
    b: tuple[Array, ...]

    @classmethod
    def of(cls, d: int, xi: Array) -> Axis:
        """Return the coefficients for beams in d dimensions at locations xi, shape (n_xi,)."""
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


def _squares(d: int) -> Array:
    """Return the coefficients in g of the squared curvatures and twist at mid-element.

    The rows are (l kappa_z)^2 and, in space, (l kappa_y)^2 and (l tau)^2. At mid-element a'.a' =
    kappa_z^2 + kappa_y^2, b_2.b_2 = kappa_z^2 + tau^2 and b_3.b_3 = kappa_y^2 + tau^2.
    """
    middle = Axis.of(d, np.array([0.5]))
    bent = _gram(middle.a_xi, middle.a_xi)[0]
    if d == 2:
        return np.asarray(0.5 * (bent + _gram(middle.b[1], middle.b[1])[0]))[None]
    first, second = (_gram(b, b)[0] for b in middle.b[1:])
    squares = np.stack([bent + first - second, bent - first + second, first + second - bent])
    return np.asarray(0.5 * squares)


def _gram(u: Array, v: Array) -> Array:
    """Return the coefficients of (sum u_i Y_i) . (sum v_j Y_j) in g, shape (..., n_g)."""
    rows, columns = upper_triangle(u.shape[-1])
    product = u[..., rows] * v[..., columns] + u[..., columns] * v[..., rows]
    return product * np.where(rows == columns, 0.5, 1.0)


# -- strains at fibres -------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class Fibres:
    """Quadrature points (fibres) of the sections of n elements, or their parameter derivative."""

    offsets: Array  # (n, n_s, 2): y and z over l
    volume: Array  # (n, n_s): area that a fibre stands for, times l
    # (n, 5): factors of strains: square roots of the shear factors along y and z, of the torsion
    # constant over the polar moment about the centroid, and of the factors of curvature waves.
    factors: Array
    # (n, 3): radii of gyration about the centroid along y and z, and sqrt(J/A), over l.
    radii: Array
    stretch: Array  # (n, 2): axial strain that is subtracted per squared curvature
    # (n, 2): factors, about z and y, of terms that kinks of the axis would make stiff: one in
    # slender elements, zero in elements much shorter than the radii of gyration.
    fade: Array
    centroid: Array  # (n, 1, 2): y and z of the centroid over l
    shear_centre: Array  # (n, 1, 2): y and z of the shear centre over l

    def any(self) -> bool:
        """Whether any number in these quadrature points (a parameter derivative) is nonzero."""
        parts = (self.offsets, self.volume, self.factors, self.shear_centre)
        return any(bool(np.any(part)) for part in parts)

    def axis(self) -> Fibres:
        """Return the whole section as one fibre at the centroid."""
        volume = self.volume.sum(axis=1, keepdims=True)
        places = self.centroid, self.shear_centre
        terms = self.factors, self.radii, self.stretch, self.fade
        return Fibres(self.centroid, volume, *terms, *places)


@final
@dataclass(frozen=True)
class Frames:
    """Reference sections of n elements at locations xi; one for all if they are straight."""

    is_straight: bool
    normal: Array  # (n, n_xi, d): normal components of r_ox and b_oj
    across: Array  # (n, n_xi, d, d - 1): components of r_ox and b_oj in the section
    inverse: Array  # (n, n_xi, d - 1, d - 1): J_s^-1
    det: Array  # (n, n_xi): determinant of J_s

    @classmethod
    def straight(cls, d: int) -> Frames:
        """Return the reference sections of straight elements: the coordinate axes."""
        normal, inverse = np.eye(d)[None, None, 0], np.eye(d - 1)[None, None]
        return cls(True, normal, np.zeros((1, 1, d, d - 1)), inverse, np.ones((1, 1)))

    @classmethod
    def of(cls, Y: Array, xi: Array) -> Frames:
        """Return the reference sections of relative node vectors Y, (n, n_y, d), at xi, (n_xi,)."""
        d = Y.shape[-1]
        axis = Axis.of(d, xi)
        slopes = np.stack([c @ Y for c in axis.c[1:]], axis=-1)
        rest = np.stack([axis.a @ Y, *(b @ Y for b in axis.b[1:])], axis=-1)
        # The axes of the section as rows: normal, r_y over its length, and in space the direction
        # perpendicular to both. Shear factors, and C without Poisson's effect, refer to these.
        r_y = slopes[..., 0] / np.sqrt(np.sum(slopes[..., 0] ** 2, axis=-1, keepdims=True))
        if d == 2:
            axes = np.stack([np.stack([r_y[..., 1], -r_y[..., 0]], axis=-1), r_y], axis=-2)
        else:
            normal = np.cross(r_y, slopes[..., 1])
            normal = normal / np.sqrt(np.sum(normal**2, axis=-1, keepdims=True))
            axes = np.stack([normal, r_y, np.cross(normal, r_y)], axis=-2)
        J_s, along = (axes @ slopes)[..., 1:, :], np.swapaxes(axes @ rest, -1, -2)
        return cls(False, along[..., 0], along[..., 1:], np.linalg.inv(J_s), np.linalg.det(J_s))

    def stretch(self, offsets: Array) -> Array:
        """Return j, the normal component of r_ox + y b_o2 + z b_o3, at fibres, (n, n_xi, n_f)."""
        ones = self._ones(offsets, self.normal.shape[-1] - 1)
        return np.asarray(np.einsum("...sk,...k->...s", ones, self.normal))

    def strains(
        self, at: Fibres, turns: int, shear_power: int, twist: Array | None = None
    ) -> Array:
        """Return the matrices from section strains s to fibre strains and turns.

        Their shape is (n, n_xi, n_f, n_v + turns, n_s). `turns` is the number of turns in the
        energy; `shear_power` is the exponent of the factors of shears and waves: 1 for strains of
        the energy, 2 for strains of the material. `twist`, (n, n_f, 2), holds the shears of torsion
        over the rate of twist and l, if known; by default sections stay plane and shears have the
        factor of twist.
        """
        d = self.normal.shape[-1]
        places, pairs, m = strain_places(d), components(d), d - 1
        y, j = self._ones(at.offsets, m), self.stretch(at.offsets)
        q = -np.einsum("...sk,...kj,...ij->...si", y, self.across, self.inverse) / j[..., None]
        shape = len(pairs) + turns, places.count(turns > 0)
        R = np.zeros((*j.shape, *shape), dtype=q.dtype)
        R[..., 0, 0] = 0.5 / j**2
        inverse = self.inverse[:, :, None]
        for i in range(m):
            R[..., 0, places.bending[i]] = y[..., 1 + i] / j**2
            for k in range(m):
                square = 0.5 * y[..., 1 + i] * y[..., 1 + k] / j**2
                R[..., 0, places.squares[i, k]] += square
                at_ik = places.thickness[i, k]
                R[..., 0, at_ik] -= 0.5 * q[..., i] * q[..., k]
                for row, (a, b) in enumerate(pairs[1 : d * (d - 1) // 2 + 1], start=1):
                    share = 0.5 if a == b else 1.0
                    R[..., row, at_ik] += share * inverse[..., i, a - 1] * inverse[..., k, b - 1]
        h = self._shears(at, shear_power, R.shape[-1], twist)
        R[..., [pairs.index((0, a)) for a in range(1, d)], :] = np.swapaxes(inverse, -1, -2) @ h
        true = h if shear_power == 2 else self._shears(at, 2, R.shape[-1], twist)
        R[..., 0, :] += np.einsum("...i,...is->...s", q, true)
        radii = at.radii[:, None, None, :turns]
        R[..., len(pairs) + np.arange(turns), places.turns[:turns]] = radii
        if turns and self.is_straight:
            R[..., 0, places.turns[:m]] = -at.stretch[:, None, None, :m]
        if turns:
            R[..., 0, places.turned] = at.fade[:, None, None, :m] * R[..., 0, places.bending]
            waves = at.factors[:, None, None, 3 : 3 + m] ** shear_power
            R[..., 0, places.waves] = waves * R[..., 0, places.bending]
        return R

    def _shears(self, at: Fibres, power: int, count: int, given: Array | None) -> Array:
        """Return the coefficients of the shears h in s, shape (n, n_xi, n_f, d - 1, count)."""
        m = self.normal.shape[-1] - 1
        places, factors = strain_places(m + 1), at.factors**power
        # Coefficients of g_i, then G_ij, in s, shape (n, n_xi, 1, d - 1, d, count).
        along = np.swapaxes(self.inverse @ np.swapaxes(self.across, -1, -2), -1, -2)
        forms = np.zeros((*along.shape[:2], 1, m, m + 1, count))
        for i in range(m):
            forms[..., 0, i, 0, places.shears[i]] = 1.0
            forms[..., 0, i, 1 + np.arange(m), places.slopes[i]] = 1.0
            forms[..., 0, i, :, places.thickness[i]] = -np.moveaxis(along, -1, 0)
        y, c, c_s = (x[:, None, :, :m] for x in (at.offsets, at.centroid, at.shear_centre))
        twist = factors[:, 2] if given is None else np.zeros(1)
        twist = np.where(np.eye(m) == 1, 1.0, twist[:, None, None])[:, None, None]
        shear = factors[:, None, None, :m, None]
        arms = shear * c_s[..., None, :] + twist * (y - c)[..., None, :]
        arms = np.concatenate([np.broadcast_to(shear, (*arms.shape[:-1], 1)), arms], axis=-1)
        h = np.einsum("...ij,...ijs->...is", arms, forms)
        if given is not None and m == 2:
            # r_y rotates by G_zy and r_z by -G_yz: if they differ, the torque follows from their
            # mean with the weights I_y and I_z.
            squares = at.radii[:, :2] ** 2
            w = (squares / np.sum(squares, axis=1, keepdims=True))[:, None, None, :, None]
            rate = w[..., 0, :] * forms[..., 1, 1, :] - w[..., 1, :] * forms[..., 0, 2, :]
            h = h + given[:, None, :, :, None] * rate[..., None, :]
        return np.asarray(h / self.stretch(at.offsets)[..., None, None])

    @staticmethod
    def _ones(offsets: Array, m: int) -> Array:
        """Return 1, y and z of the fibres of sections as rows, shape (n, 1, n_f, d)."""
        return np.concatenate([np.ones_like(offsets[..., :1]), offsets[..., :m]], axis=-1)[:, None]
