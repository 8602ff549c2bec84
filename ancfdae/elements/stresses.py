"""Stresses of continuum beams, and the section forces that they add up to.

Stresses are the second Piola-Kirchhoff ones of the law, S = C (E + tau E'), in the axes of the
reference section, as a linear map of the Gram matrix like the strains (`strain_fields`). With r_,i
along y and z, b_i = dr_,i/dx and the position field r + y r_y + z r_z, a section transmits

    n = int F S e_x dA = N r_x + M_i b_i + V_i r_,i,
    m = int (y_i r_,i) x F S e_x dA = r_,i x (M_i r_x + I_ij b_j + T_ij r_,j),
    N, V_i = int S_xx, S_xi dA,   M_i, T_ij, I_ij = int y_i S_xx, y_i S_xj, y_i y_j S_xx dA.

All scalar products among r_x, b_i and r_,i are those of the strains of the law, assumed ones
included, and give the components in the axes of the section. What else of the energy depends on
squares of curvatures and twist adds its part to the moments (docs/theory.md, section 2).
"""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.elements.element import Batch, ElementParameter, SectionLaw
from ancfdae.elements.hermite import end_weight_xi
from ancfdae.elements.packing import packed_gram
from ancfdae.elements.strain_fields import (
    components,
    frame_products,
    turn_count,
    turn_stiffness,
)
from ancfdae.elements.volume import AXIS_POINTS, Fibres, Region, fibres, gauss_rule
from ancfdae.kernels import strain
from ancfdae.numerics.arrays import Array

# Points along an element in its mean forces: of degree 4 times 2 where the reference is straight.
_ALONG = 5


@final
class StressMap:
    """Stresses at fibres and places of elements, linear in the strains of the law.

    Attributes
    ----------
    D : array, shape (n, n_f, n_xi, n_v, n_g)
        Stresses in the strains of the law, of vectors as `scaled` returns them.
    region : Region
        Strains and volume there.
    """

    def __init__(self, own: Batch, xi: Array, at: Fibres) -> None:
        volume, *rest = own.stiffness
        self._C = volume
        # Strains carry the roots of shear factors; stresses, work conjugate to true strains, both.
        squared, n_v = replace(at, factors=at.factors**2), len(components(own.d))
        owners = np.full(len(own.parameters), "stress")
        self.region = Region(own, squared, (xi, np.ones(len(xi))), owners)
        D: Array = volume[:, None] @ self.region.P[:, :, :n_v]
        self.D: Array = D.reshape(len(D), -1, len(xi), *D.shape[2:])
        for C in rest:
            # The law asks for it at these points only: linear between and beyond them.
            places, _ = gauss_rule(AXIS_POINTS)
            axis = Region(own, at.axis(), (places, np.ones(AXIS_POINTS)), owners)
            share = (xi - places[0]) / (places[1] - places[0])
            S = C[:, None] @ axis.P[:, :, :n_v]
            first, second = S[:, None, :1], S[:, None, 1:]
            share = share[:, None, None]
            self.D = self.D + first * (1 - share) + second * share

    def of_twist(self, shear: Array) -> Array:
        """Return D of shears along y and z, (n, n_f, 2), over the rate of twist and l."""
        P = self.region.of_twist(shear)[:, :, : self.D.shape[3]]
        D: Array = (self._C[:, None] @ P).reshape(self.D.shape)
        return D


def spread_stresses(own: Batch, xi: Array, places: tuple[Array, Array]) -> Array:
    """Return stresses at y and z of sections, (n, n_f) each, as maps of the strains of the law.

    Shears of torsion are in balance with the torque of the law and spread as the section knows
    them. Where properties of the section count, the mean shears of V_y and V_z and the mean
    thickness stresses, radial ones in curved beams, spread by its shares.
    """
    fibre, section, d = fibres(own), own.kind.section, own.d
    offsets = np.stack(places, axis=-1) / own.lengths[:, None, None]
    untwisted = fibre.factors * np.array([1.0, 1.0, 0.0])
    at = replace(fibre, offsets=offsets, volume=np.ones(offsets.shape[:2]), factors=untwisted)
    law = StressMap(own, xi, at)
    D = law.D
    if own.energy.corrected:
        shares = section.shares(own.sizes, *places)
        for j, share in enumerate(shares[: d - 1], start=1):
            for pair in ((0, j), (j, j)):
                D[:, :, :, components(d).index(pair)] *= share[:, :, None, None]
    if d == 3:
        shear = np.stack(section.torsional_shear(own.sizes, *places), axis=-1)
        area = np.sum(fibre.volume, axis=1) / own.lengths
        J = fibre.radii[:, 2] ** 2 * own.lengths**2 * area
        share = J / section.torsion(own.sizes) / own.lengths
        D = D + law.of_twist(shear * share[:, None, None])
    return D


