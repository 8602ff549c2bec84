"""Reference and start configuration of a scene as functions of the element lengths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.ancf.parameters import ParameterMap
from ancfdae.bodies import BeamBody
from ancfdae.elements import ElementParameter
from ancfdae.numerics.arrays import Array
from ancfdae.scene import RigidMotion, Scene


@final
@dataclass(frozen=True)
class StartState:
    """Coordinates and velocities with their design partials.

    Attributes
    ----------
    q_reference, q, v : array, shape (n_q,)
        Reference configuration; start as declared.
    q_reference_b, q_b, v_b : array, shape (n_q, n_b)
    """

    q_reference: Array
    q_reference_b: Array
    q: Array
    q_b: Array
    v: Array
    v_b: Array


def length_partials(mapping: ParameterMap, n_b: int) -> Array:
    """Return d(element lengths)/db, shape (n, n_b)."""
    partial = np.zeros((len(mapping.base), n_b))
    chosen = mapping.pairs(ElementParameter.LENGTH)
    partial[mapping.elements[chosen], mapping.variables[chosen]] = mapping.weights[chosen]
    return partial


def start_state(scene: Scene, lengths: Array, lengths_b: Array) -> StartState:
    """Evaluate reference and start configuration and their design partials.

    Only the element lengths carry the design: node k of a beam stands at
    start + sum_{e<k} l_e chord_e, and slopes do not change with the length.

    Parameters
    ----------
    scene : Scene
    lengths : array, shape (n,)
    lengths_b : array, shape (n, n_b)
    """
    first = scene.first_elements()
    parts: list[list[Array]] = [[] for _ in range(6)]
    for beam in scene.beams:
        chosen = slice(first[beam.name], first[beam.name] + beam.element_count)
        X, X_b = _nodes(beam, lengths[chosen], lengths_b[chosen])
        Z, Z_b = X, X_b
        V, V_b = np.zeros_like(X), np.zeros_like(X_b)
        for motion in (s for s in scene.start if s.beam == beam.name):
            if isinstance(motion, RigidMotion):
                V, V_b = _rigid_velocity(motion, Z, Z_b)
                continue
            Z, Z_b = motion.coordinates.astype(X.dtype), np.zeros_like(X_b)
            if motion.velocities is not None:
                V, V_b = motion.velocities.astype(X.dtype), np.zeros_like(X_b)
        for part, array in zip(parts, (X, X_b, Z, Z_b, V, V_b), strict=True):
            part.append(array)
    n_b = lengths_b.shape[1]
    q_o, q_ob, q, q_b, v, v_b = (np.concatenate(part) for part in parts)
    n_q = q.size
    return StartState(
        q_reference=q_o.ravel(),
        q_reference_b=q_ob.reshape(n_q, n_b),
        q=q.ravel(),
        q_b=q_b.reshape(n_q, n_b),
        v=v.ravel(),
        v_b=v_b.reshape(n_q, n_b),
    )


def _nodes(beam: BeamBody, lengths: Array, lengths_b: Array) -> tuple[Array, Array]:
    """Node vectors (n + 1, n_s, d) of the reference configuration and their partials."""
    shape = beam.reference()
    d, n_s, n_b = beam.dimension, beam.element.n_s, lengths_b.shape[1]
    X = np.zeros((len(lengths) + 1, n_s, d), dtype=lengths.dtype)
    X[:, 0] = shape.start
    X[1:, 0] += np.cumsum(lengths[:, None] * shape.chords, axis=0)
    X[:, 1:] = shape.slopes[:, : n_s - 1]
    X_b = np.zeros((*X.shape, n_b), dtype=lengths.dtype)
    X_b[1:, 0] = np.cumsum(shape.chords[..., None] * lengths_b[:, None, :], axis=0)
    return X, X_b


def _rigid_velocity(motion: RigidMotion, X: Array, X_b: Array) -> tuple[Array, Array]:
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
    V = arms @ omega.T
    if motion.velocity is not None:
        V[:, 0] += np.asarray(motion.velocity, dtype=float)
    return V, np.einsum("ij,nsjb->nsib", omega, X_b)
