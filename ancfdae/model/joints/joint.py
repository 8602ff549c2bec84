"""Base class of joints: scalar equations between position and slope vectors of points.

A joint never touches coordinates. It names the vectors U_i of material points
that take part and gives the coefficients of its equations,

    Phi_r = sum_i linear_ri . U_i + 1/2 sum_ij bilinear_rij U_i . U_j - offset_r = 0.

The assembler turns the coefficients of all joints at once into constraints,
Jacobians, (Phi_q^T lam)_q, the right sides of the velocity, acceleration and
jerk equations, and all design derivatives.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_direction, require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.elements import Quantity
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.parts import Elements, Normal, Part, Sign, Vectors
from ancfdae.numerics.arrays import Array

#: Position and all slopes take part, as many as space has dimensions.
SECTION = tuple(Quantity)


@final
@dataclass(frozen=True)
class RightAngle:
    """Two of the directions x, y and z of the section at a point, which a joint keeps square.

    It says nothing of a section that is rigid, and nothing new where another joint has said it.
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
    `offset` (n_rows,). `shapes` may name what the last rows hold, where that is the shape of a
    section only.
    """

    linear: Array  # (n_rows, n_vectors, d)
    bilinear: Array  # (n_rows, n_vectors, n_vectors): symmetric in the vectors
    offset: Array  # (n_rows,)
    # What the last rows hold, one each: the shape of sections only. The assembler leaves out those
    # that are held without them.
    shapes: tuple[RightAngle, ...] = ()

    def at(self, U: Array) -> Array:
        """Return the value of the equations at vectors, shape (n_vectors, d) to (n_rows,)."""
        products = np.einsum("rij,ix,jx->r", self.bilinear, U, U)
        return np.einsum("rix,ix->r", self.linear, U) + products / 2 - self.offset

    def without(self, dropped: Sequence[int]) -> JointEquations:
        """Return the equations without some of them."""
        if not dropped:
            return self
        kept = np.delete(np.arange(len(self.offset)), dropped)
        return JointEquations(self.linear[kept], self.bilinear[kept], self.offset[kept])

    def at_points(
        self, before: Sequence[MaterialPoint], after: Sequence[MaterialPoint]
    ) -> JointEquations:
        """Return the same equations of a joint that has points `after` instead of `before`."""
        pairs = zip(before, after, strict=True)
        places = {(x.beam, x.fraction, x.before): (y.beam, y.fraction, y.before) for x, y in pairs}
        shapes = (RightAngle(*places[x.beam, x.fraction, x.before], x.slopes) for x in self.shapes)
        return replace(self, shapes=tuple(shapes))


class Joint(Part):
    """A joint between points of beams or to ground; fields and names as in `Part`."""

    role = "joint"
    #: What takes part of every point; its position, or `SECTION`, say.
    takes_part: ClassVar[tuple[Quantity, ...]] = (Quantity.POSITION,)
    #: Whether the first d equations equate positions: their multipliers are then minus the reaction
    #: force on the first point.
    holds_position: ClassVar[bool] = False
    #: Sign in pictures, and whether ground is drawn below it where it has no other point.
    sign: ClassVar[Sign] = Sign("joint", "*")
    shows_ground: ClassVar[bool] = True
    #: The field that holds the axis, or the direction in which the joint moves.
    way_field: ClassVar[str | None] = None

    @property
    def way(self) -> Sequence[float] | None:
        """Axis, or direction in which the joint moves, that pictures show."""
        return None if self.way_field is None else getattr(self, self.way_field)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors that take part: positions first, then slopes point by point.

        A planar element without a section turns with its tangent; a spatial one is refused.
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
        """Whether laws of time move it."""
        return False

    def state_masses(self) -> tuple[float, ...]:
        """Return the masses of its `states`, coordinates of its own; kg."""
        return ()

    @property
    def by_slopes(self) -> bool:
        """Whether equations follow from the class, `p` and the slopes of the reference alone.

        Joints of such a kind with the same numbers have the same equations, wherever they stand.
        """
        return False

    @abc.abstractmethod
    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients, of a driven joint those that do not depend on time.

        `p` has the values of `parameters`, as `split` takes them, and `reference` the vectors in
        the reference configuration, (n_vectors, d); complex ones must go through.
        """

    @final
    def checked_coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients; InvalidInputError if their arrays do not fit their vectors."""
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
        """Return the coefficients that go with each of the `factors`; see `coefficients`."""
        return ()

    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the time derivative of this order, 0 to 3, of the factors.

        The instants t have the shape (k,), the result (n_factors, k).
        """
        return np.zeros((0, len(t)))

    def faces(self, p: Array, reference: Array, U: Array, t: float) -> bool:
        """Whether the joint stands at the angle of its law, and not half a turn away from it.

        The equations of a driven angle are met by both positions; U are the vectors, (n, d), at t.
        """
        return True

    def by_turn(self, p: Array, t: Array) -> Array:
        """Return the derivatives of the factors in a prescribed angle, (n_factors, k).

        They are zero where the law prescribes no angle. The equations of an angle hold half a turn
        off as well; their derivative in the angle has the opposite sign there.
        """
        return np.zeros_like(self.factors(p, t, 0))

    def turn_rate(self, p: Array, t: Array) -> Array:
        """Return the rate of a prescribed angle, (k,), zero without one; rad/s."""
        return np.zeros(len(t))


class DrivenJoint(Joint):
    """A joint whose coefficients depend on time: `coefficients` + sum_k factor_k(t) moving_k."""

    @property
    def driven(self) -> bool:
        """Return true."""
        return True

    @abc.abstractmethod
    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients that go with each of the factors of time."""

    @abc.abstractmethod
    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the factors of the moving coefficients at t, or their time derivatives."""

    @abc.abstractmethod
    def faces(self, p: Array, reference: Array, U: Array, t: float) -> bool:
        """Whether the vectors stand where the law says."""


@dataclass(frozen=True)
class Travelling(DrivenJoint):
    """A joint that moves its point along a direction, not zero, by one law, its one factor."""

    point: MaterialPoint
    direction: Sequence[float]
    travel: Law

    design_fields = (("direction", require_direction), ("travel", require_law))
    way_field = "direction"

    def faces(self, p: Array, reference: Array, U: Array, t: float) -> bool:
        """Return true: travel has no other side."""
        return True

    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return the prescribed travel, m, or its time derivative of the given order."""
        return self.travel.derivative(self.split(p)[1], t, order)[None]


def empty_equations(
    rows: int, p: Array, reference: Array, shapes: Sequence[RightAngle] = ()
) -> JointEquations:
    """Return coefficients, all zero, for `rows` equations and one more for each of `shapes`."""
    (n, d), dtype, rows = reference.shape, np.result_type(p, reference), rows + len(shapes)
    linear, bilinear = np.zeros((rows, n, d), dtype), np.zeros((rows, n, n), dtype)
    return JointEquations(linear, bilinear, np.zeros(rows, dtype), tuple(shapes))


def place_coincidence(
    c: JointEquations, count: int, reference: Array, ground: Array | None
) -> None:
    """Enter d first equations, U_0 - U_1 = 0 for two points, U_0 - ground = 0 for one.

    A ground that is not given is where U_0 is in the reference configuration.
    """
    rows = np.arange(c.linear.shape[2])
    c.linear[rows, 0, rows] = 1.0
    if count == 2:
        c.linear[rows, 1, rows] = -1.0
    else:
        c.offset[rows] = reference[0] if ground is None else ground
