"""Obstacles that bodies touch: plane, sphere and cylinder, on the ground or carried by a body."""

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.errors.checks import (
    require_direction,
    require_flag,
    require_kind,
    require_positive,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import Designable
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import direction, dot

#: Fraction of the radius that bounds distances from a centre from below: at zero they have no
#: direction.
CENTRE = 1e-12


@final
class Carrier(NamedTuple):
    """Axes of the body that carries an obstacle: origin and directions, now and in the reference.

    Without directions, (0, d), the obstacle is fixed to the ground.
    """

    origin: Any
    axes: Any
    origin_o: Array
    axes_o: Array

    def place(self, place: Array) -> Any:
        """Return the present position, (1, d), of a point given in the reference configuration."""
        if not len(self.axes_o):
            return place[None]
        return self.origin + self.turned(place - self.origin_o[0])

    def turned(self, vector: Array) -> Any:
        """Return a vector of the reference configuration rotated with the body, (1, d)."""
        if not len(self.axes_o):
            return vector[None]
        parts = vector @ np.linalg.inv(self.axes_o)
        return (parts[:, None] * self.axes).sum(axis=-2, keepdims=True)


class Obstacle(Designable, abc.ABC):
    """A surface with an outward normal, declared in the reference configuration."""

    def __post_init__(self) -> None:
        self.check_fields(type(self).__name__)

    def check_space(self, where: str, d: int) -> None:
        """Raise InvalidInputError if a vector of the obstacle does not have d components."""
        for name, value in self._design_values():
            if np.ndim(value) == 1:
                require_vector(f"{where}, {name}", value, (d,))

    @abc.abstractmethod
    def surface(self, c: Any, carrier: Carrier, p: Array) -> tuple[Any, Any]:
        """Return the distance of points c, (..., 1, d), from the surface, and the normal there.

        The distance, (..., 1, 1), m, is negative inside the obstacle. p holds the values of
        `parameters`.
        """


@final
@dataclass(frozen=True)
class Plane(Obstacle):
    """A half space that bodies stay out of; in the plane a half plane.

    Parameters
    ----------
    place : sequence of float
        A point on its surface; m.
    normal : sequence of float
        Outward direction, of any length; dimensionless.
    """

    place: Sequence[float]
    normal: Sequence[float]

    design_fields = (("place", require_vector), ("normal", require_direction))

    def surface(self, c: Any, carrier: Carrier, p: Array) -> tuple[Any, Any]:
        """Return the distance n . (c - place), shape (..., 1, 1), m, and the normal n."""
        place, normal = self.split(p)
        n = carrier.turned(direction(normal)[1])
        return dot(c - carrier.place(place), n), n + 0.0 * c


def _round(e: Any, radius: Any, inside: bool) -> tuple[Any, Any]:
    """Return the distance from a round surface, at e from its centre or axis, and the normal."""
    l = np.sqrt(dot(e, e) + (CENTRE * radius) ** 2)
    return (radius - l, -e / l) if inside else (l - radius, e / l)


@final
@dataclass(frozen=True)
class Sphere(Obstacle):
    """A ball that bodies stay out of, or a hollow ball that they stay in; in the plane a circle.

    Parameters
    ----------
    place : sequence of float
        Centre of the sphere; m.
    radius : float
        Radius, positive; m.
    inside : bool, optional
        Whether bodies are inside, as a ball in a socket or a journal in its bearing.
    """

    place: Sequence[float]
    radius: float
    inside: bool = False

    design_fields = (("place", require_vector), ("radius", require_positive))

    def __post_init__(self) -> None:
        super().__post_init__()
        require_flag("Sphere, inside", self.inside)

    def surface(self, c: Any, carrier: Carrier, p: Array) -> tuple[Any, Any]:
        """Return the distance |c - place| - radius, m, and the direction of c - place."""
        place, radius = self.split(p)
        return _round(c - carrier.place(place), radius, self.inside)


@final
@dataclass(frozen=True)
class Cylinder(Obstacle):
    """A cylinder without ends, in space, that bodies stay out of, or a pipe that they stay in.

    Parameters
    ----------
    place : sequence of float
        A point on its axis; m.
    axis : sequence of float
        Direction of the axis, of any length; dimensionless.
    radius : float
        Radius, positive; m.
    inside : bool, optional
        Whether bodies are inside, as a rod in a pipe.
    """

    place: Sequence[float]
    axis: Sequence[float]
    radius: float
    inside: bool = False

    design_fields = (
        ("place", require_vector),
        ("axis", require_direction),
        ("radius", require_positive),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_flag("Cylinder, inside", self.inside)

    def check_space(self, where: str, d: int) -> None:
        """Raise InvalidInputError in the plane, or for a vector without three components."""
        if d == 2:
            rule, repair = "must be a circle in the plane", "Write Sphere(place, radius)."
            raise InvalidInputError(where, rule, "a Cylinder", repair)
        super().check_space(where, d)

    def surface(self, c: Any, carrier: Carrier, p: Array) -> tuple[Any, Any]:
        """Return the distance from the axis less the radius, m, and the radial direction."""
        place, axis, radius = self.split(p)
        a, e = carrier.turned(direction(axis)[1]), c - carrier.place(place)
        return _round(e - dot(e, a) * a, radius, self.inside)


def require_obstacle(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is an `Obstacle`."""
    repair = "For example Plane(place=(0, 0, 0), normal=(0, 0, 1))."
    require_kind(where, value, (Obstacle,), repair)
