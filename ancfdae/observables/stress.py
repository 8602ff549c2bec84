"""Observables of stress: von Mises' at a point of a beam, and its smooth maximum over a beam.

The stress is the second Piola-Kirchhoff one of the beam's law, with the part of internal damping;
it differs from the true one by the order of the strain. It is what the law carries: shear stresses
are the mean ones, uniform over the section, and those of torsion grow linearly from the centroid,
as they do in circles and tubes. A strain of 1e-9 is added in squares, E times 1e-9, so that the
stress has a derivative where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.ancf import StressPoints
from ancfdae.bodies import BeamBody, Point, require_point
from ancfdae.errors import InvalidInput, require_positive
from ancfdae.numerics.arrays import Array
from ancfdae.observables.observable import Leaf, LeafGradient, Observable, Rows
from ancfdae.observables.states import Named, States, known_scene
from ancfdae.protocol import MechanicalSystem

# Places along every element: bending moments are linear in them, or nearly.
_ALONG = np.array([0.0, 0.5, 1.0])


def von_mises(point: Point) -> Observable:
    """Return von Mises' stress at a point of a beam, ``rod.at(0.3, y=0.01)`` say; Pa."""
    return VonMises(point)


def maximum_stress(beam: str, sharpness: float) -> Observable:
    """Return the smooth maximum of von Mises' stress over a beam at every instant; Pa.

    The aggregate of Kreisselmeier and Steinhauser over n points, the corners or outer fibres of the
    section at both ends and in the middle of every element, log(sum exp(k s))/k: it exceeds the
    largest stress s by at most log(n)/k.

    For the largest over time too, take ``SmoothMaximum(maximum_stress("rod", k), k)``.

    Parameters
    ----------
    beam : str
        Name of the beam.
    sharpness : float
        k, in the inverse unit of a stress; positive. 50 over the stress allowed, say.
    """
    return MaximumStress(beam, sharpness)


@final
@dataclass(frozen=True)
class VonMises(Leaf):
    """Von Mises' stress at a material point."""

    point: Point

    def __post_init__(self) -> None:
        require_point("von_mises, point", self.point)

    def check_leaf(self, system: Named) -> None:
        """Refuse a point that does not exist or lies outside the section."""
        scene = known_scene(system)
        element, _ = scene.naming.layout.beam(self.point.beam).locate(self.point.fraction)
        body = scene.beam_elements(self.point.beam).body
        half = [extent * (1 + 1e-12) for extent in body.half_extents(np.array([element]))]
        if abs(self.point.y) > half[0] or abs(self.point.z) > half[1]:
            raise InvalidInput(
                "von_mises, point",
                f"must lie in the section (|y| <= {half[0]:.6g}, |z| <= {half[1]:.6g})",
                f"y = {self.point.y}, z = {self.point.z}",
                "Move the point into the beam.",
            )
        self._points(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """One stress per instant."""
        return self._points(system).value(states.q, states.v)[:, 0, 0]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Pull back one stress."""
        return _gradient(self._points(system), system, states, np.ones((len(states.t), 1, 1)))

    def _points(self, system: Named) -> StressPoints:
        scene, point = known_scene(system), self.point
        element, xi = scene.naming.layout.beam(point.beam).locate(point.fraction)
        own = scene.beam_elements(point.beam, slice(element, element + 1))
        y, z = np.full((1, 1), point.y), np.full((1, 1), point.z)
        return StressPoints(own, np.array([xi]), lambda parameters: (y, z))


@final
@dataclass(frozen=True)
class MaximumStress(Leaf):
    """Kreisselmeier-Steinhauser aggregate of von Mises' stress over a beam."""

    beam: str
    sharpness: float

    def __post_init__(self) -> None:
        require_positive("maximum_stress, sharpness", self.sharpness)

    def check_leaf(self, system: Named) -> None:
        """Refuse a beam that does not exist or has no stresses."""
        known_scene(system).naming.layout.beam(self.beam)
        self._points(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Logarithm of the sum; the largest is split off, so that nothing overflows."""
        stress = self._stresses(system, states)
        largest = np.max(stress.real, axis=1, keepdims=True)
        total = np.sum(np.exp(self.sharpness * (stress - largest)), axis=1)
        return np.asarray(largest[:, 0] + np.log(total) / self.sharpness)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Pull back the mean with the weights exp(k s)."""
        points = self._points(system)
        stress = points.value(states.q, states.v)
        largest = np.max(stress, axis=(1, 2), keepdims=True)
        weights = np.exp(self.sharpness * (stress - largest))
        weights = weights / np.sum(weights, axis=(1, 2), keepdims=True)
        return _gradient(points, system, states, weights)

    def _stresses(self, system: Named, states: States) -> Array:
        """All stresses of every instant, shape (k, n)."""
        return self._points(system).value(states.q, states.v).reshape(len(states.t), -1)

    def _points(self, system: Named) -> StressPoints:
        own = known_scene(system).beam_elements(self.beam)
        return StressPoints(own, _ALONG, lambda parameters: _outline(own.body, parameters))


def _outline(body: BeamBody, parameters: Array) -> tuple[Array, Array]:
    """Points of the contours of sections; in the plane the lowest and the highest only."""
    kind = body.element_type()
    y, z = kind.section.outline(kind.sizes(parameters))
    if body.dimension == 2:
        ends = [int(np.argmin(y[0].real)), int(np.argmax(y[0].real))]
        y, z = y[:, ends], z[:, ends]
    return y, z


def _gradient(
    points: StressPoints, system: MechanicalSystem, states: States, weights: Array
) -> LeafGradient:
    p = points.partials(states.q, states.v, weights, system.n_b)
    v = Rows(p.columns, p.v) if np.any(p.v) else None
    return LeafGradient(q=Rows(p.columns, p.q), v=v, b=p.b)
