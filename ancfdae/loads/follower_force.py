"""Force that turns with the section it acts on."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import require_vector
from ancfdae.loads.load import CentreLine, Load
from ancfdae.numerics.arrays import Array


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

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            name = name_at("follower", self.point)
            object.__setattr__(self, "name", name)
        require_vector(f"load {self.name!r}, force_components", self.force_components)

    def parameters(self) -> dict[str, float]:
        """Components of the force."""
        return vector_parameters("force", self.force_components)

    def with_parameter(self, parameter: str, value: float) -> FollowerForce:
        """Change a component."""
        force = replaced_component("force", self.force_components, parameter, value)
        return replace(self, force_components=force)

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Never."""
        return False

    def vectors(self) -> tuple[tuple[Point, Quantity] | CentreLine, ...]:
        """Position and slopes of the point."""
        d = len(tuple(self.force_components))
        return tuple((self.point, quantity) for quantity in list(Quantity)[: d + 1])

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """F on the position, none on the slopes."""
        slopes = U[..., 1:, :]
        length = np.sqrt(np.sum(slopes * slopes, axis=-1, keepdims=True))
        return _on_position(U, np.sum(p[:, None] * slopes / length, axis=-2))

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """d(r_k/|r_k|)/dt = (r_k' - n (n . r_k')) / |r_k| with n = r_k/|r_k|."""
        slopes, rates = U[..., 1:, :], V[..., 1:, :]
        length = np.sqrt(np.sum(slopes * slopes, axis=-1, keepdims=True))
        n = slopes / length
        turning = (rates - n * np.sum(n * rates, axis=-1, keepdims=True)) / length
        return _on_position(U + V, np.sum(p[:, None] * turning, axis=-2))


def _on_position(like: Array, F: Array) -> Array:
    result = np.zeros(
        np.broadcast_shapes(like.shape, (*F.shape[:-1], *like.shape[-2:])),
        dtype=np.result_type(like, F),
    )
    result[..., 0, :] = F
    return result
