"""Friction against turning in a pin or revolute joint."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_direction
from ancfdae.model.bodies import Point
from ancfdae.model.loads.friction import DAMPING, LEVELS, friction, require_stribeck
from ancfdae.model.loads.load import LAW, SectionLoad
from ancfdae.model.loads.sections import rate_of, turn, unit_axes
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class JointFriction(SectionLoad):
    """Dry and viscous friction about an axis between two sections, or a section and the ground.

    With w = theta' the relative angular velocity the torque on the section is
    -((c + (b - c) exp(-(w/w_s)^2)) tanh(w/w_0) + d w). The level is constant: it does not follow
    the force in the joint. It never holds quite still: below w_0 a torque makes it creep. Steps
    must resolve the time in which w passes w_0. Design targets: ``coulomb``, ``smooth_speed``,
    ``viscous``, ``breakaway``, ``stribeck_speed`` and ``axis_x`` ...

    Parameters
    ----------
    point : Point
    coulomb : float
        c; N m.
    smooth_speed : float
        w_0, positive; rad/s.
    viscous : float
        d; N m s/rad.
    breakaway, stribeck_speed : float, optional
        b, in N m, and w_s, positive, in rad/s.
    axis : sequence of float, optional
        In space, in the reference configuration; it turns with the other section. z by default.
    other : Point, optional
        The other part of the joint; the ground by default.
    """

    point: Point
    coulomb: float
    smooth_speed: float
    viscous: float = 0.0
    breakaway: float | None = None
    stribeck_speed: float | None = None
    axis: Sequence[float] | None = None
    other: Point | None = None

    kind = "friction"
    elastic = True
    design_fields = (*LEVELS, ("axis", require_direction), LAW)
    damping_fields = DAMPING
    refers = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require_stribeck(f"load {self.name!r}", self.breakaway, self.stribeck_speed)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """-R(theta') theta_U."""
        *levels, axis, _ = self.split(p)
        theta_U = turn(U, U_o, unit_axes(axis))[1]
        speed = rate_of(theta_U, V[..., None, :, :])
        return -(friction(speed, tuple(levels)) * theta_U)[..., 0, :, :]
