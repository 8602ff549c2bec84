"""Section forces of beams with their partials."""

from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.beam_elements import BeamElements, StatePartials
from ancfdae.model.elements import Batch, ElementParameter
from ancfdae.model.elements.element import SectionLaw, SectionPlace
from ancfdae.model.elements.volume import change
from ancfdae.numerics.arrays import STEP, Array


@final
class SectionForces:
    """N, V_y, V_z, T, M_y and M_z, counted from 0, at a place in a run of elements of one beam."""

    def __init__(self, elements: BeamElements, place: SectionPlace) -> None:
        self._elements, self._place = elements, place
        self._law = self._law_at(elements.batch)

    def value(self, component: int, q: Array, v: Array) -> Array:
        """Return a force or moment, shape (k,)."""
        return self.values(q, v)[..., component]

    def values(self, q: Array, v: Array) -> Array:
        """Return all of them, shape (k, 6)."""
        at = self._elements.coordinates
        return self._of(self._law, q[:, at], v[:, at])

    def partials(self, component: int, q: Array, v: Array, n_b: int) -> StatePartials:
        """Return its partials, by complex steps of the coordinates of the elements."""
        elements, at = self._elements, self._elements.coordinates
        X, U, b = q[:, at], v[:, at], np.zeros((len(q), n_b))
        columns = np.unique(at)
        # All directions at once, in a leading axis.
        step = 1j * STEP * (columns[:, None, None, None] == at)[:, None]
        on_q = self._of(self._law, X + step, U)[..., component].imag.T / STEP
        on_v = np.zeros_like(on_q)
        if np.any(elements.batch.of(ElementParameter.DAMPING_TIME)):
            on_v = self._of(self._law, X, U + step)[..., component].imag.T / STEP
        still = self._of(self._law, X, U)[..., component]
        for law, size, variables, weights in self._moved:
            slope = change(self._of(law, X, U)[None, ..., component], still[None], size)[0]
            np.add.at(b.T, variables, weights[:, None] * slope)
        return StatePartials(columns, on_q, on_v, b)

    @cached_property
    def _moved(self) -> list[tuple[SectionLaw, Array, Array, Array]]:
        """Laws with a parameter of one element moved, the imaginary step, and who drives it."""
        batch, laws = self._elements.batch, []
        for moved, size, (elements, variables), weights in self._elements.moved(
            lambda batch: batch
        ):
            for k in np.unique(elements):
                parameters = batch.parameters.astype(complex)
                parameters[k] = moved.parameters[k]
                law, its = self._law_at(replace(batch, parameters=parameters)), elements == k
                laws.append((law, size[k : k + 1], variables[its], weights[its]))
        return laws

    def _law_at(self, batch: Batch) -> SectionLaw:
        return self._elements.element.section_law(batch, self._place)

    def _of(self, law: SectionLaw, X: Array, U: Array) -> Array:
        """All forces, shape (..., 6)."""
        elements = self._elements
        return law.forces(elements.relative(X), elements.relative(U))