def von_mises_form(d: int, across: Array) -> Array:
    """Return Q with von Mises' stress squared = S^T Q S, shape (n, n_v, n_v).

    Stresses stand as `components` has them; `across` is that across the plane over S_xx + S_yy.
    """
    full = np.zeros((6, 6))
    full[:3, :3] = 1.5 * np.eye(3) - 0.5
    full[[3, 4, 5], [3, 4, 5]] = 3.0
    if d == 3:
        return np.broadcast_to(full, (len(across), 6, 6))
    whole = np.zeros((len(across), 6, 3), dtype=across.dtype)
    whole[:, [0, 1, 5], [0, 1, 2]] = 1.0
    whole[:, 2, :2] = across[:, None]
    return np.asarray(whole.swapaxes(1, 2) @ full @ whole)


def scaled(Y: Array, l: Array) -> Array:
    """Divide the chords of relative node vectors (..., n, n_y, d) by the lengths."""
    Y_s = Y.astype(np.result_type(Y, l))
    Y_s[..., 0, :] = Y_s[..., 0, :] / l[:, None]
    return Y_s


@final
class ContinuumSectionLaw(SectionLaw):
    """Forces in the sections at xi of n elements."""

    def __init__(self, own: Batch, xi: float) -> None:
        self._l, self._tau = own.lengths, own.of(ElementParameter.DAMPING_TIME)
        self._g_o, self._assumed = packed_gram(own.Y_unit), own.energy.assumed_strains
        self._maps = _resultants(own, xi)
        self._frame = frame_products(own.d, xi, self._assumed, own.kind.straight)

    def forces(self, Y: Array, V: Array) -> Array:
        """Return integrals of tractions, and of tractions times arms."""
        Y, V = np.broadcast_arrays(scaled(Y, self._l), scaled(V, self._l))
        x = strain(self._g_o, Y, V, self._tau)
        axial, shear, squares = (_applied(R, x) for R in self._maps)
        vectors = _in_section_axes(np.einsum("ijg,...g->...ij", self._frame, packed_gram(Y)))
        d, rates = self._frame.shape[0], _rates(vectors)
        if self._assumed:
            axial, shear = _lessened(axial, shear, rates)
        # int F S e_x times 1, y and z.
        tractions = np.einsum("...ij,...cj->...ic", axial, vectors[..., [0, *range(d, 2 * d - 1)]])
        tractions = tractions + np.einsum("...ij,...cj->...ic", shear, vectors[..., 1:d])
        arms = np.moveaxis(vectors[..., 1:d], -1, -2)
        moment = np.sum(np.cross(arms, tractions[..., 1:, :]), axis=-2)
        # The last axis is about z, y and x; in the plane about z only.
        moment[..., : -1 - squares.shape[-1] : -1] += 2 * rates * squares
        return np.concatenate([tractions[..., 0, :], self._l[:, None] * moment], axis=-1)


def _applied(R: Array, x: Array) -> Array:
    """Apply maps (n, ..., n_g) to strains (..., n, n_g) element by element."""
    flat = x.reshape(-1, *x.shape[-2:])
    values: Array = np.einsum("n...g,kng->kn...", R, flat)
    return values.reshape(*x.shape[:-1], *R.shape[1:-1])


def _resultants(own: Batch, xi: float) -> tuple[Array, Array, Array]:
    """Integrals over the section as maps of x; lengths are divided by l.

    Of y_i y_j S_xx and y_i S_xj with y_0 = 1, shape (n, d, d, n_g) and (n, d, d - 1, n_g), and what
    is work conjugate to the squares of curvatures and twist, shape (n, n_t, n_g).
    """
    d, at = own.d, fibres(own)
    smooth, weights = smoothing(xi)
    law, n_v = StressMap(own, np.concatenate([[xi], smooth]), at), len(components(d))
    n, n_f, n_xi = law.D.shape[:3]
    T = law.region.T[..., :n_v, :n_v]
    T = T if own.kind.straight else T.reshape(n, n_f, n_xi, n_v, n_v)
    S = np.swapaxes(T, -1, -2) @ law.D
    dA = law.region.dV.reshape(n, n_f, n_xi) / own.lengths[:, None, None]
    one = np.ones((n, n_f, 1))
    y = np.concatenate([one, at.offsets[..., : d - 1]], axis=-1)
    index = {pair: v for v, pair in enumerate(components(d))}
    S_xx, S_x = 2 * S[:, :, :, 0], S[:, :, :, [index[0, j] for j in range(1, d)]]
    axial = np.einsum("nfp,nfi,nfj,nfpg->pnijg", dA, y, y, S_xx, optimize=True)
    shear = np.einsum("nfp,nfi,nfpjg->pnijg", dA, y, S_x, optimize=True)
    smooth_N, smooth_V = (np.einsum("p,pn...->n...", weights, x[1:, :, 0]) for x in (axial, shear))
    axial, shear = axial[0], shear[0]
    axial[:, 0, 0] = smooth_N[:, 0]
    if not own.energy.assumed_strains:
        shear[:, 0] = smooth_V
    rows = law.region.P.reshape(n, n_f, n_xi, *law.region.P.shape[2:])[:, :, 0, n_v:]
    return axial, shear, _conjugate_to_squares(own, rows, at, dA[..., 0], axial)


