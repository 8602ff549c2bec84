"""Directions in joints: fixed to ground or carried along by a section, and across another."""

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

# Sine of the angle between a direction and a section above which the direction does not count as
# lying in it; the joint then also keeps right angles of the section, by further equations. It is
# not a tolerance: a design variable may rotate directions as long as they stay on their side of it.
OUT_OF_PLANE = 0.1
# Sine s between axis and section up to which linear equations hold an axis fixed to ground. With
# them a moment across the axis stretches the section by a fraction s, which rotates it by s^2: 2e-3
# of the deflection of a beam three times its height at s = 0.05, 7e-7 here, less than the squared
# strains by which the general equations differ at s = 0. Gradients are right for axes up to it.
_LINEAR = 1e-3


def unit(vector: Array) -> Array:
    """Return the vector divided by its length; real or complex."""
    # Scaled first, so that no square under- or overflows.
    scaled: Array = vector / np.max(np.abs(vector.real))
    return scaled / np.sqrt(np.sum(scaled * scaled))


def across(direction: Array) -> Array:
    """Return d - 1 orthonormal vectors perpendicular to a direction, shape (d - 1, d).

    In space the first one is as near as possible to the coordinate axis that is most perpendicular
    to the direction, the earlier axis on a tie: for the z axis the vectors are x and y.
    """
    direction = unit(direction)
    if len(direction) == 2:
        return np.stack([np.array([-direction[1], direction[0]])])
    helper = np.zeros(3)
    helper[int(np.argmin(np.round(np.abs(direction.real), 12)))] = 1.0
    first = unit(helper - np.sum(helper * direction) * direction)
    return np.stack([first, cross(direction, first)])


def normal_of(spanning: Array) -> Array:
    """Return the unit normal, (d,), of the section that slopes span, shape (d - 1, d)."""
    if spanning.shape[1] == 2:
        return unit(np.array([spanning[0, 1], -spanning[0, 0]]))
    return unit(cross(*spanning))


class Carrier(abc.ABC):
    """Base class of a section or the ground, which carry directions of the reference along."""

    @abc.abstractmethod
    def meet(
        self, c: JointEquations, row: int, weights: Array, direction: Array, factor: float = 1.0
    ) -> None:
        """Add factor (sum_i weights_i U_i) . (`direction` carried along) to equation `row`."""


@final
class Ground(Carrier):
    """Directions fixed in space, to which joints to ground refer."""

    def meet(
        self, c: JointEquations, row: int, weights: Array, direction: Array, factor: float = 1.0
    ) -> None:
        """Add factor (sum_i weights_i U_i) . `direction` to equation `row`: linear coefficients."""
        c.linear[row] += factor * np.outer(weights, direction)


@final
class SectionFrame(Carrier):
    """The section of a point, by its d slopes among the vectors of a joint.

    A direction w of the reference is carried along as F w, the combination of the slopes that
    equals w in the reference. If w lies in the section, F w depends on the section alone; otherwise
    also on the centre line, which shears against the section. `normal` is the unit normal of the
    section in the reference, shape (d,).
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
        """Add factor (sum_i weights_i U_i) . F `direction` to equation `row`: bilinear ones."""
        product = factor * np.outer(weights, self.carried(direction))
        c.bilinear[row] += product + product.T

    def share(self, direction: Array) -> float:
        """Return |w . n| of a unit direction: 0 in the section, 1 along the normal."""
        return abs(float((direction @ self.normal).real))

    def holds(self, direction: Array) -> bool:
        """Whether a unit direction lies in the section, up to OUT_OF_PLANE."""
        return self.share(direction) < OUT_OF_PLANE

    def take_out_shear(self, c: JointEquations, row: int, e: Array, factor: float) -> None:
        """Add the term that turns the mean rotation of all slopes into that of the section.

        The mean rotation omega about e, of the skew part of F, contains half of the shear strain E
        n of the centre line against the section: e . phi = e . omega - 1/2 F n . F (e x n).
        """
        e_n = cross(e, in_space(self.normal))[: len(self.normal)]
        self.meet(c, row, self.carried(self.normal), e_n, -factor / 2)

    def flat(self) -> tuple[RightAngle, ...]:
        """Return the right angle within the section, kept by joints that rotate the section.

        If it were free, a torque would act on one axis of the section and rotate it against the
        other.
        """
        return flat_angle(self.point) if len(self.normal) == 3 else ()

    def square(self) -> tuple[RightAngle, ...]:
        """Return all right angles of a section, kept by joints with directions out of it."""
        shear = [Quantity.SLOPE_Y, Quantity.SLOPE_Z][: len(self.normal) - 1]
        return (*self.flat(), *(_angle(self.point, Quantity.SLOPE_X, other) for other in shear))

    def place_right_angle(self, c: JointEquations, row: int, angle: RightAngle) -> None:
        """Enter F w . F w' = 0 for the two section axes of `angle` as equation `row`."""
        y = unit(self._slopes[1])
        axes = [self.normal, y] if len(y) == 2 else [self.normal, y, cross(self.normal, y)]
        first, second = (axes[quantity - 1] for quantity in sorted(angle.slopes))
        self.meet(c, row, self.carried(first), second)


