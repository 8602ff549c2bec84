"""Base class by which a solution finds points, joints and coordinates of a system by name."""

from __future__ import annotations

import abc
from typing import Any

from ancfdae.numerics.arrays import Array


class Naming(abc.ABC):
    """Names of the points, joints and coordinates of a system; a scene has names of beams, too."""

    @abc.abstractmethod
    def nodes(self, states: Array, name: str) -> Array:
        """Return the node vectors of a body in states of shape (k, n_q), (k, n_nodes, n_s, d)."""

    @abc.abstractmethod
    def ends(self, states: Array, name: str) -> Array:
        """Return the node vectors of both ends of every element, shape (k, n, 2, n_s, d)."""

    @abc.abstractmethod
    def position(self, states: Array, point: Any) -> Array:
        """Return the position of a point in states of shape (k, n_q), shape (k, d); m."""

    @abc.abstractmethod
    def slope(self, states: Array, point: Any, along: int) -> Array:
        """Return the slope vector of a point along an axis of its section, shape (k, d)."""

    @abc.abstractmethod
    def rows(self, joint: str) -> slice:
        """Return the slice of the multipliers of a joint in lam."""

    @abc.abstractmethod
    def reaction(self, lam: Array, joint: str) -> Array:
        """Return the force of a joint on its first point, shape (k, d); N."""

    @abc.abstractmethod
    def coordinate_names(self) -> list[str]:
        """Return a name for each coordinate, n_q in all."""

    @abc.abstractmethod
    def centred(self, q: Array, weights: Array) -> Array:
        """Return the coordinates, (n_q,), translated so that the weighted mean position is zero."""

    @abc.abstractmethod
    def stepped(self, variable: int, step: complex) -> Naming:
        """Return the naming with a design variable increased by a step, real or complex."""

    @abc.abstractmethod
    def motions_in_words(self, q: Array, motions: Array) -> str:
        """Return a text on which bodies move, and how, in motions without stiffness, (n_q, k)."""

    @abc.abstractmethod
    def deforms(self, q: Array, motions: Array) -> bool:
        """Return whether motions without stiffness, (n_q, k), change the shape of a body."""

    @abc.abstractmethod
    def packed(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Return the arrays and the JSON data of the naming that a solution file stores."""
