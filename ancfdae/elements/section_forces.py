"""Section forces of continuum beams: what their elements transmit from node to node.

With Q = dU/dY, damping included, the forces of an element on its relative node vectors: the chord's
is what the element transmits between the positions of its nodes, and what the slopes r_y, r_z of
each end have, M_k = sum_i r_i x Q_i there, is what it transmits between their turns. Both are
in balance with the rest of the model to round-off, since they are its very equations: work
conjugate to the energy whatever it is made of. Along the element n is taken linear,

    n = Q_c/l + (xi - 1/2) n',     n' = 6 (Q_x2 - Q_x1)/l,

with Q_x of the axial slopes: their weights in dr/dx have the moments -1/12 and 1/12 about the
middle, that of the chord none. The moment is that of n beyond, from either end,

    m = (1 - xi) (-M_1 - int_0^xi r_x x n l dxi) + xi (M_2 + int_xi^1 r_x x n l dxi).

For loads at nodes this is exact, for forces (and inertia) spread along an element the error is of
second order, none for uniform ones in a straight element (docs/theory.md, section 2).
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.elements.element import Batch, ElementParameter, SectionLaw
from ancfdae.elements.hermite import end_weight_xi, slope_weights_xi
from ancfdae.elements.packing import packed_gram
from ancfdae.elements.stresses import scaled
from ancfdae.kernels import strain, stressed
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule


@final
class ContinuumSectionLaw(SectionLaw):
    """Forces in the sections at xi of n elements with the invariants A of scaled vectors."""

    def __init__(self, own: Batch, A: Array, xi: float) -> None:
        self._l, self._tau = own.lengths, own.of(ElementParameter.DAMPING_TIME)
        self._g_o, self._A, self._xi, self._d = packed_gram(own.Y_unit), A, xi, own.d
        whole, part = _arms(1.0), _arms(xi)
        self._arms = part - xi * whole

    def forces(self, Y: Array, V: Array) -> Array:
        """Return what the nodes get, carried to xi by statics."""
        Y, V = np.broadcast_arrays(scaled(Y, self._l), scaled(V, self._l))
        d, xi, l = self._d, self._xi, self._l[:, None]
        x = strain(self._g_o, Y, V, self._tau)
        Q = stressed(np.einsum("nij,...nj->...ni", self._A, x), Y)
        Y, Q = (_in_space(each) for each in (Y, Q))
        # The chord, and of each end the axial slope and those of the section.
        axis, ends = [0, 1, 1 + d], (slice(2, 1 + d), slice(2 + d, 1 + 2 * d))
        turns = [np.sum(np.cross(Y[..., end, :], Q[..., end, :]), axis=-2) for end in ends]
        middle, slope = Q[..., 0, :] / l, 6 * (Q[..., 1 + d, :] - Q[..., 1, :]) / l
        moment = xi * turns[1] - (1 - xi) * turns[0]
        for arm, force in zip(self._arms, (middle, slope), strict=True):
            moment = moment - l * np.cross(np.einsum("a,...ad->...d", arm, Y[..., axis, :]), force)
        axes = _axes((1 - xi) * Y[..., ends[0], :] + xi * Y[..., ends[1], :])
        vectors = np.stack([middle + (xi - 0.5) * slope, moment], axis=-2)
        parts: Array = np.einsum("...ij,...kj->...ki", axes, vectors)
        return parts.reshape(*parts.shape[:-2], 6)


def _arms(xi: float) -> Array:
    """Integrals from 0 to xi of the weights of dr/dx, and of these times xi - 1/2, (2, 3)."""
    corner, rule = box_rule((3,))
    places, rule = xi * corner[:, 0], xi * rule
    weights = np.stack([end_weight_xi(places), *slope_weights_xi(places)], axis=-1)
    return np.stack([rule @ weights, (rule * (places - 0.5)) @ weights])


def _in_space(vectors: Array) -> Array:
    """Give vectors of the plane a third component, zero."""
    missing = np.zeros((*vectors.shape[:-1], 3 - vectors.shape[-1]), dtype=vectors.dtype)
    return np.concatenate([vectors, missing], axis=-1)


def _axes(slopes: Array) -> Array:
    """Rows: normal, r_y over its length, what is across both; out of the slopes (..., d - 1, 3)."""
    y = slopes[..., 0, :]
    normal = np.cross(y, slopes[..., 1, :] if slopes.shape[-2] == 2 else np.eye(3)[2])
    y, normal = (v / np.sqrt(np.sum(v * v, axis=-1, keepdims=True)) for v in (y, normal))
    return np.stack([normal, y, np.cross(normal, y)], axis=-2)
