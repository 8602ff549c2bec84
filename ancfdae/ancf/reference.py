"""Reference and start configuration of a scene as functions of the element lengths."""

from __future__ import annotations

import copy
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.bodies import BeamBody, RigidBody
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.scene import Scene
from ancfdae.starts import NodeState, RigidMotion


@final
class StartState:
    """Reference and start configuration.

    Only the element lengths carry the design: node k of a beam stands at
    start + sum_{e<k} l_e chord_e, and slopes do not change with the length.

    Parameters
    ----------
    scene : Scene
    lengths : array, shape (n,)
    lengths_b : array, shape (n, n_b)

    Attributes
    ----------
    active : list of int
        Design variables that they depend on.
    """

    def __init__(self, scene: Scene, lengths: Array, lengths_b: Array) -> None:
        self._scene, self._lengths, self._lengths_b = scene, lengths, lengths_b
        self._firsts = scene.first_elements()
        self.active: list[int] = np.flatnonzero(np.any(lengths_b != 0, axis=0)).tolist()

    @property
    def q_reference(self) -> Array:
        """Reference configuration, shape (n_q,)."""
        return self._states[0]

    @property
    def q(self) -> Array:
        """Start as declared, shape (n_q,)."""
        return self._states[1]

    @property
    def v(self) -> Array:
        """Its velocity, shape (n_q,)."""
        return self._states[2]

    @cached_property
    def _states(self) -> tuple[Array, Array, Array]:
        parts = []
        for body in self._scene.members:
            X = Z = self._nodes(body)
            V = np.zeros_like(X)
            motion = self._scene.start_of(body.name)
            if isinstance(motion, RigidMotion):
                V = _rigid_velocity(motion, Z)
            elif isinstance(motion, NodeState):
                Z = motion.coordinates.astype(X.dtype)
                if motion.velocities is not None:
                    V = motion.velocities.astype(X.dtype)
            parts.append((X.ravel(), Z.ravel(), V.ravel()))
        q_o, q, v = (np.concatenate(part) for part in zip(*parts, strict=True))
        return q_o, q, v

    def _nodes(self, body: BeamBody | RigidBody) -> Array:
        """Node vectors (n_nodes, n_s, d) of the reference configuration, one node if rigid."""
        if isinstance(body, RigidBody):
            frame = np.concatenate([[body.position], body.directions()])
            return frame[None].astype(self._lengths.dtype)
        if body.rigid:
            frame = np.concatenate([[body.reference().start], body.directions()])
            return frame[None].astype(self._lengths.dtype)
        first = self._firsts[body.name]
        lengths = self._lengths[first : first + body.element_count]
        return _beam_nodes(body, lengths)

    def moved(self, i: int) -> StartState:
        """Return them moved in design variable i by an imaginary step."""
        if i not in self.active:
            return self
        other = copy.copy(self)
        other.__dict__.pop("_states", None)
        other._lengths = self._lengths + 1j * STEP * self._lengths_b[:, i]
        return other


def _beam_nodes(beam: BeamBody, lengths: Array) -> Array:
    """Node vectors (n + 1, n_s, d) of the reference configuration."""
    shape, n_s = beam.reference(), beam.element.n_s
    X = np.zeros((len(lengths) + 1, n_s, len(shape.start)), dtype=lengths.dtype)
    X[:, 0] = shape.start
    X[1:, 0] += np.cumsum(lengths[:, None] * shape.chords, axis=0)
    X[:, 1:] = shape.slopes[:, : n_s - 1]
    return X


def _rigid_velocity(motion: RigidMotion, X: Array) -> Array:
    """Velocity v + omega x (r - about) of positions and omega x slope of slopes."""
    d = X.shape[-1]
    spin = np.atleast_1d(np.asarray(motion.angular_velocity, dtype=float))
    if d == 2:
        omega = np.array([[0.0, -spin[0]], [spin[0], 0.0]])
    else:
        x, y, z = spin
        omega = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    arms = X.copy()
    arms[:, 0] -= np.asarray(motion.about, dtype=float)
    V: Array = arms @ omega.T
    if motion.velocity is not None:
        V[:, 0] += np.asarray(motion.velocity, dtype=float)
    return V
