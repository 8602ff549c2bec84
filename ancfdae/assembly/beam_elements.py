"""Elements of one beam of a scene, for section forces and stresses."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar, final

import numpy as np

from ancfdae.assembly.block import unit_vectors
from ancfdae.assembly.layout import BeamLayout
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.errors.checks import named
from ancfdae.model.bodies import BeamBody
from ancfdae.model.elements import Batch
from ancfdae.numerics.arrays import Array

_Law = TypeVar("_Law")


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

    The parameters given, (n_all, 10), are those of all elements of the scene, real or complex.
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
        self.element = body.element
        self.numbers = place.first_element + np.arange(place.element_count)[elements]
        Y_unit = unit_vectors(body)[elements]
        self.batch = Batch(body.element_type(), parameters[self.numbers], Y_unit)
        vectors = named("beam", place.name, numbering.bodies).ends[elements]
        self.coordinates = numbering.coordinates(vectors)
        self._mapping = mapping

    def outline(self, batch: Batch) -> tuple[Array, Array]:
        """Return y and z of outer points of sections, shape (n, n_f) each.

        In the plane the lowest, the highest and the middle, where bending and shear are largest.
        """
        y, z = batch.kind.section.outline(batch.sizes)
        if self.element.d == 2:
            low, high = (y[:, pick(y[0].real)] for pick in (np.argmin, np.argmax))
            y = np.stack([low, (low + high) / 2, high], axis=1)
            z = 0 * y
        return y, z

    def relative(self, X: Array) -> Array:
        """Relative node vectors of node vectors, shape (..., n, n_a, d) to (..., n, n_y, d)."""
        n_s = self.element.n_s
        chord = X[..., n_s : n_s + 1, :] - X[..., :1, :]
        return np.concatenate([chord, X[..., 1:n_s, :], X[..., n_s + 1 :, :]], axis=-2)

    def spread(self, on_Y: Array) -> Array:
        """Return gradients in node vectors from those in relative ones: `relative` transposed."""
        n_s, chord = self.element.n_s, on_Y[..., :1, :]
        return np.concatenate([-chord, on_Y[..., 1:n_s, :], chord, on_Y[..., n_s:, :]], axis=-2)

    def moved(self, law_at: Callable[[Batch], _Law]) -> list[tuple[_Law, Array, Array, Array]]:
        """Return laws at moved parameters, one tuple for each parameter that a variable drives.

        A tuple holds the law, the imaginary step, the pairs of element and design variable that
        drive the parameter, shape (2, n_pairs), and the weight of each pair, shape (n_pairs,).
        """
        mapping, laws = self._mapping, []
        for which in mapping.driven():
            pairs = mapping.pairs(which)
            pairs = pairs[np.isin(mapping.elements[pairs], self.numbers)]
            if len(pairs):
                elements = mapping.elements[pairs] - self.numbers[0]
                targets = np.stack([elements, mapping.variables[pairs]])
                law, step = law_at(self.batch.moved(which)), self.batch.step(which)
                laws.append((law, step, targets, mapping.weights[pairs]))
        return laws
