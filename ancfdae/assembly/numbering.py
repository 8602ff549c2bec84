"""Numbering of coordinates: vectors of d numbers, body by body.

A beam has n_s vectors per node and one more per kink; a rigid body or beam has one frame of d + 1
vectors: its reference point and its directions (docs/theory/02-strain-energy.md). Then follow one
vector for each coordinate that a joint adds, and one for each state of a controller
(docs/theory/17-controllers.md and 20-cables.md).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.layout import BeamLayout, BodyLayout, RigidNodes, StatesLayout
from ancfdae.assembly.rigid_motions import RigidMotions
from ancfdae.model.bodies import BeamBody, RigidBody
from ancfdae.model.elements import BeamElement, default_element
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Numbering:
    """Indices of the coordinates of every body and every flexible element."""

    d: int  # dimension of space
    bodies: tuple[BodyLayout, ...]  # of all beams and rigid bodies in the order of their vectors
    beams: tuple[BeamLayout, ...]
    rigid: Array  # of bool, (n_bodies,)
    elements: Array  # of int, (n,): indices of the flexible elements in the scene
    # flexible element whose nodes have all vectors that nodes of other flexible elements have.
    widest: BeamElement
    # of int, (n, n_a): indices of their node vectors; vector k has the coordinates d k to d k + d -
    # 1. Rows of elements with fewer vectors than the widest repeat their first vector.
    vectors: Array
    n_q: int  # number of coordinates
    # of int, (n, d + 1): vectors of every node with d slopes, and of rigid bodies and beams; each
    # row begins with the position.
    sections: Array
    frames: Array  # of int, (n_rigid, d + 1): vectors of rigid bodies and beams
    positions: Array  # of int: vectors that are positions
    sliders: tuple[StatesLayout, ...]
    controllers: tuple[StatesLayout, ...]
    masses: Array  # (n_states,): masses of the vectors of states of joints and controllers
    controlled: int  # number of states of controllers, whose vectors are the last ones
    routed: bool  # whether a joint or load has a guide or pulleys that a motion may leave

    def rigid_motions(self) -> RigidMotions:
        """Return the rigid motions of all bodies, as maps on the coordinates."""
        counts = [body.count for body in self.bodies]
        # Vectors of states start at zero and are no positions: no motion of a body moves them.
        counts[-1] += len(self.masses)
        owner = np.repeat(np.arange(len(self.bodies)), counts)
        is_position = np.zeros(len(owner), dtype=bool)
        is_position[self.positions] = True
        return RigidMotions(owner, is_position, self.d)

    def size(self, weights: Array) -> float:
        """Return the size of the bodies in the norm with weights of coordinates, (n_q,)."""
        w = weights.reshape(-1, self.d)[:, 0]
        return float(np.sqrt(sum(np.sum(w[x.positions]) * x.size**2 for x in self.bodies)))

    @property
    def owners(self) -> Array:
        """Index of the beam of each flexible element among the bodies, shape (n,)."""
        counts = [0 if beam.rigid else beam.element_count for beam in self.beams]
        return np.repeat(np.arange(len(self.beams)), counts)

    def coordinates(self, vectors: Array) -> Array:
        """Return the coordinate indices of vectors, shape (..., d) for indices of shape (...)."""
        return vectors[..., None] * self.d + np.arange(self.d)

    def couplings(self, turning: bool) -> tuple[Array, Array]:
        """Return rows and columns of entries that couple coordinates of an element or rigid body.

        Within rigid bodies only a rotating frame (`turning`) couples directions of space.
        """
        size = self.vectors.shape[1] * self.d
        soft = self.coordinates(self.vectors).reshape(-1, size)
        frames = self.coordinates(self.frames)
        if turning:
            frames = frames.reshape(len(frames), (self.d + 1) * self.d, 1)
        return coupled([soft[..., None], frames])


def coupled(blocks: Iterable[Array]) -> tuple[Array, Array]:
    """Return row and column indices of entries (x[i, a, c], x[i, b, c]) for blocks x, (n, k, m)."""
    rows, columns = [], []
    for x in blocks:
        shape = (len(x), x.shape[1], *x.shape[1:])
        rows.append(np.broadcast_to(x[:, :, None], shape).ravel())
        columns.append(np.broadcast_to(x[:, None], shape).ravel())
    return np.concatenate(rows), np.concatenate(columns)


def number(scene: Scene) -> Numbering:
    """Return the numbering of a scene, body by body and node by node."""
    bodies, beams, vectors, elements = [], [], [], []
    sections, frames, positions = [], [], []
    soft = [beam.element for beam in scene.beams if not beam.rigid]
    widest = max(soft, key=lambda element: element.n_s, default=default_element(scene.dimension))
    vector = first = 0
    for member in scene.members:
        body = _body_layout(member, vector, scene.kinks.get(member.name, ()))
        bodies.append(body)
        vector += body.count
        positions.append(body.positions)
        if body.stride == scene.dimension + 1:
            sections.append(body.nodes)
        if isinstance(member, RigidBody) or member.rigid:
            frames.append(body.nodes)
        if isinstance(member, RigidBody):
            continue
        numbers = np.arange(member.element_count)
        if not member.rigid:
            places = np.repeat(body.ends[:, :1], widest.n_a, axis=1)
            places[:, member.element.places_in(widest)] = body.ends
            vectors.append(places)
            elements.append(first + numbers)
        beams.append(_beam_layout(member, first))
        first += member.element_count
    sliders, controllers, masses = list[StatesLayout](), list[StatesLayout](), list[float]()
    routed = False
    for joint in scene.joints:
        routed = routed or joint.routed
        if joint.states:
            sliders.append(StatesLayout(joint.name, vector, joint.states))
            masses += joint.state_masses()
            vector += len(joint.states)
    controlled = vector
    for load in scene.loads:
        routed = routed or load.routed
        if load.states:
            controllers.append(StatesLayout(load.name, vector, load.states))
            vector += len(load.states)
    empty = np.zeros(0, dtype=np.int64)
    return Numbering(
        d=scene.dimension,
        bodies=tuple(bodies),
        beams=tuple(beams),
        rigid=np.array([isinstance(x, RigidBody) or x.rigid for x in scene.members]),
        elements=np.concatenate([empty, *elements]),
        widest=widest,
        vectors=np.concatenate([empty.reshape(0, widest.n_a), *vectors]),
        n_q=vector * scene.dimension,
        sections=np.concatenate([empty.reshape(0, scene.dimension + 1), *sections]),
        frames=np.concatenate([empty.reshape(0, scene.dimension + 1), *frames]),
        positions=np.concatenate(positions),
        sliders=tuple(sliders),
        controllers=tuple(controllers),
        masses=np.array(masses + [1.0] * (vector - controlled)),
        controlled=vector - controlled,
        routed=routed,
    )


def _body_layout(member: BeamBody | RigidBody, first: int, kinks: tuple[int, ...]) -> BodyLayout:
    if isinstance(member, RigidBody):
        moments = member.moments(np.array(list(member.parameters().values())))
        size = float(np.sqrt(np.trace(moments[1:, 1:]) / moments[0, 0]))
    else:
        size = float(np.sum(member.reference().lengths))
        if not member.rigid:
            stride = member.element.n_s
            count = (member.element_count + 1) * stride + len(kinks)
            return BodyLayout(member.name, first, count, stride, size, kinks)
    return BodyLayout(member.name, first, member.dimension + 1, member.dimension + 1, size)


def _beam_layout(beam: BeamBody, first: int) -> BeamLayout:
    shape, rigid = beam.reference(), None
    if beam.rigid:
        axes = beam.directions().T
        chords = tuple(map(tuple, (shape.chords @ axes).tolist()))
        slopes = tuple(tuple(map(tuple, node)) for node in (shape.slopes @ axes).tolist())
        rigid = RigidNodes(chords, slopes)
    return BeamLayout(beam.name, beam.element, first, tuple(shape.fractions.tolist()), rigid)
