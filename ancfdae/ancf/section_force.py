"""Section forces of beams with their partials."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np

from ancfdae.ancf.beam_elements import BeamElements, StatePartials
from ancfdae.elements import Batch, ElementParameter
from ancfdae.elements.element import SectionLaw
from ancfdae.elements.volume import change
from ancfdae.numerics.arrays import STEP, Array


@final
class SectionForces:
    """N, V_y, V_z, T, M_y and M_z, counted from 0, at a place xi of one element."""

    def __init__(self, elements: BeamElements, xi: float) -> None:
        self._own, self._xi = elements, xi
        self._law = self._law_at(elements.batch)

    def value(self, component: int, q: Array, v: Array) -> Array:
        """Return a force or moment, shape (k,)."""
        at = self._own.coordinates
        return self._of(self._law, q[:, at], v[:, at])[..., component]

    def partials(self, component: int, q: Array, v: Array, n_b: int) -> StatePartials:
        """Return its partials, by complex steps of the coordinates of the element."""
        own, at = self._own, self._own.coordinates
        X, U, b = q[:, at], v[:, at], np.zeros((len(q), n_b))
        # All directions at once, in a leading axis.
        step = 1j * STEP * np.eye(at.size).reshape(at.size, 1, *at.shape)
        on_q = self._of(self._law, X + step, U)[..., component].imag.T / STEP
        on_v = np.zeros_like(on_q)
        if np.any(own.batch.of(ElementParameter.DAMPING_TIME)):
            on_v = self._of(self._law, X, U + step)[..., component].imag.T / STEP
        still = self._of(self._law, X, U)[..., component]
        for law, size, (_, variables), weights in self._moved:
            slope = change(self._of(law, X, U)[None, ..., component], still[None], size)[0]
            np.add.at(b.T, variables, weights[:, None] * slope)
        return StatePartials(at.ravel(), on_q, on_v, b)

    @cached_property
    def _moved(self) -> list[tuple[SectionLaw, Array, Array, Array]]:
        return self._own.moved(self._law_at)

    def _law_at(self, batch: Batch) -> SectionLaw:
        return self._own.element.section_law(batch, self._xi)

    def _of(self, law: SectionLaw, X: Array, U: Array) -> Array:
        """All forces, shape (..., 6)."""
        own = self._own
        forces: Array = law.forces(own.relative(X), own.relative(U))[..., 0, :]
        return forces