def smoothing(xi: float) -> tuple[Array, Array]:
    """Return Gauss points and their weights in the linear force at xi.

    Of all linear forces along an element it is the one that does the same work as the force of the
    law on the chord and on both tangents, which have the weights 6 xi (1 - xi), (1 - xi)(1 - 3 xi)
    and xi (3 xi - 2).
    """
    places, rule = gauss_rule(_ALONG)
    weights = rule * (end_weight_xi(places) + 6 * (xi - 0.5) * (2 * places - 1))
    return places, weights


def _conjugate_to_squares(own: Batch, rows: Array, at: Fibres, dA: Array, axial: Array) -> Array:
    """Stresses work conjugate to the squares of l kappa_z(, l kappa_y and l tau)."""
    d, straight, turns = own.d, own.kind.straight, turn_count(own.d)
    if not own.energy.assumed_strains:
        return np.zeros((len(dA), turns, axial.shape[-1]), dtype=axial.dtype)
    C = turn_stiffness(d, *own.moduli, straight)
    radii = at.radii[:, :turns]
    Q: Array = np.einsum("nf,nft...->nt...", dA, rows) * (radii * C)[..., None]
    if straight:
        lowered = np.zeros_like(radii)
        lowered[:, : d - 1] = 1.5 * radii[:, : d - 1] ** 2
        Q = Q - lowered[..., None] * axial[:, None, 0, 0]
    return Q


def _in_section_axes(products: Array) -> Array:
    """Components of r_x, r_y(, r_z), b_2(, b_3) along normal, height and width of the section.

    From their scalar products with r_x, r_y(, r_z), shape (..., d, 2 d - 1) to (..., 3, 2 d - 1).
    """
    d = products.shape[-2]
    rows = np.zeros((*products.shape[:-2], 3, products.shape[-1]), dtype=products.dtype)
    done: list[int] = []
    # r_y gives the second axis, what of r_z is across it the third, what of r_x is left the first.
    for axis in (*range(1, d), 0):
        left = products[..., axis, :]
        for other in done:
            left = left - rows[..., other, :] * rows[..., other, axis, None]
        rows[..., axis, :] = left / np.sqrt(left[..., axis, None])
        done.append(axis)
    return rows


def _rates(vectors: Array) -> Array:
    """Curvature about the width(, about the height, and twist), times l; shape (..., n_t)."""
    d = (vectors.shape[-1] + 1) // 2
    # r_y turns towards minus the normal where the beam bends about z.
    rates = [-vectors[..., 0, d] / vectors[..., 0, 0]]
    if d == 3:
        rates.append(vectors[..., 0, d + 1] / vectors[..., 0, 0])
        turn_y, turn_z = vectors[..., 2, d] / vectors[..., 1, 1], vectors[..., 1, d + 1]
        rates.append(0.5 * (turn_y - turn_z / vectors[..., 2, 2]))
    return np.stack(rates, axis=-1)


def _lessened(axial: Array, shear: Array, rates: Array) -> tuple[Array, Array]:
    """Take the moments that the assumed curvatures and twist k give to those of the true ones.

    k = kappa (1 - (l kappa)^2/12), or tau (1 - (l tau)^2/6), in the mean of an element: dk/dkappa.
    """
    axial, shear = axial.copy(), shear.copy()
    for i in range(axial.shape[-1] - 1):
        axial[..., 1 + i, 0] *= 1 - rates[..., i] ** 2 / 4
    if shear.shape[-1] == 2:
        shear[..., 1, 1] *= 1 - rates[..., 2] ** 2 / 2
        shear[..., 2, 0] *= 1 - rates[..., 2] ** 2 / 2
    return axial, shear
