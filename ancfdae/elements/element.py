"""What an element has to state so that everything else can be built from it.

An element of node vectors X (n_a x d: position and slopes of both nodes)
declares its shape functions, r = sum_a s_a X_a, and the position gradient in
terms of the *relative* node vectors

    Y = [r_2 - r_1, slopes of node 1, slopes of node 2]     (n_y x d),
    dr/dx_alpha = sum_y N_{y alpha} Y_y,

with the partial derivatives of both in height, width and length. Invariants,
forces, tangents and all their design derivatives follow from these facts.
"""

from __future__ import annotations

import abc
from enum import IntEnum

from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import Array


class Quantity(IntEnum):
    """A vector of a material point; slopes are derivatives along the section's axes."""

    POSITION = 0
    SLOPE_X = 1
    SLOPE_Y = 2
    SLOPE_Z = 3


class ElementParameter(IntEnum):
    """Column of each design parameter in a block's parameter array, shape (n, 7)."""

    YOUNGS_MODULUS = 0
    POISSON_RATIO = 1
    DENSITY = 2
    HEIGHT = 3
    WIDTH = 4
    LENGTH = 5
    DAMPING_TIME = 6


#: Parameters that shape functions depend on.
GEOMETRIC = (ElementParameter.HEIGHT, ElementParameter.WIDTH, ElementParameter.LENGTH)


class BeamElement(abc.ABC):
    """Facts about a two-node ANCF beam element.

    Implementations are stateless; arrays are batched over elements (leading
    axis n) and over points (axis n_p) and keep the dtype of their input, so
    that complex perturbations of coordinates and parameters pass through.

    Attributes
    ----------
    d : int
        Dimension of space.
    quantities : tuple of Quantity
        What the vectors of a node are: position and slopes.
    n_s : int
        Node vectors per node.
    n_a : int
        Node vectors per element, 2 n_s.
    n_y : int
        Relative node vectors per element, n_a - 1.
    voigt : tuple of (int, int)
        Index pairs of the strain components, normal components first.
    """

    d: int
    quantities: tuple[Quantity, ...]
    voigt: tuple[tuple[int, int], ...]

    @property
    def n_s(self) -> int:
        """Node vectors per node."""
        return len(self.quantities)

    @property
    def n_a(self) -> int:
        """Node vectors per element."""
        return 2 * self.n_s

    @property
    def n_y(self) -> int:
        """Relative node vectors per element."""
        return self.n_a - 1

    def require(self, where: str, quantity: Quantity) -> None:
        """Refuse a vector that a point of this element does not have.

        Raises
        ------
        InvalidInput
        """
        if quantity not in self.quantities:
            raise InvalidInput(
                where,
                f"the element must have the vector {quantity.name}",
                f"an element of {', '.join(own.name for own in self.quantities)}",
                "Choose another element for the beam, or another part.",
            )

    @abc.abstractmethod
    def shape(self, points: Array, parameters: Array) -> Array:
        """Shape functions s_a at reference points (eq. 8).

        Parameters
        ----------
        points : array, shape (n_p, d)
            Reference coordinates (xi, y/height[, z/width]).
        parameters : array, shape (n, 6 or 7)
            Columns as in `ElementParameter`.

        Returns
        -------
        array, shape (n, n_p, n_a)
        """

    @abc.abstractmethod
    def shape_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Partial derivative of `shape` in a geometric parameter, points held; same shape."""

    @abc.abstractmethod
    def gradient(self, points: Array, parameters: Array) -> Array:
        """Coefficients N of the position gradient.

        Returns
        -------
        array, shape (n, n_p, n_y, d)
            N[..., y, alpha], so that dr/dx_alpha = sum_y N[y, alpha] Y_y.
        """

    @abc.abstractmethod
    def gradient_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Partial derivative of `gradient` in a geometric parameter, points held; same shape."""
