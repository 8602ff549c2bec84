"""States with their rates as one value that can be moved, and directions of them."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from ancfdae.numerics.arrays import Array

#: (q, v, a, lam) at an instant, or their derivatives.
States: TypeAlias = tuple[Array, Array, Array, Array]


class StateDirection(NamedTuple):
    """A direction of (t, q, v): along the motion it is (1, v, a)."""

    t: float
    q: Array
    v: Array


class Motion(NamedTuple):
    """State at one instant, or a change of it; what a quantity does not depend on is zero."""

    q: Array
    v: Array
    a: Array
    lam: Array
    t: Any

    def plus(self, e: float, change: Motion) -> Motion:
        """Add e times a change."""
        return Motion(*(x + e * dx for x, dx in zip(self, change, strict=True)))
