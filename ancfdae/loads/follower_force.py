"""Force that turns with the section it acts on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity
from ancfdae.elements import BeamElement
from ancfdae.errors import require_vector
from ancfdae.loads.load import Load, direction, direction_rate
from ancfdae.numerics.arrays import Array
from ancfdae.parts import Vectors


@final
@dataclass(frozen=True)
class FollowerForce(Load):
    """A force of constant components along the section's axes.

    F = sum_k f_k r_k / |r_k| over the slope vectors r_k of the point. Design targets:
    ``force_x`` (along the beam), ``force_y``(, ``force_z``).

    Parameters
    ----------
    point : Point
    force_components : sequence of float
        Components along tangent, height axis(, width axis); N.
    name : str, optional
        By default ``follower(beam@fraction)``.
    """

    point: Point
    force_components: Sequence[float]
    name: str = ""

    kind = "follower"
    design_fields = (("force_components", require_vector),)

    def vectors(self, element: BeamElement) -> Vectors:
        """Position and slopes of the point."""
        return tuple((self.point, quantity) for quantity in list(Quantity)[: element.d + 1])

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """F on the position, none on the slopes."""
        return _on_position(p, direction(U[..., 1:, :])[1])

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """F' by the rates of r_k / |r_k|."""
        return _on_position(p, direction_rate(U[..., 1:, :], V[..., 1:, :])[1])


def _on_position(p: Array, axes: Array) -> Array:
    """Return the force sum_k p_k axis_k on the position, and none on the slopes."""
    F = np.sum(p[:, None] * axes, axis=-2, keepdims=True)
    return np.concatenate([F, np.zeros_like(p[:, None] * axes)], axis=-2)
