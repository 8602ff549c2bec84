"""Torque of a motor between two sections, or on one against the ground."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_direction
from ancfdae.model.bodies import Point
from ancfdae.model.design import numbers
from ancfdae.model.loads.load import LAW, SectionLoad
from ancfdae.model.loads.sections import turn, unit_axes
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Torque(SectionLoad):
    """A motor: a torque on a section about an axis, and the opposite on another section or ground.

    It does the work T dtheta on the angle between them (docs/theory/03-joints-and-loads.md).
    Where they turn about the axis alone, as a revolute joint makes them, the moment is T times the
    axis. Design targets: ``torque``, ``axis_x`` ..., and the parameters of the law.

    Parameters
    ----------
    point : Point
    torque : float
        T; N m.
    axis : sequence of float, optional
        In space, in the reference configuration; it turns with the other section. z by default.
    other : Point, optional
        Body that carries the motor; the ground by default.
    """

    point: Point
    torque: float
    axis: Sequence[float] | None = None
    other: Point | None = None

    kind = "torque"
    design_fields = (*numbers("torque"), ("axis", require_direction), LAW)
    refers = True

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """T theta_U."""
        torque, axis, _ = self.split(p)
        return (torque * turn(U, U_o, unit_axes(axis))[1])[..., 0, :, :]
