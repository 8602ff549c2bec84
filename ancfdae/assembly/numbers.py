"""Numbers of a scene at design values: where parts stand, forces, masses, the start.

They come in groups, each with the design variables that reach it. At other values of the design a
group that none of the changed variables reaches is taken over as it is, with all that it has
computed: Young's modulus leaves joints and the closed start alone. The others are made anew on the
same structure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.assembly.assembled_start import AssembledStart
from ancfdae.assembly.block import ElementBlock
from ancfdae.assembly.constraints import JointConstraints
from ancfdae.assembly.elastic_forces import ElasticForces
from ancfdae.assembly.inertia import (
    Inertia,
    MassBlocks,
    MassPartials,
    MassPlaces,
    of_states,
    other_masses,
)
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.load_forces import LoadForces
from ancfdae.assembly.load_input import LoadInput
from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.numbering import Numbering, number
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.assembly.part_inputs import PartInputs
from ancfdae.assembly.reference import Reference
from ancfdae.assembly.state_scales import state_masses
from ancfdae.assembly.structure import Structure
from ancfdae.assembly.turning import TurningForces
from ancfdae.model.design import DesignVariable
from ancfdae.model.elements import ElementParameter
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True, eq=False)
class Geometry:
    """Placement of the bodies, and inputs of joints and loads, at one value of the design."""

    naming: SceneNaming
    reference: Reference
    inputs: PartInputs
    joints: JointStructure
    loads: list[LoadInput]

    @staticmethod
    def of(
        scene: Scene, layout: Layout, numbering: Numbering, mapping: ParameterMap, b: Array
    ) -> Geometry:
        """Return the geometry at b, and with it the forms of joints and loads."""
        lengths = mapping.values(b)[:, ElementParameter.LENGTH]
        naming = SceneNaming(layout, lengths, mapping.lengths_b(len(b)))
        reference = Reference(scene, mapping, b, naming)
        inputs = PartInputs(scene, numbering, naming, mapping, reference, b)
        return Geometry(naming, reference, inputs, inputs.joints(), inputs.loads())

    def at(self, b: Array) -> Geometry | None:
        """Return the geometry at other parameter values; None if the structure changes.

        So they do where a coefficient appears that had vanished, or a point comes to another
        element.
        """
        old = self.inputs
        lengths = old.mapping.values(b)[:, ElementParameter.LENGTH]
        naming = SceneNaming(self.naming.layout, lengths, self.naming.lengths_b)
        reference = Reference(old.scene, old.mapping, b, naming)
        inputs = PartInputs(old.scene, old.numbering, naming, old.mapping, reference, b)
        joints, loads = inputs.joints_like(self.joints), inputs.loads()
        pairs = zip(loads, self.loads, strict=True)
        if joints is None or not all(x.vectors.is_like(y.vectors) for x, y in pairs):
            return None
        return Geometry(naming, reference, inputs, joints, loads)

    def reached_by(self, structure: Structure) -> Array:
        """Tell which design variables change it, (n_b,)."""
        reached = structure.reaches_parts.copy()
        reached[self.reference.active] = True
        return reached


@final
@dataclass(frozen=True, eq=False)
class Numbers:
    """All numbers of a scene at design values b, real or complex."""

    structure: Structure
    b: Array
    geometry: Geometry
    constraints: JointConstraints
    loads: LoadForces
    start: AssembledStart
    block: ElementBlock
    elastic: ElasticForces
    inertia: Inertia
    turning: TurningForces | None

    @staticmethod
    def first(
        scene: Scene,
        design: tuple[DesignVariable, ...],
        mapping: ParameterMap,
        b: Array,
        numbering: Numbering | None = None,
    ) -> Numbers:
        """Return the numbers of a scene, with the structure that they share with those to come.

        The numbering has masses of states; by default they follow from the mechanism.
        """
        if numbering is None:
            numbering = number(scene)
            if len(numbering.masses):
                of_one = Numbers.first(scene, design, mapping, b.real, numbering)
                loads, weights = of_one.geometry.loads, of_one.inertia.weights
                size = numbering.size(weights)
                found = [state_masses(item, weights, size) for item in loads if len(item.masses)]
                numbering = replace(numbering, masses=np.concatenate(found))
        masses = tuple(mass.name for mass in scene.point_masses)
        bodies = numbering.bodies, numbering.beams
        layout = Layout(numbering.d, *bodies, masses, (), numbering.controllers)
        geometry = Geometry.of(scene, layout, numbering, mapping, b)
        parts = geometry.joints, geometry.loads
        structure = Structure.of(scene, design, mapping, numbering, layout, parts)
        # From now on names know the joints, too.
        geometry = replace(geometry, naming=replace(geometry.naming, layout=structure.layout))
        block = structure.forms.at(b)
        elastic = ElasticForces(block, structure.places, structure.soft, len(b))
        fixed = _placed(structure, geometry, b)
        return Numbers(
            structure, b, geometry, *fixed, block, elastic, *_masses(structure, geometry, block, b)
        )

    def at(self, b: Array) -> Numbers | None:
        """Return the numbers at other values, None where they have another structure."""
        structure, geometry = self.structure, self.geometry
        # Numbers are of the kind of b, real or complex.
        other_kind, moved = np.iscomplexobj(b) != np.iscomplexobj(self.b), b != self.b

        def changes(reached: Array) -> bool:
            return bool(other_kind or (moved & reached).any())

        fixed = self.constraints, self.loads, self.start
        displaced = changes(geometry.reached_by(structure))
        if displaced:
            changed = geometry.at(b)
            if changed is None:
                return None
            geometry, fixed = changed, _placed(structure, changed, b)
        block, elastic = self.block, self.elastic
        if changes(structure.reaches_elements):
            block = structure.forms.at(b)
            elastic = ElasticForces(block, structure.places, structure.soft, len(b))
        masses = self.inertia, self.turning
        if displaced or changes(structure.reaches_masses):
            masses = _masses(structure, geometry, block, b, self.inertia.places)
        return Numbers(structure, b, geometry, *fixed, block, elastic, *masses)


def _placed(
    structure: Structure, geometry: Geometry, b: Array
) -> tuple[JointConstraints, LoadForces, AssembledStart]:
    """Return constraints, loads and start, which depend on the places of parts."""
    pattern, mapping, n_b = structure.pattern, structure.mapping, len(b)
    constraints = JointConstraints.on(pattern, geometry.joints, n_b)
    reached = geometry.reached_by(structure)
    start = AssembledStart(
        structure.scene,
        structure.numbering,
        mapping,
        geometry.reference,
        constraints,
        pattern,
        b,
        bool(np.any((b.real != mapping.nominal)[reached])),
    )
    return constraints, LoadForces(geometry.loads, pattern, n_b), start


def _masses(
    structure: Structure,
    geometry: Geometry,
    block: ElementBlock,
    b: Array,
    places: MassPlaces | None = None,
) -> tuple[Inertia, TurningForces | None]:
    """Return inertia with gravity, and the forces of a rotating frame; None without a frame."""
    scene, numbering, n_b, d = structure.scene, structure.numbering, len(b), structure.numbering.d
    p, p_b = structure.mapping.numbers("scene", b)
    gravity, frame = (np.zeros(d), np.zeros((d, n_b))), (p, p_b)
    if scene.gravity is not None:
        gravity, frame = (p[:d], p_b[:d]), (p[d:], p_b[d:])
    others = other_masses(scene, geometry.naming, structure.mapping, b, structure.masses)
    soft, pairs = structure.soft, block.mass_pairs
    of_pairs = soft.elements[pairs], soft.variables[pairs]
    derivative = lambda: MassPartials(*of_pairs, block.partials.m_b)  # noqa: E731
    blocks = (MassBlocks(numbering.vectors, block.m, numbering.owners, derivative), *others)
    if len(numbering.masses):
        blocks = (*blocks, of_states(numbering))
    inertia = Inertia(blocks, numbering, n_b, structure.pattern, gravity, places)
    turns = scene.frame
    return inertia, turns and TurningForces(turns, frame, inertia, structure.pattern)
