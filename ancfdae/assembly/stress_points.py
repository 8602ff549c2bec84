"""Von Mises stresses at many points of beams with their partials."""

from collections.abc import Callable
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.beam_elements import BeamElements, StatePartials
from ancfdae.model.elements import Batch
from ancfdae.model.elements.element import StressLaw
from ancfdae.model.elements.volume import change
from ancfdae.numerics.arrays import Array

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
        self._elements, self._xi, self._places = elements, xi, places
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
        # Columns of other parts may lie between, where these have zeros.
        at = self._elements.coordinates
        return StatePartials(np.arange(np.min(at), np.max(at) + 1), *rows)

    def _partials(self, q: Array, v: Array, weights: Array, n_b: int) -> tuple[Array, Array, Array]:
        beam, b = self._elements, np.zeros((len(q), n_b))
        Y, V = self._relative(q, v)
        still = self._law.von_mises(Y, V)
        for law, size, (elements, variables), factors in self._moved:
            stresses = law.von_mises(Y, V)
            slope = change(stresses.swapaxes(0, 1), still.swapaxes(0, 1), size)
            per_element = np.einsum("knp,nkp->nk", weights, slope)
            np.add.at(b.T, variables, factors[:, None] * per_element[elements])
        # The elements of a beam share the columns between their first and last one.
        at, rows = beam.coordinates - np.min(beam.coordinates), []
        for on_Y in self._law.pulled_back(Y, V, weights / still):
            total = np.zeros((len(q), int(np.max(at)) + 1))
            np.add.at(total.T, at.ravel(), beam.spread(on_Y).reshape(len(q), -1).T)
            rows.append(total)
        return rows[0], rows[1], b

    @cached_property
    def _moved(self) -> list[tuple[StressLaw, Array, Array, Array]]:
        return self._elements.moved(self._law_at)

    def _relative(self, q: Array, v: Array) -> tuple[Array, Array]:
        at = self._elements.coordinates
        return self._elements.relative(q[:, at]), self._elements.relative(v[:, at])

    def _parts(self, count: int) -> list[slice]:
        """Split instants, so that arrays of stresses stay small."""
        together = max(1, _TOGETHER // self._law.count)
        return [slice(first, first + together) for first in range(0, count, together)]

    def _law_at(self, batch: Batch) -> StressLaw:
        return self._elements.element.stress_law(batch, self._xi, self._places(batch))
