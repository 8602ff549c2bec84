"""Friction against rotation and sliding, by a differentiable function of the speed.

It acts between two bodies, or on the guide of a sliding joint along its beam or cable.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import (
    require_direction,
    require_positive,
    require_text,
    require_together,
)
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.design import design_numbers
from ancfdae.model.loads.load import LAW_FIELD, Load, SectionLoad
from ancfdae.model.loads.sections import rate_of, section_of, travel, turn, unit_axes
from ancfdae.model.parts import Elements, StateVector, Vectors
from ancfdae.numerics.arrays import Array

#: Design fields of the friction curve, in the order of `friction`, and those that are zero without
#: it.
LEVELS = (
    *design_numbers("coulomb"),
    ("smooth_speed", require_positive),
    *design_numbers("viscous", "breakaway"),
    ("stribeck_speed", require_positive),
)
DAMPING = ("coulomb", "viscous", "breakaway")


def friction(speed: Any, levels: tuple[Any, ...]) -> Any:
    """Return the friction force or torque at a relative speed w, with the sign of the speed.

    R = (c + (b - c) exp(-(w/w_s)^2)) tanh(w/w_0) + d w: above w_s the level falls from the
    breakaway level b to Coulomb's level c (Stribeck); below w_0 the curve is smoothed. `levels` are
    c, w_0, d, b and w_s, the last two None without breakaway.
    """
    coulomb, smooth_speed, viscous, breakaway, stribeck_speed = levels
    level = coulomb
    if breakaway is not None:
        level = coulomb + (breakaway - coulomb) * np.exp(-np.square(speed / stribeck_speed))
    return level * np.tanh(speed / smooth_speed) + viscous * speed


@final
@dataclass(frozen=True)
class RotationalFriction(SectionLoad):
    """Dry and viscous friction about an axis between two sections, or a section and the ground.

    With w = theta' the relative angular velocity the torque on the section is
    -((c + (b - c) exp(-(w/w_s)^2)) tanh(w/w_0) + d w). The levels are constant: they do not depend
    on the force in the joint. There is no sticking: below w_0 a torque makes the sections creep.
    Steps must resolve the time in which w passes w_0. Design targets: ``coulomb``,
    ``smooth_speed``, ``viscous``, ``breakaway``, ``stribeck_speed`` and ``axis_x`` ...

    Parameters
    ----------
    point : MaterialPoint
    coulomb : float
        Coulomb torque c; N m.
    smooth_speed : float
        Smoothing speed w_0, positive; rad/s.
    viscous : float
        Viscous coefficient d; N m s/rad.
    breakaway, stribeck_speed : float, optional
        Breakaway torque b; N m; and Stribeck speed w_s, positive; rad/s.
    axis, other
        As in `MotorTorque`; `other` is a point of the second body of the joint.
    """

    point: MaterialPoint
    coulomb: float
    smooth_speed: float
    viscous: float = 0.0
    breakaway: float | None = None
    stribeck_speed: float | None = None
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    sharp = False
    kind = "friction"
    elastic = True
    design_fields = (*LEVELS, ("axis", require_direction), LAW_FIELD)
    damping_fields = DAMPING
    refers = True

    def __post_init__(self) -> None:
        super().__post_init__()
        given = {"breakaway": self.breakaway, "stribeck_speed": self.stribeck_speed}
        require_together(f"load {self.name!r}", given)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the forces -R(theta') theta_U on slopes of a friction moment R, U: slopes; N m."""
        *levels, axis, _ = self.split(p)
        theta_U = turn(U, U_o, unit_axes(axis))[1]
        speed = rate_of(theta_U, V[..., None, :, :])
        return -(friction(speed, tuple(levels)) * theta_U)[..., 0, :, :]


@final
@dataclass(frozen=True)
class TranslationalFriction(Load):
    """Dry and viscous friction of a point along a line, on the ground or on another section.

    With w the speed along the line, the force in N follows the curve of `RotationalFriction`.
    Design targets: ``direction_x`` ..., ``coulomb``, ``smooth_speed``, ``viscous``, ``breakaway``
    and ``stribeck_speed``.

    Parameters
    ----------
    point : MaterialPoint
    direction : sequence of float
        Direction of the line in the reference configuration; it rotates with `other`.
    coulomb, smooth_speed, viscous, breakaway, stribeck_speed
        As in `RotationalFriction`, in N, m/s, N s/m, N and m/s.
    other : MaterialPoint, optional
        A point of the line, on a beam; the line is on the ground by default.
    """

    point: MaterialPoint
    direction: Sequence[float]
    coulomb: float
    smooth_speed: float
    viscous: float = 0.0
    breakaway: float | None = None
    stribeck_speed: float | None = None
    other: MaterialPoint | None = None

    sharp = False
    kind = "slide-friction"
    elastic = True
    design_fields = (("direction", require_direction), *LEVELS, LAW_FIELD)
    damping_fields = DAMPING
    refers = True

    def __post_init__(self) -> None:
        super().__post_init__()
        given = {"breakaway": self.breakaway, "stribeck_speed": self.stribeck_speed}
        require_together(f"load {self.name!r}", given)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the positions of the points, and the slopes of the section with the line."""
        places = tuple((point, Quantity.POSITION) for point in self.points)
        return (*places, *section_of(self.points[1:], elements))

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return -R(x') x_U with x = a . (r - r_other), the forces on the vectors; N."""
        along, *levels, _ = self.split(p)
        gradient = travel(U, U_o, along, self.other is not None)[1]
        return -friction(rate_of(gradient, V), tuple(levels)) * gradient


@final
@dataclass(frozen=True)
class SlidingFriction(Load):
    """Dry and viscous friction of the guide of a `SlidingJoint` along the beam.

    With w = s' the rate of the arc length, the force along the beam in N follows the curve of
    `RotationalFriction`. It acts on the guide and the opposite on the beam. The levels are
    constant: they do not depend on the force across the beam. Design targets: ``coulomb``,
    ``smooth_speed``, ``viscous``, ``breakaway`` and ``stribeck_speed``.

    Parameters
    ----------
    joint : str
        Name of the sliding joint.
    coulomb, smooth_speed, viscous, breakaway, stribeck_speed
        As in `RotationalFriction`, in N, m/s, N s/m, N and m/s.
    """

    joint: str
    coulomb: float
    smooth_speed: float
    viscous: float = 0.0
    breakaway: float | None = None
    stribeck_speed: float | None = None

    sharp = False
    kind = "sliding-friction"
    elastic = True
    design_fields = (*LEVELS, LAW_FIELD)
    damping_fields = DAMPING

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"load {self.name!r}"
        require_text(f"{where}, joint", self.joint)
        given = {"breakaway": self.breakaway, "stribeck_speed": self.stribeck_speed}
        require_together(where, given)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vector that the force acts on: the arc length of the sliding joint."""
        return (StateVector(self.joint, 0),)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the friction force -R(s') on the arc length; N."""
        *levels, _ = self.split(p)
        along = np.eye(U_o.shape[1])[:1]
        return -friction(V[..., :1, :1], tuple(levels)) * along