def flat_angle(point: MaterialPoint) -> tuple[RightAngle, ...]:
    """Return the right angle between the height and width axes of a spatial section."""
    return (_angle(point, Quantity.SLOPE_Y, Quantity.SLOPE_Z),)


def _angle(point: MaterialPoint, first: Quantity, second: Quantity) -> RightAngle:
    return RightAngle(point.beam, point.fraction, point.before, frozenset((first, second)))


def sections(points: Sequence[MaterialPoint], reference: Array) -> list[SectionFrame]:
    """Return the sections of points whose slopes are the last vectors of a joint."""
    n, d = reference.shape
    firsts = range(n - d * len(points), n, d)
    return [SectionFrame(point, reference, k) for point, k in zip(points, firsts, strict=True)]


def carrier_of(others: Sequence[SectionFrame]) -> Carrier:
    """Return the section of the second point of a joint, or the ground."""
    return others[0] if others else Ground()


def square(carrier: Carrier, unless_it_holds: Array | None = None) -> tuple[RightAngle, ...]:
    """Return the right angles of a section that carries directions; none for the ground.

    The angle within the section suffices if the section holds the direction `unless_it_holds`.
    """
    if not isinstance(carrier, SectionFrame):
        return ()
    enough = unless_it_holds is not None and carrier.holds(unless_it_holds)
    return carrier.flat() if enough else carrier.square()


def place_shapes(c: JointEquations, at: Sequence[SectionFrame]) -> None:
    """Enter the right angles of sections, `c.shapes`, as the last equations."""
    points = (section.point for section in at)
    places = dict(zip(((x.beam, x.fraction, x.before) for x in points), at, strict=True))
    for row, angle in enumerate(c.shapes, len(c.offset) - len(c.shapes)):
        places[angle.beam, angle.fraction, angle.before].place_right_angle(c, row, angle)


def is_fixed_in(section: SectionFrame, carrier: Carrier, axis: Array) -> bool:
    """Whether an axis is fixed to ground and lies in the section: then equations are linear."""
    return isinstance(carrier, Ground) and section.share(axis) < _LINEAR


def axis_torque(section: SectionFrame, axis: Array) -> tuple[RightAngle, ...]:
    """Return the right angle that transmits a torque about an axis outside the section."""
    return () if section.holds(axis) else section.flat()


def hold_axis(
    c: JointEquations, rows: slice, section: SectionFrame, carrier: Carrier, axis: Array
) -> None:
    """Enter two equations: the axis carried by the section equals the axis of the carrier.

    With e_1, e_2 across the axis a they are F e_j . a = 0, less the strain of the slopes that would
    count as a rotation of the section: 1/2 F e_j . F a + 1/2 F n . F ((e_j x a) x n). They are
    exact in every rigid motion and in rotations about the axis of any size.
    """
    for row, e in zip(range(rows.start, rows.stop), across(axis), strict=True):
        if is_fixed_in(section, carrier, axis):
            # The same, linear: (R a - a) . e_j = 0 with R a = F (a - s n) + s R n, s = a . n. For a
            # rotation about a fixed a, R n = s a + a x F (n x a): no shear is left in it.
            s, n = axis @ section.normal, section.normal
            carrier.meet(c, row, section.carried(axis - s * n), e)
            carrier.meet(c, row, section.carried(s * cross(n, axis)), cross(e, axis))
            continue
        carrier.meet(c, row, section.carried(e), axis)
        section.meet(c, row, section.carried(e), axis, -0.5)
        section.take_out_shear(c, row, cross(e, axis), 1.0)


def hold_turn(c: JointEquations, rows: slice, section: SectionFrame, other: SectionFrame) -> None:
    """Enter one equation for every rotation of a section against another one.

    e . (phi - phi') = 1/2 (F e_1 . F' e_2 - F e_2 . F' e_1), e_1 x e_2 = e, less the shear of both
    sections.
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
    """Enter e . (r - r') = offset with e carried along by the carrier; r' = 0 on the ground."""
    gap = np.zeros(c.linear.shape[1])
    gap[0] = 1.0
    if isinstance(carrier, SectionFrame):
        gap[1] = -1.0
    carrier.meet(c, row, gap, e)
    c.offset[row] = offset


def fix_turn(c: JointEquations, row: int, slopes: Array, first: int) -> None:
    """Enter that a section does not rotate: one equation in the plane, 4 in space.

    The fourth is the right angle in the section. `slopes` are the slopes that span the section,
    `first` the index of the first of them among the vectors. A single slope, as always in the
    plane, keeps its direction: d - 1 equations.
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
    """Return the normal of a section, its axes, and the slopes' weights for each axis.

    The rows of `slopes` span the section; directions have three components, in the plane too.
    """
    first = unit(in_space(slopes[0]))
    if slopes.shape[1] == 2:
        return np.cross(first, [0.0, 0.0, 1.0]), first[None], np.ones((1, 1))
    normal = normal_of(slopes)
    axes = np.stack([first, np.cross(normal, first)])
    return normal, axes, np.linalg.inv(slopes @ axes.T)
