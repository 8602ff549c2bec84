"""Coordinates and velocities at an instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Point:
    """Coordinates and velocities with their design derivatives, or None without.

    Attributes
    ----------
    q, v : array, shape (n_q,)
    q_b, v_b : array, shape (n_q, n_b), or None
    """

    q: Array
    v: Array
    q_b: Array | None = None
    v_b: Array | None = None
