"""Material points of beams and rigid bodies."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.checks import require_finite, require_flag, require_kind, require_text
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class MaterialPoint:
    """A material point of a beam or a rigid body.

    Parameters
    ----------
    beam : str
        Name of the beam or rigid body that the point belongs to.
    fraction : float, optional
        Arc-length fraction along the beam, 0 at the start, 1 at the end; None for a body.
    y, z : float
        Offset from the centre line along the section's axes, or coordinates along the axes of the
        body; m.
    x : float
        Coordinate along the first axis of the body; m. Zero for a beam.
    before : bool
        At an inner node of a beam: whether the point takes its slope along the beam and its
        section forces from the element that ends there. By default from the element that begins
        there.

    Raises
    ------
    InvalidInputError
        If the fraction lies outside [0, 1], a number is not finite or both x and the fraction are
        given.
    """

    beam: str
    fraction: float | None = None
    y: float = 0.0
    z: float = 0.0
    x: float = 0.0
    before: bool = False

    def __post_init__(self) -> None:
        require_text("point, beam", self.beam)
        where = f"point of {self.beam!r}"
        require_flag(f"{where}, before", self.before)
        for value in (self.x, self.y, self.z):
            require_finite(where, value)
        if self.before and not self.fraction:
            rule = "must be False at the start of a beam and in a body: nothing lies before"
            raise InvalidInputError(f"{where}, before", rule, f"True at fraction {self.fraction}")
        if self.fraction is None:
            return
        require_finite(where, self.fraction)
        if self.x != 0:
            rule = "needs either a fraction along a beam or an x in a body"
            got = f"both: {self.fraction}, {self.x}"
            raise InvalidInputError(
                where, rule, got, "Write beam.at(fraction, y), or body.at(x, y)."
            )
        require_fraction(where, self.fraction)

    def numbers(self) -> dict[str, float]:
        """Return the coordinates of the point by name: fraction, y, z; in a rigid body x, y, z."""
        first = {"x": self.x} if self.fraction is None else {"fraction": self.fraction}
        return first | {"y": self.y, "z": self.z}

    def __str__(self) -> str:
        if self.fraction is not None:
            return f"{self.beam}@{self.fraction:g}{' before' if self.before else ''}"
        place = (self.x, self.y, self.z) if self.z else (self.x, self.y)
        return f"{self.beam}({', '.join(f'{x:g}' for x in place)})" if any(place) else self.beam


def require_point(where: str, point: object, dimension: int = 3) -> None:
    """Raise InvalidInputError unless `point` is a `MaterialPoint`, in a planar scene with z = 0."""
    require_kind(
        where, point, (MaterialPoint,), "Write beam.at_end, beam.at(fraction) or body.at(x, y)."
    )
    assert isinstance(point, MaterialPoint)
    if dimension == 2 and point.z != 0.0:
        raise InvalidInputError(where, "z must be 0 in a planar scene", f"z = {point.z}")


def require_fraction(where: str, fraction: float | None) -> float:
    """Return the arc-length fraction; InvalidInputError if it is None or outside [0, 1]."""
    if fraction is None or not 0.0 <= fraction <= 1.0:
        raise InvalidInputError(
            where,
            "the fraction along the beam must lie in [0, 1]",
            fraction,
            "0 is the start of the beam and 1 its end.",
        )
    return fraction


def locate(nodes: Array, fraction: float, before: bool = False) -> tuple[int, float]:
    """Return the element index and xi at an arc-length fraction of a beam.

    `nodes` are the fractions of its nodes, shape (n + 1,). An inner node is the start of the
    element behind it, or with `before` the end of the element before it.
    """
    n = len(nodes) - 1
    element = min(int(np.searchsorted(nodes, fraction, side="right")) - 1, n - 1)
    span = nodes[element + 1] - nodes[element]
    xi = float((fraction - nodes[element]) / span)
    # A fraction such as 1/3 of three elements means the node, not a point 1e-16 beside it: node
    # fractions are sums of up to n lengths over their total, each with a round-off of n eps / 2.
    near = 2 * n * np.finfo(float).eps / span
    if xi > 1.0 - near:
        element, xi = (element + 1, 0.0) if element + 1 < n else (element, 1.0)
    elif xi < near:
        xi = 0.0
    return (element - 1, 1.0) if before and xi == 0.0 and element else (element, xi)


def require_in_section(where: str, point: MaterialPoint, half: tuple[float, float]) -> None:
    """Raise InvalidInputError if a point lies outside the section of these half extents; m."""
    # Widened by round-off, so that the surface belongs to the beam.
    if abs(point.y) > half[0] * (1 + 1e-12) or abs(point.z) > half[1] * (1 + 1e-12):
        raise InvalidInputError(
            where,
            f"the point must lie in the section (|y| <= {half[0]:.6g}, |z| <= {half[1]:.6g})",
            f"y = {point.y}, z = {point.z} at fraction {point.fraction}",
            "Move the point into the beam.",
        )
