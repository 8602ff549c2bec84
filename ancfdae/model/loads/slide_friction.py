"""Friction against sliding along a line."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_direction
from ancfdae.model.bodies import Point, Quantity
from ancfdae.model.loads.friction import DAMPING, LEVELS, friction, require_stribeck
from ancfdae.model.loads.load import LAW, Load
from ancfdae.model.loads.sections import CarriedAxes, rate_of, section_of
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.jets import concatenate, direction, dot


@final
@dataclass(frozen=True)
class SlideFriction(Load):
    """Dry and viscous friction of a point along a line, on the ground or on another section.

    With w the speed along the line the force is the curve of `JointFriction`, in newton. Design
    targets: ``direction_x`` ..., ``coulomb``, ``smooth_speed``, ``viscous``, ``breakaway`` and
    ``stribeck_speed``.

    Parameters
    ----------
    point : Point
    direction : sequence of float
        Of the line in the reference configuration; it turns with the other section.
    coulomb : float
        c; N.
    smooth_speed : float
        w_0, positive; m/s.
    viscous : float
        d; N s/m.
    breakaway, stribeck_speed : float, optional
        b, in N, and w_s, positive, in m/s.
    other : Point, optional
        A point of the line, on a beam; the line is on the ground by default.
    """

    point: Point
    direction: Sequence[float]
    coulomb: float
    smooth_speed: float
    viscous: float = 0.0
    breakaway: float | None = None
    stribeck_speed: float | None = None
    other: Point | None = None

    kind = "slide-friction"
    elastic = True
    design_fields = (("direction", require_direction), *LEVELS, LAW)
    damping_fields = DAMPING
    refers = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require_stribeck(f"load {self.name!r}", self.breakaway, self.stribeck_speed)

    def vectors(self, elements: Elements) -> Vectors:
        """Positions of the points and slopes of the section that has the line."""
        places = tuple((point, Quantity.POSITION) for point in self.points)
        return (*places, *section_of(self.points[1:], elements))

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """-R(x') x_U with x = a . (r - r_other)."""
        along, *levels, _ = self.split(p)
        rows, carrier = along[None], CarriedAxes(U[..., 2:, :], U_o[2:])
        size, a = direction(carrier.of(rows))
        gradient = a + 0.0 * U[..., :1, :]
        if self.other is not None:
            e = U[..., :1, :] - U[..., 1:2, :]
            on_line = carrier.pull_back(rows, (e - dot(e, a) * a) / size)
            gradient = concatenate([gradient, -gradient, on_line])
        return -friction(rate_of(gradient, V), tuple(levels)) * gradient
