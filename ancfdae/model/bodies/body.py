"""Base class of straight and curved beams: reference shape, sections and materials."""

from __future__ import annotations

import abc
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar, final

import numpy as np

from ancfdae.errors.checks import require_finite, require_kind, require_name, require_sequence
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.model.bodies.point import MaterialPoint, locate, require_fraction
from ancfdae.model.bodies.rigid_body import Placed
from ancfdae.model.elements import (
    ALL_ELEMENTS,
    BeamElement,
    ElementParameter,
    ElementType,
    Quantity,
    StrainEnergyFunction,
    default_element,
)
from ancfdae.model.material import Material
from ancfdae.model.sections.section import Section
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import orthonormal

# Design parameters of every beam by the name in targets; the sizes of its section are added.
_PARAMETERS = {
    "youngs_modulus": ElementParameter.YOUNGS_MODULUS,
    "poisson_ratio": ElementParameter.POISSON_RATIO,
    "density": ElementParameter.DENSITY,
    "length": ElementParameter.LENGTH,
    "damping_time": ElementParameter.DAMPING_TIME,
}
_SIZES = tuple(each for each in ElementParameter if each.is_size)


@final
@dataclass(frozen=True)
class ReferenceShape:
    """Reference configuration of a beam of n elements, first node at the origin, not rotated.

    The position of the beam and its rotation `turn` are applied afterwards (`Placed`).
    """

    lengths: Array  # (n,): element lengths
    slopes: Array  # (n + 1, d, d): node frames; row k is the slope along the section's k-th axis
    chords: Array  # (n, d): (r_2 - r_1) / length of each element
    straight: bool  # whether dr_o/dx is the same at every point of the beam

    @cached_property
    def fractions(self) -> Array:
        """Arc-length fractions of the nodes, shape (n + 1,)."""
        fractions = np.concatenate([[0.0], np.cumsum(self.lengths) / np.sum(self.lengths)])
        fractions[-1] = 1.0
        return fractions


