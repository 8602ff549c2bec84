"""Geometry of a scene at one design: reference configuration, declared start, inputs of parts.

Inputs of joints and loads are their vectors of points, design fields and reference vectors.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.joint_input import JointInput
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.left_out_pairs import near_pairs
from ancfdae.assembly.load_forces import LoadInput, own_numbers
from ancfdae.assembly.naming import PointVector, SceneNaming, Vectors, point_vectors
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.errors.checks import require_index
from ancfdae.model.bodies import BeamBody, MaterialPoint, Quantity, RigidBody
from ancfdae.model.elements import ElementParameter
from ancfdae.model.joints.joint import Joint, JointEquations, RightAngle, empty_equations
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.pair_contact import leaves_out, without
from ancfdae.model.parts import Elements, FrameDirection, Part
from ancfdae.model.parts import Vectors as Names
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
            point = body.attached
            if place is None and point is not None:  # A point of a body that is placed already.
                vector = self._naming.vector(point, Quantity.POSITION)
                first = self._naming.layout.body(point.beam).first_vector
                place = vector.weights @ known[point.beam][vector.vectors - first]
            assert place is not None
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


_FLAT = frozenset((Quantity.SLOPE_Y, Quantity.SLOPE_Z))
# Fraction of the element length within which two locations count as one.
_NEAR = 1e-6


@final
@dataclass(frozen=True)
class Rigidity(Joint):
    """Constraints that keep the directions of a rigid body orthonormal.

    (d_i . d_j - delta_ij) / (1 + delta_ij) = 0: three equations in the plane and six in space,
    named ``rigid(body)``.
    """

    beam: str

    kind = "rigid"

    @property
    def by_slopes(self) -> bool:
        """Return true: the equations of all rigid bodies have the same coefficients."""
        return True

    def vectors(self, elements: Elements) -> Names:
        """Return the directions of the axes of the rigid body."""
        return tuple(FrameDirection(self.beam, k + 1) for k in range(elements.d))

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of d_i . d_j for i <= j."""
        i, j = np.triu_indices(reference.shape[1])
        rows = np.arange(len(i))
        c = empty_equations(len(i), p, reference)
        c.bilinear[rows, i, j] = c.bilinear[rows, j, i] = 1.0
        c.offset[:] = 0.5 * (i == j)
        return c


@final
class HeldAngles:
    """The right angles of sections that joints keep so far.

    Slopes of a section are linear along an element, and so is the change of its right angle: two
    sections of an element fix it in every other one. Bodies in `rigid` keep their shape by
    themselves; elements without a section have no right angle.
    """

    def __init__(self, layout: Layout, rigid: Container[str] = ()) -> None:
        self._layout, self._rigid = layout, rigid
        self._named: set[RightAngle] = set()
        self._flat: dict[str, Array] = {}

    def add(self, angle: RightAngle) -> bool:
        """Add a right angle of a section; return whether it needs an equation."""
        if angle.fraction is None or angle.beam in self._rigid or angle in self._named:
            return False
        beam = self._layout.beam(angle.beam)
        if Quantity.SLOPE_Y not in beam.element.quantities:
            return False
        self._named.add(angle)
        if angle.slopes != _FLAT:
            return True
        element, xi = beam.locate(angle.fraction, angle.before)
        weights = np.zeros((1, beam.element_count + 1))
        weights[0, element], weights[0, element + 1] = 1 - xi, xi
        held = self._flat.get(angle.beam, weights[:0])
        both = np.vstack([held, weights])
        if np.linalg.matrix_rank(both, tol=_NEAR) == len(held):
            return False
        self._flat[angle.beam] = both
        return True


