"""Base class of joints: scalar equations between position and slope vectors of points.

A joint never touches coordinates. It names the vectors U_i of material points
that take part and gives the coefficients of its equations,

    Phi_r = sum_i linear_ri . U_i + 1/2 sum_ij bilinear_rij U_i . U_j - offset_r = 0.

`assembly` turns the coefficients of all joints into constraints, Jacobians,
(Phi_q^T lam)_q, the right-hand sides of the velocity, acceleration and jerk
equations, and all design derivatives.

The equations of a `FormulaJoint` are any smooth functions of the vectors, parameters and time.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_direction, require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.elements import Quantity
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.parts import Elements, Normal, Part, Sign, Vectors
from ancfdae.numerics.arrays import Array

#: `Joint.takes_part` of joints that depend on position and all slopes (d of them) of each point.
SECTION = tuple(Quantity)


@final
@dataclass(frozen=True)
class RightAngle:
    """Two of the directions x, y and z of a section that a joint keeps perpendicular.

    For a rigid section, or if another joint keeps the angle already, it gives no equation.
    """

    beam: str
    fraction: float | None
    before: bool
    slopes: frozenset[Quantity]


@final
@dataclass(frozen=True)
class JointEquations:
    """Coefficients of a joint's equations, or one of their time derivatives.

    Equation r is sum_i linear[r, i] . U_i + sum_ij bilinear[r, i, j] U_i . U_j / 2 = offset[r] in
    the vectors U of the joint, shape (n_vectors, d): `linear` has the shape
    (n_rows, n_vectors, d), `bilinear` (n_rows, n_vectors, n_vectors) and is symmetric in i and j,
    `offset` (n_rows,). `shapes` names the right angles that the last rows keep, one each.
    """

    linear: Array  # (n_rows, n_vectors, d)
    bilinear: Array  # (n_rows, n_vectors, n_vectors): symmetric in the vectors
    offset: Array  # (n_rows,)
    # Right angles of sections that the last rows keep, one each. `assembly` leaves out rows whose
    # right angle is kept already.
    shapes: tuple[RightAngle, ...] = ()

    def at(self, U: Array) -> Array:
        """Return the residuals of the equations, shape (n_rows,), at vectors U, (n_vectors, d)."""
        products = np.einsum("rij,ix,jx->r", self.bilinear, U, U)
        return np.einsum("rix,ix->r", self.linear, U) + products / 2 - self.offset

    def without(self, dropped: Sequence[int]) -> JointEquations:
        """Return the equations without the rows `dropped`."""
        if not dropped:
            return self
        kept = np.delete(np.arange(len(self.offset)), dropped)
        return JointEquations(self.linear[kept], self.bilinear[kept], self.offset[kept])

    def at_points(
        self, before: Sequence[MaterialPoint], after: Sequence[MaterialPoint]
    ) -> JointEquations:
        """Return the same equations with the points `before` in `shapes` replaced by `after`."""
        pairs = zip(before, after, strict=True)
        places = {(x.beam, x.fraction, x.before): (y.beam, y.fraction, y.before) for x, y in pairs}
        shapes = (RightAngle(*places[x.beam, x.fraction, x.before], x.slopes) for x in self.shapes)
        return replace(self, shapes=tuple(shapes))


class Joint(Part):
    """A joint between points of beams or to ground; fields and names as in `Part`."""

    role = "joint"
    #: Vectors of each point that the equations depend on: its position, or `SECTION`.
    takes_part: ClassVar[tuple[Quantity, ...]] = (Quantity.POSITION,)
    #: Whether the first d equations equate positions: their multipliers are then minus the reaction
    #: force on the first point.
    holds_position: ClassVar[bool] = False
    #: Symbol in pictures, and whether ground is drawn below it if the joint has no other point.
    sign: ClassVar[Sign] = Sign("joint", "*")
    shows_ground: ClassVar[bool] = True
    #: The field that holds the axis, or the direction in which the joint moves.
    way_field: ClassVar[str | None] = None

    @property
    def way(self) -> Sequence[float] | None:
        """Axis, or direction in which the joint moves, shown in pictures; None if it has none."""
        return None if self.way_field is None else getattr(self, self.way_field)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors in the equations: positions first, then slopes point by point.

        For a planar element without a section, the normal of its tangent replaces the section
        slope.
        """
        chosen = [quantity for quantity in self.takes_part if quantity <= elements.d]
        positions = [(point, q) for q in chosen if q is Quantity.POSITION for point in self.points]
        slopes = [
            Normal(point) if elements.d == 2 and q not in quantities else (point, q)
            for point, quantities in ((x, elements.at(x).quantities) for x in self.points)
            for q in chosen
            if q is not Quantity.POSITION
        ]
        return (*positions, *slopes)

    @property
    def driven(self) -> bool:
        """Whether the equations depend on time by a law."""
        return False

    def state_masses(self) -> tuple[float, ...]:
        """Return the masses, kg, of the coordinates that the joint adds (`states`)."""
        return ()

    @property
    def by_slopes(self) -> bool:
        """Whether the equations depend on class, `p` and reference slopes only, not on positions.

        Such joints with equal numbers share their equations.
        """
        return False

    @abc.abstractmethod
    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of the equations; for a driven joint the part constant in time.

        `p` holds the values of `parameters`, as `split` takes them, and `reference` the vectors in
        the reference configuration, (n_vectors, d); both may be complex.
        """

    @final
    def checked_coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return `coefficients`; InvalidInputError if the shapes of its arrays are wrong."""
        where, (n, d) = f"coefficients of joint {self.name!r}", reference.shape
        c: object = self.coefficients(p, reference)
        require_kind(where, c, (JointEquations,), "Fill in the arrays of `empty_equations`.")
        assert isinstance(c, JointEquations)
        rows, shapes = len(c.offset), (c.linear.shape, c.bilinear.shape, c.offset.shape)
        if shapes != ((rows, n, d), (rows, n, n), (rows,)):
            rule = f"{rows} equations in {n} vectors need ({rows}, {n}, {d}), ({rows}, {n}, {n})"
            raise InvalidInputError(
                where, rule, shapes[:2], "Fill in the arrays of `empty_equations`."
            )
        return c

    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients multiplied by each law factor of time; none by default."""
        return ()

    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the time derivative of order 0 to 3 of the factors of `moving`.

        The times t have the shape (k,), the result (n_factors, k).
        """
        return np.zeros((0, len(t)))

    def faces(self, p: Array, reference: Array, U: Array, t: float) -> bool:
        """Whether a driven section is at the prescribed angle, not half a turn away from it.

        The equations hold in both positions; U are the vectors, (n, d), at t.
        """
        return True

    def by_turn(self, p: Array, t: Array) -> Array:
        """Return the derivatives of the factors in a prescribed angle, shape (n_factors, k).

        They are zero without a prescribed angle. The equations of an angle also hold half a turn
        away; their derivative in the angle has the opposite sign there.
        """
        return np.zeros_like(self.factors(p, t, 0))

    def turn_rate(self, p: Array, t: Array) -> Array:
        """Return the rate of a prescribed angle at times t, (k,), zero without one; rad/s."""
        return np.zeros(len(t))


