"""What a load states: forces on vectors of points as functions of these vectors.

A load names vectors U_i of material points and gives the generalised force F_i
that works on each, delta W = sum_i F_i . delta U_i, and its rate along the
motion. The assembler lifts it to Q = L^T F and forms tangents and design
derivatives from the complex-safe `force` (docs/theory.md, section 3).
"""

from __future__ import annotations

import abc
from collections.abc import Collection
from typing import ClassVar

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.parts import Part


class Load(Part):
    """A load on points of beams; fields and names as in `Part`.

    Arrays have any leading axes (instants, perturbations) before (n_vectors, d); complex
    numbers must go through.

    Attributes
    ----------
    constant : bool
        Whether the force depends neither on positions nor on velocities.
    elastic : bool
        Whether it is a stiffness rather than a load: a search for an equilibrium, which brings up
        the loads, leaves it as it is.
    damping_fields : tuple of str
        Numbers among the design fields without which the force does not depend on velocities.
    """

    role = "load"
    constant: ClassVar[bool] = False
    elastic: ClassVar[bool] = False
    damping_fields: ClassVar[tuple[str, ...]] = ()

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Whether the force depends on velocities, given the parameters that are design targets."""
        return any(name in driven or getattr(self, name) != 0 for name in self.damping_fields)

    @abc.abstractmethod
    def force(self, U: Array, V: Array, p: Array) -> Array:
        """Return the generalised forces on the vectors.

        Parameters
        ----------
        U, V : array, shape (..., n_vectors, d)
            The vectors and their time derivatives.
        p : array, shape (n_p,)
            Values of `parameters`, as `split` takes them.

        Returns
        -------
        array, shape (..., n_vectors, d)
        """

    @abc.abstractmethod
    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """Return d(force)/dt along a motion with second derivatives Z; shape as `force`."""


class ConstantLoad(Load):
    """A load of constant force on one vector, its only design field."""

    constant = True

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """F = p."""
        return np.broadcast_to(p, np.broadcast_shapes(U.shape, p.shape))

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """Zero."""
        return np.zeros_like(U)
