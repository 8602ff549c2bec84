"""Section forces of continuum beams: what their elements transmit from node to node.

With Q = dU/dY, damping included, the forces of an element on its relative node vectors: that of the
chord is what the element transmits between the positions of its nodes, the turn M = sum_s r_s x Q_s
of the slopes of its second node what it transmits there. Both are in balance with the rest of the
model to round-off, since they are its very equations: work conjugate to the energy whatever it is
made of. The force of the chord is the mean of the section force,

    n = Q_c/l + (xi - 1/2) n',     n' = n_2 - n_1,

and its slope that of its values n_k at the nodes. Where nothing acts, that is the mean with the
element beyond, or zero at the end of a beam; where something acts, n jumps, and the slope is that
of the other half of the element. The moment follows,

    m = M - (l/12) r_x2 x n' + int_xi^1 r_x x n l dxi,

since loads spread along the element have a share l n'/12 in Q_x2 that is no moment of the section.
For loads at nodes this is exact; for spread ones, inertia among them, the error is of second order
in the length (docs/theory/02-strain-energy.md).
"""

from typing import final

import numpy as np

from ancfdae.kernels import strain, stressed
from ancfdae.model.elements.element import Batch, ElementParameter, SectionLaw, SectionPlace
from ancfdae.model.elements.hermite import tangent_weights
from ancfdae.model.elements.strain_fields import packed_gram
from ancfdae.model.elements.stresses import scaled
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule
from ancfdae.numerics.rotations import in_space


@final
class ContinuumSectionLaw(SectionLaw):
    """Forces in a section of a run of elements with the invariants A of scaled vectors."""

    def __init__(self, run: Batch, A: Array, place: SectionPlace) -> None:
        self._l, self._tau = run.lengths, run.of(ElementParameter.DAMPING_TIME)
        self._g_o, self._A, self._d, self._place = packed_gram(run.Y_free), A, run.d, place
        self._arms = _arms(1.0) - _arms(place.xi) - np.outer([0, 1 / 12], [0, 0, 1])
        self._slope = slope_of_means(self._l, place)

    def forces(self, Y: Array, V: Array) -> Array:
        """Return section forces and moments from the forces on nodes, by statics."""
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
    """Weights of the means of the elements of a run in the slope n_2 - n_1, shape (n,)."""
    k, weights = place.element, np.zeros(len(l), dtype=l.dtype)
    smooth = [side for side in (-1, 1) if place.smooth[max(side, 0)]]
    for side in smooth:
        # n_k less the mean of the element, of which that is half the slope.
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
    """Integrals from 0 to xi of the weights of dr/dx, and of these times xi - 1/2, (2, 3)."""
    corner, rule = box_rule((3,))
    places, rule = xi * corner[:, 0], xi * rule
    weights = tangent_weights(places)
    return np.stack([rule @ weights, (rule * (places - 0.5)) @ weights])


def _axes(slopes: Array) -> Array:
    """Rows: normal, r_y over its length, what is across both; out of the slopes (..., d - 1, 3)."""
    y = slopes[..., 0, :]
    normal = np.cross(y, slopes[..., 1, :] if slopes.shape[-2] == 2 else np.eye(3)[2])
    y, normal = (v / np.sqrt(np.sum(v * v, axis=-1, keepdims=True)) for v in (y, normal))
    return np.stack([normal, y, np.cross(normal, y)], axis=-2)
