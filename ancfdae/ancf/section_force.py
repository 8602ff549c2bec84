"""Section forces of beams with their partials."""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.ancf.beam_elements import BeamElements, StatePartials
from ancfdae.elements import ElementParameter
from ancfdae.elements.volume import change
from ancfdae.numerics.arrays import STEP, Array


@final
class SectionForce:
    """One of N, V_y, V_z, T, M_y and M_z, counted from 0, at a place of a beam.

    Parameters
    ----------
    elements : BeamElements
        The one element that the place lies in.
    xi : float
    component : int
    """

    def __init__(self, elements: BeamElements, xi: float, component: int) -> None:
        self._own, self._xi, self._component = elements, xi, component

    def value(self, q: Array, v: Array) -> Array:
        """Return the force or moment, shape (k,)."""
        at = self._own.coordinates
        return self._of(self._own.parameters, q[:, at], v[:, at])

    def partials(self, q: Array, v: Array, n_b: int) -> StatePartials:
        """Return its partials, by complex steps of the coordinates of the element."""
        own, at = self._own, self._own.coordinates
        X, U, b = q[:, at], v[:, at], np.zeros((len(q), n_b))
        # All directions at once, in a leading axis.
        step = 1j * STEP * np.eye(at.size).reshape(at.size, 1, *at.shape)
        on_q = self._of(own.parameters, X + step, U).imag.T / STEP
        on_v = np.zeros_like(on_q)
        if np.any(own.parameters[:, ElementParameter.DAMPING_TIME]):
            on_v = self._of(own.parameters, X, U + step).imag.T / STEP
        still = self._of(own.parameters, X, U)
        for moved, size, (_, variables), weights in own.driven():
            slope = change(self._of(moved, X, U)[None], still[None], size)[0]
            np.add.at(b.T, variables, weights[:, None] * slope)
        return StatePartials(at.ravel(), on_q, on_v, b)

    def _of(self, parameters: Array, X: Array, U: Array) -> Array:
        own = self._own
        states = own.relative(X), own.relative(U)
        forces = own.element.section_forces(own.kind, parameters, own.Y_unit, self._xi, *states)
        return forces[..., 0, self._component]
