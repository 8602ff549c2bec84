"""Spring and damper against turning."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_direction
from ancfdae.model.bodies import Point
from ancfdae.model.design import numbers
from ancfdae.model.loads.load import LAW, SectionLoad
from ancfdae.model.loads.sections import rate_of, turn, unit_axes
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class TorsionSpring(SectionLoad):
    """Linear spring and damper about an axis between two sections, or a section and the ground.

    The torque on the section is -(k (theta - theta_0) + c theta'), with theta the angle from the
    reference, between -pi and pi (docs/theory/03-joints-and-loads.md). A turn beyond pi
    comes out at -pi: there the torque of the spring jumps, and a run does not pass. Design targets:
    ``stiffness``, ``damping``, ``free_angle`` and ``axis_x`` ...

    Parameters
    ----------
    point : Point
    stiffness : float
        k; N m/rad.
    damping : float
        c; N m s/rad.
    free_angle : float
        theta_0; rad.
    axis : sequence of float, optional
        In space, in the reference configuration; it turns with the other section. z by default.
    other : Point, optional
        What the spring is fixed to; the ground by default.
    """

    point: Point
    stiffness: float
    damping: float = 0.0
    free_angle: float = 0.0
    axis: Sequence[float] | None = None
    other: Point | None = None

    kind = "torsion-spring"
    elastic = True
    design_fields = (
        *numbers("stiffness", "damping", "free_angle"),
        ("axis", require_direction),
        LAW,
    )
    damping_fields = ("damping",)
    refers = True

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """-(k (theta - theta_0) + c theta') theta_U."""
        k, damping, free_angle, axis, _ = self.split(p)
        theta, theta_U = turn(U, U_o, unit_axes(axis))
        torque = k * (theta - free_angle) + damping * rate_of(theta_U, V[..., None, :, :])
        return -(torque * theta_U)[..., 0, :, :]
