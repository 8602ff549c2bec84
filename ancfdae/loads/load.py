"""What a load states: forces on vectors of points as functions of these vectors.

A load names vectors U_i of material points and gives the generalised force F_i
that works on each, delta W = sum_i F_i . delta U_i, and its rate along the
motion. The assembler lifts it to Q = L^T F and forms tangents and design
derivatives from the complex-safe `force` (docs/theory.md, section 3).
"""

from __future__ import annotations

import abc
from collections.abc import Collection
from dataclasses import dataclass
from typing import final

from ancfdae.bodies import Point, Quantity
from ancfdae.design import Parametrised
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class CentreLine:
    """The integral of the position along the centre line of a beam, as a vector for loads.

    Parameters
    ----------
    beam : str
    """

    beam: str


class Load(Parametrised):
    """A load on points of beams.

    Arrays have any leading axes (instants, perturbations) before (n_vectors, d); complex
    numbers must go through.

    Attributes
    ----------
    name : str
        Unique in a scene.
    constant : bool
        Whether the force depends neither on positions nor on velocities.
    """

    constant: bool = False

    @abc.abstractmethod
    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Whether the force depends on velocities, given the parameters that are design targets."""

    @abc.abstractmethod
    def vectors(self) -> tuple[tuple[Point, Quantity] | CentreLine, ...]:
        """Return the vectors that the load depends on or works on."""

    @abc.abstractmethod
    def force(self, U: Array, V: Array, p: Array) -> Array:
        """Return the generalised forces on the vectors.

        Parameters
        ----------
        U, V : array, shape (..., n_vectors, d)
            The vectors and their time derivatives.
        p : array, shape (n_p,)
            Values of `parameters`, in their order.

        Returns
        -------
        array, shape (..., n_vectors, d)
        """

    @abc.abstractmethod
    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """Return d(force)/dt along a motion with second derivatives Z; shape as `force`."""
