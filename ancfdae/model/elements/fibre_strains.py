"""Strains at the fibres of sections, as linear functions of the strains s of the section.

At a point (xi, y, z), with dr_o/dx = (r_ox + y b_o2 + z b_o3, r_oy, r_oz) in the axes of the
reference section (its normal, r_oy over its length, and what is across both), let j be the normal
component of the first column, p the two others of it, J_s those of r_oy and r_oz, and
q = -J_s^-1 p/j. Green and Lagrange's strain E = J_o^-T (B - B_o)/2 J_o^-1 is then

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

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.model.elements.strain_fields import Axis, components, strain_places
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Fibres:
    """Fibres of n elements, or their derivative with respect to a parameter."""

    offsets: Array  # (n, n_s, 2): y and z over l
    volume: Array  # (n, n_s): area that a fibre stands for, times l
    # (n, 5): strains are multiplied by them: square roots of the shear factors along y and z, of
    # what the torsion constant is to the polar moment about the centroid, and of what counts of the
    # waves of curvature.
    factors: Array
    # (n, 3): radii of gyration about the centroid along y and z, and sqrt(J/A), over l.
    radii: Array
    stretch: Array  # (n, 2): axial strain that squares of curvatures take off
    # (n, 2): what counts, about z and y, of terms that kinks of the axis would make stiff: one in
    # slender elements, nothing in those that are shorter than the radii.
    fade: Array
    centroid: Array  # (n, 1, 2): y and z of them over l
    shear_centre: Array  # (n, 1, 2)

    def any(self) -> bool:
        """Whether a number of the fibres is nonzero; radii and centroid follow from the others."""
        parts = (self.offsets, self.volume, self.factors, self.shear_centre)
        return any(bool(np.any(part)) for part in parts)

    def axis(self) -> Fibres:
        """All of the section in one fibre at the centroid."""
        volume = self.volume.sum(axis=1, keepdims=True)
        places = self.centroid, self.shear_centre
        terms = self.factors, self.radii, self.stretch, self.fade
        return Fibres(self.centroid, volume, *terms, *places)


@final
@dataclass(frozen=True)
class Frames:
    """Reference sections at places of n elements, or one for all where they are straight."""

    is_straight: bool
    normal: Array  # (n, n_xi, d): normal components of r_ox and b_oj
    across: Array  # (n, n_xi, d, d - 1): components of these in the section
    inverse: Array  # (n, n_xi, d - 1, d - 1): J_s^-1
    det: Array  # (n, n_xi): determinant of J_s

    @classmethod
    def straight(cls, d: int) -> Frames:
        """Return the frames of straight elements: unit vectors along the axes of the beam."""
        normal, inverse = np.eye(d)[None, None, 0], np.eye(d - 1)[None, None]
        return cls(True, normal, np.zeros((1, 1, d, d - 1)), inverse, np.ones((1, 1)))

    @classmethod
    def of(cls, Y: Array, xi: Array) -> Frames:
        """Return those of reference vectors (n, n_y, d), which depend on no parameter."""
        d = Y.shape[-1]
        axis = Axis.of(d, xi)
        slopes = np.stack([c @ Y for c in axis.c[1:]], axis=-1)
        rest = np.stack([axis.a @ Y, *(b @ Y for b in axis.b[1:])], axis=-1)
        axes = _section_axes(slopes)
        J_s, along = (axes @ slopes)[..., 1:, :], np.swapaxes(axes @ rest, -1, -2)
        return cls(False, along[..., 0], along[..., 1:], np.linalg.inv(J_s), np.linalg.det(J_s))

    def stretch(self, offsets: Array) -> Array:
        """Return j at fibres, shape (n, n_xi, n_f)."""
        ones = self._ones(offsets, self.normal.shape[-1] - 1)
        return np.asarray(np.einsum("...sk,...k->...s", ones, self.normal))

    def strains(
        self, at: Fibres, turns: int, shear_power: int, twist: Array | None = None
    ) -> Array:
        """Return strains and turns in s, shape (n, n_xi, n_f, n_v + turns, n_s).

        `turns` says how many of them the energy has; `shear_power` is that of the factors in shears
        and waves: 1 in those of the energy, 2 of the material. `twist`, (n, n_f, 2), has shears of
        torsion over the rate of twist and l, where they are known; by default they are those of
        sections that stay flat, with the factor.
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
        """Return h in s, shape (n, n_xi, n_f, d - 1, count)."""
        m = self.normal.shape[-1] - 1
        forms, factors = self._forms(count), at.factors**power
        y, c, c_s = (x[:, None, :, :m] for x in (at.offsets, at.centroid, at.shear_centre))
        twist = factors[:, 2] if given is None else np.zeros(1)
        twist = np.where(np.eye(m) == 1, 1.0, twist[:, None, None])[:, None, None]
        shear = factors[:, None, None, :m, None]
        arms = shear * c_s[..., None, :] + twist * (y - c)[..., None, :]
        arms = np.concatenate([np.broadcast_to(shear, (*arms.shape[:-1], 1)), arms], axis=-1)
        h = np.einsum("...ij,...ijs->...is", arms, forms)
        if given is not None and m == 2:
            # r_y turns by G_zy and r_z by -G_yz: where they differ, the torque is that of their
            # mean with the weights I_y and I_z.
            squares = at.radii[:, :2] ** 2
            w = (squares / np.sum(squares, axis=1, keepdims=True))[:, None, None, :, None]
            rate = w[..., 0, :] * forms[..., 1, 1, :] - w[..., 1, :] * forms[..., 0, 2, :]
            h = h + given[:, None, :, :, None] * rate[..., None, :]
        return np.asarray(h / self.stretch(at.offsets)[..., None, None])

    def _forms(self, count: int) -> Array:
        """Return g_i, then G_ij, in s, shape (n, n_xi, 1, d - 1, d, count)."""
        m = self.normal.shape[-1] - 1
        places = strain_places(m + 1)
        along = np.swapaxes(self.inverse @ np.swapaxes(self.across, -1, -2), -1, -2)
        forms = np.zeros((*along.shape[:2], 1, m, m + 1, count))
        for i in range(m):
            forms[..., 0, i, 0, places.shears[i]] = 1.0
            forms[..., 0, i, 1 + np.arange(m), places.slopes[i]] = 1.0
            forms[..., 0, i, :, places.thickness[i]] = -np.moveaxis(along, -1, 0)
        return forms

    @staticmethod
    def _ones(offsets: Array, m: int) -> Array:
        """1, y(, z), shape (n, 1, n_f, d)."""
        return np.concatenate([np.ones_like(offsets[..., :1]), offsets[..., :m]], axis=-1)[:, None]


def _section_axes(slopes: Array) -> Array:
    """Rows: the normal of the section, r_y over its length, and what is across both in space.

    Shear factors, and C without Poisson's effect, belong to these axes.
    """
    r_y = slopes[..., 0] / np.sqrt(np.sum(slopes[..., 0] ** 2, axis=-1, keepdims=True))
    if slopes.shape[-2] == 2:
        normal = np.stack([r_y[..., 1], -r_y[..., 0]], axis=-1)
        return np.stack([normal, r_y], axis=-2)
    normal = np.cross(r_y, slopes[..., 1])
    normal = normal / np.sqrt(np.sum(normal**2, axis=-1, keepdims=True))
    return np.stack([normal, r_y, np.cross(normal, r_y)], axis=-2)
