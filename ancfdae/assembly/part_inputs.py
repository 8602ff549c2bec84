"""Numeric inputs of joints and loads: their vectors, design fields and reference vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.joint_input import HeldAngles, JointInput
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.left_out_pairs import near_pairs
from ancfdae.assembly.load_forces import LoadInput, own_numbers
from ancfdae.assembly.naming import PointVector, SceneNaming, Vectors, point_vectors
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.assembly.reference import Reference
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.joints.joint import Joint, JointEquations, empty_equations
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.pair_contact import leaves_out, without
from ancfdae.model.parts import Elements, FrameDirection, Part
from ancfdae.model.parts import Vectors as Names
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import STEP, Array


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
        """Return the structure of all joints, with the constraints of rigid bodies."""
        bodies = zip(self.numbering.bodies, self.numbering.rigid, strict=True)
        rigidities = [Rigidity(body.name) for body, rigid in bodies if rigid]
        held = HeldAngles(self.naming.layout, {item.beam for item in rigidities})
        inputs, vectors = self._together((*self.scene.joints, *rigidities))
        without: dict[str, list[int]] = {}
        for name, row in self.scene.left_out:
            without.setdefault(name, []).append(row)
        inputs = [item.shaped(held, without.get(item.joint.name, ())) for item in inputs]
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
        reference, along = vectors.of(q_o[None])[0], vectors.of_b(q_o[None])[0]
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
