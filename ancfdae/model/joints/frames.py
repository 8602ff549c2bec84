"""Directions of joints: across a given one, and carried along by ground or by a section."""

import abc
from collections.abc import Sequence
from typing import final

import numpy as np

from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.joint import JointEquations, RightAngle
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import in_space
from ancfdae.numerics.vector_formulas import cross

# A direction this much out of a section, as the sine of the angle, is not in it, where another
# section carries it: right angles that this one keeps then are equations more. It is no tolerance:
# directions of design variables may move within their kind.
OUT_OF_PLANE = 0.1
# Up to this sine s the linear equations of an axis fixed to ground do. A moment across it stretches
# the section through them by a share s, which turns it by s^2: 2e-3 of the deflection of a beam
# three times its height at s = 0.05, 7e-7 here, less than the squared strains by which the general
# equations differ at s = 0. Design variables may turn the axis within it, with the right gradient.
_LINEAR = 1e-3


def unit(vector: Array) -> Array:
    """Return the vector over its length; complex perturbations go through."""
    # Scaled first, so that no square under- or overflows.
    scaled: Array = vector / np.max(np.abs(vector.real))
    return scaled / np.sqrt(np.sum(scaled * scaled))


def across(direction: Array) -> Array:
    """Return d - 1 orthonormal vectors across a direction, shape (d - 1, d).

    In space the first one is as near as possible to the coordinate axis that is most across,
    the earlier one on a tie: for the z axis the vectors are x and y.
    """
    direction = unit(direction)
    if len(direction) == 2:
        return np.stack([np.array([-direction[1], direction[0]])])
    helper = np.zeros(3)
    helper[int(np.argmin(np.round(np.abs(direction.real), 12)))] = 1.0
    first = unit(helper - np.sum(helper * direction) * direction)
    return np.stack([first, cross(direction, first)])


def normal_of(spanning: Array) -> Array:
    """Return the unit normal of the section that slopes span: (1, 2) in the plane, (2, 3)."""
    if spanning.shape[1] == 2:
        return unit(np.array([spanning[0, 1], -spanning[0, 0]]))
    return unit(cross(*spanning))


class Carrier(abc.ABC):
    """Base of a section or the ground, which carries directions of the reference along."""

    @abc.abstractmethod
    def meet(
        self, c: JointEquations, row: int, weights: Array, direction: Array, factor: float = 1.0
    ) -> None:
        """Add factor (sum_i own_i U_i) . (the direction, carried along) to an equation."""


@final
class Ground(Carrier):
    """Directions fixed in space, to which joints to ground refer."""

    def meet(
        self, c: JointEquations, row: int, weights: Array, direction: Array, factor: float = 1.0
    ) -> None:
        """Add factor times (direction . weighted sum of vectors) to a row: linear coefficients."""
        c.linear[row] += factor * np.outer(weights, direction)


