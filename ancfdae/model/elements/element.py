"""Protocol of an element, from which invariants, forces and stresses are built.

An element of node vectors X (n_a x d: position and slopes of both nodes)
declares the vectors of its points, r = sum_a s_a X_a and the slopes, and its
invariants in terms of the *relative* node vectors

    Y = [r_2 - r_1, slopes of node 1, slopes of node 2]     (n_y x d)

with their derivatives in every parameter. Forces, tangents and all their
design derivatives follow from these facts. Elements share polynomials in xi, and beams with
sections their shape functions (eq. 8).
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_text
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.elements.energy import StrainEnergyFunction
from ancfdae.model.sections.section import Section
from ancfdae.numerics.arrays import STEP, Array


def end_weight(xi: Array) -> Array:
    """Weight of the second node's position, 3 xi^2 - 2 xi^3; the first has one minus it."""
    return xi * xi * (3.0 - 2.0 * xi)


def slope_weights(xi: Array) -> tuple[Array, Array]:
    """Weights of the axial slopes per unit length: xi - 2 xi^2 + xi^3 and -xi^2 + xi^3."""
    return xi * (1.0 - xi) ** 2, -xi * xi * (1.0 - xi)


def end_weight_xi(xi: Array) -> Array:
    """Return the derivative of `end_weight` in xi."""
    return 6.0 * xi * (1.0 - xi)


def slope_weights_xi(xi: Array) -> tuple[Array, Array]:
    """Return the derivatives of `slope_weights` in xi."""
    return (1.0 - xi) * (1.0 - 3.0 * xi), xi * (3.0 * xi - 2.0)


def tangent_weights(xi: Array) -> Array:
    """Return the weights of the chord and both axial slopes in dr/dx at unit length, (..., 3)."""
    return np.stack([end_weight_xi(xi), *slope_weights_xi(xi)], axis=-1)


def curvature_weights(xi: Array) -> tuple[Array, Array, Array]:
    """Return the second derivatives of `end_weight` and of both `slope_weights`."""
    return 6.0 - 12.0 * xi, 6.0 * xi - 4.0, 6.0 * xi - 2.0


def shape_weights(d: int, quantity: Quantity, xi: Any, y: Any, z: Any) -> Array:
    """Return the weights of node vectors in a position or slope, shape (..., 2 (d + 1)).

    Eq. (8), in space with the terms of the width (docs/theory/01-elements.md), at unit length and
    at places xi, y and z that broadcast.
    """
    shape, dtype = np.broadcast(xi, y, z).shape, np.result_type(xi, y, z, float)
    # The nodes along the second axis from the end.
    w = np.zeros((*shape, 2, d + 1), dtype=dtype)
    if quantity is Quantity.POSITION:
        s5 = end_weight(xi)
        w[..., 0, 0], w[..., 1, 0] = 1 - s5, s5
        w[..., 0, 1], w[..., 1, 1] = slope_weights(xi)
        for k, offset in enumerate((y, z)[: d - 1], start=2):
            w[..., 0, k], w[..., 1, k] = offset * (1 - xi), offset * xi
    elif quantity is Quantity.SLOPE_X:
        s5 = end_weight_xi(xi)
        w[..., 0, 0], w[..., 1, 0] = -s5, s5
        w[..., 0, 1], w[..., 1, 1] = slope_weights_xi(xi)
        for k, offset in enumerate((y, z)[: d - 1], start=2):
            w[..., 0, k], w[..., 1, k] = -offset, offset
    else:
        w[..., 0, quantity], w[..., 1, quantity] = 1 - xi, xi
    return w.reshape(*shape, -1)


class Quantity(IntEnum):
    """A vector of a material point; slopes are derivatives along the section's axes."""

    POSITION = 0
    SLOPE_X = 1
    SLOPE_Y = 2
    SLOPE_Z = 3


