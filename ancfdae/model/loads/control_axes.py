"""Axes that controllers measure and drive: an angle of a section, a displacement of a point."""

import abc
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.model.loads.sections import section_of, travel, turn, unit_axes
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array


class ControlAxis(abc.ABC):
    """A coordinate s of the mechanism: what a controller measures, and what its effort works on.

    An effort e, a torque or a force, does the work e ds, so that the forces on the vectors U of its
    points are e s_U.
    """

    @abc.abstractmethod
    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors of points that the coordinate depends on."""

    @abc.abstractmethod
    def count(self, d: int) -> int:
        """Return the number of vectors that the axis measures and acts on, in d dimensions."""

    @abc.abstractmethod
    def coordinate(self, U: Any, U_o: Array) -> tuple[Any, Any]:
        """Return s, (..., 1, 1), and its gradient s_U, (..., n_vectors, d).

        U are the vectors and U_o the vectors in the reference configuration, where s is zero.
        """


def _require_points(where: str, point: object, other: object) -> None:
    """Raise InvalidInputError unless both are points; `other` may be None."""
    require_point(f"{where}, point", point)
    if other is not None:
        require_point(f"{where}, other", other)


def _require_components(where: str, value: object, sizes: tuple[int, ...]) -> None:
    """Raise InvalidInputError unless a vector is an array with a number of components."""
    given = np.asarray(value)
    if given.dtype.kind not in "iufc" or given.ndim != 1 or len(given) not in sizes:
        rule = f"must be an array of {' or '.join(map(str, sizes))} numbers"
        raise InvalidInputError(where, rule, repr(value), "For example np.array([1.0, 0.0, 0.0]).")


@final
@dataclass(frozen=True)
class RotationAxis(ControlAxis):
    """The angle of a section about an axis, from the reference, between -pi and pi; rad.

    Its effort is a torque, in N m. The angle jumps at half a turn; its rate does not.

    Parameters
    ----------
    point : MaterialPoint
    axis : array, shape (3,), optional
        In space, in the reference configuration; it turns with the other section. z by default.
    other : MaterialPoint, optional
        Section that the angle counts from and that takes the opposite torque; ground by default.
    """

    point: MaterialPoint
    axis: Array | None = None
    other: MaterialPoint | None = None

    def __post_init__(self) -> None:
        _require_points("RotationAxis", self.point, self.other)
        if self.axis is not None:
            _require_components("RotationAxis, axis", self.axis, (3,))

    def vectors(self, elements: Elements) -> Vectors:
        """Return the slopes that span the sections."""
        points = (self.point,) if self.other is None else (self.point, self.other)
        return section_of(points, elements)

    def count(self, d: int) -> int:
        """Return d - 1 slopes for each section."""
        return (d - 1) * (1 if self.other is None else 2)

    def coordinate(self, U: Any, U_o: Array) -> tuple[Any, Any]:
        """Return the angle and its gradient in the slopes."""
        angle, gradient = turn(U, U_o, unit_axes(self.axis))
        return angle[..., 0, :, :], gradient[..., 0, :, :]


@final
@dataclass(frozen=True)
class TranslationAxis(ControlAxis):
    """The displacement of a point along a direction since the reference; m. Its effort is a force.

    Parameters
    ----------
    point : MaterialPoint
    direction : array, shape (d,)
        In the reference configuration; it turns with the other section.
    other : MaterialPoint, optional
        Point that the displacement counts from and that takes the opposite force; ground by
        default.
    """

    point: MaterialPoint
    direction: Array
    other: MaterialPoint | None = None

    def __post_init__(self) -> None:
        _require_points("TranslationAxis", self.point, self.other)
        _require_components("TranslationAxis, direction", self.direction, (2, 3))

    def vectors(self, elements: Elements) -> Vectors:
        """Return the positions of the points, and the slopes of the section with the direction."""
        others = () if self.other is None else (self.other,)
        places = tuple((point, Quantity.POSITION) for point in (self.point, *others))
        return (*places, *section_of(others, elements))

    def count(self, d: int) -> int:
        """Return one position, or two and d - 1 slopes."""
        return 1 if self.other is None else d + 1

    def coordinate(self, U: Any, U_o: Array) -> tuple[Any, Any]:
        """Return the displacement and its gradient in positions and slopes."""
        return travel(U, U_o, self.direction, self.other is not None)
