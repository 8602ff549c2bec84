"""Section forces and von Mises stresses of beams, with partials, prepared on first use."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar, final

import numpy as np

from ancfdae.assembly.block import unit_vectors
from ancfdae.assembly.layout import BeamLayout, Layout
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.errors.checks import named
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import BeamBody, MaterialPoint, require_in_section
from ancfdae.model.elements import Batch, ElementParameter
from ancfdae.model.elements.element import SectionLaw, SectionPlace, StressLaw
from ancfdae.model.elements.strains import change
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import STEP, Array

_Law = TypeVar("_Law")


@final
@dataclass(frozen=True)
class StatePartials:
    """Partials of one number per time in m coordinates and velocities, and in the design.

    q and v have the shape (k, m) for the coordinates with indices `columns`, b has (k, n_b).
    """

    columns: Array
    q: Array
    v: Array
    b: Array


@final
class BeamElements:
    """Consecutive elements of one beam: their indices, parameters and coordinates.

    The argument `parameters`, (n_all, 10), holds all elements of the scene, real or complex.
    """

    def __init__(
        self,
        body: BeamBody,
        place: BeamLayout,
        numbering: Numbering,
        mapping: ParameterMap,
        parameters: Array,
        elements: slice,
    ) -> None:
        self.element = body.element
        self.numbers = place.first_element + np.arange(place.element_count)[elements]
        Y_unit = unit_vectors(body)[elements]
        self.batch = Batch(body.element_type(), parameters[self.numbers], Y_unit)
        vectors = named("beam", place.name, numbering.bodies).ends[elements]
        self.coordinates = numbering.coordinates(vectors)
        self._mapping = mapping

    def outline(self, batch: Batch) -> tuple[Array, Array]:
        """Return y and z of outer points of the sections, shape (n, n_f) each; m.

        In the plane they are the lowest, the highest and the middle point, where bending and shear
        are largest.
        """
        y, z = batch.kind.section.outline(batch.sizes)
        if self.element.d == 2:
            low, high = (y[:, pick(y[0].real)] for pick in (np.argmin, np.argmax))
            y = np.stack([low, (low + high) / 2, high], axis=1)
            z = 0 * y
        return y, z

    def relative(self, X: Array) -> Array:
        """Return relative node vectors, (..., n, n_y, d), of node vectors X, (..., n, n_a, d)."""
        n_s = self.element.n_s
        chord = X[..., n_s : n_s + 1, :] - X[..., :1, :]
        return np.concatenate([chord, X[..., 1:n_s, :], X[..., n_s + 1 :, :]], axis=-2)

    def spread(self, on_Y: Array) -> Array:
        """Return a gradient in node vectors from the gradient in relative node vectors."""
        n_s, chord = self.element.n_s, on_Y[..., :1, :]
        return np.concatenate([-chord, on_Y[..., 1:n_s, :], chord, on_Y[..., n_s:, :]], axis=-2)

    def moved(self, law_at: Callable[[Batch], _Law]) -> list[tuple[_Law, Array, Array, Array]]:
        """Return evaluators at perturbed parameters, one tuple for each driven parameter.

        A tuple holds the evaluator, the imaginary step, the pairs of element and design variable
        that drive the parameter, shape (2, n_pairs), and the weight of each pair, shape (n_pairs,).
        """
        mapping, laws = self._mapping, []
        for which in mapping.driven():
            pairs = mapping.pairs(which)
            pairs = pairs[np.isin(mapping.elements[pairs], self.numbers)]
            if len(pairs):
                elements = mapping.elements[pairs] - self.numbers[0]
                targets = np.stack([elements, mapping.variables[pairs]])
                law, step = law_at(self.batch.moved(which)), self.batch.step(which)
                laws.append((law, step, targets, mapping.weights[pairs]))
        return laws


@final
class SectionForces:
    """Evaluator of N, V_y, V_z, T, M_y and M_z (components 0 to 5) in one section of a beam."""

    def __init__(self, elements: BeamElements, place: SectionPlace) -> None:
        self._elements, self._place = elements, place
        self._law = self._law_at(elements.batch)

    def value(self, component: int, q: Array, v: Array) -> Array:
        """Return one component of the section forces, shape (k,); N or N m."""
        return self.values(q, v)[..., component]

    def values(self, q: Array, v: Array) -> Array:
        """Return all section forces and moments, shape (k, 6)."""
        at = self._elements.coordinates
        return self._of(self._law, q[:, at], v[:, at])

    def partials(self, component: int, q: Array, v: Array, n_b: int) -> StatePartials:
        """Return the partials of one component, by complex steps of the elements' coordinates."""
        elements, at = self._elements, self._elements.coordinates
        X, U, b = q[:, at], v[:, at], np.zeros((len(q), n_b))
        columns = np.unique(at)
        # All directions at once, in a leading axis.
        step = 1j * STEP * (columns[:, None, None, None] == at)[:, None]
        on_q = self._of(self._law, X + step, U)[..., component].imag.T / STEP
        on_v = np.zeros_like(on_q)
        if np.any(elements.batch.of(ElementParameter.DAMPING_TIME)):
            on_v = self._of(self._law, X, U + step)[..., component].imag.T / STEP
        still = self._of(self._law, X, U)[..., component]
        for law, size, variables, weights in self._moved:
            slope = change(self._of(law, X, U)[None, ..., component], still[None], size)[0]
            np.add.at(b.T, variables, weights[:, None] * slope)
        return StatePartials(columns, on_q, on_v, b)

    @cached_property
    def _moved(self) -> list[tuple[SectionLaw, Array, Array, Array]]:
        """Evaluators with one element parameter perturbed, the perturbation, and its variables."""
        batch, laws = self._elements.batch, []
        for moved, size, (elements, variables), weights in self._elements.moved(
            lambda batch: batch
        ):
            for k in np.unique(elements):
                parameters = batch.parameters.astype(complex)
                parameters[k] = moved.parameters[k]
                law, its = self._law_at(replace(batch, parameters=parameters)), elements == k
                laws.append((law, size[k : k + 1], variables[its], weights[its]))
        return laws

    def _law_at(self, batch: Batch) -> SectionLaw:
        return self._elements.element.section_law(batch, self._place)

    def _of(self, law: SectionLaw, X: Array, U: Array) -> Array:
        """Return section forces and moments N, V_y, V_z, T, M_y, M_z, (..., 6), of elements."""
        elements = self._elements
        return law.forces(elements.relative(X), elements.relative(U))


