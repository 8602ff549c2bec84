"""Reference configuration and declared start of a scene as functions of the design."""

from __future__ import annotations

import copy
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.ancf.parameters import ParameterMap
from ancfdae.bodies import BeamBody, Quantity, ReferenceShape
from ancfdae.elements import ElementParameter
from ancfdae.naming import Naming
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.rotations import cayley, generators, rotation
from ancfdae.scene import Scene
from ancfdae.starts import NodeState, RigidMotion


def length_partials(mapping: ParameterMap, n_b: int) -> Array:
    """Return d(element lengths)/db, shape (n, n_b)."""
    partial = np.zeros((len(mapping.base), n_b))
    chosen = mapping.pairs(ElementParameter.LENGTH)
    partial[mapping.elements[chosen], mapping.variables[chosen]] = mapping.weights[chosen]
    return partial


@final
class Reference:
    """Reference configuration of all beams, and the start that is declared on it.

    Node k of a beam stands at start + R (sum_{e<k} l_e chord_e), and its slopes at R times those of
    the shape, with R the rotation by the beam's turn. Its start is a place, or a point of another
    beam.

    Parameters
    ----------
    scene : Scene
    mapping : ParameterMap
    b : array, shape (n_b,)
        Values of the design variables, real or complex.
    naming : Naming
        With element lengths at these values.

    Attributes
    ----------
    active : list of int
        Design variables that reference configuration or start depend on.
    """

    def __init__(self, scene: Scene, mapping: ParameterMap, b: Array, naming: Naming) -> None:
        self._scene, self._mapping, self._b = scene, mapping, b
        self._lengths, self._naming = naming.lengths, naming
        self._shapes = {beam.name: beam.reference() for beam in scene.beams}
        moving = np.any(naming.lengths_b != 0, axis=0)
        for beam in scene.beams:
            moving |= np.any(mapping.numbers(beam.name, b)[1] != 0, axis=0)
        self.active: list[int] = np.flatnonzero(moving).tolist()

    @cached_property
    def q(self) -> Array:
        """Reference configuration, shape (n_q,)."""
        return np.concatenate([self._nodes(beam).ravel() for beam in self._scene.beams])

    @cached_property
    def Z(self) -> Array:
        """Vectors of the start as declared, before any assembly, shape (n_vectors, d)."""
        parts = []
        for beam in self._scene.beams:
            X, start = self._nodes(beam), self._scene.start_of(beam.name)
            parts.append(start.coordinates if isinstance(start, NodeState) else X)
        d = self._scene.dimension
        return np.concatenate([part.reshape(-1, d) for part in parts])

    def velocities(self, q: Array, motion: Array) -> Array:
        """Return the declared velocities at coordinates that a rigid motion brought there.

        Velocities of nodes turn with their beam, by `motion` of shape (n_bodies, n_x).
        """
        d, first, parts = self._scene.dimension, 0, []
        for beam, x in zip(self._scene.beams, motion, strict=True):
            X = self._nodes(beam)
            own, first = q[first : first + X.size].reshape(X.shape), first + X.size
            start = self._scene.start_of(beam.name)
            V = np.zeros_like(own)
            if isinstance(start, RigidMotion):
                V = self._rigid_velocity(beam, start, own)
            elif isinstance(start, NodeState) and start.velocities is not None:
                V = start.velocities @ cayley(x[None, d:], d)[0].T
            parts.append(V.ravel())
        return np.concatenate(parts)

    def moved(self, i: int) -> Reference:
        """Return them moved in design variable i by an imaginary step."""
        if i not in self.active:
            return self
        other = copy.copy(self)
        for name in ("q", "Z", "_starts"):
            other.__dict__.pop(name, None)
        other._b = self._b + 1j * STEP * np.eye(len(self._b))[i]
        other._lengths = self._lengths + 1j * STEP * self._naming.lengths_b[:, i]
        other._naming = Naming(self._naming.layout, other._lengths, self._naming.lengths_b)
        return other

    def _nodes(self, beam: BeamBody) -> Array:
        """Node vectors (n + 1, n_s, d) of a beam in the reference configuration."""
        shape: ReferenceShape = self._shapes[beam.name]
        first, n_s, d = self._first(beam), beam.element.n_s, beam.dimension
        lengths = self._lengths[first : first + beam.element_count]
        numbers, _ = self._mapping.numbers(beam.name, self._b)
        start, turn = beam.split_placement(numbers)
        R = rotation(turn, d)
        X = np.zeros((len(lengths) + 1, n_s, d), dtype=np.result_type(lengths, numbers))
        X[1:, 0] = np.cumsum(lengths[:, None] * shape.chords, axis=0)
        X[:, 1:] = shape.slopes[:, : n_s - 1]
        X = X @ R.T
        X[:, 0] += self._attached(beam) if start is None else start
        return X

    def _attached(self, beam: BeamBody) -> Array:
        """Return the place of the point of another beam where a beam starts."""
        point = beam.attached
        assert point is not None
        vector = self._naming.vector(point, Quantity.POSITION)
        other = self._scene.beam(point.beam)
        X = self._nodes(other).reshape(-1, other.dimension)
        place = self._naming.layout.beam(point.beam).first_node * other.element.n_s
        start: Array = vector.weights @ X[vector.vectors - place]
        return start

    def _first(self, beam: BeamBody) -> int:
        return self._naming.layout.beam(beam.name).first_element

    def _rigid_velocity(self, beam: BeamBody, start: RigidMotion, X: Array) -> Array:
        """Velocity v + omega x (r - about) of positions and omega x slope of slopes."""
        d = X.shape[-1]
        numbers, _ = self._mapping.numbers(beam.name, self._b)
        spin, about, velocity = start.split(numbers[len(beam.placement()) :])
        omega = np.tensordot(np.atleast_1d(spin), generators(d), 1)
        arms = X.astype(np.result_type(X, numbers))
        arms[:, 0] -= about
        V: Array = arms @ omega.T
        if velocity is not None:
            V[:, 0] += velocity
        return V
