"""How long arrows are drawn, and the points of springs, ways and moments."""

from collections.abc import Sequence
from typing import Final, final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.plotting.mechanism import Mechanism
from ancfdae.plotting.symbols import Arrows, Line

# Of the extent of the picture: longest arrow, arcs of moments, half a way.
_ARROW, _ARC, _WAY = 0.16, 0.05, 0.12
_TURNS: Final = 7  # of a spring
_UNITS: Final = {"force": "N", "force per length": "N/m", "moment": "N m"}


@final
class Glyphs:
    """Signs of a mechanism in the size of its picture, the largest extent of everything; m.

    `labels` has by kind of arrow a text with its largest size, which the longest arrow stands for.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.extent = float(np.max(np.ptp(mechanism.bounds, axis=0))) or 1.0
        self._largest = _largest(mechanism.arrows)
        self.labels = {
            kind: f"{kind}, largest {size:.3g} {_UNITS[kind]}"
            for kind, size in self._largest.items()
        }

    def line(self, line: Line, k: int) -> Array:
        """Return the points of a line at instant k, shape (n, d)."""
        ends: Array = line.ends[k]
        if line.kind == "spring":
            return _zigzag(ends)
        if line.kind == "way":
            half = _WAY * self.extent * (ends[1] - ends[0])
            return np.array([ends[0] - half, ends[0] + half])
        return ends

    def arrow(self, arrows: Arrows) -> Array:
        """Return arrows from places to tips, shape (k, n, d)."""
        return np.asarray(_ARROW * self.extent / self._largest[arrows.kind] * arrows.vectors)

    def arc(self, arrows: Arrows, k: int) -> Array:
        """Return three quarters of a circle about a moment with the head of its arrow, (n, d).

        All at one place where the moment vanishes.
        """
        centre, M, radius = arrows.places[k, 0], arrows.vectors[k, 0], _ARC * self.extent
        size = np.linalg.norm(M)
        if len(M) == 1:
            turn = _circle_arrow(-1.0 if M[0] < 0 else 1.0)
            return np.asarray(centre + radius * abs(np.sign(M[0])) * turn)
        axis = M / (size or 1.0)
        first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        first = first / (np.linalg.norm(first) or 1.0)
        plane = np.stack([first, np.cross(axis, first)])
        return np.asarray(centre + 1.6 * radius * (_circle_arrow(1.0) @ plane))


def _largest(arrows: Sequence[Arrows]) -> dict[str, float]:
    """Largest size of each kind of arrow over all instants."""
    sizes: dict[str, float] = {}
    for each in arrows:
        size = float(np.max(np.linalg.norm(each.vectors, axis=-1)))
        sizes[each.kind] = max(size, sizes.get(each.kind, 0.0))
    return {kind: size or 1.0 for kind, size in sizes.items()}


def _zigzag(ends: Array) -> Array:
    """Return a spring between two places; in space it lies in a plane that holds an axis."""
    e = ends[1] - ends[0]
    length = float(np.linalg.norm(e))
    if len(e) == 2:
        normal = np.array([-e[1], e[0]])
    else:
        normal = np.cross(e, np.eye(3)[int(np.argmin(np.abs(e)))])
    along = np.concatenate([[0.0], np.linspace(0.15, 0.85, 2 * _TURNS), [1.0]])
    side = np.concatenate([[0.0], 0.06 * (-1.0) ** np.arange(2 * _TURNS), [0.0]])
    side[[1, -2]] = 0.0
    across = normal * (length / (float(np.linalg.norm(normal)) or 1.0))
    return np.asarray(ends[0] + along[:, None] * e + side[:, None] * across)


def _circle_arrow(sense: float) -> Array:
    """Return three quarters of a unit circle from below on, in one sense, with an arrowhead."""
    angle = sense * np.linspace(-0.5 * np.pi, np.pi, 30)
    arc = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    tip, along = arc[-1], arc[-1] - arc[-4]
    normal = np.array([-along[1], along[0]])
    head = np.stack([tip - 1.3 * along + 0.8 * normal, tip, tip - 1.3 * along - 0.8 * normal])
    return np.concatenate([arc, head])