class BeamBody(Placed):
    """Base class of straight and curved beams; name and turn as in `Placed`."""

    element: BeamElement  # the type of element that discretises the beam
    energy: (
        StrainEnergyFunction | None
    )  # strain energy function; None for elements that define their own, such as cables
    # One section for the beam or one per element; these may differ in their sizes.
    section: Section | Sequence[Section]
    material: Material | Sequence[Material]  # one for the beam or one per element
    rigid: bool  # whether it has the coordinates of a rigid body instead of those of its elements
    # Fractions of inner nodes with a slope along the beam on either side, see `Beam`.
    kinks: Sequence[float]
    initial_strain: float  # strain along the axis in the reference configuration, see `Beam`

    @property
    @abc.abstractmethod
    def element_count(self) -> int:
        """Number of elements of the beam."""

    @cached_property
    @abc.abstractmethod
    def _reference(self) -> ReferenceShape:
        """Reference configuration of the beam; cached."""

    def reference(self) -> ReferenceShape:
        """Return the reference configuration of the beam: its lengths, slopes and chords."""
        return self._reference

    def at_origin(self, point: MaterialPoint) -> Array:
        """Return the reference position of a point of a beam that starts at the origin, (d,); m."""
        shape, n_s = self.reference(), self.element.n_s
        fraction = require_fraction(str(point), point.fraction)
        k, xi = locate(shape.fractions, fraction, point.before)
        l, start = shape.lengths[k], shape.lengths[:k] @ shape.chords[:k]
        ends = np.stack([start, start + l * shape.chords[k]])
        X = np.concatenate([ends[:, None], shape.slopes[k : k + 2, : n_s - 1]], axis=1)
        w, p = self.element.vector_weights(Quantity.POSITION, xi, point.y, point.z)
        return (w * l**p) @ X.reshape(2 * n_s, self.dimension)

    @abc.abstractmethod
    def with_length(self, length: float) -> BeamBody:
        """Return the same beam, stretched from its start to another total length."""

    def with_elements(self, count: int) -> BeamBody:
        """Return the same beam with `count` elements.

        InvalidInputError if an element of the new mesh had two sections or materials, or if the
        nodes of the beam are given one by one (`CurvedBeam`).
        """
        rule, repair = "its nodes are given one by one", "Declare it with other nodes."
        raise InvalidInputError(f"beam {self.name!r}, elements", rule, count, repair)

    def directions(self) -> Array:
        """Return the axes of the beam as a rigid body, (d, d): the slopes of its first section."""
        return orthonormal(self.reference().slopes[0])

    @property
    def at_start(self) -> MaterialPoint:
        """The point at the start of the centre line."""
        return MaterialPoint(self.name, 0.0)

    @property
    def at_end(self) -> MaterialPoint:
        """The point at the end of the centre line."""
        return MaterialPoint(self.name, 1.0)

    def at(
        self, fraction: float, y: float = 0.0, z: float = 0.0, before: bool = False
    ) -> MaterialPoint:
        """Return the point at an arc-length fraction, offset in the section by y and z.

        At an inner node it belongs to the element that begins there, or with `before` to the one
        that ends there.
        """
        require_finite(f"point of {self.name!r}", fraction)
        return MaterialPoint(self.name, fraction, y, z, before=before)

    def inner_nodes(self, fractions: Iterable[float]) -> set[int]:
        """Return the indices of the inner nodes that lie at one of the arc-length `fractions`."""
        nodes, n = self.reference().fractions, self.element_count
        places = [locate(nodes, fraction) for fraction in fractions]
        return {element for element, xi in places if xi == 0.0 and 0 < element < n}

    def with_kinks(self, nodes: Iterable[int]) -> BeamBody:
        """Return the same beam with kinks declared at the inner nodes of these indices."""
        kinks = self.reference().fractions[sorted(nodes)].tolist()
        return replace(self, kinks=tuple(kinks))  # type: ignore[type-var]

    def parameter_names(self) -> dict[str, ElementParameter]:
        """Return the columns of the beam's design parameters by name, such as ``"height"``."""
        strain = {} if self.rigid else {"initial_strain": ElementParameter.INITIAL_STRAIN}
        return _PARAMETERS | strain | dict(zip(self._section().size_names(), _SIZES, strict=False))

    def element_parameters(self) -> Array:
        """Parameters of every element, shape (n, 10), columns as in `ElementParameter`."""
        sections, materials = self._per_element()
        parameters = np.zeros((self.element_count, len(ElementParameter)))
        parameters[:, ElementParameter.LENGTH] = self.reference().lengths
        parameters[:, ElementParameter.INITIAL_STRAIN] = self.initial_strain
        for name, which in _PARAMETERS.items():
            if which is not ElementParameter.LENGTH:
                parameters[:, which] = [getattr(material, name) for material in materials]
        distinct = {id(section): section for section in sections}
        size = {key: section.sizes() for key, section in distinct.items()}
        sizes = np.array([size[id(section)] for section in sections])
        first = ElementParameter.SIZE_1
        parameters[:, first : first + sizes.shape[1]] = sizes
        return parameters

    def element_type(self) -> ElementType:
        """Return the type that all elements share; without strain energy if the beam is rigid."""
        energy = None if self.rigid else self.energy
        return ElementType(self._section(), energy, self.reference().straight)

    def half_extents(self, elements: Array) -> tuple[float, float]:
        """Return half the largest height and width of the sections of these elements; m."""
        y, z = np.max([self._per_element()[0][k].half_extents for k in elements], axis=0)
        return float(y), float(z)

    def with_values(self, changes: Iterable[tuple[str, int | None, float]]) -> BeamBody:
        """Return the same beam with design parameters changed: (parameter, element, value) each.

        The element is None to change the parameter along the whole beam. InvalidInputError if a
        value is not admissible for its parameter, sizes of a section do not fit together or an
        element does not exist; UnknownNameError if the beam has no parameter of that name.
        """
        names, placement = self.parameter_names(), self.placement()
        changes = tuple(changes)
        moved = {name: value for name, _, value in changes if name in placement}
        beam = self.with_placement(moved) if moved else self
        constants = []
        for change in changes:
            parameter, element, value = change
            self.check_target(parameter, element)
            if parameter in placement:
                continue
            if names[parameter] is ElementParameter.LENGTH:
                beam = beam.with_length(value)
            elif names[parameter] is ElementParameter.INITIAL_STRAIN:
                beam = replace(beam, initial_strain=value)  # type: ignore[type-var]
            else:
                constants.append(change)
        sections, materials = self._with_constants(constants)
        return replace(beam, section=sections, material=materials)  # type: ignore[type-var]

    def refuse_values(self, changes: Sequence[tuple[str, int | None, float]]) -> None:
        """Raise the exceptions of `with_values` for these changes.

        Sizes and material constants are checked without making the beam.
        """
        names, others = self.parameter_names(), ("length", "initial_strain")
        if any(name in others or name not in names for name, _, _ in changes):
            self.with_values(changes)
            return
        resized = any(names[name].is_size for name, _, _ in changes)
        if resized or any(element is not None for _, element, _ in changes):
            sections, _ = self._with_constants(changes)
            if resized:
                self._check_sections(sections)
            return
        numbers = {name: value for name, _, value in changes}
        for material in {id(x): x for x in self._per_element()[1]}.values():
            replace(material, **numbers)  # Raises InvalidInputError for inadmissible constants.

    def _with_constants(
        self, changes: Sequence[tuple[str, int | None, float]]
    ) -> tuple[Sequence[Section], Sequence[Material]]:
        """Return sections and materials, one per element, with sizes and constants changed."""
        names, (sections, materials) = self.parameter_names(), self._per_element()
        sizes: list[dict[str, float]] = [{} for _ in sections]
        numbers: list[dict[str, float]] = [{} for _ in materials]
        for parameter, element, value in changes:
            for k in range(self.element_count) if element is None else [element]:
                (sizes if names[parameter].is_size else numbers)[k][parameter] = value
        return _changed(sections, sizes), _changed(materials, numbers)

    def check_target(self, parameter: str, element: int | None) -> None:
        """Raise UnknownNameError or InvalidInputError unless the beam has this design target."""
        names, placement = self.parameter_names(), self.placement()
        if parameter not in names and parameter not in placement:
            known = (f"{self.name}.{name}" for name in (*names, *placement))
            raise UnknownNameError("design target", f"{self.name}.{parameter}", known)
        if element is None:
            return
        where = f"design target {self.name}.{parameter}[{element}]"
        if not 0 <= element < self.element_count:
            raise InvalidInputError(
                where,
                f"the beam has elements 0 to {self.element_count - 1}",
                element,
                "Name an element that exists.",
            )
        if names.get(parameter) in (None, ElementParameter.LENGTH, ElementParameter.INITIAL_STRAIN):
            raise InvalidInputError(
                where,
                f"{parameter} is a property of the whole beam",
                f"[{element}]",
                f"Write {self.name}.{parameter}, without an index.",
            )

    def _section(self) -> Section:
        return self.section if isinstance(self.section, Section) else self.section[0]

    def _per_element(self) -> tuple[list[Section], list[Material]]:
        n = self.element_count
        sections = [self.section] * n if isinstance(self.section, Section) else list(self.section)
        materials = (
            [self.material] * n if isinstance(self.material, Material) else list(self.material)
        )
        return sections, materials

    def _check_parts(self) -> None:
        require_name("Beam.name", self.name)
        given: object = self.element
        if given is None:
            given = default_element(self.dimension)
            object.__setattr__(self, "element", given)
        names = ", ".join(each.name for each in ALL_ELEMENTS if each.d == self.dimension)
        if not isinstance(given, BeamElement) or given.d != self.dimension:
            raise InvalidInputError(
                f"beam {self.name!r}, element",
                f"must be one of {self.dimension} dimensions",
                repr(given),
                f"Leave it out, or choose among {names}.",
            )
        given.check(f"element of beam {self.name!r}")
        self._check_turn(f"beam {self.name!r}")
        self._check_part(self.section, Section)
        self._check_part(self.material, Material)
        self._check_sections(self._per_element()[0])
        where, default = f"beam {self.name!r}, energy", self.element.default_energy
        energy: object = self.energy
        if energy is None:
            object.__setattr__(self, "energy", default)
        elif default is None:
            rule = f"must be left out for {self.element.name}, which has its own strain energy"
            raise InvalidInputError(where, rule, repr(energy))
        else:
            require_kind(where, energy, (StrainEnergyFunction,), "For example EnhancedContinuum().")
            assert isinstance(energy, StrainEnergyFunction)
            if self.dimension not in energy.dimensions:
                rule = f"must be an energy for {self.dimension} dimensions"
                raise InvalidInputError(where, rule, repr(energy), "Use EnhancedContinuum().")
        self._check_shape()

    def _check_shape(self) -> None:
        """Check the kinks and the initial strain; store the kinks as a tuple."""
        where = f"beam {self.name!r}, kinks"
        kinks = require_sequence(where, self.kinks)
        for fraction in kinks:
            require_finite(where, fraction)
            require_fraction(where, fraction)
            if not self.inner_nodes([fraction]):
                rule = "must lie at nodes between elements"
                repair = "Choose the number of elements so that there is a node at each kink."
                raise InvalidInputError(where, rule, fraction, repair)
        if kinks and not self.element.can_kink:
            name = self.element.name
            rule = f"must be empty for {name}, whose slope along the beam resists bending"
            raise InvalidInputError(
                where, rule, kinks, "Join two beams instead, by a Pin or a Weld."
            )
        object.__setattr__(self, "kinks", kinks)
        where, repair = f"beam {self.name!r}, initial_strain", "Give a force over E A."
        require_finite(where, self.initial_strain, repair)
        if abs(self.initial_strain) >= 0.5:
            rule = "must lie between -1/2 and 1/2: the length free of stress must be positive"
            raise InvalidInputError(where, rule, self.initial_strain, repair)
        if self.rigid and self.initial_strain != 0:
            rule = "a rigid beam has no strain"
            raise InvalidInputError(where, rule, self.initial_strain, "Leave it or rigid=True out.")

    def _check_part(self, part: object, kind: type) -> None:
        if isinstance(part, kind):
            return
        listed = part if isinstance(part, Sequence) else ()
        if len(listed) != self.element_count or not all(isinstance(x, kind) for x in listed):
            raise InvalidInputError(
                f"beam {self.name!r}",
                f"needs one {kind.__name__} or a sequence of {self.element_count}, one per element",
                repr(part),
                f"Give one {kind.__name__}, or as many as there are elements.",
            )

    def _check_sections(self, sections: Sequence[Section]) -> None:
        distinct = list({id(section): section for section in sections}.values())
        forms = {section.form() for section in distinct}
        if len(forms) > 1:
            raise InvalidInputError(
                f"beam {self.name!r}, section",
                "the sections of a beam must differ in their sizes only",
                repr(tuple(sections)),
                "Join two beams with a Clamp instead.",
            )
        for section in {x.sizes(): x for x in distinct}.values():
            self.element.check_section(f"beam {self.name!r}", section)


_Numbered = TypeVar("_Numbered", Section, Material)


def _changed(parts: list[_Numbered], numbers: list[dict[str, float]]) -> tuple[_Numbered, ...]:
    """Return copies of sections or materials with changed numbers; equal elements share one."""
    made: dict[tuple[object, ...], _Numbered] = {}
    changed = []
    for part, its in zip(parts, numbers, strict=True):
        key = id(part), tuple(its.items())
        if key not in made:
            made[key] = replace(part, **its) if its else part  # type: ignore[arg-type]
        changed.append(made[key])
    return tuple(changed)
