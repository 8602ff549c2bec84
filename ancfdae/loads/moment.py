"""Moment on a section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point
from ancfdae.elements import BeamElement
from ancfdae.errors import InvalidInput, require_finite, require_vector
from ancfdae.loads.load import Load, direction, direction_rate, dot
from ancfdae.numerics.arrays import Array
from ancfdae.parts import Vectors


def _require_moment(where: str, value: object) -> None:
    if np.ndim(value) == 0:  # type: ignore[arg-type]
        require_finite(where, value)
    else:
        require_vector(where, value, (3,))


@final
@dataclass(frozen=True)
class Moment(Load):
    """A moment of constant size on a section of a beam.

    It does the work M . dphi on a turn dphi of the section. The section turns as its plane does,
    and in this plane with the mean of its slopes: with n across r_y and r_z and r^y, r^z dual to
    them in the plane, the force on r_k is (M - (M . n) n / 2) x r^k. In the plane of a planar
    scene the section turns with r_y (a cable, which has none, with its tangent), and
    the force is M x r_y / |r_y|^2 (docs/theory.md, section 3). Design targets: ``moment`` in the
    plane; ``moment_x``, ``moment_y``, ``moment_z`` in space.

    Parameters
    ----------
    point : Point
    moment : float or sequence of float
        A number in the plane, from x to y; three components in space; N m.
    follower : bool, optional
        Whether the components are along n and the height and width slopes, and turn with them,
        instead of being fixed in space. In the plane there is no difference.
    name : str, optional
        By default ``moment(beam@fraction)``.
    """

    point: Point
    moment: float | Sequence[float]
    follower: bool = False
    name: str = ""

    kind = "moment"
    design_fields = (("moment", _require_moment),)

    def vectors(self, element: BeamElement) -> Vectors:
        """Slopes of the section."""
        if np.ndim(self.moment) != element.d - 2:
            raise InvalidInput(
                f"load {self.name!r}, moment",
                "must be a number in the plane and have 3 components in space",
                self.moment,
                f"The scene has {element.d} dimensions.",
            )
        return tuple((self.point, slope) for slope in element.quantities[1 - element.d :])

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """(M - (M . n) n / 2) x r^k."""
        if U.shape[-1] == 2:
            F: Array = p * (U @ _QUARTER_TURN) / dot(U, U)
            return F
        s, n = direction(_cross(U, U))
        M = self._moment(p, n, direction(U)[1])
        return np.cross(M - 0.5 * dot(M, n) * n, _duals(U, n) / s)

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """F' by the product rule."""
        if U.shape[-1] == 2:
            turned = V - 2 * dot(U, V) / dot(U, U) * U
            F_1: Array = p * (turned @ _QUARTER_TURN) / dot(U, U)
            return F_1
        N, N_1 = _cross(U, U), _cross(V, U) + _cross(U, V)
        (s, n), (s_1, n_1) = direction(N), direction_rate(N, N_1)
        M = self._moment(p, n, direction(U)[1])
        M_1 = self._moment(p, n_1, direction_rate(U, V)[1]) if self.follower else np.zeros_like(n_1)
        along, along_1 = dot(M, n), dot(M_1, n) + dot(M, n_1)
        D = _duals(U, n) / s
        D_1 = (_duals(V, n) + _duals(U, n_1) - D * s_1) / s
        turning = np.cross(M_1 - 0.5 * (along_1 * n + along * n_1), D)
        return turning + np.cross(M - 0.5 * along * n, D_1)

    def _moment(self, p: Array, n: Array, slopes: Array) -> Array:
        """Return M, shape (..., 1, 3), from the axes of the section."""
        if not self.follower:
            return p
        axes = np.concatenate([n, slopes], axis=-2)
        M: Array = np.sum(p[:, None] * axes, axis=-2, keepdims=True)
        return M


# U @ _QUARTER_TURN is U turned by 90 degrees, from x to y.
_QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])


def _cross(U: Array, W: Array) -> Array:
    """Return U_y x W_z, shape (..., 1, 3)."""
    return np.cross(U[..., :1, :], W[..., 1:, :])


def _duals(U: Array, n: Array) -> Array:
    """Return |r_y x r_z| times the duals of r_y and r_z in their plane: r_z x n and n x r_y."""
    return np.concatenate([np.cross(U[..., 1:, :], n), np.cross(n, U[..., :1, :])], axis=-2)
