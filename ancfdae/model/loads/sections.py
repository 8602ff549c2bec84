"""Rotation of a section, directions carried by it, and the gradients of both in its slopes.

Arrays have axes (..., n_vectors, d). A section is given by its slopes r_y, r_z (r_y in the plane).
A direction carried by a section is a fixed combination of n, r_y and r_z, with n its unit normal
(in the plane of r_y and r_y rotated by a right angle), so that directions of the reference rotate
with the section.

The angle theta of a section about an axis a is that of the best rotation about it: with r_k = n,
r_y, r_z and d_k their reference values, carried by the other section or fixed in space,

    theta = atan2(S, C),  S = a . sum d_k x r_k,  C = sum d_k . r_k - (a . d_k) (a . r_k).

A rigid rotation about a by any angle from -pi to pi is found exactly, and there dtheta = a . dphi
for every further rotation dphi, because the three directions have equal weight. The gradients are
those of this function: a torque T does the work T dtheta, its forces are T theta_U.
"""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import angle, concatenate, cross, direction, dot

#: U @ QUARTER_TURN is U turned by 90 degrees, from x to y.
QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])


def section_of(points: tuple[MaterialPoint, ...], elements: Elements) -> Vectors:
    """Return the slopes that span the sections of points; tangents for planar cables."""
    return tuple((point, slope) for point in points for slope in elements.at(point).spanning)


@final
@dataclass(frozen=True)
class CarriedAxes:
    """A section that carries directions along, slopes U, in the reference U_o; or the ground."""

    U: Any
    U_o: Array

    @property
    def ground(self) -> bool:
        """Whether the directions are fixed in space, carried by no section."""
        return len(self.U_o) == 0

    def of(self, rows: Array) -> Any:
        """Return the present directions of axes given as rows in the reference configuration."""
        return rows if self.ground else self._weights(rows) @ _basis(self.U)

    def pull_back(self, rows: Array, G: Any) -> Any:
        """Return a gradient in slopes U from G, the gradient in the carried directions `rows`."""
        return _on_slopes(self.U, np.swapaxes(self._weights(rows), -1, -2) @ G)

    def _weights(self, rows: Array) -> Array:
        return rows @ np.linalg.inv(_basis(self.U_o))


def _basis(U: Any) -> Any:
    """Return normal and slopes of a section, a basis for directions that it carries along."""
    if U.shape[-1] == 2:
        return concatenate([U @ QUARTER_TURN, U])
    return concatenate([direction(cross(U[..., :1, :], U[..., 1:, :]))[1], U])


def _on_slopes(U: Any, G: Any) -> Any:
    """Return a gradient in section slopes U from G, the gradient in the basis `_basis(U)`."""
    if U.shape[-1] == 2:
        return G[..., 1:, :] - G[..., :1, :] @ QUARTER_TURN
    r_y, r_z = U[..., :1, :], U[..., 1:, :]
    s, n = direction(cross(r_y, r_z))
    on_normal = (G[..., :1, :] - dot(G[..., :1, :], n) * n) / s
    return G[..., 1:, :] + concatenate([cross(r_z, on_normal), cross(on_normal, r_y)])


def turn(U: Any, U_o: Array, axes: Array) -> tuple[Any, Any]:
    """Return angles about axes, (..., m, 1, 1), rad, and gradients, (..., m, n_vectors, d).

    U holds the slopes of one section, or of two, the second of which carries the axes, and U_o the
    slopes in the reference. The axes, (m, 3), are unit vectors in the reference; in the plane they
    are not used.
    """
    d = U_o.shape[1]
    U = U[..., None, :, :]
    if d == 2:
        return _planar_turn(U, U_o)
    slopes, carrier = U[..., :2, :], CarriedAxes(U[..., 2:, :], U_o[2:])
    rows, start = axes[:, None, :], _basis(U_o[:2])
    size, a = direction(carrier.of(rows))
    r, d_k = _basis(slopes), carrier.of(start)
    ar, ad, dr = dot(a, r), dot(a, d_k), cross(d_k, r).sum(axis=-2, keepdims=True)
    S, C = dot(a, dr), (dot(d_k, r) - ad * ar).sum(axis=-2, keepdims=True)
    on_S, on_C = C / (S * S + C * C), -S / (S * S + C * C)
    on_slopes = _on_slopes(slopes, on_S * cross(a, d_k) + on_C * (d_k - ad * a))
    theta = angle(S, C)
    if carrier.ground:
        return theta, on_slopes
    on_d = on_S * cross(r, a) + on_C * (r - ar * a)
    on_a = on_S * dr - on_C * (ar * d_k + ad * r).sum(axis=-2, keepdims=True)
    on_axis = (on_a - dot(on_a, a) * a) / size
    other = carrier.pull_back(start, on_d) + carrier.pull_back(rows, on_axis)
    return theta, concatenate([on_slopes, other])


def _planar_turn(U: Any, U_o: Array) -> tuple[Any, Any]:
    """Return the rotation of a planar section relative to another or ground, and its gradient."""
    r, carrier = U[..., :1, :], CarriedAxes(U[..., 1:, :], U_o[1:])
    start = carrier.of(U_o[:1])
    theta = angle(dot(start @ QUARTER_TURN, r), dot(start, r))
    on_r = (r @ QUARTER_TURN) / dot(r, r)
    if carrier.ground:
        return theta, on_r
    other = U[..., 1:, :]
    return theta, concatenate([on_r, -(other @ QUARTER_TURN) / dot(other, other)])


def rate_of(x_U: Any, V: Any) -> Any:
    """Return x' = x_U . V, (..., 1, 1), the rate of coordinates with the gradients x_U."""
    return dot(x_U, V).sum(axis=-2, keepdims=True)


def travel(U: Any, U_o: Array, along: Array, other: bool) -> tuple[Any, Any]:
    """Return the displacement of a point along a line since the reference, m, and its gradient.

    Shapes (..., 1, 1) and (..., n_vectors, d). U holds the position of the point and, if `other`,
    position and section slopes of the point that carries the line.
    """
    rows, carrier = along[None], CarriedAxes(U[..., 2:, :], U_o[2:])
    size, a = direction(carrier.of(rows))
    gradient = a + 0.0 * U[..., :1, :]
    if not other:
        return dot(U[..., :1, :] - U_o[:1], a), gradient
    e, e_o = U[..., :1, :] - U[..., 1:2, :], U_o[:1] - U_o[1:2]
    on_line = carrier.pull_back(rows, (e - dot(e, a) * a) / size)
    x = dot(e, a) - dot(e_o, direction(rows)[1])
    return x, concatenate([gradient, -gradient, on_line])


def unit_axes(axis: Array | None) -> Array:
    """Return the axis of a joint as a unit vector, (1, 3); the z axis if it is None."""
    if axis is None:
        return np.array([[0.0, 0.0, 1.0]])
    return direction(axis[None])[1]
