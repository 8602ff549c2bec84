"""Forces in sections of beams, and von Mises stresses at many points, with their partials."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.beam_elements import BeamElements, StatePartials
from ancfdae.model.elements import Batch, ElementParameter
from ancfdae.model.elements.element import SectionLaw, SectionPlace, StressLaw
from ancfdae.model.elements.strains import change
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
        """Return the partials of a component, by complex steps of the elements' coordinates."""
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
        """Return the six components of forces and moments in sections, shape (..., 6)."""
        elements = self._elements
        return law.forces(elements.relative(X), elements.relative(U))


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
