"""Base class of ANCF elements, from which invariants, forces and stresses are built.

An element of node vectors X (n_a x d: position and slopes of both nodes) declares the vectors of
its points, r = sum_a s_a X_a and the slopes, and its invariants in terms of the *relative* node
vectors

    Y = [r_2 - r_1, slopes of node 1, slopes of node 2]     (n_y x d)

with their derivatives in every parameter. Forces, tangents and all their design derivatives follow
from these. Here are also the polynomials in xi that elements share, and the shape functions of
beams with sections (eq. 8).
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
    """Return the shape function of the second node's position, 3 xi^2 - 2 xi^3.

    The shape function of the first node's position is one minus it.
    """
    return xi * xi * (3.0 - 2.0 * xi)


def slope_weights(xi: Array) -> tuple[Array, Array]:
    """Return the shape functions of both axial slopes at unit length.

    They are xi - 2 xi^2 + xi^3 and -xi^2 + xi^3.
    """
    return xi * (1.0 - xi) ** 2, -xi * xi * (1.0 - xi)


def end_weight_xi(xi: Array) -> Array:
    """Return the derivative in xi of `end_weight`, the weight of the chord in a position."""
    return 6.0 * xi * (1.0 - xi)


def slope_weights_xi(xi: Array) -> tuple[Array, Array]:
    """Return the derivatives in xi of `slope_weights`, the weights of r_x in a position."""
    return (1.0 - xi) * (1.0 - 3.0 * xi), xi * (3.0 * xi - 2.0)


def tangent_weights(xi: Array) -> Array:
    """Return weights of the chord and of r_x at both ends in r_x at xi, for l = 1, (..., 3)."""
    return np.stack([end_weight_xi(xi), *slope_weights_xi(xi)], axis=-1)


def curvature_weights(xi: Array) -> tuple[Array, Array, Array]:
    """Return weights of the chord and of r_x at both ends in r_xx at xi, for l = 1."""
    return 6.0 - 12.0 * xi, 6.0 * xi - 4.0, 6.0 * xi - 2.0


def shape_weights(d: int, quantity: Quantity, xi: Any, y: Any, z: Any) -> Array:
    """Return the weights of node vectors in a position or slope, shape (..., 2 (d + 1)).

    Eq. (8), in space with the terms of the width (docs/theory/01-elements.md), at unit length and
    at coordinates xi, y and z that broadcast.
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
    """Vector of a material point: position, or slope, its derivative along a section axis."""

    POSITION = 0
    SLOPE_X = 1
    SLOPE_Y = 2
    SLOPE_Z = 3


class ElementParameter(IntEnum):
    """Column of each design parameter in an array of element parameters, shape (n, 10)."""

    YOUNGS_MODULUS = 0
    POISSON_RATIO = 1
    DENSITY = 2
    LENGTH = 3
    DAMPING_TIME = 4
    INITIAL_STRAIN = 5
    # Sizes of the section, in the order of `Section.sizes`.
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
    """Type of an element: section form and strain energy, common to all elements of a batch."""

    section: Section  # section of one of the elements; only its form is used, not its sizes
    energy: StrainEnergyFunction | None  # None for rigid beams and for cables
    # Whether dr_o/dx is the same at every point of an element, so that a low-order rule is exact.
    straight: bool

    def sizes(self, parameters: Array) -> Array:
        """Return the columns of `parameters`, shape (n, 10), that hold the sizes of the section."""
        first = ElementParameter.SIZE_1
        return parameters[:, first : first + len(self.section.size_names())]


