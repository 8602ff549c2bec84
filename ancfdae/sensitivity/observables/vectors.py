"""Observables of material points: components of positions, velocities and slopes."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.functions import Function
from ancfdae.sensitivity.observables.observable import Columns, Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import (
    Named,
    States,
    known_naming,
    known_scene,
    require_index,
)


def position(point: MaterialPoint, axis: int) -> Observable:
    """Return a component of the position of a point such as ``beam.at_end``; m.

    Axes 0, 1 and 2 are x, y and z.
    """
    return VectorComponent(point, Quantity.POSITION, axis)


def velocity(point: MaterialPoint, axis: int) -> Observable:
    """Return a component of the velocity of a point; m/s. Axes as in `position`."""
    return VectorComponent(point, Quantity.POSITION, axis, rate=True)


def slope(point: MaterialPoint, along: int, axis: int) -> Observable:
    """Return a component of a slope vector; axes as in `position`.

    `along` is 0 for the tangent, 1 and 2 for the slopes along the section's height and width.
    """
    require_index("slope, along", along)
    return VectorComponent(point, Quantity(along + 1), axis)


def deflection(point: MaterialPoint, frame_at: MaterialPoint) -> Observable:
    """Return the deflection of a point in a frame that moves with the centre line; m.

    The frame sits at `frame_at` with its first axis along the x-y part of the tangent there;
    the deflection is the component of point - frame_at along its second axis, which is the
    first one turned by +90 degrees about z. In space the z components play no part.
    """
    t_x, t_y = slope(frame_at, 0, 0), slope(frame_at, 0, 1)
    arm_x, arm_y = (position(point, i) - position(frame_at, i) for i in (0, 1))
    return (t_x * arm_y - t_y * arm_x) / (t_x * t_x + t_y * t_y) ** 0.5


def slope_angle(point: MaterialPoint) -> Observable:
    """Return the angle of the tangent in the x-y plane, from x towards y; rad.

    It starts between -pi and pi and is continuous in time over full turns, provided that the
    tangent turns by less than half a turn between neighbouring instants.
    """
    t_x, t_y = slope(point, 0, 0), slope(point, 0, 1)
    angle = t_x.combined(Function("slope_angle", angle_of, edged=False), (t_x, t_y))
    return angle + Turns(angle)


def axial_strain(point: MaterialPoint) -> Observable:
    """Return the Green-Lagrange strain along the beam, (r_x . r_x / |r_ox|^2 - 1)/2.

    r_ox is the slope in the reference configuration, not of unit length off the centre line of
    curved and twisted beams and between their nodes.
    """
    x, y, z = (VectorComponent(point, Quantity.SLOPE_X, i, may_lack=True) for i in range(3))
    return 0.5 * ((x * x + y * y + z * z) / ReferenceSquare(point) - 1.0)


def angle_of(x: Array, y: Array) -> Array:
    """Return the angle of (x, y) from -pi to pi; analytic, as the remaining angle is small."""
    turn = np.arctan2(y.real, x.real)
    c, s = np.cos(turn), np.sin(turn)
    angle: Array = turn + np.arctan((c * y - s * x) / (c * x + s * y))
    return angle


@final
@dataclass(frozen=True)
class Turns(Leaf):
    """Full turns since the start of the run of an angle that lies between -pi and pi; rad."""

    remembers: ClassVar[bool] = True

    angle: Observable

    def check_leaf(self, system: Named) -> None:
        """Refuse an angle that the system does not have."""
        self.angle.check(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Add or take a turn where the angle would jump by more than half of one."""
        angle = self.angle.value(system, states).real
        turns = 2 * np.pi * np.round((np.unwrap(angle) - angle) / (2 * np.pi))
        return np.asarray(turns + states.past.get(self, 0.0))

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return none: turns stay as they are."""
        return LeafGradient()


@final
@dataclass(frozen=True)
class ReferenceSquare(Leaf):
    """Squared length of the slope along a beam in the reference configuration."""

    point: MaterialPoint

    def check_leaf(self, system: Named) -> None:
        """Refuse a point that does not exist, or a solution without its system."""
        known_scene(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """|r_ox|^2, the same at every instant."""
        r_ox, _ = known_scene(system).inputs.in_reference(self.point, Quantity.SLOPE_X)
        return np.full(len(states.t), np.sum(r_ox * r_ox))

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """2 r_ox . r_oxb."""
        r_ox, r_oxb = known_scene(system).inputs.in_reference(self.point, Quantity.SLOPE_X)
        return LeafGradient(b=np.tile(2 * r_ox @ r_oxb, (len(states.t), 1)))


@final
@dataclass(frozen=True)
class VectorComponent(Leaf):
    """A component of a position or slope vector, or of its time derivative if `rate`.

    If it `may_lack`, it is zero where the plane has none.
    """

    point: MaterialPoint
    quantity: Quantity
    axis: int
    rate: bool = False
    may_lack: bool = False

    def __post_init__(self) -> None:
        require_point("observable, point", self.point)
        require_index("observable, axis", self.axis)

    def check_leaf(self, system: Named) -> None:
        """Refuse a point or an axis that does not exist."""
        naming = known_naming(system)
        naming.layout.body(self.point.beam)
        if not self.may_lack:
            require_index("observable, axis", self.axis, naming.layout.d)
        if self.quantity is not Quantity.POSITION:
            require_index("slope, along", int(self.quantity) - 1, naming.layout.d)
        naming.vector(self.point, self.quantity)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Weights times coordinates or velocities."""
        columns, weights, _ = self._combination(system)
        value: Array = self._of(states)[:, columns] @ weights
        return value

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the weights, and their design derivatives times the coordinates."""
        columns, weights, weights_b = self._combination(system)
        rows = Columns(columns, weights[None])
        b = self._of(states)[:, columns] @ weights_b if np.any(weights_b) else None
        return LeafGradient(v=rows, b=b) if self.rate else LeafGradient(q=rows, b=b)

    def _of(self, states: States) -> Array:
        return states.v if self.rate else states.q

    def _combination(self, system: Named) -> tuple[Array, Array, Array]:
        """Columns, weights and their design derivatives of the coordinates that matter."""
        naming = known_naming(system)
        vector = naming.vector(self.point, self.quantity)
        # A weight is a power of the length times a number, and vanishes with its derivative.
        used = (vector.weights != 0) & (self.axis < naming.layout.d)
        columns = vector.vectors[used] * naming.layout.d + self.axis
        return columns, vector.weights[used], vector.weights_b[used]
