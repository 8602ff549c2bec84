"""Parts of a system that do not depend on design values: owners, numbering, joints, patterns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.block import WEIGHTLESS, ElementForms
from ancfdae.assembly.elastic_forces import ElementPlaces
from ancfdae.assembly.inertia import KnownMasses
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.load_input import LoadInput
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.model.scene_design import SCENE
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import SparsityPattern


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """The parts of a system that do not depend on design values: sizes, patterns, numbering.

    `soft` maps the design to the elements that deform, which have `forms` and stand at `places` of
    the pattern.
    `constraint_names` are the joints of the equations, `reach` is the largest coordinate in m of a
    place on the ground that a load refers to. `masses` holds the masses of rigid bodies and beams
    at the values of the design that were asked for last.
    """

    scene: Scene
    design: tuple[DesignVariable, ...]
    mapping: ParameterMap
    numbering: Numbering
    layout: Layout
    soft: ParameterMap
    forms: ElementForms
    pattern: SparsityPattern
    places: ElementPlaces
    constraint_names: tuple[str, ...]
    reach: float
    masses: KnownMasses = field(default_factory=dict)

    @staticmethod
    def of(
        scene: Scene,
        design: tuple[DesignVariable, ...],
        mapping: ParameterMap,
        numbering: Numbering,
        layout: Layout,
        parts: tuple[JointStructure, Sequence[LoadInput]],
    ) -> Structure:
        """Return the structure of a scene with these joints and loads."""
        joints, loads = parts
        # Elements, rigid bodies, curvature of joints, tangents of loads.
        moving = [item.couplings for item in loads if not item.load.constant]
        bodies = numbering.couplings(scene.frame is not None)
        entries = zip(bodies, joints.couplings, *moving, strict=True)
        pattern = SparsityPattern((numbering.n_q, numbering.n_q), *map(np.concatenate, entries))
        places = ElementPlaces.of(numbering, pattern)
        layout = replace(layout, joints=joints.joints)
        soft = mapping.only(numbering.elements)
        beams = [beam for beam in scene.beams if not beam.rigid]
        forms = ElementForms.of(numbering.widest, beams, soft)
        names = tuple(joint.name for joint in layout.joints for _ in range(joint.rows))
        of_ground = (
            abs(value)
            for load in scene.loads
            for name, value in load.parameters().items()
            if name.startswith(("ground_", "obstacle_place_"))
        )
        reach = max(of_ground, default=0.0)
        return Structure(
            scene, design, mapping, numbering, layout, soft, forms, pattern, places, names, reach
        )

    def reaches(self, owners: Iterable[str]) -> Array:
        """Tell which design variables write to these owners of parameters, (n_b,)."""
        reached = np.zeros(len(self.design), dtype=bool)
        for owner in owners:
            reached[[slot[1] for slot in self.mapping.slots.get(owner, ())]] = True
        return reached

    @cached_property
    def reaches_parts(self) -> Array:
        """Whether each design variable writes to a joint or load, (n_b,)."""
        return self.reaches(part.name for part in (*self.scene.joints, *self.scene.loads))

    @cached_property
    def reaches_elements(self) -> Array:
        """Tell which design variables write to elements that deform, (n_b,)."""
        return np.bincount(self.soft.variables, minlength=len(self.design)) > 0

    @cached_property
    def reaches_masses(self) -> Array:
        """Tell which design variables masses, gravity or the frame may depend on, (n_b,)."""
        pairs = ~WEIGHTLESS[self.mapping.parameters]
        heavy = np.bincount(self.mapping.variables[pairs], minlength=len(self.design)) > 0
        owners = (*self.scene.members, *self.scene.point_masses)
        return heavy | self.reaches([SCENE, *(owner.name for owner in owners)])
