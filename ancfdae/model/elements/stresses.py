"""Stresses of continuum beams.

They are the second Piola-Kirchhoff ones of the law, S = C (E + tau E'), in the axes of the
reference section, as a linear map of the Gram matrix like the strains (`strain_fields`).
"""

from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.kernels import strain, stressed
from ancfdae.model.elements.element import Batch, ElementParameter, StressLaw
from ancfdae.model.elements.fibre_strains import Fibres
from ancfdae.model.elements.strain_fields import components, packed_gram
from ancfdae.model.elements.volume import AXIS_POINTS, Region, fibres, gauss_rule
from ancfdae.numerics.arrays import Array

_AXIS_PLACES, _ = gauss_rule(AXIS_POINTS)
#: Strain that stresses are taken together with, so that their norm has a derivative where they
#: vanish: far above the round-off of strains, 1e-16 to 1e-14, and far below what matters.
SMALL_STRAIN = 1e-9


@final
class ContinuumStressLaw(StressLaw):
    """sqrt(S^T Q S + small^2), S = D x with the strains x of the law.

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
        """Return the stresses, shape (k, n, n_f n_xi)."""
        S = self._stresses(Y, V)
        squares = np.sum(S * (S @ self._Q), axis=-1)
        return np.asarray(np.sqrt(squares + self._small[:, None] ** 2))

    def pulled_back(self, Y: Array, V: Array, weights: Array) -> tuple[Array, Array]:
        """Return the sum of weights times Q S S_Y, and of that times S_V, shaped as Y and V."""
        QS = weights[..., None] * (self._stresses(Y, V) @ self._Q)
        flat = QS.swapaxes(0, 1).reshape(len(self._D), len(QS), -1)
        p = (flat @ self._D).swapaxes(0, 1)
        tau = self._tau[:, None, None]
        Y, V = scaled(Y, self._l), scaled(V, self._l)
        on_Y, on_V = stressed(p, Y), tau * stressed(p, Y)
        return scaled(on_Y + tau * stressed(p, V), self._l), scaled(on_V, self._l)

    def _stresses(self, Y: Array, V: Array) -> Array:
        """S, shape (k, n, n_p, n_v)."""
        x = strain(self._g_o, scaled(Y, self._l), scaled(V, self._l), self._tau)
        S = x.swapaxes(0, 1) @ self._D.swapaxes(1, 2)
        return S.swapaxes(0, 1).reshape(len(x), len(self._D), *self._shape)


def _spread_stresses(batch: Batch, xi: Array, places: tuple[Array, Array]) -> Array:
    """Return stresses at y and z of sections, (n, n_f) each, as maps of the strains of the law.

    Shears of torsion are in balance with the torque of the law and spread as the section knows
    them. Where properties of the section count, the mean shears of V_y and V_z and the mean
    thickness stresses, radial ones in curved beams, spread by its shares.
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
    """Return stresses at fibres; `twist` as in `Frames.strains`."""
    volume, *rest = batch.stiffness
    owners, n_v = np.full(len(batch.parameters), "stress"), len(components(batch.d))

    def stresses(C: Array, at: Fibres, xi: Array, twist: Array | None) -> Array:
        region = Region(batch, at, (xi, np.ones(len(xi))), owners)
        eps = region.true_strains(twist)[..., :n_v, :] @ region.beta[:, None]
        return np.asarray((C[:, None, None] @ eps).swapaxes(1, 2))

    D = stresses(volume, at, xi, twist)
    for C in rest:
        # The law asks for it at these points only: linear between and beyond them.
        first, second = np.split(stresses(C, at.axis(), _AXIS_PLACES, None), AXIS_POINTS, axis=2)
        share = (xi - _AXIS_PLACES[0]) / (_AXIS_PLACES[1] - _AXIS_PLACES[0])
        share = share[:, None, None]
        D = D + first * (1 - share) + second * share
    return D


def _von_mises_form(d: int, across: Array) -> Array:
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
