"""Von Mises stresses at many points of beams with their partials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.beam_elements import BeamElements, StatePartials
from ancfdae.kernels import strain, stressed
from ancfdae.model.elements import Batch, ElementParameter
from ancfdae.model.elements.packing import packed_gram
from ancfdae.model.elements.stresses import scaled, von_mises_form
from ancfdae.model.elements.volume import change
from ancfdae.numerics.arrays import Array

# Strain that stresses are taken together with, so that their norm has a derivative where they
# vanish: far above the round-off of strains, 1e-16 to 1e-14, and far below what matters.
_SMALL = 1e-9
# Numbers in the arrays of stresses that are held at once.
_TOGETHER = 2_000_000


@final
class StressPoints:
    """Von Mises stresses at fibres and places xi of some elements.

    `places` gives y and z of the fibres, (n, n_f) each, out of the elements, moved or not.
    """

    def __init__(
        self, elements: BeamElements, xi: Array, places: Callable[[Batch], tuple[Array, Array]]
    ) -> None:
        self._own, self._xi, self._places = elements, xi, places
        self._law = self._law_at(elements.batch)

    def value(self, q: Array, v: Array) -> Array:
        """Return the stresses, shape (k, n, n_p)."""
        return np.concatenate(
            [self._law.von_mises(*self._relative(q[k], v[k])) for k in self._parts(len(q))]
        )

    def partials(self, q: Array, v: Array, weights: Array, n_b: int) -> StatePartials:
        """Return the partials of the stresses, times weights (k, n, n_p) and added up."""
        parts = [self._partials(q[k], v[k], weights[k], n_b) for k in self._parts(len(q))]
        rows = (np.concatenate(part) for part in zip(*parts, strict=True))
        return StatePartials(np.unique(self._own.coordinates), *rows)

    def _partials(self, q: Array, v: Array, weights: Array, n_b: int) -> tuple[Array, Array, Array]:
        own, b = self._own, np.zeros((len(q), n_b))
        Y, V = self._relative(q, v)
        still = self._law.von_mises(Y, V)
        for law, size, (elements, variables), factors in self._moved:
            stresses = law.von_mises(Y, V)
            slope = change(stresses.swapaxes(0, 1), still.swapaxes(0, 1), size)
            per_element = np.einsum("knp,nkp->nk", weights, slope)
            np.add.at(b.T, variables, factors[:, None] * per_element[elements])
        # The elements of a beam share the columns between their first and last one.
        at, rows = own.coordinates - np.min(own.coordinates), []
        for on_Y in self._law.pulled_back(Y, V, weights / still):
            total = np.zeros((len(q), int(np.max(at)) + 1))
            np.add.at(total.T, at.ravel(), own.spread(on_Y).reshape(len(q), -1).T)
            rows.append(total)
        return rows[0], rows[1], b

    @cached_property
    def _moved(self) -> list[tuple[_Law, Array, Array, Array]]:
        return self._own.moved(self._law_at)

    def _relative(self, q: Array, v: Array) -> tuple[Array, Array]:
        at = self._own.coordinates
        return self._own.relative(q[:, at]), self._own.relative(v[:, at])

    def _parts(self, count: int) -> list[slice]:
        """Split instants, so that arrays of stresses stay small."""
        together = max(1, _TOGETHER // self._law.D[..., 0].size)
        return [slice(first, first + together) for first in range(0, count, together)]

    def _law_at(self, own: Batch) -> _Law:
        D = self._own.element.stress_map(own, self._xi, self._places(own))
        n, n_f, n_xi, n_v, n_g = D.shape
        E, nu = own.moduli
        Q = von_mises_form(own.d, own.energy.stress_across(own.d, nu))
        return _Law(D.reshape(n, n_f * n_xi, n_v, n_g), Q, _SMALL * E, own)


@final
@dataclass(frozen=True)
class _Law:
    """What turns relative node vectors into von Mises stresses: sqrt(S^T Q S + small^2), S = D x.

    Shapes: D (n, n_p, n_v, n_g), Q (n, n_v, n_v), small (n,).
    """

    D: Array
    Q: Array
    small: Array
    own: Batch

    def von_mises(self, Y: Array, V: Array) -> Array:
        """Return the stresses, shape (k, n, n_p)."""
        S = self._stresses(Y, V)
        squares = np.sum(S * self._weighted(S), axis=-1)
        return np.asarray(np.sqrt(squares + self.small[:, None] ** 2))

    def pulled_back(self, Y: Array, V: Array, weights: Array) -> tuple[Array, Array]:
        """Return the sum of weights times Q S S_Y, and of that times S_V, shaped as Y and V."""
        QS = weights[..., None] * self._weighted(self._stresses(Y, V))
        n, n_p, n_v, n_g = self.D.shape
        flat = QS.swapaxes(0, 1).reshape(n, len(QS), n_p * n_v)
        p = (flat @ self.D.reshape(n, n_p * n_v, n_g)).swapaxes(0, 1)
        tau = self._tau[:, None, None]
        Y, V = scaled(Y, self._l), scaled(V, self._l)
        on_Y, on_V = stressed(p, Y), tau * stressed(p, Y)
        return scaled(on_Y + tau * stressed(p, V), self._l), scaled(on_V, self._l)

    @property
    def _l(self) -> Array:
        return self.own.lengths

    @property
    def _tau(self) -> Array:
        return self.own.of(ElementParameter.DAMPING_TIME)

    def _stresses(self, Y: Array, V: Array) -> Array:
        """S, shape (k, n, n_p, n_v)."""
        g_o = packed_gram(self.own.Y_unit)
        x = strain(g_o, scaled(Y, self._l), scaled(V, self._l), self._tau)
        n, n_p, n_v, n_g = self.D.shape
        S = x.swapaxes(0, 1) @ self.D.reshape(n, n_p * n_v, n_g).swapaxes(1, 2)
        return S.swapaxes(0, 1).reshape(len(x), n, n_p, n_v)

    def _weighted(self, S: Array) -> Array:
        """Q S."""
        product: Array = S @ self.Q
        return product
