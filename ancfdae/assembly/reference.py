"""Reference configuration and declared start of a scene as functions of the design."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.model.bodies import BeamBody, Quantity, RigidBody
from ancfdae.model.scene import Scene
from ancfdae.model.starts import InitialVelocity, NodalState
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.rotations import cayley, generators, rotation


@final
class Reference:
    """Reference configuration of all bodies, and the declared start, at design values b.

    Node k of a beam is at start + R (sum_{e<k} l_e chord_e), and its slopes are R times the slopes
    of the shape, with R the rotation by the beam's `turn`. The start is a position, or a point of
    another body, which is placed before. A rigid body or beam has one node: its position and R
    times its directions. The values b of the design variables, with the element lengths of the
    naming at them, are real or complex. Both configurations depend on the `active` variables.
    """

    def __init__(self, scene: Scene, mapping: ParameterMap, b: Array, naming: SceneNaming) -> None:
        self._scene, self._mapping, self._b = scene, mapping, b
        self._lengths, self._naming = naming.lengths, naming
        self._firsts = scene.first_elements()
        self._moved: dict[int, Reference] = {}
        self._stateful = [part for part in (*scene.joints, *scene.loads) if part.states]
        # Vectors of added coordinates and integrals of states start from zero.
        shapes = [(len(part.states), scene.dimension) for part in self._stateful]
        self._zero_states = [np.zeros(shape) for shape in shapes]

    @cached_property
    def active(self) -> list[int]:
        """Design variables that the reference configuration or the start depends on."""
        moving = np.any(self._naming.lengths_b != 0, axis=0)
        for body in self._scene.members:
            moving |= np.any(self._placed(body)[1] != 0, axis=0)
        if self._stateful:
            moving |= np.any(self.state_rates_b != 0, axis=0)
        return np.flatnonzero(moving).tolist()

    @cached_property
    def q(self) -> Array:
        """Coordinates of the reference configuration, shape (n_q,); m, slopes dimensionless."""
        parts = [self._vectors[body.name].ravel() for body in self._scene.members]
        return np.concatenate([*parts, *(x.ravel() for x in self._zero_states)])

    @cached_property
    def Z(self) -> Array:
        """Position and slope vectors of the declared start, before assembly, (n_vectors, d)."""
        parts = []
        for body in self._scene.members:
            X, start = self._vectors[body.name], self._scene.start_of.get(body.name)
            parts.append(self._of(start.coordinates, body) if isinstance(start, NodalState) else X)
        return np.concatenate([*parts, *self._zero_states])

    def velocities(self, q: Array, motion: Array | None) -> Array:
        """Return the declared velocities, (n_q,), at coordinates q, after a rigid motion if given.

        Velocities of nodes rotate with their body, by `motion` of shape (n_bodies, n_x).
        """
        d, first, parts = self._scene.dimension, 0, []
        for k, body in enumerate(self._scene.members):
            X = self._vectors[body.name]
            vectors, first = q[first : first + X.size].reshape(X.shape), first + X.size
            start = self._scene.start_of.get(body.name)
            V = np.zeros_like(vectors)
            if isinstance(start, InitialVelocity):
                V = self._rigid_velocity(body, start, vectors)
            elif isinstance(start, NodalState) and start.velocities is not None:
                V = self._of(start.velocities, body)
                V = V if motion is None else V @ cayley(motion[k : k + 1, d:], d)[0].T
            parts.append(V.ravel())
        return np.concatenate([*parts, *([self.state_rates] if self._stateful else [])])

    def moved(self, i: int) -> Reference:
        """Return the reference with design variable i perturbed by an imaginary step."""
        if i not in self.active:
            return self
        if i not in self._moved:
            b = self._b + 1j * STEP * np.eye(len(self._b))[i]
            lengths = self._lengths + 1j * STEP * self._naming.lengths_b[:, i]
            naming = replace(self._naming, lengths=lengths)
            self._moved[i] = Reference(self._scene, self._mapping, b, naming)
        return self._moved[i]

    @property
    def state_rates(self) -> Array:
        """Rates of the vectors of states of joints and controllers at t = 0, (d n_states,)."""
        return self._state_rates(self._b)

    @cached_property
    def state_rates_b(self) -> Array:
        """Design derivatives of `state_rates`, shape (d n_states, n_b)."""
        steps = 1j * STEP * np.eye(len(self._b))
        columns = [self._state_rates(self._b.real + step).imag / STEP for step in steps]
        return np.array(columns).reshape(len(self._b), len(self.state_rates)).T

    def _state_rates(self, b: Array) -> Array:
        d, parts = self._scene.dimension, [np.zeros(0)]
        for part in self._stateful:
            p = self._mapping.numbers(part.name, b)[0][: len(part.parameters())]
            parts += [np.append(x, np.zeros(d - 1)) for x in part.initial_states(p)]
        return np.concatenate(parts)

    def _of(self, nodes: Array, body: BeamBody | RigidBody) -> Array:
        """Return the vectors of a body, (count, d), from vectors of nodes or of element ends."""
        layout = self._naming.layout.body(body.name)
        X = nodes if nodes.ndim == 4 else np.stack([nodes[:-1], nodes[1:]], axis=1)
        vectors = np.zeros((layout.count, X.shape[-1]), dtype=X.dtype)
        vectors[layout.ends - layout.first_vector] = X.reshape(*layout.ends.shape, -1)
        return vectors

    def _positions(self, body: BeamBody | RigidBody) -> Array:
        """Return the indices of the positions among the vectors of a body."""
        layout = self._naming.layout.body(body.name)
        return layout.positions - layout.first_vector

    @cached_property
    def _vectors(self) -> dict[str, Array]:
        """Vectors of each body in the reference configuration, shape (count, d), by name."""
        known: dict[str, Array] = {}
        for body in self._scene.by_attachment:
            numbers, _ = self._placed(body)
            place, turn = body.split_placement(numbers)
            X = self._unturned(body)
            kind = np.result_type(X, numbers, self._lengths)
            X = X.astype(kind) @ rotation(turn, body.dimension).T
            place = self._attached(body, known) if place is None else place
            X = X.astype(np.result_type(X, place), copy=False)
            X[self._positions(body)] += place
            known[body.name] = X
        return known

    def _unturned(self, body: BeamBody | RigidBody) -> Array:
        """Return the vectors of a body at the origin and not rotated, shape (count, d)."""
        if isinstance(body, RigidBody) or body.rigid:
            return np.concatenate([np.zeros((1, body.dimension)), body.directions()])
        shape, first, n_s = body.reference(), self._firsts[body.name], body.element.n_s
        lengths = self._lengths[first : first + body.element_count]
        X = np.zeros((len(lengths) + 1, n_s, body.dimension), dtype=lengths.dtype)
        X[1:, 0] = np.cumsum(lengths[:, None] * shape.chords, axis=0)
        X[:, 1:] = shape.slopes[:, : n_s - 1]
        return self._of(X, body)

    def _attached(self, body: BeamBody | RigidBody, known: dict[str, Array]) -> Array:
        """Return the position, (d,), of the point that a body is attached to.

        `known` holds the vectors of bodies that are placed already.
        """
        point = body.attached
        assert point is not None
        vector = self._naming.vector(point, Quantity.POSITION)
        other = known[point.beam]
        first = self._naming.layout.body(point.beam).first_vector
        return vector.weights @ other[vector.vectors - first]

    def _placed(self, body: BeamBody | RigidBody) -> tuple[Array, Array]:
        """Return a body's numbers from its placement on, and their design derivatives."""
        first = body.design_places[1] if isinstance(body, RigidBody) else 0
        numbers, numbers_b = self._mapping.numbers(body.name, self._b)
        return numbers[first:], numbers_b[first:]

    def _rigid_velocity(
        self, body: BeamBody | RigidBody, start: InitialVelocity, X: Array
    ) -> Array:
        """Return the velocities v + omega x (r - about) of positions, omega x slope of slopes."""
        d = X.shape[-1]
        numbers = self._placed(body)[0][len(body.placement()) :]
        spin, about, velocity = start.split(numbers)
        omega = np.tensordot(np.atleast_1d(spin), generators(d), 1)
        arms, positions = X.astype(np.result_type(X, numbers)), self._positions(body)
        arms[positions] -= about
        V: Array = arms @ omega.T
        if velocity is not None:
            V[positions] += velocity
        return V
