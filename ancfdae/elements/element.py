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
from dataclasses import dataclass
from enum import IntEnum
from typing import final

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


@final
@dataclass(frozen=True)
class InvariantPartial:
    """Derivatives of the invariants in one element parameter.

    Attributes
    ----------
    A : array, shape (n, n_g, n_g)
    g_o : array, shape (n, n_g)
    c : array, shape (n, n_g)
        A (dg_o/db) - dp_o/db: minus what the stress gains with g held, beside A_b dg.
    m : array, shape (n, n_a, n_a)
    """

    A: Array
    g_o: Array
    c: Array
    m: Array


@final
@dataclass(frozen=True)
class Invariants:
    """Invariants of n elements.

    Attributes
    ----------
    A : array, shape (n, n_g, n_g)
        Elastic invariant.
    g_o : array, shape (n, n_g)
        Packed Gram matrix of the reference configuration.
    m : array, shape (n, n_a, n_a)
        Mass invariant.
    p_o : array, shape (n, n_g), or None
        Linear term of the energy; None where there is none.
    partials : dict
        Derivatives by element parameter, only those asked for; none for the damping time,
        which no invariant depends on.
    """

    A: Array
    g_o: Array
    m: Array
    p_o: Array | None
    partials: dict[ElementParameter, InvariantPartial]


class BeamElement(abc.ABC):
    """Facts about a two-node ANCF beam element.

    Implementations are stateless; arrays are batched over elements (leading
    axis n) and over points (axis n_p) and keep the dtype of their input, so
    that complex perturbations of coordinates and parameters pass through.

    Attributes
    ----------
    d : int
        Dimension of space.
    n_s : int
        Node vectors per node.
    n_a : int
        Node vectors per element, 2 n_s.
    n_y : int
        Relative node vectors per element, n_a - 1.
    name : str
        What saved solutions call it.
    """

    name: str
    d: int

    @property
    @abc.abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """What the vectors of a node are: position and slopes."""

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

    def require(self, where: str, quantity: Quantity, y: float, z: float) -> None:
        """Refuse a vector that a point, offset in the section by y and z, does not have.

        Raises
        ------
        InvalidInput
        """
        if Quantity.SLOPE_Y not in self.quantities and (y != 0 or z != 0):
            raise InvalidInput(
                where, "the element has no section to be off", f"y = {y}, z = {z}", "Leave it out."
            )
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

    @abc.abstractmethod
    def invariants(
        self,
        parameters: Array,
        Y_unit: Array,
        straight: bool,
        wanted: tuple[ElementParameter, ...],
        owners: Array,
    ) -> Invariants:
        """Integrate the invariants of some elements; arguments as in `invariants.prepare`."""
