"""Nodes and frames of curved beams: circular arcs, and smooth curves through points.

A frame has the unit tangent in its first row. In the plane the second points to the left. In space
the section does not turn about the tangent along the curve (rotation-minimising frames). On an arc
the angle between its height and the plane of the arc is constant. On another curve the frame is
carried on by double reflection, of fourth order in the distance of neighbouring points (W. Wang,
B. Juttler, D. Zheng, Y. Liu, ACM Transactions on Graphics 27, 2008).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from ancfdae.errors.checks import require_array, require_count, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import box_rule

# A remaining direction below the square root of round-off, relative to the whole, is round-off.
_NOISE = 1e-8
# Intervals between neighbouring points on which frames are carried on and lengths are tabulated.
_FINE = 32


def arc(
    where: str,
    ends: tuple[Sequence[float], Sequence[float], Sequence[float]],
    elements: int,
    height_axis: Sequence[float] | None,
) -> tuple[Array, Array]:
    """Return node positions, (n + 1, d), m, and frames, (n + 1, d, d), of a circular arc.

    `ends` are its start, a middle point and its end. Raises InvalidInputError if they lie in one
    line.
    """
    require_count(f"{where}, elements", elements, "An element may turn by a tenth of a radian.")
    for name, point in zip(("start", "middle", "end"), ends, strict=True):
        require_vector(f"{where}, {name}", point, (len(tuple(ends[0])),))
    start, middle, end = (np.asarray(x, dtype=float) for x in ends)
    a, b = middle - start, end - start
    # The centre is start + x a + y b with equal distances to the three points.
    gram = np.array([[a @ a, a @ b], [a @ b, b @ b]])
    if not np.linalg.det(gram) > _NOISE**2 * (a @ a) * (b @ b):
        rule, repair = "its three points must not lie in one line", "A straight beam is a Beam."
        raise InvalidInputError(f"{where}, arc", rule, (ends[0], ends[1], ends[2]), repair)
    x, y = np.linalg.solve(gram, 0.5 * np.diag(gram))
    outward = -(x * a + y * b)
    radius = np.linalg.norm(outward)
    across = (p - (p @ outward) / radius**2 * outward for p in (a, b))
    along = max(across, key=lambda p: float(p @ p))
    along *= radius / np.linalg.norm(along)

    def angle(point: Array) -> float:
        from_centre = point - start + outward
        return float(np.arctan2(from_centre @ along, from_centre @ outward) % (2 * np.pi))

    # The direction in which the middle lies before the end.
    sense = 1.0 if angle(middle) < angle(end) else -1.0
    total = angle(end) if sense > 0 else angle(end) - 2 * np.pi
    theta = np.linspace(0.0, total, elements + 1)[:, None]
    nodes = start + outward * (np.cos(theta) - 1) + along * np.sin(theta)
    nodes[-1] = end
    tangents = sense * (along * np.cos(theta) - outward * np.sin(theta)) / radius
    if len(start) == 2:
        return nodes, _planar(where, tangents, height_axis)
    inward = -(outward * np.cos(theta) + along * np.sin(theta)) / radius
    binormal = np.cross(tangents, inward)
    if height_axis is None:
        return nodes, np.stack([tangents, inward, binormal], axis=1)
    height = _across(where, height_axis, tangents[0])
    heights = (height @ inward[0]) * inward + (height @ binormal[0]) * binormal
    return nodes, np.stack([tangents, heights, np.cross(tangents, heights)], axis=1)


def through(
    where: str,
    points: Array | Sequence[Sequence[float]],
    elements: int | None,
    height_axis: Sequence[float] | None,
) -> tuple[Array, Array]:
    """Return node positions, (n + 1, d), m, and frames, (n + 1, d, d), of a spline through points.

    The cubic spline through `points`, shape (k, d), has the length of the chords as its parameter.
    The points are the nodes if `elements` is None.
    """
    points = require_array(f"{where}, points", points)
    if points.ndim != 2 or len(points) < 2 or points.shape[1] not in (2, 3):
        rule = "must have shape (k, 2) or (k, 3) with k >= 2"
        raise InvalidInputError(f"{where}, points", rule, points.shape, "Give one row per point.")
    chords = _norms(np.diff(points, axis=0))
    if not np.all(chords > 0):
        rule, repair = "neighbouring points must differ", "Remove the repeated point."
        raise InvalidInputError(f"{where}, points", rule, "two at one place", repair)
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    curve = scipy.interpolate.CubicSpline(knots, points)
    parts = np.linspace(0.0, 1.0, _FINE, endpoint=False)
    fine = np.append((knots[:-1, None] + chords[:, None] * parts).ravel(), knots[-1])
    if elements is None:
        at = knots
    else:
        require_count(f"{where}, elements", elements, "Leave it out for one between two points.")
        lengths = _lengths(curve, fine)
        inverse = scipy.interpolate.CubicHermiteSpline(lengths, fine, 1 / _norms(curve(fine, 1)))
        at = inverse(np.linspace(0.0, lengths[-1], elements + 1))
        at[-1] = knots[-1]
    places = np.union1d(fine, at)
    tangents = curve(places, 1)
    tangents /= _norms(tangents)[:, None]
    rows = np.searchsorted(places, at)
    if points.shape[1] == 2:
        return curve(at), _planar(where, tangents[rows], height_axis)
    default = _default_height(tangents[0])
    first = _across(where, default if height_axis is None else height_axis, tangents[0])
    heights = _carried(curve(places), tangents, first)[rows]
    nodes, along = curve(at), tangents[rows]
    return nodes, np.stack([along, heights, np.cross(along, heights)], axis=1)


def _planar(where: str, tangents: Array, height_axis: Sequence[float] | None) -> Array:
    if height_axis is not None:
        rule, repair = "must be left out in the plane", "The height lies in the plane."
        raise InvalidInputError(f"{where}, height_axis", rule, tuple(height_axis), repair)
    left = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    return np.stack([tangents, left], axis=1)


def _lengths(curve: scipy.interpolate.CubicSpline, places: Array) -> Array:
    """Return the arc lengths of a curve from its start to parameter values, shape (k,); m."""
    points, weights = box_rule((6,))
    steps = np.diff(places)
    speeds = _norms(curve(places[:-1, None] + steps[:, None] * points[:, 0], 1))
    return np.concatenate([[0.0], np.cumsum(steps * (speeds @ weights))])


def _norms(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _default_height(tangent: Array) -> Array:
    """Return the height direction of a straight spatial beam along `tangent`, shape (3,)."""
    along_z = abs(tangent[2]) > 1.0 - _NOISE
    return np.cross((0.0, 1.0, 0.0) if along_z else (0.0, 0.0, 1.0), tangent)


def _across(where: str, axis: Sequence[float] | Array, tangent: Array) -> Array:
    """Return the unit vector of `axis` projected perpendicular to `tangent`, shape (3,)."""
    require_vector(f"{where}, height_axis", axis, (3,))
    given = np.asarray(axis, dtype=float)
    across = given - (given @ tangent) * tangent
    if np.linalg.norm(across) <= _NOISE * np.linalg.norm(given):
        rule, repair = "must not be parallel to the start of the curve", "Give one across it."
        raise InvalidInputError(f"{where}, height_axis", rule, tuple(axis), repair)
    return np.asarray(across / np.linalg.norm(across))


def _carried(places: Array, tangents: Array, height: Array) -> Array:
    """Return the height directions of rotation-minimising frames along a curve, shape (k, 3).

    `height` is the first; double reflection carries it from point to point of the curve.
    """
    heights = [height]
    for chord, before, after in zip(
        np.diff(places, axis=0), tangents[:-1], tangents[1:], strict=True
    ):
        mirrored, tangent = (_reflected(x, chord) for x in (heights[-1], before))
        heights.append(_reflected(mirrored, after - tangent))
    return np.array(heights)


def _reflected(x: Array, normal: Array) -> Array:
    """Return x mirrored in the plane perpendicular to `normal` (of any length), shape (3,)."""
    return np.asarray(x - 2 * (normal @ x) / (normal @ normal) * normal)
