"""What a joint states: scalar equations between position and slope vectors of points.

A joint never touches coordinates. It names the vectors U_i of material points
that take part and gives the coefficients of its equations,

    Phi_r = sum_i linear_ri . U_i + 1/2 sum_ij bilinear_rij U_i . U_j - offset_r = 0.

The assembler turns the coefficients of all joints at once into constraints,
Jacobians, (Phi_q^T lam)_q, the right sides of the velocity, acceleration and
jerk equations, and all design derivatives.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity
from ancfdae.design import Parametrised
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Coefficients:
    """Coefficients of a joint's equations, or one of their time derivatives.

    Attributes
    ----------
    linear : array, shape (n_rows, n_vectors, d)
    bilinear : array, shape (n_rows, n_vectors, n_vectors)
        Symmetric in the vectors.
    offset : array, shape (n_rows,)
    """

    linear: Array
    bilinear: Array
    offset: Array


class Joint(Parametrised):
    """A joint between points of beams or to ground.

    Attributes
    ----------
    name : str
        Unique in a scene; reactions are asked for by it.
    driven : bool
        Whether the coefficients depend on time. Bilinear ones never do.
    holds_position : bool
        Whether the first d equations equate positions: their multipliers are then minus the
        reaction force on the first point.
    """

    driven: bool = False
    holds_position: bool = False

    @property
    @abc.abstractmethod
    def points(self) -> tuple[Point, ...]:
        """The points that the joint touches, the one that reactions act on first."""

    @abc.abstractmethod
    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Return the point vectors that take part in space of dimension d."""

    @abc.abstractmethod
    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """Return the time derivative of this order of the coefficients.

        Parameters
        ----------
        p : array
            Values of `parameters`, in their order; may be complex, and must go through.
        reference : array, shape (n_vectors, d)
            The vectors in the reference configuration; may be complex.
        t : float
        order : int
            0 to 3; above 0 only asked of driven joints.
        """


def empty_coefficients(rows: int, vectors: int, d: int, dtype: np.dtype) -> Coefficients:
    """Return coefficients of zeros, to be filled by a joint."""
    return Coefficients(
        np.zeros((rows, vectors, d), dtype=dtype),
        np.zeros((rows, vectors, vectors), dtype=dtype),
        np.zeros(rows, dtype=dtype),
    )


def place_coincidence(c: Coefficients, count: int, ground: Array) -> None:
    """Enter d first equations, U_0 - U_1 = 0 for two points, U_0 - ground = 0 for one."""
    d = c.linear.shape[2]
    rows = np.arange(d)
    c.linear[rows, 0, rows] = 1.0
    if count == 2:
        c.linear[rows, 1, rows] = -1.0
    else:
        c.offset[:d] = ground
