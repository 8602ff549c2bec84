"""Friction of a guide along the beam or cable of a sliding joint."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_text, require_together
from ancfdae.model.loads.friction import DAMPING, LEVELS, friction
from ancfdae.model.loads.load import LAW_FIELD, Load
from ancfdae.model.parts import Elements, StateVector, Vectors
from ancfdae.numerics.arrays import Array


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
