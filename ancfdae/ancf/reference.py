"""Reference configuration and declared start of a scene as functions of the design."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.ancf.parameters import ParameterMap
from ancfdae.bodies import BeamBody, Quantity, RigidBody
from ancfdae.naming import Naming
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.rotations import cayley, generators, rotation
from ancfdae.scene import Scene
from ancfdae.starts import NodeState, RigidMotion


@final
class Reference:
    """Reference configuration of all beams and bodies, and the start that is declared on it.

    Node k of a beam stands at start + R (sum_{e<k} l_e chord_e), and its slopes at R times those of
    the shape, with R the rotation by the beam's turn. Its start is a place, or a point of another
    member. What is rigid has one node, with its axes for slopes.

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
        moving = np.any(naming.lengths_b != 0, axis=0)
        for member in scene.members:
            own = mapping.numbers(member.name, b)[1][: -_own(member) or None]
            moving |= np.any(own != 0, axis=0)
        self.active: list[int] = np.flatnonzero(moving).tolist()

    @cached_property
    def q(self) -> Array:
        """Reference configuration, shape (n_q,)."""
        return np.concatenate([self._nodes(member).ravel() for member in self._scene.members])

    @cached_property
    def Z(self) -> Array:
        """Vectors of the start as declared, before any assembly, shape (n_vectors, d)."""
        parts = []
        for member in self._scene.members:
            X, start = self._nodes(member), self._scene.start_of(member.name)
            parts.append(start.coordinates if isinstance(start, NodeState) else X)
        d = self._scene.dimension
        return np.concatenate([part.reshape(-1, d) for part in parts])

    def velocities(self, q: Array, motion: Array) -> Array:
        """Return the declared velocities at coordinates that a rigid motion brought there.

        Velocities of nodes turn with their beam, by `motion` of shape (n_bodies, n_x).
        """
        d, first, parts = self._scene.dimension, 0, []
        for member, x in zip(self._scene.members, motion, strict=True):
            X = self._nodes(member)
            own, first = q[first : first + X.size].reshape(X.shape), first + X.size
            start = self._scene.start_of(member.name)
            V = np.zeros_like(own)
            if isinstance(start, RigidMotion):
                V = self._rigid_velocity(member, start, own)
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
        other._naming = replace(self._naming, lengths=other._lengths)
        return other

    def _nodes(self, member: BeamBody | RigidBody) -> Array:
        """Node vectors (n_nodes, n_s, d) of a beam or body in the reference configuration."""
        numbers, _ = self._mapping.numbers(member.name, self._b)
        place, turn = member.split_placement(numbers)
        X = self._shape(member) @ rotation(turn, member.dimension).T
        X = X.astype(np.result_type(X, numbers))
        X[:, 0] += self._attached(member) if place is None else place
        return X

    def _shape(self, member: BeamBody | RigidBody) -> Array:
        """Node vectors before the turn, from the origin on."""
        d = member.dimension
        if isinstance(member, RigidBody) or member.rigid:
            return np.concatenate([np.zeros((1, d)), member.directions()])[None]
        shape, n_s = member.reference(), member.element.n_s
        lengths = self._lengths[self._naming.layout.beam(member.name).elements]
        X = np.zeros((len(lengths) + 1, n_s, d), dtype=lengths.dtype)
        X[1:, 0] = np.cumsum(lengths[:, None] * shape.chords, axis=0)
        X[:, 1:] = shape.slopes[:, : n_s - 1]
        return X

    def _attached(self, member: BeamBody | RigidBody) -> Array:
        """Return the place of the point of another member where one starts."""
        point = member.attached
        assert point is not None
        vector = self._naming.vector(point, Quantity.POSITION)
        X = self._nodes(self._scene.member(point.beam)).reshape(-1, member.dimension)
        first = self._naming.layout.body(point.beam).first_vector
        start: Array = vector.weights @ X[vector.vectors - first]
        return start

    def _rigid_velocity(self, member: BeamBody | RigidBody, start: RigidMotion, X: Array) -> Array:
        """Velocity v + omega x (r - about) of positions and omega x slope of slopes."""
        d = X.shape[-1]
        numbers, _ = self._mapping.numbers(member.name, self._b)
        spin, about, velocity = start.split(numbers[len(member.placement()) :])
        omega = np.tensordot(np.atleast_1d(spin), generators(d), 1)
        arms = X.astype(np.result_type(X, numbers))
        arms[:, 0] -= about
        V: Array = arms @ omega.T
        if velocity is not None:
            V[:, 0] += velocity
        return V


def _own(member: BeamBody | RigidBody) -> int:
    """How many of its last numbers are parameters, which do not move it."""
    return len(member.parameters()) if isinstance(member, RigidBody) else 0
