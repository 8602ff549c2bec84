"""Material points of beams, and the vectors that belong to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.errors import (
    InvalidInput,
    require_finite,
    require_kind,
)


@final
@dataclass(frozen=True)
class Point:
    """A material point of a beam.

    Parameters
    ----------
    beam : str
        Name of the beam.
    fraction : float
        Arc-length fraction along the beam, 0 at the start, 1 at the end.
    y, z : float
        Offset from the centre line along the section's axes; m.

    Raises
    ------
    InvalidInput
        If the fraction lies outside [0, 1] or a number is not finite.
    """

    beam: str
    fraction: float
    y: float = 0.0
    z: float = 0.0

    def __post_init__(self) -> None:
        """Validate."""
        where = f"point of {self.beam!r}"
        for value in (self.fraction, self.y, self.z):
            require_finite(where, value)
        if not 0.0 <= self.fraction <= 1.0:
            raise InvalidInput(
                where,
                "the fraction along the beam must lie in [0, 1]",
                self.fraction,
                "0 is the start of the beam and 1 its end.",
            )

    def numbers(self) -> dict[str, float]:
        """Return the place on the beam, by name."""
        return {"fraction": self.fraction, "y": self.y, "z": self.z}


def require_point(where: str, point: object, dimension: int = 3) -> None:
    """Refuse what is no point, and a point off the plane of a planar beam.

    Raises
    ------
    InvalidInput
    """
    require_kind(where, point, (Point,), "Write beam.at_start, beam.at_end or beam.at(fraction).")
    assert isinstance(point, Point)
    if dimension == 2 and point.z != 0.0:
        raise InvalidInput(where, "a planar beam has no z axis", f"z = {point.z}", "Leave z out.")