@final
@dataclass(frozen=True)
class Batch:
    """Elements of one type as arrays: their parameters and unit relative node vectors."""

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
        """Strain energy function of the elements, which must have one."""
        assert self.kind.energy is not None
        return self.kind.energy

    def of(self, which: ElementParameter) -> Array:
        """Return the values of one parameter in all elements, shape (n,)."""
        return self.parameters[:, which]

    @property
    def lengths(self) -> Array:
        """Element lengths l, shape (n,); m."""
        return self.of(ElementParameter.LENGTH)

    @property
    def moduli(self) -> tuple[Array, Array]:
        """Young's modulus E, Pa, and Poisson's ratio nu of the elements, shape (n,) each."""
        return self.of(ElementParameter.YOUNGS_MODULUS), self.of(ElementParameter.POISSON_RATIO)

    @property
    def stiffness(self) -> tuple[Array, ...]:
        """Elasticity matrices at E and nu of the elements, see `StrainEnergyFunction.stiffness`."""
        return self.energy.stiffness(self.d, *self.moduli)

    @property
    def sizes(self) -> Array:
        """Sizes of the sections of the elements, shape (n, n_sizes)."""
        return self.kind.sizes(self.parameters)

    @property
    def Y_free(self) -> Array:
        """Relative node vectors `Y_unit` of the elements free of stress, shape (n, n_y, d).

        The initial strain, which stretched them along the axis, is taken off, and with it the
        contraction across the axis that leaves no stress there.
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
        """Return the complex step per element: STEP times the power of two next to the value.

        Scaled so, it vanishes against the parameter in any units.
        """
        return np.ldexp(STEP, np.frexp(self.of(which).real)[1])

    def moved(self, which: ElementParameter) -> Batch:
        """Return the elements with one parameter perturbed by the imaginary `step`."""
        parameters = self.parameters.astype(complex)
        parameters[:, which] += 1j * self.step(which)
        return replace(self, parameters=parameters)


@final
@dataclass(frozen=True)
class InvariantPartial:
    """Derivatives of the invariants of n elements with respect to one element parameter."""

    A: Array  # (n, n_g, n_g)
    g_o: Array  # (n, n_g)
    bending: Array  # (n, 2)
    c: Array  # (n, n_g): A (dg_o/db); at fixed g the stress changes by A_b dg - c
    m: Array  # (n, n_a, n_a)


Partials = dict[ElementParameter, InvariantPartial]


@final
@dataclass(frozen=True)
class Invariants:
    """Invariants of n elements, from which energy, forces and mass follow (eqs. 10, 15)."""

    A: Array  # (n, n_g, n_g): elastic invariant
    # (n, n_g): packed Gram matrix of the elements free of stress: the reference configuration less
    # the initial strain.
    g_o: Array
    m: Array  # (n, n_a, n_a): mass invariant
    # (n, 2): flexural stiffness E I and length of cables (`cable`), zero stiffness for other
    # elements; None if there is no cable.
    bending: Array | None
    # Function that returns the derivatives in given element parameters; not for the damping time,
    # on which no invariant depends.
    partials: Callable[[Iterable[ElementParameter]], Partials]


class ElementIntegrals(abc.ABC):
    """Invariants A, m and E I of n elements, divided by powers of the element length l."""

    # A, m, and for cables the flexural stiffness E I, (n, 1).
    values: tuple[Array, ...]
    powers: tuple[Array, ...]  # exponent of l of each entry of `values`

    @abc.abstractmethod
    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Return the derivatives of `values` with respect to an element parameter."""


@final
@dataclass(frozen=True)
class SectionPlace:
    """Location of a section: its element in a run of neighbouring elements, and xi."""

    element: int  # index of its element in the run, which includes neighbours at `smooth` nodes
    xi: float
    # Whether no joint, load or mass acts at the first and at the second node of the element.
    smooth: tuple[bool, bool] = (False, False)


class SectionLaw(abc.ABC):
    """Evaluator of the forces and moments in one section, prepared for many states."""

    @abc.abstractmethod
    def forces(self, Y: Array, V: Array) -> Array:
        """Return the section forces N, V_y, V_z and moments T, M_y, M_z, shape (..., 6); N, N m.

        They act from the part beyond the section on the part before it, in the axes of the section;
        real or complex. In the plane V_z, T and M_y are zero. Y and V, (..., n, n_y, d), are the
        relative node vectors of the run of elements and their velocities.
        """


