"""Stresses of continuum beams.

They are the second Piola-Kirchhoff ones of the law, S = C (E + tau E'), in the axes of the
reference section, as a linear map of the Gram matrix like the strains (`strain_fields`).
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.elements.element import Batch
from ancfdae.elements.fibre_strains import Fibres
from ancfdae.elements.strain_fields import components
from ancfdae.elements.volume import AXIS_POINTS, Region, gauss_rule
from ancfdae.numerics.arrays import Array

_AXIS_PLACES, _ = gauss_rule(AXIS_POINTS)


@final
class StressMap:
    """Stresses at fibres and places of elements, linear in the strains of the law.

    Attributes
    ----------
    D : array, shape (n, n_f, n_xi, n_v, n_g)
        Stresses in the strains of the law, of vectors as `scaled` returns them.
    """

    def __init__(self, own: Batch, xi: Array, at: Fibres) -> None:
        volume, *rest = own.stiffness
        owners, n_v = np.full(len(own.parameters), "stress"), len(components(own.d))

        def stresses(C: Array, at: Fibres, xi: Array) -> Array:
            region = Region(own, at, (xi, np.ones(len(xi))), owners)
            eps = region.true_strains()[..., :n_v, :] @ region.beta[:, None]
            return np.asarray((C[:, None, None] @ eps).swapaxes(1, 2))

        self.D: Array = stresses(volume, at, xi)
        for C in rest:
            self.D = self.D + _between(stresses(C, at.axis(), _AXIS_PLACES), xi, 2)


def _between(values: Array, xi: Array, axis: int) -> Array:
    """Values at xi of what is asked for on the axis only: linear between its places and beyond."""
    first, second = np.split(values, AXIS_POINTS, axis=axis)
    share = (xi - _AXIS_PLACES[0]) / (_AXIS_PLACES[1] - _AXIS_PLACES[0])
    share = share.reshape(-1, *[1] * (values.ndim - 1 - axis))
    return np.asarray(first * (1 - share) + second * share)


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
