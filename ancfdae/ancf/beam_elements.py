"""Elements of one beam of a scene, for what is asked of its sections."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.ancf.block import unit_vectors
from ancfdae.ancf.numbering import Numbering
from ancfdae.ancf.parameters import ParameterMap
from ancfdae.bodies import BeamBody
from ancfdae.elements.volume import shifted, step_of
from ancfdae.naming import BeamLayout
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class StatePartials:
    """Partials of one number per instant in the coordinates and velocities of m columns.

    q and v have the shape (k, m), b has (k, n_b).
    """

    columns: Array
    q: Array
    v: Array
    b: Array


@final
class BeamElements:
    """Some elements of one beam, counted from its start: their numbers, parameters, coordinates.

    The parameters given, (n_all, 9), are those of all elements of the scene, real or complex.
    """

    def __init__(
        self,
        body: BeamBody,
        place: BeamLayout,
        numbering: Numbering,
        mapping: ParameterMap,
        parameters: Array,
        elements: slice,
    ) -> None:
        self.element, self.kind = body.element, body.element_type()
        self.numbers = place.first_element + np.arange(place.element_count)[elements]
        self.parameters = parameters[self.numbers]
        self.Y_unit = unit_vectors(body)[elements]
        own = np.searchsorted(numbering.elements, self.numbers)
        self.coordinates = numbering.coordinates(numbering.vectors[own])
        self._mapping = mapping

    def outline(self, parameters: Array) -> tuple[Array, Array]:
        """Return y and z of outer points of sections of these parameters, shape (n, n_f) each.

        In the plane the lowest and the highest only.
        """
        y, z = self.kind.section.outline(self.kind.sizes(parameters))
        if self.element.d == 2:
            ends = [int(np.argmin(y[0].real)), int(np.argmax(y[0].real))]
            y, z = y[:, ends], z[:, ends]
        return y, z

    def relative(self, X: Array) -> Array:
        """Relative node vectors of node vectors, shape (..., n, n_a, d) to (..., n, n_y, d)."""
        n_s = self.element.n_s
        chord = X[..., n_s : n_s + 1, :] - X[..., :1, :]
        return np.concatenate([chord, X[..., 1:n_s, :], X[..., n_s + 1 :, :]], axis=-2)

    def spread(self, on_Y: Array) -> Array:
        """Return the transpose of `relative`."""
        n_s, chord = self.element.n_s, on_Y[..., :1, :]
        return np.concatenate([-chord, on_Y[..., 1:n_s, :], chord, on_Y[..., n_s:, :]], axis=-2)

    def driven(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Yield parameters moved by an imaginary step, the step, and who drives them.

        The latter as pairs of element and design variable, shape (2, n_pairs), with their weights.
        """
        mapping = self._mapping
        for which in mapping.driven():
            pairs = mapping.pairs(which)
            pairs = pairs[np.isin(mapping.elements[pairs], self.numbers)]
            if len(pairs):
                targets = np.stack(
                    [mapping.elements[pairs] - self.numbers[0], mapping.variables[pairs]]
                )
                moved = shifted(self.parameters, which)
                yield moved, step_of(self.parameters, which), targets, mapping.weights[pairs]