class StressLaw(abc.ABC):
    """Evaluator of von Mises stresses at fibres of sections of n elements, at locations xi."""

    count: int  # number of points; each needs memory for a few numbers per time

    @abc.abstractmethod
    def von_mises(self, Y: Array, V: Array) -> Array:
        """Return the stresses, shape (k, n, n_f n_xi), Pa, for Y and V of shape (k, n, n_y, d).

        A stress of E SMALL_STRAIN is added in quadrature, so that they are positive and
        differentiable everywhere.
        """

    @abc.abstractmethod
    def pulled_back(self, Y: Array, V: Array, weights: Array) -> tuple[Array, Array]:
        """Return gradients in Y and V of the weighted sum of half the squared stresses."""


class BeamElement(abc.ABC):
    """A two-node ANCF beam element: its node vectors, shape functions and invariants.

    Implementations are stateless; arrays are batched over elements (leading axis n) and over points
    (axis n_p) and keep the dtype of their input, so that complex perturbations of coordinates and
    parameters pass through.
    """

    name: str  # name in saved solutions
    d: int  # dimension of space

    @property
    @abc.abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """Vectors of a node: position and slopes, as `Quantity` members."""

    @property
    def n_s(self) -> int:
        """Number of vectors per node: the position and the slopes."""
        return len(self.quantities)

    @property
    def n_a(self) -> int:
        """Number of node vectors per element, 2 n_s."""
        return 2 * self.n_s

    @property
    def n_y(self) -> int:
        """Number of relative node vectors per element, n_a - 1."""
        return self.n_a - 1

    def places_in(self, wider: BeamElement) -> Array:
        """Return the indices of this element's node vectors, (n_a,), among those of `wider`."""
        places = np.arange(wider.n_a).reshape(2, wider.n_s)
        return places[:, [wider.quantities.index(quantity) for quantity in self.quantities]].ravel()

    @property
    def spanning(self) -> tuple[Quantity, ...]:
        """Slopes that span the section; for a planar element without section slopes the tangent.

        `require` rejects a spatial element without section slopes.
        """
        if self.d == 2 and Quantity.SLOPE_Y not in self.quantities:
            return (Quantity.SLOPE_X,)
        return tuple(Quantity)[2 : self.d + 1]

    @property
    def can_kink(self) -> bool:
        """Whether r_x may jump at a node: if section slopes, not r_x, resist bending."""
        return Quantity.SLOPE_Y in self.quantities

    @final
    def check(self, where: str) -> None:
        """Raise InvalidInputError if node vectors and `vector_weights` of the element disagree."""
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
        """Raise InvalidInputError for a section that the element cannot represent."""
        return

    def require(self, where: str, quantity: Quantity, y: float, z: float) -> None:
        """Raise InvalidInputError unless the point at y and z in a section has this vector."""
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
        """Return the weights w and powers p of a point's vector sum_a w_a l^p_a X_a, (n_a,) each.

        For a position the weights are the shape functions of eq. 8 at unit length; y and z are in
        m. X_a are the node vectors and l is the element length.
        """

    @property
    @abc.abstractmethod
    def default_energy(self) -> StrainEnergyFunction | None:
        """Strain energy of beams that declare none; None if the element defines its own."""

    @abc.abstractmethod
    def integrals(self, batch: Batch, owners: Array) -> ElementIntegrals:
        """Return the integrals of a batch of elements; `owners`, (n,), are names for errors."""

    @abc.abstractmethod
    def section_law(self, batch: Batch, place: SectionPlace) -> SectionLaw:
        """Return the evaluator of the forces in one section of a run of elements."""

    @abc.abstractmethod
    def stress_law(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> StressLaw:
        """Return the evaluator of stresses at fibres of sections of the elements of a batch.

        The sections lie at xi, (n_xi,), and the fibres at y and z in them, (n, n_f) each; m.
        """