class ElementParameter(IntEnum):
    """Column of each design parameter in a block's parameter array, shape (n, 10)."""

    YOUNGS_MODULUS = 0
    POISSON_RATIO = 1
    DENSITY = 2
    LENGTH = 3
    DAMPING_TIME = 4
    INITIAL_STRAIN = 5
    # Sizes of the section, in its order.
    SIZE_1 = 6
    SIZE_2 = 7
    SIZE_3 = 8
    SIZE_4 = 9

    @property
    def is_size(self) -> bool:
        """Whether the parameter is a size of the section."""
        return self >= ElementParameter.SIZE_1


@final
@dataclass(frozen=True)
class ElementType:
    """Type of an element: what is equal in a batch, whose elements differ in numbers only."""

    section: Section  # one of theirs; its sizes do not count
    energy: StrainEnergyFunction | None  # None for elements with a law of their own
    # Whether dr_o/dx is the same at every point of an element, so that a low-order rule is exact.
    straight: bool

    def sizes(self, parameters: Array) -> Array:
        """Return the sizes of the section out of parameters of shape (n, 10)."""
        first = ElementParameter.SIZE_1
        return parameters[:, first : first + len(self.section.size_names())]


@final
@dataclass(frozen=True)
class Batch:
    """Elements of one type as arrays: parameters, (n, n_p), and unit relative node vectors."""

    kind: ElementType
    parameters: Array  # (n, 10): columns as in `ElementParameter`; real or complex
    # (n, n_y, d): relative node vectors of the reference configuration, the first one, r_2 - r_1,
    # divided by the element length.
    Y_unit: Array

    def __getitem__(self, rows: slice | Array) -> Batch:
        """Return the batch of the elements with these indices."""
        return Batch(self.kind, self.parameters[rows], self.Y_unit[rows])

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.Y_unit.shape[2])

    @property
    def energy(self) -> StrainEnergyFunction:
        """The energy of elements that have one."""
        assert self.kind.energy is not None
        return self.kind.energy

    def of(self, which: ElementParameter) -> Array:
        """Return one parameter of all elements, shape (n,)."""
        return self.parameters[:, which]

    @property
    def lengths(self) -> Array:
        """Element lengths l, shape (n,); m."""
        return self.of(ElementParameter.LENGTH)

    @property
    def moduli(self) -> tuple[Array, Array]:
        """E and nu, shape (n,) each."""
        return self.of(ElementParameter.YOUNGS_MODULUS), self.of(ElementParameter.POISSON_RATIO)

    @property
    def stiffness(self) -> tuple[Array, ...]:
        """Elastic moduli by E and nu; see `StrainEnergyFunction.stiffness`."""
        return self.energy.stiffness(self.d, *self.moduli)

    @property
    def sizes(self) -> Array:
        """Sizes of the sections, shape (n, n_sizes)."""
        return self.kind.sizes(self.parameters)

    @property
    def Y_free(self) -> Array:
        """`Y_unit` of the elements free of stress, shape (n, n_y, d).

        Initial strain has stretched them along the axis, and across it they have contracted as the
        energy makes them, so that no stress is left there.
        """
        strain, d = self.of(ElementParameter.INITIAL_STRAIN), self.d
        factors = np.ones((len(strain), d + 1), dtype=strain.dtype)
        factors[:, :2] = np.sqrt(1 - 2 * strain)[:, None]
        if self.kind.energy is not None:
            C = np.sum(self.stiffness, axis=0)[:, :d, :d]
            across = np.linalg.solve(C[:, 1:, 1:], C[:, 1:, :1])[..., 0]
            factors[:, 2:] = np.sqrt(1 + 2 * strain[:, None] * across)
        n_s = (self.Y_unit.shape[1] + 1) // 2
        of_rows = np.column_stack([factors[:, :n_s], factors[:, 1:n_s]])
        return np.asarray(self.Y_unit * of_rows[..., None])

    def step(self, which: ElementParameter) -> Array:
        """Return STEP times the power of two next to each value: it vanishes in any units."""
        return np.ldexp(STEP, np.frexp(self.of(which).real)[1])

    def moved(self, which: ElementParameter) -> Batch:
        """Return the elements with one parameter moved by an imaginary `step`."""
        parameters = self.parameters.astype(complex)
        parameters[:, which] += 1j * self.step(which)
        return replace(self, parameters=parameters)


