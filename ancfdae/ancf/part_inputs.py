"""Joints and loads of a scene as numbers: their vectors, design fields and reference."""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.ancf.constraints import JointConstraints
from ancfdae.ancf.held_angles import HeldAngles
from ancfdae.ancf.joint_input import JointInput
from ancfdae.ancf.load_forces import LoadForces, LoadInput
from ancfdae.ancf.numbering import Numbering
from ancfdae.ancf.parameters import ParameterMap
from ancfdae.ancf.reference import Reference
from ancfdae.ancf.rigidity import Rigidity
from ancfdae.ancf.vectors import Vectors, point_vectors
from ancfdae.joints import Joint
from ancfdae.loads import Load
from ancfdae.naming import Naming, PointVector
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.parts import Part
from ancfdae.scene import Scene


@final
class PartInputs:
    """What joints and loads are made of, at given design values.

    Parameters
    ----------
    scene : Scene
    numbering : Numbering
    naming : Naming
    mapping : ParameterMap
    reference : Reference
    b : array, shape (n_b,)
    """

    def __init__(
        self,
        scene: Scene,
        numbering: Numbering,
        naming: Naming,
        mapping: ParameterMap,
        reference: Reference,
        b: Array,
    ) -> None:
        self._scene, self._numbering, self._naming = scene, numbering, naming
        self._mapping, self._reference, self._b = mapping, reference, b
        self._size = numbering.n_q, len(b)

    def constraints(self) -> JointConstraints:
        """Return the constraints of all joints, and of bodies that are rigid."""
        inputs, points = [], []
        bodies = zip(self._numbering.bodies, self._numbering.rigid, strict=True)
        rigidities = [Rigidity(body.name) for body, rigid in bodies if rigid]
        held = HeldAngles(self._naming.layout, {item.beam for item in rigidities})
        for joint in (*self._scene.joints, *rigidities):
            item, own = self._joint(joint)
            inputs.append(item.shaped(held))
            points += own
        n_b, d = len(self._b), self._numbering.element.d
        return JointConstraints(inputs, self._vectors(points), n_b, d)

    def forces(self) -> LoadForces:
        """Return the forces of all loads."""
        inputs = [self.load(load) for load in self._scene.loads]
        return LoadForces(inputs, *self._size, self._numbering.element.d)

    def joint(self, joint: Joint) -> tuple[JointInput, Vectors]:
        """Return one joint as it stands alone, with its vectors."""
        item, own = self._joint(joint)
        return item, self._vectors(own)

    def load(self, load: Load) -> LoadInput:
        """Return one load."""
        own, p, p_b = self._part(load)
        vectors = self._vectors(own)
        reference, reference_b = self._in_reference(vectors)
        used = reference_b if load.refers else {}
        return LoadInput(load, vectors, p, p_b, reference, used)

    def _joint(self, joint: Joint) -> tuple[JointInput, list[PointVector]]:
        own, p, p_b = self._part(joint)
        return JointInput(joint, p, p_b, *self._in_reference(self._vectors(own))), own

    def _vectors(self, points: list[PointVector]) -> Vectors:
        return Vectors(points, self._numbering.element.d, *self._size)

    def _in_reference(self, vectors: Vectors) -> tuple[Array, dict[int, Array]]:
        """Return vectors in the reference configuration, and their partials that are not zero."""
        q_o, active = self._reference.q, self._reference.active
        reference, along = vectors.of(q_o[None])[0], vectors.of_b(q_o[None])[0]
        if active:
            q_ob = np.array([self._reference.moved(i).q.imag / STEP for i in active])
            along[..., active] += np.moveaxis(vectors.of(q_ob), 0, -1).real
        moving = np.flatnonzero(np.any(along, axis=(0, 1)))
        return reference, {int(i): along[..., i] for i in moving}

    def _part(self, part: Part) -> tuple[list[PointVector], Array, Array]:
        """Return vectors of a joint or load, and values and partials of its design fields."""
        p, p_b = self._mapping.numbers(part.name, self._b)
        count = len(part.parameters())
        places, first = {}, count
        for point in part.points:
            last = first + len(point.numbers())
            places[point] = (p[first:last], p_b[first:last])
            first = last
        names = part.vectors(self._numbering.element)
        return point_vectors(self._naming, names, places), p[:count], p_b[:count]
