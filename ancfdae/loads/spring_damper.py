"""Spring and damper between two points, or between a point and the ground."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import InvalidInput, require_finite, require_vector
from ancfdae.loads.load import CentreLine, Load
from ancfdae.numerics.arrays import Array


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

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("spring", self.point))
        for what in ("stiffness", "damping", "free_length"):
            require_finite(f"load {self.name!r}, {what}", getattr(self, what))
        if (self.other is None) == (self.ground is None):
            raise InvalidInput(
                f"load {self.name!r}",
                "connects a point either with another one or with the ground",
                "both" if self.other is not None else "neither",
                "Give `other` or `ground`.",
            )
        if self.ground is not None:
            require_vector(f"load {self.name!r}, ground", self.ground)

    def parameters(self) -> dict[str, float]:
        """Stiffness, damping, free length, components of `ground`."""
        own = {
            "stiffness": self.stiffness,
            "damping": self.damping,
            "free_length": self.free_length,
        }
        return own | vector_parameters("ground", self.ground)

    def with_parameter(self, parameter: str, value: float) -> SpringDamper:
        """Change one of them."""
        if parameter.startswith("ground") and self.ground is not None:
            return replace(self, ground=replaced_component("ground", self.ground, parameter, value))
        return replace(self, **{parameter: value})  # type: ignore[arg-type]

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """With a damper, or one that the design can add."""
        return self.damping != 0 or "damping" in driven

    def vectors(self) -> tuple[tuple[Point, Quantity] | CentreLine, ...]:
        """Positions of the points."""
        points = (self.point,) if self.other is None else (self.point, self.other)
        return tuple((point, Quantity.POSITION) for point in points)

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """-(k (l - l_0) + c l') n on the first point, the opposite on the second."""
        k, damping, free_length = p[:3]
        e, w = self._between(U, p), self._between_rates(V)
        l = np.sqrt(np.sum(e * e, axis=-1, keepdims=True))
        n = e / l
        f = k * (l - free_length) + damping * np.sum(n * w, axis=-1, keepdims=True)
        return self._on_points(-f * n)

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """-(f' n + f n') with n' = (w - n l')/l, l'' = n' . w + n . w'."""
        k, damping, free_length = p[:3]
        e, w, z = self._between(U, p), self._between_rates(V), self._between_rates(Z)
        l = np.sqrt(np.sum(e * e, axis=-1, keepdims=True))
        n = e / l
        l_1 = np.sum(n * w, axis=-1, keepdims=True)
        n_1 = (w - n * l_1) / l
        l_2 = np.sum(n_1 * w + n * z, axis=-1, keepdims=True)
        f = k * (l - free_length) + damping * l_1
        return self._on_points(-(k * l_1 + damping * l_2) * n - f * n_1)

    def _between(self, U: Array, p: Array) -> Array:
        return U[..., 0, :] - (p[3:] if self.other is None else U[..., 1, :])

    def _between_rates(self, V: Array) -> Array:
        return V[..., 0, :] if self.other is None else V[..., 0, :] - V[..., 1, :]

    def _on_points(self, F: Array) -> Array:
        return np.stack([F] if self.other is None else [F, -F], axis=-2)