@final
@dataclass(frozen=True)
class InvariantPartial:
    """Derivatives of the invariants in one element parameter."""

    A: Array  # (n, n_g, n_g)
    g_o: Array  # (n, n_g)
    bending: Array  # (n, 2)
    c: Array  # (n, n_g): A (dg_o/db), minus what the stress gains with g held, beside A_b dg
    m: Array  # (n, n_a, n_a)


Partials = dict[ElementParameter, InvariantPartial]


@final
@dataclass(frozen=True)
class Invariants:
    """Arrays of n elements from which energy, forces and mass follow (eqs. 10, 15)."""

    A: Array  # (n, n_g, n_g): elastic invariant
    # (n, n_g): packed Gram matrix of the elements free of stress: the reference configuration less
    # the initial strain.
    g_o: Array
    m: Array  # (n, n_a, n_a): mass invariant
    # (n, 2): flexural stiffness E I and length of elements that bend as cables do (`cable`),
    # zero stiffness of those that do not; None where no element does.
    bending: Array | None
    # Returns the derivatives in the element parameters given; none for the damping time, which no
    # invariant depends on.
    partials: Callable[[Iterable[ElementParameter]], Partials]


class ElementIntegrals(abc.ABC):
    """Invariants divided by a power of the element length l, given for each entry by `powers`."""

    # A, m, and the flexural stiffness E I, (n, 1), of elements that bend as cables do.
    values: tuple[Array, ...]
    powers: tuple[Array, ...]  # the power of l of each entry of these

    @abc.abstractmethod
    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Return the derivatives of the values in a parameter."""


@final
@dataclass(frozen=True)
class SectionPlace:
    """Location of a section: its element in a run of neighbouring elements, and xi."""

    element: int  # its element in the run, which holds those beside it on `smooth` nodes
    xi: float
    # Whether nothing acts at the first, at the second node of its element.
    smooth: tuple[bool, bool] = (False, False)


class SectionLaw(abc.ABC):
    """Forces in a section, prepared for many states."""

    @abc.abstractmethod
    def forces(self, Y: Array, V: Array) -> Array:
        """Return N, V_y, V_z, T, M_y and M_z, shape (..., 6).

        What the part beyond the section does to the part before it, in the axes of the section;
        real or complex. In the plane V_z, T and M_y are zero. Y and V, (..., n, n_y, d), are the
        relative node vectors of the run of elements and their velocities.
        """


class StressLaw(abc.ABC):
    """Von Mises stresses at many points of elements: fibre by fibre, each at all its places."""

    count: int  # number of points, of which each holds a few numbers per instant

    @abc.abstractmethod
    def von_mises(self, Y: Array, V: Array) -> Array:
        """Return the stresses, shape (k, n, n_f n_xi), of Y and V of shape (k, n, n_y, d).

        They are positive and have derivatives everywhere: a stress of SMALL_STRAIN goes with them.
        """

    @abc.abstractmethod
    def pulled_back(self, Y: Array, V: Array, weights: Array) -> tuple[Array, Array]:
        """Return the sum of weights times half the gradients of the squares, as Y and as V."""


class BeamElement(abc.ABC):
    """Facts about a two-node ANCF beam element.

    Implementations are stateless; arrays are batched over elements (leading
    axis n) and over points (axis n_p) and keep the dtype of their input, so
    that complex perturbations of coordinates and parameters pass through.
    """

    name: str  # what saved solutions call it
    d: int  # dimension of space

    @property
    @abc.abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """Vectors of a node: position and slopes, as `Quantity`."""

    @property
    def n_s(self) -> int:
        """Number of vectors per node: the position and the slopes."""
        return len(self.quantities)

    @property
    def n_a(self) -> int:
        """Node vectors per element, 2 n_s."""
        return 2 * self.n_s

    @property
    def n_y(self) -> int:
        """Relative node vectors per element, n_a - 1."""
        return self.n_a - 1

    def places_in(self, wider: BeamElement) -> Array:
        """Return the places of this type's node vectors, (n_s,), among all of a full element."""
        places = np.arange(wider.n_a).reshape(2, wider.n_s)
        return places[:, [wider.quantities.index(quantity) for quantity in self.quantities]].ravel()

    @property
    def spanning(self) -> tuple[Quantity, ...]:
        """The slopes that span a section; of a planar element without one its tangent.

        `require` refuses a spatial element that lacks them.
        """
        if self.d == 2 and Quantity.SLOPE_Y not in self.quantities:
            return (Quantity.SLOPE_X,)
        return tuple(Quantity)[2 : self.d + 1]

    @property
    def can_kink(self) -> bool:
        """Whether r_x may jump at a node: where sections bend, not where r_x does."""
        return Quantity.SLOPE_Y in self.quantities

    @final
    def check(self, where: str) -> None:
        """Refuse an element whose declarations do not fit each other."""
        require_text(f"{where}, name", self.name)
        if self.quantities[:2] != (Quantity.POSITION, Quantity.SLOPE_X):
            rule = "must begin with a position and the slope along the beam"
            repair = "Begin with Quantity.POSITION, Quantity.SLOPE_X."
            raise InvalidInputError(f"{where}, quantities", rule, self.quantities, repair)
        for quantity in self.quantities:
            given: object = self.vector_weights(quantity, 0.5, 0.0, 0.0)
            shapes = [np.shape(x) for x in given] if isinstance(given, tuple) else repr(given)
            if shapes != 2 * [(self.n_a,)]:
                rule = f"must be weights and powers of the length, ({self.n_a},) each"
                repair = "Give one for each vector of both nodes."
                raise InvalidInputError(f"{where}, vector_weights", rule, shapes, repair)

    def check_section(self, where: str, section: Section) -> None:
        """Refuse a section that the element cannot stand for."""
        return

    def require(self, where: str, quantity: Quantity, y: float, z: float) -> None:
        """Refuse a vector that a point, offset in the section by y and z, does not have."""
        if Quantity.SLOPE_Y not in self.quantities and (y != 0 or z != 0):
            raise InvalidInputError(
                where, "y and z must be 0: the element has no section", f"y = {y}, z = {z}"
            )
        if quantity not in self.quantities:
            raise InvalidInputError(
                where,
                f"the element must have the vector {quantity.name}",
                f"an element of {', '.join(each.name for each in self.quantities)}",
                "Choose another element for the beam, or another part.",
            )

    @abc.abstractmethod
    def vector_weights(
        self, quantity: Quantity, xi: float, y: float, z: float
    ) -> tuple[Array, Array]:
        """Return how a vector of a point is made of the node vectors: sum_a w_a l^p_a X_a.

        Of a position the weights are the shape functions of eq. 8; y and z are in m. Returned are
        the weights w at unit length, and the power p of the length l that each goes with, (n_a,)
        each.
        """

    @property
    @abc.abstractmethod
    def default_energy(self) -> StrainEnergyFunction | None:
        """Energy of beams that declare none; None if the element has a law of its own."""

    @abc.abstractmethod
    def integrals(self, batch: Batch, owners: Array) -> ElementIntegrals:
        """Integrate the invariants of some elements; `owners` as in `invariants.prepare`."""

    @abc.abstractmethod
    def section_law(self, batch: Batch, place: SectionPlace) -> SectionLaw:
        """Return the evaluator of forces in a section of a run of elements."""

    @abc.abstractmethod
    def stress_law(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> StressLaw:
        """Return the evaluator of stresses at fibres of sections of elements.

        The sections lie at xi, (n_xi,), and the fibres at y and z in them, (n, n_f) each; m.
        """
