"""Section forces of continuum beams, and their stresses.

Section forces are the forces that elements transmit from node to node. Let Q = dU/dY, damping
included, be the forces of an element on its relative node vectors. The force Q_c on the chord is
transmitted between the positions of its nodes, the moment M = sum_s r_s x Q_s on the slopes of its
second node is transmitted there. Both are in equilibrium with the rest of the model to round-off,
since they are terms of its equations of motion. The chord force is the mean of the section force,

    n = Q_c/l + (xi - 1/2) n',     n' = n_2 - n_1,

and the slope n' follows from its values n_k at the nodes. Where nothing acts, n_k is the mean with
the next element, or zero at the end of a beam; where something acts, n jumps, and the slope of the
other half of the element is used. The moment is

    m = M - (l/12) r_x2 x n' + int_xi^1 r_x x n l dxi,

since loads spread along the element have a share l n'/12 in Q_x2 that is no moment of the section.
For loads at nodes this is exact; for spread ones, inertia among them, the error is of second order
in the length (docs/theory/02-strain-energy.md).

**Stresses** are the second Piola-Kirchhoff ones of the law, S = C (E + tau E'), in the axes of the
reference section, as a linear map of the Gram matrix like the strains (`strains`).
"""

from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.kernels import strain, stressed
from ancfdae.model.elements.element import (
    Batch,
    ElementParameter,
    SectionLaw,
    SectionPlace,
    StressLaw,
    tangent_weights,
)
from ancfdae.model.elements.strains import (
    AXIS_POINTS,
    Fibres,
    Region,
    components,
    fibres,
    gauss_rule,
    packed_gram,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import in_space
from ancfdae.numerics.time_grid import box_rule


@final
class ContinuumSectionLaw(SectionLaw):
    """Evaluator of the forces in one section of a run of continuum elements.

    A are the invariants of node vectors scaled by the element length.
    """

    def __init__(self, run: Batch, A: Array, place: SectionPlace) -> None:
        self._l, self._tau = run.lengths, run.of(ElementParameter.DAMPING_TIME)
        self._g_o, self._A, self._d, self._place = packed_gram(run.Y_free), A, run.d, place
        self._arms = _arms(1.0) - _arms(place.xi) - np.outer([0, 1 / 12], [0, 0, 1])
        self._slope = slope_of_means(self._l, place)

    def forces(self, Y: Array, V: Array) -> Array:
        """Return the section forces and moments, shape (..., 6), by equilibrium of the nodes."""
        Y, V = np.broadcast_arrays(scaled(Y, self._l), scaled(V, self._l))
        d, k, xi = self._d, self._place.element, self._place.xi
        x = strain(self._g_o, Y, V, self._tau)
        Q = stressed(np.einsum("nij,...nj->...ni", self._A, x), Y)
        Y, Q = (in_space(each) for each in (Y, Q))
        means = Q[..., 0, :] / self._l[:, None]
        mean, slope = means[..., k, :], np.einsum("n,...nd->...d", self._slope, means)
        Y, Q = Y[..., k, :, :], Q[..., k, :, :]
        axis, end = [0, 1, 1 + d], slice(1 + d, 1 + 2 * d)
        moment = np.sum(np.cross(Y[..., end, :], Q[..., end, :]), axis=-2)
        for arm, force in zip(self._arms, (mean, slope), strict=True):
            along = np.einsum("a,...ad->...d", arm, Y[..., axis, :])
            moment = moment + self._l[k] * np.cross(along, force)
        axes = _axes((1 - xi) * Y[..., 2 : 1 + d, :] + xi * Y[..., 2 + d :, :])
        vectors = np.stack([mean + (xi - 0.5) * slope, moment], axis=-2)
        parts: Array = np.einsum("...ij,...kj->...ki", axes, vectors)
        return parts.reshape(*parts.shape[:-2], 6)


def slope_of_means(l: Array, place: SectionPlace) -> Array:
    """Return the weights of the element means of a run in the slope n' = n_2 - n_1, shape (n,)."""
    k, weights = place.element, np.zeros(len(l), dtype=l.dtype)
    smooth = [side for side in (-1, 1) if place.smooth[max(side, 0)]]
    for side in smooth:
        # n_k minus the mean of the element is half the slope.
        share = side * 2 / len(smooth)
        other = k + side
        if 0 <= other < len(l):
            part = share * l[k] / (l[k] + l[other])
            weights[other] += part
            weights[k] -= part
        else:
            weights[k] -= share
    return weights


def _arms(xi: float) -> Array:
    """Return the integrals from 0 to xi of the weights of dr/dx, times 1 and xi - 1/2, (2, 3)."""
    corner, rule = box_rule((3,))
    places, rule = xi * corner[:, 0], xi * rule
    weights = tangent_weights(places)
    return np.stack([rule @ weights, (rule * (places - 0.5)) @ weights])


def _axes(slopes: Array) -> Array:
    """Return the section axes as rows, shape (..., 3, 3), from its slopes, (..., d - 1, 3).

    The rows are the unit normal, r_y over its length, and the direction perpendicular to both.
    """
    y = slopes[..., 0, :]
    normal = np.cross(y, slopes[..., 1, :] if slopes.shape[-2] == 2 else np.eye(3)[2])
    y, normal = (v / np.sqrt(np.sum(v * v, axis=-1, keepdims=True)) for v in (y, normal))
    return np.stack([normal, y, np.cross(normal, y)], axis=-2)


# -- stresses ----------------------------------------------------------------------------------


_AXIS_PLACES, _ = gauss_rule(AXIS_POINTS)
#: Strain that is added to stresses in quadrature, so that their norm has a derivative where they
#: vanish: far above the round-off of strains, 1e-16 to 1e-14, and far below strains of interest.
SMALL_STRAIN = 1e-9


@final
class ContinuumStressLaw(StressLaw):
    """Evaluator of sqrt(S^T Q S + small^2), S = D x, with the strains x of the energy.

    Shapes: D (n, n_f n_xi, n_v, n_g), Q (n, n_v, n_v).
    """

    def __init__(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> None:
        D = _spread_stresses(batch, xi, places)
        n, n_f, n_xi, n_v, n_g = D.shape
        self._D, self._shape = D.reshape(n, n_f * n_xi * n_v, n_g), (n_f * n_xi, n_v)
        E, nu = batch.moduli
        self._Q = _von_mises_form(batch.d, batch.energy.stress_across(batch.d, nu))
        self._small, self._g_o = SMALL_STRAIN * E, packed_gram(batch.Y_free)
        self._l, self._tau = batch.lengths, batch.of(ElementParameter.DAMPING_TIME)
        self.count = D[..., 0].size

    def von_mises(self, Y: Array, V: Array) -> Array:
        """Return the von Mises stresses, shape (k, n, n_f n_xi); Pa."""
        S = self._stresses(Y, V)
        squares = np.sum(S * (S @ self._Q), axis=-1)
        return np.asarray(np.sqrt(squares + self._small[:, None] ** 2))

    def pulled_back(self, Y: Array, V: Array, weights: Array) -> tuple[Array, Array]:
        """Return gradients in Y and V of the weighted sum of half the squared stresses."""
        QS = weights[..., None] * (self._stresses(Y, V) @ self._Q)
        flat = QS.swapaxes(0, 1).reshape(len(self._D), len(QS), -1)
        p = (flat @ self._D).swapaxes(0, 1)
        tau = self._tau[:, None, None]
        Y, V = scaled(Y, self._l), scaled(V, self._l)
        on_Y, on_V = stressed(p, Y), tau * stressed(p, Y)
        return scaled(on_Y + tau * stressed(p, V), self._l), scaled(on_V, self._l)

    def _stresses(self, Y: Array, V: Array) -> Array:
        """Return the stress components S, shape (k, n, n_p, n_v); Pa."""
        x = strain(self._g_o, scaled(Y, self._l), scaled(V, self._l), self._tau)
        S = x.swapaxes(0, 1) @ self._D.swapaxes(1, 2)
        return S.swapaxes(0, 1).reshape(len(x), len(self._D), *self._shape)


def _spread_stresses(batch: Batch, xi: Array, places: tuple[Array, Array]) -> Array:
    """Return the matrices D of stresses at points y and z of sections, (n, n_f) each.

    They map the strains of the energy. Shear stresses of torsion are in equilibrium with the torque
    and distributed by the solution of the section for torsion. For energies with section
    properties, `Section.shares` distributes the mean shears of V_y and V_z and the mean thickness
    stresses, in curved beams the radial stresses.
    """
    fibre, section, d = fibres(batch), batch.kind.section, batch.d
    offsets = np.stack(places, axis=-1) / batch.lengths[:, None, None]
    at = replace(fibre, offsets=offsets, volume=np.ones(offsets.shape[:2]))
    D = flat = _stresses(batch, xi, at, np.zeros_like(offsets))
    if batch.energy.corrected:
        D = flat.copy()
        shares = section.shares(batch.sizes, *places)
        for j, share in enumerate(shares[: d - 1], start=1):
            for pair in ((0, j), (j, j)):
                D[:, :, :, components(d).index(pair)] *= share[:, :, None, None]
    if d == 3:
        shear = np.stack(section.torsional_shear(batch.sizes, *places), axis=-1)
        area = np.sum(fibre.volume, axis=1) / batch.lengths
        J = fibre.radii[:, 2] ** 2 * batch.lengths**2 * area
        share = J / section.torsion(batch.sizes) / batch.lengths
        D = D + _stresses(batch, xi, at, shear * share[:, None, None]) - flat
    return D


def _stresses(batch: Batch, xi: Array, at: Fibres, twist: Array) -> Array:
    """Return the matrices D from strains to stresses at fibres; `twist` as in `Frames.strains`."""
    volume, *rest = batch.stiffness
    owners, n_v = np.full(len(batch.parameters), "stress"), len(components(batch.d))

    def stresses(C: Array, at: Fibres, xi: Array, twist: Array | None) -> Array:
        region = Region(batch, at, (xi, np.ones(len(xi))), owners)
        eps = region.true_strains(twist)[..., :n_v, :] @ region.beta[:, None]
        return np.asarray((C[:, None, None] @ eps).swapaxes(1, 2))

    D = stresses(volume, at, xi, twist)
    for C in rest:
        # The energy evaluates this term at the axis points only: linear between and beyond them.
        first, second = np.split(stresses(C, at.axis(), _AXIS_PLACES, None), AXIS_POINTS, axis=2)
        share = (xi - _AXIS_PLACES[0]) / (_AXIS_PLACES[1] - _AXIS_PLACES[0])
        share = share[:, None, None]
        D = D + first * (1 - share) + second * share
    return D


def _von_mises_form(d: int, across: Array) -> Array:
    """Return Q with von Mises' stress squared = S^T Q S, shape (n, n_v, n_v).

    Stresses are ordered as `components`; `across` is the stress normal to the plane over S_xx +
    S_yy.
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
    """Return relative node vectors, (..., n, n_y, d), with the chord divided by the length l."""
    Y_s = Y.astype(np.result_type(Y, l))
    Y_s[..., 0, :] = Y_s[..., 0, :] / l[:, None]
    return Y_s
