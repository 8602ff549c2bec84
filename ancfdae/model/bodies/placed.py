"""Where a body stands: a place and a turn about it, both design targets."""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from ancfdae.errors.checks import require_axial
from ancfdae.model.bodies.point import MaterialPoint
from ancfdae.numerics.arrays import Array


class Placed(abc.ABC):
    """A part of a scene with a place and a rotation, which are design targets."""

    name: str
    # Turn of the whole body about its place: in space a vector along the axis; rad.
    turn: float | Sequence[float]
    place_word: ClassVar[str] = "start"  # what targets of the place begin with

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""

    @property
    @abc.abstractmethod
    def place(self) -> Sequence[float] | MaterialPoint:
        """Where its first point stands: a place, or a point of another beam."""

    @abc.abstractmethod
    def with_place(self, place: Sequence[float]) -> Self:
        """Return the same body, moved to another place."""

    @abc.abstractmethod
    def at_origin(self, point: MaterialPoint) -> Array:
        """Return the place of a point of the body where it stands at the origin, not turned."""

    @property
    def attached(self) -> MaterialPoint | None:
        """The point of another body that it starts at, None if it stands at a place."""
        place = self.place
        return place if isinstance(place, MaterialPoint) else None

    def placement(self) -> dict[str, float]:
        """Return the numbers that say where the body stands, by the names of their targets."""
        turns = np.atleast_1d(np.asarray(self.turn, float)).tolist()
        names = ["turn"] if self.dimension == 2 else [f"turn_{axis}" for axis in "xyz"]
        numbers = dict(zip(names, turns, strict=True))
        if not isinstance(self.place, MaterialPoint):
            places = zip("xyz", self.place, strict=False)
            numbers |= {f"{self.place_word}_{axis}": float(x) for axis, x in places}
        return numbers

    def split_placement(self, numbers: Array) -> tuple[Array | None, Array]:
        """Return place and turn out of numbers that begin with those of `placement`.

        The place is None where it is a point of another body.
        """
        n_r = 1 if self.dimension == 2 else 3
        place = None if self.attached else numbers[n_r : n_r + self.dimension]
        return place, numbers[:n_r]

    def with_placement(self, changes: Mapping[str, float]) -> Self:
        """Return the same body with numbers of its `placement` changed."""
        numbers = np.array(list((self.placement() | dict(changes)).values()))
        place, turn = self.split_placement(numbers)
        body = self if place is None else self.with_place(tuple(place.tolist()))
        new = float(turn[0]) if self.dimension == 2 else tuple(turn.tolist())
        return replace(body, turn=new)  # type: ignore[type-var]

    def _check_turn(self, where: str) -> None:
        if self.dimension == 3 and np.ndim(self.turn) == 0 and self.turn == 0:
            object.__setattr__(self, "turn", (0.0, 0.0, 0.0))
        require_axial(f"{where}, turn", self.turn, self.dimension)
