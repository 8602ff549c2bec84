"""A frame that rotates at a constant rate, in which a scene can be declared."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.checks import require_direction, require_finite, require_kind, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import Designable
from ancfdae.numerics.arrays import Array, Numbers

# Gravity across the axis, relative to its magnitude, that counts as round-off of the directions.
_ACROSS = 1e-12


@final
@dataclass(frozen=True)
class RotatingFrame(Designable):
    """A frame that rotates steadily about a fixed axis: for blades, shafts, discs.

    The whole scene is declared in the frame and rotates with it: ground, directions of forces,
    dampers to ground. Bodies at rest in it rotate steadily; centrifugal and gyroscopic forces are
    added. Gravity must act along the axis. Design targets ``scene.rate``, and ``scene.axis_x`` ...,
    ``scene.through_x`` ... where they are given.

    Parameters
    ----------
    rate : float
        Angular velocity, positive about the axis, in the plane counterclockwise; rad/s.
    axis : sequence of float, optional
        Axis in space; z by default. Must be left out in the plane.
    through : sequence of float, optional
        A point of the axis; the origin by default; m.
    """

    rate: float
    axis: Sequence[float] | None = None
    through: Sequence[float] | None = None

    design_fields = (
        ("rate", require_finite),
        ("axis", require_direction),
        ("through", require_vector),
    )

    def __post_init__(self) -> None:
        self.check_fields("RotatingFrame")

    def check(self, dimension: int, gravity: Numbers | None) -> None:
        """Raise InvalidInputError for vectors of another dimension, and gravity across the axis."""
        if self.axis is not None:
            require_vector("RotatingFrame.axis, which is for space", self.axis, (3,))
            if dimension == 2:
                rule, repair = "must be left out in the plane", "A plane turns about z."
                raise InvalidInputError("RotatingFrame.axis", rule, self.axis, repair)
        if self.through is not None:
            require_vector("RotatingFrame.through", self.through, (dimension,))
        g = np.zeros(dimension) if gravity is None else np.array(gravity, dtype=float)
        across = self.turn(np.array(list(self.parameters().values())), dimension)[1] @ g
        if np.linalg.norm(across) > _ACROSS * np.linalg.norm(g):
            raise InvalidInputError(
                "Scene.gravity",
                "must act along the axis of the rotating frame, in which another direction rotates",
                g.tolist(),
                "Omit gravity, or drive the scene by a RotationDriver in a frame at rest.",
            )

    def turn(self, p: Array, dimension: int) -> tuple[Array, Array, Array]:
        """Return the rate, rad/s, the matrix J with J x = axis x x, and a point of the axis; m."""
        rate, axis, through = self.split(p)
        through = np.zeros(dimension) if through is None else through
        if dimension == 2:
            return rate, np.array([[0.0, -1.0], [1.0, 0.0]]), through
        x, y, z = np.array([0.0, 0.0, 1.0]) if axis is None else axis / (axis @ axis) ** 0.5
        return rate, np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]), through


def require_frame(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is a `RotatingFrame`."""
    require_kind(where, value, (RotatingFrame,), "For example RotatingFrame(rate=10).")