class DrivenJoint(Joint):
    """A joint whose coefficients depend on time: `coefficients` + sum_k factor_k(t) moving_k."""

    @property
    def driven(self) -> bool:
        """Return true: a law of time drives the joint."""
        return True

    @abc.abstractmethod
    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients that each law factor of time multiplies."""

    @abc.abstractmethod
    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the time factors of `moving` at times t, or a time derivative, (n_factors, k)."""

    @abc.abstractmethod
    def faces(self, p: Array, reference: Array, U: Array, t: float) -> bool:
        """Whether the vectors U are at the position that the law prescribes at t."""


@dataclass(frozen=True)
class Travelling(DrivenJoint):
    """A joint that prescribes the displacement of its point along a direction by one law."""

    point: MaterialPoint
    direction: Sequence[float]
    travel: Law

    design_fields = (("direction", require_direction), ("travel", require_law))
    way_field = "direction"

    def faces(self, p: Array, reference: Array, U: Array, t: float) -> bool:
        """Return true: a prescribed displacement has only one position."""
        return True

    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the prescribed travel, m, or its time derivative of the given order."""
        return self.travel.derivative(self.split(p)[1], t, order)[None]


def empty_equations(
    rows: int, p: Array, reference: Array, shapes: Sequence[RightAngle] = ()
) -> JointEquations:
    """Return equations with zero coefficients: `rows` of them, and one for each right angle."""
    (n, d), dtype, rows = reference.shape, np.result_type(p, reference), rows + len(shapes)
    linear, bilinear = np.zeros((rows, n, d), dtype), np.zeros((rows, n, n), dtype)
    return JointEquations(linear, bilinear, np.zeros(rows, dtype), tuple(shapes))


def place_coincidence(
    c: JointEquations, count: int, reference: Array, ground: Array | None
) -> None:
    """Enter as first d equations U_0 - U_1 = 0 for two points, U_0 - ground = 0 for one.

    By default `ground` is the position U_0 in the reference configuration.
    """
    rows = np.arange(c.linear.shape[2])
    c.linear[rows, 0, rows] = 1.0
    if count == 2:
        c.linear[rows, 1, rows] = -1.0
    else:
        c.offset[rows] = reference[0] if ground is None else ground


class FormulaJoint(Joint):
    """A joint given by formulas, Phi(U, p, reference, laws) = 0.

    When equations of motion are assembled, `equations` is called with arrays of symbols instead of
    numbers and recorded as a list of operations; all derivatives that statics, integrators and
    gradients need are derived from the list. The formulas may use all functions of NumPy that are
    smooth where the mechanism moves, and call an `ExternalFunction`, for example a table with its
    derivative.
    """

    #: Number of equations.
    equation_count: ClassVar[int] = 1

    @abc.abstractmethod
    def equations(self, U: Array, p: Array, reference: Array, laws: Array) -> Any:
        """Return the `equation_count` residuals, which vanish where the joint is closed.

        U are the vectors, (n_vectors, d), and `reference` the same vectors in the reference
        configuration. p holds the values of `parameters`, as `split` takes them. `laws` are the
        values, at the time of U, of the design fields that hold a `Law`, in their order.
        """

    def row_count(self, d: int) -> int:
        """Return the number of equations in d dimensions, `equation_count` by default."""
        return self.equation_count

    @final
    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return zero coefficients: the formulas are the whole equations."""
        return empty_equations(self.row_count(reference.shape[1]), p, reference)

    @final
    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return zero coefficients for each law: the formulas are the whole equations."""
        return (self.coefficients(p, reference),) * len(self.laws)

    @final
    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the laws at times t, or a time derivative of them, shape (n_laws, k)."""
        values = [law.derivative(p[at], t, order) for law, at in self.laws]
        return np.array(values).reshape(len(values), len(t))

    @property
    def laws(self) -> list[tuple[Law, slice]]:
        """Laws among the design fields, each with the slice of its numbers in p."""
        values, (places, _) = self._design_values(), self.design_places
        pairs = zip(values, places, strict=True)
        return [(x, at) for (_, x), at in pairs if isinstance(x, Law) and isinstance(at, slice)]

    @property
    def driven(self) -> bool:
        """Whether the joint has a law of time."""
        return len(self.laws) > 0