@final
@dataclass(frozen=True, eq=False)
class PartInputs:
    """Inputs of joints and loads, with their design derivatives, at design values b."""

    scene: Scene
    numbering: Numbering
    naming: SceneNaming
    mapping: ParameterMap
    reference: Reference
    b: Array
    elements: Elements

    def along(self, q: Array, wider: float) -> PartInputs:
        """Return the inputs in which contact loads have the pairs near states q, (k, n_q).

        The inputs themselves are returned if they have these pairs.
        """
        found = dict[str, Array]()
        for load in self.scene.loads:
            if leaves_out(load):
                near = near_pairs(load, self.naming, self.elements, q.real, wider)
                if len(without(near, load.pairs(self.elements))):
                    found[load.name] = near
        if not found:
            return self
        return replace(self, elements=replace(self.elements, pairs=self.elements.pairs | found))

    def joints(self) -> JointStructure:
        """Return the structure of all joints, with the constraints of rigid bodies.

        Equations that the scene leaves out, and right angles that are kept already, are dropped.
        """
        bodies = zip(self.numbering.bodies, self.numbering.rigid, strict=True)
        rigidities = [Rigidity(body.name) for body, rigid in bodies if rigid]
        held = HeldAngles(self.naming.layout, {item.beam for item in rigidities})
        inputs, vectors = self._together((*self.scene.joints, *rigidities))
        for k, item in enumerate(inputs):
            name, c = item.joint.name, item.parts[0]
            left_out = [row for owner, row in self.scene.left_out if owner == name]
            for row in left_out:
                where = f"Scene.left_out, equation of {name!r}"
                require_index(where, row, len(c.offset), "Counted from 0.")
            shapes = enumerate(c.shapes, len(c.offset) - len(c.shapes))
            dropped = {row for row, angle in shapes if not held.add(angle)} | {*left_out}
            if dropped:
                inputs[k] = replace(item, dropped=tuple(sorted(dropped)))
        return JointStructure.of(inputs, vectors)

    def joints_like(self, known: JointStructure) -> JointStructure | None:
        """Return the joints at these values in the structure `known`; None if they do not fit."""
        inputs, vectors = self._together([slot.item.joint for slot in known.slots])
        pairs = zip(inputs, known.slots, strict=True)
        inputs = [replace(item, dropped=slot.item.dropped) for item, slot in pairs]
        return known.with_numbers(inputs, vectors)

    def loads(self) -> list[LoadInput]:
        """Return the inputs of all loads of the scene."""
        return [self.load(load) for load in self.scene.loads]

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times between which all joints and loads are analytic functions of time; s."""
        parts = (*self.scene.joints, *self.scene.loads)
        numbers = ((part, self.mapping.numbers(part.name, self.b)[0]) for part in parts)
        return tuple(t for part, p in numbers for t in part.breakpoints(p))

    def joint(self, joint: Joint) -> tuple[JointInput, Vectors]:
        """Return the input of one joint alone, with its vectors."""
        (item,), vectors = self._together([joint])
        return item, vectors

    def load(self, load: Load) -> LoadInput:
        """Return the input of one load: vectors, parameters and reference, with derivatives."""
        points, p, p_b = self._part(load)
        vectors = self._vectors(points)
        reference, reference_b = self._in_reference(vectors)
        own, own_b = own_numbers(load.copies(self.elements), self.naming, p, p_b)
        n = len(reference) // max(len(own), 1)
        used = {i: x[:n] for i, x in reference_b.items()} if load.refers else {}
        masses = self._masses(load)
        return LoadInput(load, vectors, p, p_b, reference[:n], used, masses, own, own_b)

    def in_all_states(self, load: Load) -> LoadInput:
        """Return the input of one load that serves all states: contact with all pairs."""
        if not leaves_out(load):
            return self.load(load)
        whole = replace(self, elements=replace(self.elements, pairs={}))
        return whole.load(replace(load, reach=None))

    def _masses(self, load: Load) -> Array:
        """Return the masses of the vectors of the states of a load, (n_states,)."""
        numbering = self.numbering
        first = numbering.n_q // numbering.d - len(numbering.masses)
        its = [x.first_vector - first for x in numbering.controllers if x.name == load.name]
        return numbering.masses[its[0] : its[0] + len(load.states)] if its else numbering.masses[:0]

    def in_reference(self, point: MaterialPoint, quantity: Quantity) -> tuple[Array, Array]:
        """Return a vector of a point in the reference, (d,), and its design partials, (d, n_b)."""
        vectors = self._vectors([self.naming.vector(point, quantity)])
        (U_o,), moving = self._in_reference(vectors)
        U_ob = np.zeros((len(U_o), len(self.b)))
        for i, change in moving.items():
            U_ob[:, i] = change[0].real
        return U_o, U_ob

    def _together(self, joints: Sequence[Joint]) -> tuple[list[JointInput], Vectors]:
        """Return the inputs of joints, and their vectors joined in one `Vectors`."""
        parts = [self._part(joint) for joint in joints]
        vectors = self._vectors([vector for points, *_ in parts for vector in points])
        # Partials of all vectors of a large scene in all variables would not fit into memory.
        still = not (self.reference.active or np.any(vectors.moves))
        whole = self._in_reference(vectors)[0] if still else None
        inputs, first = list[JointInput](), 0
        alike: dict[object, tuple[Joint, list[JointEquations]]] = {}
        for joint, (points, p, p_b) in zip(joints, parts, strict=True):
            first, begin = first + len(points), first
            if whole is None:
                reference, reference_b = self._in_reference(self._vectors(points))
            else:
                reference, reference_b = whole[begin:first], {}
            inputs.append(JointInput(joint, p, p_b, reference, reference_b, alike=alike))
        return inputs, vectors

    def _vectors(self, points: list[PointVector]) -> Vectors:
        return Vectors.of_points(points, self.numbering.d, self.numbering.n_q, len(self.b))

    def _in_reference(self, vectors: Vectors) -> tuple[Array, dict[int, Array]]:
        """Return vectors in the reference, (n_v, d), and their nonzero design partials."""
        q_o, active = self.reference.q, self.reference.active
        reference = vectors.of(q_o[None])[0]
        along = np.zeros((*reference.shape, len(self.b)), dtype=q_o.dtype)
        for i in np.flatnonzero(vectors.moves):
            along[..., i] = vectors.moved(int(i)).of(q_o.real[None])[0].imag / STEP
        if active:
            q_ob = np.array([self.reference.moved(i).q.imag / STEP for i in active])
            along[..., active] += np.moveaxis(vectors.of(q_ob), 0, -1).real
        moving = np.flatnonzero(np.any(along, axis=(0, 1)))
        return reference, {int(i): along[..., i] for i in moving}

    def _part(self, part: Part) -> tuple[list[PointVector], Array, Array]:
        """Return the vectors of a joint or load, and values and partials of its design fields."""
        p, p_b = self.mapping.numbers(part.name, self.b)
        count = part.design_places[1]
        places, first = {}, count
        for point in part.points:
            last = first + len(point.numbers())
            places[point] = (p[first:last], p_b[first:last])
            first = last
        names = part.vectors(self.elements)
        return point_vectors(self.naming, names, places), p[:count], p_b[:count]


@final
@dataclass(frozen=True, eq=False)
class Geometry:
    """Reference positions of the bodies, and inputs of joints and loads, at one design."""

    naming: SceneNaming
    reference: Reference
    inputs: PartInputs
    joints: JointStructure
    loads: list[LoadInput]

    @staticmethod
    def of(
        elements: Elements,
        scene: Scene,
        layout: Layout,
        numbering: Numbering,
        mapping: ParameterMap,
        b: Array,
    ) -> Geometry:
        """Return the geometry at design values b, with the structure of joints and loads."""
        lengths = mapping.values(b)[:, ElementParameter.LENGTH]
        naming = SceneNaming(layout, lengths, mapping.lengths_b(len(b)))
        reference = Reference(scene, mapping, b, naming)
        inputs = PartInputs(scene, numbering, naming, mapping, reference, b, elements)
        return Geometry(naming, reference, inputs, inputs.joints(), inputs.loads())

    def at(self, b: Array) -> Geometry | None:
        """Return the geometry at other design values; None if the structure changes.

        It changes if a coefficient that was zero becomes nonzero, or a point comes to another
        element.
        """
        old = self.inputs
        lengths = old.mapping.values(b)[:, ElementParameter.LENGTH]
        naming = SceneNaming(self.naming.layout, lengths, self.naming.lengths_b)
        reference = Reference(old.scene, old.mapping, b, naming)
        inputs = replace(old, naming=naming, reference=reference, b=b)
        joints, loads = inputs.joints_like(self.joints), inputs.loads()
        pairs = zip(loads, self.loads, strict=True)
        if joints is None or not all(x.vectors.is_like(y.vectors) for x, y in pairs):
            return None
        return Geometry(naming, reference, inputs, joints, loads)
