"""Numeric inputs of joints and loads: their vectors, design fields and reference vectors."""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.joint_input import JointInput
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.load_forces import LoadInput, own_numbers
from ancfdae.assembly.naming import PointVector, SceneNaming, Vectors, point_vectors
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.assembly.reference import Reference
from ancfdae.errors.checks import require_index
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.joints.joint import Joint, JointEquations, RightAngle, empty_equations
from ancfdae.model.loads.load import Load
from ancfdae.model.parts import Elements, FrameDirection, Part
from ancfdae.model.parts import Vectors as Names
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import STEP, Array

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
        own, own_b = own_numbers(load.copies(self.scene.elements), self.naming, p, p_b)
        n = len(reference) // max(len(own), 1)
        used = {i: x[:n] for i, x in reference_b.items()} if load.refers else {}
        masses = self._masses(load)
        return LoadInput(load, vectors, p, p_b, reference[:n], used, masses, own, own_b)

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
        names = part.vectors(self.scene.elements)
        return point_vectors(self.naming, names, places), p[:count], p_b[:count]