@final
class SectionFrame(Carrier):
    """The section of a point, by its d slopes among the vectors of a joint.

    A direction w of the reference is carried along as F w, the combination of the slopes that
    equals w in the reference. One across the normal is a matter of the section alone; of the others
    the centre line has a part, which shears against the section. `normal` is that of the section in
    the reference, shape (d,).
    """

    def __init__(self, point: MaterialPoint, reference: Array, first: int) -> None:
        d = reference.shape[1]
        self.point, self._place, self._count = point, slice(first, first + d), len(reference)
        self._slopes = reference[self._place]
        self.normal = normal_of(self._slopes[1:])

    def carried(self, direction: Array) -> Array:
        """Return the weights of all vectors of the joint in F w, shape (n_vectors,)."""
        components = np.linalg.solve(self._slopes.T, direction)
        weights = np.zeros(self._count, components.dtype)
        weights[self._place] = components
        return weights

    def meet(
        self, c: JointEquations, row: int, weights: Array, direction: Array, factor: float = 1.0
    ) -> None:
        """Add the same with the direction carried by the section: bilinear entries."""
        product = factor * np.outer(weights, self.carried(direction))
        c.bilinear[row] += product + product.T

    def share(self, direction: Array) -> float:
        """Return |w . n| of a unit direction: 0 in the section, 1 along the normal."""
        return abs(float((direction @ self.normal).real))

    def holds(self, direction: Array) -> bool:
        """Tell whether a unit direction lies in the section, or nearly so."""
        return self.share(direction) < OUT_OF_PLANE

    def take_out_shear(self, c: JointEquations, row: int, e: Array, factor: float) -> None:
        """Add to a turn of all slopes about e what makes it that of the section.

        Their mean turn, that of the skew part of F, holds half of the shear strain E n of the
        centre line against the section: e . phi = e . omega - 1/2 F n . F (e x n).
        """
        e_n = cross(e, in_space(self.normal))[: len(self.normal)]
        self.meet(c, row, self.carried(self.normal), e_n, -factor / 2)

    def flat(self) -> tuple[RightAngle, ...]:
        """Return the right angle in the section, as a joint keeps it that turns the section.

        Were it free, a torque would act on one axis of the section and turn it against the other.
        """
        return flat_angle(self.point) if len(self.normal) == 3 else ()

    def square(self) -> tuple[RightAngle, ...]:
        """Return all right angles, as a joint keeps them that carries directions off it."""
        shear = [Quantity.SLOPE_Y, Quantity.SLOPE_Z][: len(self.normal) - 1]
        return (*self.flat(), *(_angle(self.point, Quantity.SLOPE_X, other) for other in shear))

    def place_right_angle(self, c: JointEquations, row: int, angle: RightAngle) -> None:
        """Enter F w . F w' = 0 for two of its axes."""
        y = unit(self._slopes[1])
        axes = [self.normal, y] if len(y) == 2 else [self.normal, y, cross(self.normal, y)]
        first, second = (axes[quantity - 1] for quantity in sorted(angle.slopes))
        self.meet(c, row, self.carried(first), second)


def flat_angle(point: MaterialPoint) -> tuple[RightAngle, ...]:
    """Return the right angle in a section in space."""
    return (_angle(point, Quantity.SLOPE_Y, Quantity.SLOPE_Z),)


def _angle(point: MaterialPoint, first: Quantity, second: Quantity) -> RightAngle:
    return RightAngle(point.beam, point.fraction, point.before, frozenset((first, second)))


def sections(points: Sequence[MaterialPoint], reference: Array) -> list[SectionFrame]:
    """Return the sections of points whose slopes are the last vectors of a joint."""
    n, d = reference.shape
    firsts = range(n - d * len(points), n, d)
    return [SectionFrame(point, reference, k) for point, k in zip(points, firsts, strict=True)]


def carrier_of(others: Sequence[SectionFrame]) -> Carrier:
    """Return the section of the other point, or the ground."""
    return others[0] if others else Ground()


def square(carrier: Carrier, unless_it_holds: Array | None = None) -> tuple[RightAngle, ...]:
    """Return the right angles of sections that carry directions; angles within them may suffice."""
    if not isinstance(carrier, SectionFrame):
        return ()
    enough = unless_it_holds is not None and carrier.holds(unless_it_holds)
    return carrier.flat() if enough else carrier.square()


def place_shapes(c: JointEquations, at: Sequence[SectionFrame]) -> None:
    """Enter the last equations, the right angles of sections."""
    points = (section.point for section in at)
    places = dict(zip(((x.beam, x.fraction, x.before) for x in points), at, strict=True))
    for row, angle in enumerate(c.shapes, len(c.offset) - len(c.shapes)):
        places[angle.beam, angle.fraction, angle.before].place_right_angle(c, row, angle)


def is_fixed_in(section: SectionFrame, carrier: Carrier, axis: Array) -> bool:
    """Tell whether an axis is fixed to ground and lies in the section: linear equations do then."""
    return isinstance(carrier, Ground) and section.share(axis) < _LINEAR


def axis_torque(section: SectionFrame, axis: Array) -> tuple[RightAngle, ...]:
    """Return the right angle through which a section feels a torque about an axis off it."""
    return () if section.holds(axis) else section.flat()