# Largest number of entries in an array of stresses.
_TOGETHER = 2_000_000


@final
class StressPoints:
    """Evaluator of von Mises stresses at fibres and locations xi of some elements.

    `places` returns y and z of the fibres, (n, n_f) each, for a batch of the elements.
    """

    def __init__(
        self, elements: BeamElements, xi: Array, places: Callable[[Batch], tuple[Array, Array]]
    ) -> None:
        self._elements, self._xi, self._places = elements, xi, places
        self._law = self._law_at(elements.batch)

    def value(self, q: Array, v: Array) -> Array:
        """Return the von Mises stresses, shape (k, n, n_p); Pa."""
        return np.concatenate(
            [self._law.von_mises(*self._relative(q[k], v[k])) for k in self._parts(len(q))]
        )

    def partials(self, q: Array, v: Array, weights: Array, n_b: int) -> StatePartials:
        """Return partials in q, v and b of the sum of stresses times `weights`, (k, n, n_p)."""
        parts = [self._partials(q[k], v[k], weights[k], n_b) for k in self._parts(len(q))]
        rows = (np.concatenate(part) for part in zip(*parts, strict=True))
        # Coordinates of other bodies may lie between; their partials are zero.
        at = self._elements.coordinates
        return StatePartials(np.arange(np.min(at), np.max(at) + 1), *rows)

    def _partials(self, q: Array, v: Array, weights: Array, n_b: int) -> tuple[Array, Array, Array]:
        beam, b = self._elements, np.zeros((len(q), n_b))
        Y, V = self._relative(q, v)
        still = self._law.von_mises(Y, V)
        for law, size, (elements, variables), factors in self._moved:
            stresses = law.von_mises(Y, V)
            slope = change(stresses.swapaxes(0, 1), still.swapaxes(0, 1), size)
            per_element = np.einsum("knp,nkp->nk", weights, slope)
            np.add.at(b.T, variables, factors[:, None] * per_element[elements])
        # The elements of a beam share the columns between their first and last one.
        at, rows = beam.coordinates - np.min(beam.coordinates), []
        for on_Y in self._law.pulled_back(Y, V, weights / still):
            total = np.zeros((len(q), int(np.max(at)) + 1))
            np.add.at(total.T, at.ravel(), beam.spread(on_Y).reshape(len(q), -1).T)
            rows.append(total)
        return rows[0], rows[1], b

    @cached_property
    def _moved(self) -> list[tuple[StressLaw, Array, Array, Array]]:
        return self._elements.moved(self._law_at)

    def _relative(self, q: Array, v: Array) -> tuple[Array, Array]:
        at = self._elements.coordinates
        return self._elements.relative(q[:, at]), self._elements.relative(v[:, at])

    def _parts(self, count: int) -> list[slice]:
        """Return slices of the times, so that arrays of stresses stay small."""
        together = max(1, _TOGETHER // self._law.count)
        return [slice(first, first + together) for first in range(0, count, together)]

    def _law_at(self, batch: Batch) -> StressLaw:
        return self._elements.element.stress_law(batch, self._xi, self._places(batch))


# Locations xi in every element at which the largest stress is searched: bending moments are linear
# along elements, or nearly.
_STRESS_PLACES = np.array([0.0, 0.5, 1.0])


@final
class BeamSections:
    """Evaluators of section forces and stresses of all beams of a scene, cached."""

    def __init__(
        self, scene: Scene, layout: Layout, numbering: Numbering, mapping: ParameterMap, b: Array
    ) -> None:
        self._scene, self._layout = scene, layout
        self._numbering, self._mapping, self._b = numbering, mapping, b
        self._forces: dict[MaterialPoint, SectionForces] = {}
        self._stresses: dict[MaterialPoint | str, StressPoints] = {}

    def forces(self, point: MaterialPoint) -> SectionForces:
        """Return the evaluator of the section forces at a point of a beam; cached."""
        if point not in self._forces:
            self._forces[point] = self.forces_in(point.beam, *self._locate(point))
        return self._forces[point]

    def forces_in(self, beam: str, element: int, xi: float) -> SectionForces:
        """Return the evaluator of the section forces at xi of an element of a beam."""
        # Nodes at or next to which joints, loads or masses act.
        scene, nodes = self._scene, set[int]()
        for part in (*scene.joints, *scene.loads, *scene.point_masses):
            for point in part.points:
                if point.beam == beam:
                    near, at = self._locate(point)
                    nodes |= {near + (at == 1.0), near + (at > 0.0)}
        smooth = element not in nodes, element + 1 not in nodes
        first = max(element - smooth[0], 0)
        run = slice(first, min(element + 1 + smooth[1], self._layout.beam(beam).element_count))
        place = SectionPlace(element - first, xi, smooth)
        return SectionForces(self._elements(beam, run), place)

    def _locate(self, point: MaterialPoint) -> tuple[int, float]:
        return self._layout.beam(point.beam).locate(point.fraction, point.before)

    def require_material(self, point: MaterialPoint) -> None:
        """Raise InvalidInputError for a point outside its section, or in a hole of it."""
        where = "von_mises, point"
        element, _ = self._element(point)
        section, sizes = element.batch.kind.section, element.batch.sizes[0].real.tolist()
        section = section.with_sizes(dict(zip(section.size_names(), sizes, strict=True)))
        require_in_section(where, point, section.half_extents)
        # In the plane a point represents the whole width.
        if element.element.d == 3 and not section.holds(point.y, point.z):
            raise InvalidInputError(
                where,
                "there must be material at the point",
                f"y = {point.y}, z = {point.z} of {section}",
                "Move the point into a wall.",
            )

    def stress_at(self, point: MaterialPoint) -> StressPoints:
        """Return the evaluator of the von Mises stress at a point of a beam; cached."""
        if point not in self._stresses:
            element, xi = self._element(point)
            y, z = np.full((1, 1), point.y), np.full((1, 1), point.z)
            places = partial(_held, (y, z))
            self._stresses[point] = StressPoints(element, np.array([xi]), places)
        return self._stresses[point]

    def stress_over(self, beam: str) -> StressPoints:
        """Return the evaluator of stresses at the outline of all sections of a beam; cached."""
        if beam not in self._stresses:
            elements = self._elements(beam, slice(None))
            self._stresses[beam] = StressPoints(elements, _STRESS_PLACES, elements.outline)
        return self._stresses[beam]

    def _element(self, point: MaterialPoint) -> tuple[BeamElements, float]:
        """Return the element that a point lies in, and its xi."""
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
    """Return coordinates y and z of fibres that no design parameter moves."""
    return places
