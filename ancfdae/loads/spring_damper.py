"""Spring and damper between two points, or between a point and the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity
from ancfdae.design import numbers
from ancfdae.elements import BeamElement
from ancfdae.errors import require_vector
from ancfdae.loads.load import Load
from ancfdae.loads.rates import direction, direction_rate, dot
from ancfdae.numerics.arrays import Array
from ancfdae.parts import Vectors


@final
@dataclass(frozen=True)
class SpringDamper(Load):
    """Linear spring and damper along the line between two points.

    With e = r(point) - r(other), l = |e| and n = e/l: F(point) = -(k (l - l_0) + c l') n, and
    the opposite on the other point. Design targets: ``stiffness``, ``damping``,
    ``free_length``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : Point
    stiffness : float
        k; N/m.
    damping : float
        c; N s/m.
    free_length : float
        l_0; m.
    other : Point, optional
    ground : sequence of float, optional
        One of `other` and `ground` must be given.
    name : str, optional
        By default ``spring(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If a number is not finite, or not exactly one of `other` and `ground` is given.
    """

    point: Point
    stiffness: float
    damping: float = 0.0
    free_length: float = 0.0
    other: Point | None = None
    ground: Sequence[float] | None = None
    name: str = ""

    kind = "spring"
    elastic = True
    design_fields = (*numbers("stiffness", "damping", "free_length"), ("ground", require_vector))
    damping_fields = ("damping",)
    needs_other_end = True

    def vectors(self, element: BeamElement) -> Vectors:
        """Positions of the points."""
        return tuple((point, Quantity.POSITION) for point in self.points)

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """-(k (l - l_0) + c l') n on the first point, the opposite on the second."""
        k, damping, free_length, ground = self.split(p)
        l, n = direction(_between(U, ground))
        return self._on_points(-(k * (l - free_length) + damping * dot(n, _between(V, None))) * n)

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """-(f' n + f n') with l'' = n' . w + n . w'."""
        k, damping, free_length, ground = self.split(p)
        e, w, z = _between(U, ground), _between(V, None), _between(Z, None)
        (l, n), (l_1, n_1) = direction(e), direction_rate(e, w)
        f = k * (l - free_length) + damping * l_1
        l_2 = dot(n_1, w) + dot(n, z)
        return self._on_points(-(k * l_1 + damping * l_2) * n - f * n_1)

    def _on_points(self, F: Array) -> Array:
        return np.stack([F, -F][: len(self.points)], axis=-2)


def _between(U: Array, ground: Array | None) -> Array:
    """Return the first vector less the second one, if any, or a place on the ground."""
    e = U[..., 0, :] - (U[..., 1, :] if U.shape[-2] == 2 else 0.0)
    return e if ground is None else e - ground
