"""Forces and stresses in the sections of beams, prepared when they are first asked for."""

from functools import partial
from typing import final

import numpy as np

from ancfdae.assembly.beam_elements import BeamElements
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.assembly.section_results import SectionForces, StressPoints
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, require_in_section
from ancfdae.model.elements import Batch
from ancfdae.model.elements.element import SectionPlace
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array

# Places along every element where the largest stress is looked for: bending moments are linear in
# them, or nearly.
_STRESS_PLACES = np.array([0.0, 0.5, 1.0])


@final
class BeamSections:
    """Section forces and stresses of all beams of a scene, for observables."""

    def __init__(
        self, scene: Scene, layout: Layout, numbering: Numbering, mapping: ParameterMap, b: Array
    ) -> None:
        self._scene, self._layout = scene, layout
        self._numbering, self._mapping, self._b = numbering, mapping, b
        self._forces: dict[MaterialPoint, SectionForces] = {}
        self._stresses: dict[MaterialPoint | str, StressPoints] = {}

    def forces(self, point: MaterialPoint) -> SectionForces:
        """Return the evaluator of the section forces at a point of a beam."""
        if point not in self._forces:
            self._forces[point] = self.forces_in(point.beam, *self._locate(point))
        return self._forces[point]

    def forces_in(self, beam: str, element: int, xi: float) -> SectionForces:
        """Return the evaluator of the section forces at xi of an element of a beam."""
        nodes, count = self._acted_on(beam), self._layout.beam(beam).element_count
        smooth = element not in nodes, element + 1 not in nodes
        first = max(element - smooth[0], 0)
        run = slice(first, min(element + 1 + smooth[1], count))
        place = SectionPlace(element - first, xi, smooth)
        return SectionForces(self._elements(beam, run), place)

    def _acted_on(self, beam: str) -> set[int]:
        """Return the nodes of a beam that joints, loads or masses act on, or beside which."""
        scene, nodes = self._scene, set()
        for part in (*scene.joints, *scene.loads, *scene.point_masses):
            for point in part.points:
                if point.beam == beam:
                    element, xi = self._locate(point)
                    nodes |= {element + (xi == 1.0), element + (xi > 0.0)}
        return nodes

    def _locate(self, point: MaterialPoint) -> tuple[int, float]:
        return self._layout.beam(point.beam).locate(point.fraction, point.before)

    def require_material(self, where: str, point: MaterialPoint) -> None:
        """Refuse a point of a beam that lies outside its section, or in a hole of it."""
        element, _ = self._element(point)
        section, sizes = element.batch.kind.section, element.batch.sizes[0].real.tolist()
        section = section.with_sizes(dict(zip(section.size_names(), sizes, strict=True)))
        require_in_section(where, point, section.half_extents)
        # In the plane a point stands for all of the width.
        if element.element.d == 3 and not section.holds(point.y, point.z):
            raise InvalidInputError(
                where,
                "there must be material at the point",
                f"y = {point.y}, z = {point.z} of {section}",
                "Move the point into a wall.",
            )

    def stress_at(self, point: MaterialPoint) -> StressPoints:
        """Return the evaluator of the stress at a point of a beam."""
        if point not in self._stresses:
            element, xi = self._element(point)
            y, z = np.full((1, 1), point.y), np.full((1, 1), point.z)
            places = partial(_held, (y, z))
            self._stresses[point] = StressPoints(element, np.array([xi]), places)
        return self._stresses[point]

    def stress_over(self, beam: str) -> StressPoints:
        """Return the evaluator of stresses at the outer points of all sections of a beam."""
        if beam not in self._stresses:
            elements = self._elements(beam, slice(None))
            self._stresses[beam] = StressPoints(elements, _STRESS_PLACES, elements.outline)
        return self._stresses[beam]

    def _element(self, point: MaterialPoint) -> tuple[BeamElements, float]:
        """Return the element that a point lies in, and where."""
        element, xi = self._locate(point)
        return self._elements(point.beam, slice(element, element + 1)), xi

    def _elements(self, beam: str, elements: slice) -> BeamElements:
        place, values = self._layout.beam(beam), self._mapping.values(self._b)
        body, mapping = self._scene.beam(beam), self._mapping
        if body.rigid:
            raise InvalidInputError(
                f"beam {beam!r}",
                "must deform to have section forces and stresses",
                "a rigid one, which has no strain",
                "Leave out rigid=True, or ask for the reactions of its joints.",
            )
        return BeamElements(body, place, self._numbering, mapping, values, elements)


def _held(places: tuple[Array, Array], batch: Batch) -> tuple[Array, Array]:
    """Places in a section that no parameter moves."""
    return places