def axis_shapes(section: SectionFrame, carrier: Carrier, axis: Array) -> tuple[RightAngle, ...]:
    """Return the right angles that `hold_axis` stands on."""
    return section.flat() + square(carrier, unless_it_holds=axis)


def hold_axis(
    c: JointEquations, rows: slice, section: SectionFrame, carrier: Carrier, axis: Array
) -> None:
    """Enter two equations: the axis stays where the carrier has it, as the section has it.

    With e_1, e_2 across the axis a they say F e_j . a = 0, less the strain of the slopes that would
    count as a turn of the section: 1/2 F e_j . F a + 1/2 F n . F ((e_j x a) x n).
    They are exact in every rigid motion and in turns about the axis of any size.
    """
    for row, e in zip(range(rows.start, rows.stop), across(axis), strict=True):
        if is_fixed_in(section, carrier, axis):
            # The same, linear: (R a - a) . e_j = 0 with R a = F (a - s n) + s R n, s = a . n. What
            # turns about a fixed a has R n = s a + a x F (n x a): no shear is left in it.
            s, n = axis @ section.normal, section.normal
            carrier.meet(c, row, section.carried(axis - s * n), e)
            carrier.meet(c, row, section.carried(s * cross(n, axis)), cross(e, axis))
            continue
        carrier.meet(c, row, section.carried(e), axis)
        section.meet(c, row, section.carried(e), axis, -0.5)
        section.take_out_shear(c, row, cross(e, axis), 1.0)


def hold_turn(c: JointEquations, rows: slice, section: SectionFrame, other: SectionFrame) -> None:
    """Enter one equation for every turn of a section against another.

    e . (phi - phi') = 1/2 (F e_1 . F' e_2 - F e_2 . F' e_1), e_1 x e_2 = e, less the shear of the
    section and of the other one.
    """
    d = len(section.normal)
    turns = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    for row, (i, j) in zip(range(rows.start, rows.stop), turns, strict=True):
        e_i, e_j = np.eye(d)[[i, j]]
        other.meet(c, row, section.carried(e_i), e_j, 0.5)
        other.meet(c, row, section.carried(e_j), e_i, -0.5)
        about = np.eye(3)[3 - i - j]
        section.take_out_shear(c, row, about, 1.0)
        other.take_out_shear(c, row, about, -1.0)


def hold_place(
    c: JointEquations, row: int, carrier: Carrier, e: Array, offset: Array | float
) -> None:
    """Enter e . (r - r') = offset, where e is carried along; r' = 0 on the ground."""
    gap = np.zeros(c.linear.shape[1])
    gap[0] = 1.0
    if isinstance(carrier, SectionFrame):
        gap[1] = -1.0
    carrier.meet(c, row, gap, e)
    c.offset[row] = offset


def fix_turn(c: JointEquations, row: int, slopes: Array, first: int) -> None:
    """Enter that a section does not turn: one equation in the plane, 4 in space; or a tangent.

    The fourth is the right angle in the section. `slopes` are those that span it, vectors `first`
    and on. The one of a line, as all in the plane are, keeps its direction: d - 1 equations.
    """
    if len(slopes) == 1:
        for k, e in enumerate(across(slopes[0])):
            c.linear[row + k, first] = e
        return
    normal, (y, z), (b_y, b_z) = spanned(slopes)
    c.linear[row, first] = c.linear[row + 1, first + 1] = normal
    c.linear[row + 2, first:] = b_y[:, None] * z
    c.linear[row + 3, first:] = b_z[:, None] * y


def spanned(slopes: Array) -> tuple[Array, Array, Array]:
    """Return the normal of a section, its axes, and the weights of its slopes that equal each.

    The slopes are those that span it; directions have three components, in the plane too.
    """
    first = unit(in_space(slopes[0]))
    if slopes.shape[1] == 2:
        return np.cross(first, [0.0, 0.0, 1.0]), first[None], np.ones((1, 1))
    normal = normal_of(slopes)
    axes = np.stack([first, np.cross(normal, first)])
    return normal, axes, np.linalg.inv(slopes @ axes.T)
