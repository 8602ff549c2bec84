"""Spring and damper between two points, or between a point and the ground."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_vector
from ancfdae.model.bodies import Point, Quantity
from ancfdae.model.design import numbers
from ancfdae.model.drawing import Stroke
from ancfdae.model.loads.load import LAW, Load
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.jets import concatenate, direction, dot


@final
@dataclass(frozen=True)
class SpringDamper(Load):
    """Linear spring and damper along the line between two points.

    With e = r(point) - r(other), l = |e| and n = e/l: F(point) = -(k (l - l_0) + c l') n, and
    the opposite on the other point. Design targets: ``stiffness``, ``damping``,
    ``free_length``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : Point
    stiffness : float
        k; N/m.
    damping : float
        c; N s/m.
    free_length : float
        l_0; m.
    other : Point, optional
    ground : sequence of float, optional
        Just one of `other` and `ground` must be given.
    """

    point: Point
    stiffness: float
    damping: float = 0.0
    free_length: float = 0.0
    other: Point | None = None
    ground: Sequence[float] | None = None

    kind = "spring"
    stroke = Stroke.SPRING
    elastic = True
    design_fields = (
        *numbers("stiffness", "damping", "free_length"),
        ("ground", require_vector),
        LAW,
    )
    damping_fields = ("damping",)
    needs_other_end = True

    def vectors(self, elements: Elements) -> Vectors:
        """Positions of the points."""
        return tuple((point, Quantity.POSITION) for point in self.points)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """-(k (l - l_0) + c l') n on the first point, the opposite on the second."""
        k, damping, free_length, ground, _ = self.split(p)
        e, w = U[..., :1, :], V[..., :1, :]
        e, w = (e - ground, w) if self.other is None else (e - U[..., 1:, :], w - V[..., 1:, :])
        l, n = direction(e)
        F = -(k * (l - free_length) + damping * dot(n, w)) * n
        return F if self.other is None else concatenate([F, -F])
