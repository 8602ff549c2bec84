"""Moment on a section."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_axial, require_flag
from ancfdae.model.bodies import Point
from ancfdae.model.loads.load import LAW, SectionLoad
from ancfdae.model.loads.sections import QUARTER_TURN
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.jets import concatenate, cross, direction, dot


@final
@dataclass(frozen=True)
class Moment(SectionLoad):
    """A moment on a section of a beam.

    It does the work M . dphi on a turn dphi of the section. The section turns as its plane does,
    and in this plane with the mean of its slopes: with n across r_y and r_z and r^y, r^z dual to
    them in the plane, the force on r_k is (M - (M . n) n / 2) x r^k. In the plane of a planar
    scene the section turns with r_y (a cable, which has none, with its tangent), and
    the force is M x r_y / |r_y|^2 (docs/theory/03-joints-and-loads.md). Cables in space have no
    section to take it. Design targets: ``moment`` in the plane; ``moment_x``, ``moment_y``,
    ``moment_z`` in space.

    Parameters
    ----------
    point : Point
    moment : float or sequence of float
        A number in the plane, from x to y; three components in space; N m.
    follower : bool, optional
        Whether the components are along n and the height and width slopes, and turn with them,
        instead of being fixed in space. In the plane there is no difference.
    """

    point: Point
    moment: float | Sequence[float]
    follower: bool = False

    kind = "moment"
    design_fields = (("moment", require_axial), LAW)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_flag("moment, follower", self.follower)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """(M - (M . n) n / 2) x r^k."""
        M = self.split(p)[0]
        if U_o.shape[1] == 2:
            return M * (U @ QUARTER_TURN) / dot(U, U)
        r_y, r_z = U[..., :1, :], U[..., 1:, :]
        s, n = direction(cross(r_y, r_z))
        if self.follower:
            axes = concatenate([n, direction(U)[1]])
            M = (M[:, None] * axes).sum(axis=-2, keepdims=True)
        duals = concatenate([cross(r_z, n), cross(n, r_y)]) / s
        return cross(M - 0.5 * dot(M, n) * n, duals)
