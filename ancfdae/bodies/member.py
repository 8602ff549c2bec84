"""What beams and rigid bodies share: a place and a turn in the reference configuration."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from ancfdae.bodies.point import Point
from ancfdae.errors import require_finite, require_vector
from ancfdae.numerics.arrays import Array


class Member(abc.ABC):
    """Something with coordinates, which stands somewhere.

    Attributes
    ----------
    name : str
    turn : float or sequence of float
        Turn of the whole about its place: in space a vector along the axis; rad.
    placed_by : str
        What its place is called in design targets, ``start`` or ``position``.
    """

    placed_by: ClassVar[str]

    name: str
    turn: float | Sequence[float]

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""

    @property
    @abc.abstractmethod
    def place(self) -> Sequence[float] | Point:
        """Where it starts or has its reference point: a place, or a point of another member."""

    @abc.abstractmethod
    def with_place(self, place: Sequence[float]) -> Self:
        """Return the same, moved to another place."""

    @abc.abstractmethod
    def directions(self) -> Array:
        """Return its axes as a rigid body, before its turn, as rows."""

    @property
    def attached(self) -> Point | None:
        """The point of another member that it is placed at, None if it has a place."""
        place = self.place
        return place if isinstance(place, Point) else None

    def placement(self) -> dict[str, float]:
        """Return the numbers that say where it stands, by the names of their targets."""
        turns = np.atleast_1d(np.asarray(self.turn, float)).tolist()
        names = ["turn"] if self.dimension == 2 else [f"turn_{axis}" for axis in "xyz"]
        found = dict(zip(names, turns, strict=True))
        if not isinstance(self.place, Point):
            places = zip("xyz", self.place, strict=False)
            found |= {f"{self.placed_by}_{axis}": float(x) for axis, x in places}
        return found

    def split_placement(self, numbers: Array) -> tuple[Array | None, Array]:
        """Return place and turn out of numbers that begin with those of `placement`.

        The place is None where it is a point of another member.
        """
        n_r = 1 if self.dimension == 2 else 3
        place = None if self.attached else numbers[n_r : n_r + self.dimension]
        return place, numbers[:n_r]

    def with_placement(self, changes: Mapping[str, float]) -> Self:
        """Return the same with numbers of its `placement` changed."""
        numbers = np.array(list((self.placement() | dict(changes)).values()))
        place, turn = self.split_placement(numbers)
        moved = self if place is None else self.with_place(tuple(place.tolist()))
        new = float(turn[0]) if self.dimension == 2 else tuple(turn.tolist())
        return replace(moved, turn=new)  # type: ignore[type-var]

    def _check_turn(self, where: str) -> None:
        if self.dimension == 2:
            require_finite(f"{where}, turn", self.turn)
        elif np.ndim(self.turn) == 0 and self.turn == 0:
            object.__setattr__(self, "turn", (0.0, 0.0, 0.0))
        else:
            require_vector(f"{where}, turn", self.turn, (3,))
