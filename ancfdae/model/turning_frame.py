"""A frame that turns at a constant rate, in which a scene is declared."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.checks import require_direction, require_finite, require_kind, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import Designable
from ancfdae.numerics.arrays import Array, Numbers

# Gravity across the axis, relative to its size, that is round-off of the directions.
_ACROSS = 1e-12


@final
@dataclass(frozen=True)
class RotatingFrame(Designable):
    """The frame of a scene that turns steadily about a fixed axis: blades, shafts, discs.

    All of the scene is declared in it and turns with it: ground, directions of forces, dampers to
    ground. What was at rest in it turns steadily; centrifugal and gyroscopic forces are added.
    Gravity must act along the axis. Design targets ``scene.rate``, and ``scene.axis_x`` ...,
    ``scene.through_x`` ... where they are given.

    Parameters
    ----------
    rate : float
        Positive about the axis, in the plane counterclockwise; rad/s.
    axis : sequence of float, optional
        In space; z by default. Not in the plane.
    through : sequence of float, optional
        A point of the axis; the origin by default.
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
        """Refuse vectors of another space, and gravity that turns in the frame."""
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
        """Return rate, matrix J of the turn by a right angle, J x = axis x x, and point."""
        rate, axis, through = self.split(p)
        through = np.zeros(dimension) if through is None else through
        if dimension == 2:
            return rate, np.array([[0.0, -1.0], [1.0, 0.0]]), through
        x, y, z = np.array([0.0, 0.0, 1.0]) if axis is None else axis / (axis @ axis) ** 0.5
        return rate, np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]), through


def require_frame(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is a `RotatingFrame`."""
    require_kind(where, value, (RotatingFrame,), "For example RotatingFrame(rate=10).")
