"""What a scene is at every value of its design: owners, numbering, forms of joints, patterns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.block import WEIGHTLESS
from ancfdae.assembly.elastic_forces import ElementPlaces
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.load_input import LoadInput
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.model.scene_design import SCENE
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """What values of the design do not change; made with the first numbers.

    `soft` maps the design to the elements that deform, which stand at `places` of the pattern.
    """

    scene: Scene
    design: tuple[DesignVariable, ...]
    mapping: ParameterMap
    numbering: Numbering
    layout: Layout
    soft: ParameterMap
    pattern: Pattern
    places: ElementPlaces

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
        pattern = _pattern(scene, numbering, *parts)
        places = ElementPlaces.of(numbering, pattern)
        layout = replace(layout, joints=parts[0].joints)
        soft = mapping.only(numbering.elements)
        return Structure(scene, design, mapping, numbering, layout, soft, pattern, places)

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """Joint of every equation."""
        return tuple(joint.name for joint in self.layout.joints for _ in range(joint.rows))

    @cached_property
    def reach(self) -> float:
        """The largest coordinate of a place on the ground that a load refers to; m."""
        of_ground = (
            abs(value)
            for load in self.scene.loads
            for name, value in load.parameters().items()
            if name.startswith("ground_")
        )
        return max(of_ground, default=0.0)

    @property
    def n_b(self) -> int:
        """Number of design variables."""
        return len(self.design)

    def reaches_parts(self) -> Array:
        """Tell which design variables write to joints, to loads or to their points, (n_b,)."""
        return self._writing(part.name for part in (*self.scene.joints, *self.scene.loads))

    def reaches_elements(self) -> Array:
        """Tell which design variables write to elements that deform, (n_b,)."""
        return np.bincount(self.soft.variables, minlength=self.n_b) > 0

    def reaches_masses(self) -> Array:
        """Tell which design variables masses, gravity or the frame may depend on, (n_b,)."""
        pairs = ~np.isin(self.mapping.parameters, WEIGHTLESS)
        heavy = np.bincount(self.mapping.variables[pairs], minlength=self.n_b) > 0
        owners = (*self.scene.members, *self.scene.point_masses)
        return heavy | self._writing([SCENE, *(owner.name for owner in owners)])

    def _writing(self, owners: Iterable[str]) -> Array:
        reached = np.zeros(self.n_b, dtype=bool)
        for owner in owners:
            reached[[slot[1] for slot in self.mapping.slots.get(owner, ())]] = True
        return reached


def _pattern(
    scene: Scene, numbering: Numbering, joints: JointStructure, loads: Sequence[LoadInput]
) -> Pattern:
    """Pattern of elements, rigid bodies, curvature of joints, tangents of loads."""
    moving = [item.couplings for item in loads if not item.load.constant]
    bodies = numbering.couplings(scene.frame is not None)
    parts = zip(bodies, joints.couplings, *moving, strict=True)
    rows, columns = (np.concatenate(part) for part in parts)
    return Pattern((numbering.n_q, numbering.n_q), rows, columns)
