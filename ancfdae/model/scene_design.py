"""Design targets of a scene, their values, and copies of a scene at other values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Self, TypeAlias, TypeVar

import numpy as np

from ancfdae.errors.checks import named, require_finite, require_kind, require_text
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.model.bodies import BeamBody, MaterialPoint, Quantity, RigidBody
from ancfdae.model.design import Designable, DesignVariable, Target, parse_target
from ancfdae.model.elements import ElementParameter
from ancfdae.model.joints.joint import Joint
from ancfdae.model.loads.load import Load
from ancfdae.model.parts import (
    TARGETS,
    Elements,
    Normal,
    Part,
    PointMass,
    on_ground,
    reference_place,
)
from ancfdae.model.starts import EquilibriumStart, InitialVelocity, NodalState, Start
from ancfdae.numerics.arrays import Array

# Relative difference up to which two targets hold the same value: a length is summed from its n
# elements, with a round-off of n eps; this admits 4500 elements.
_SAME = 1e-12
#: Owner of the design targets of the scene itself, as in "scene.gravity_y".
SCENE = "scene"


class SceneDesign(Designable):
    """Base class of `Scene`: its parts by name, and the design targets in them."""

    beams: Sequence[BeamBody]
    bodies: Sequence[RigidBody | PointMass]
    joints: Sequence[Joint]
    loads: Sequence[Load]
    start: Sequence[Start]

    @property
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.members[0].dimension

    @cached_property
    def elements(self) -> Elements:
        """Elements of all beams, by name of the beam, for the vectors of joints and loads."""
        kinds = {beam.name: beam.element for beam in self.beams}
        counts = {beam.name: beam.element_count for beam in self.beams}
        return Elements(self.dimension, kinds, counts, self.place_of)

    @cached_property
    def members(self) -> tuple[BeamBody | RigidBody, ...]:
        """All bodies with coordinates, in the order of these: beams, then rigid bodies."""
        rigid = (body for body in self.bodies if isinstance(body, RigidBody))
        return (*self.beams, *rigid)

    @property
    def point_masses(self) -> tuple[PointMass, ...]:
        """Point masses among the bodies of the scene."""
        return tuple(body for body in self.bodies if isinstance(body, PointMass))

    @property
    def rest(self) -> EquilibriumStart | None:
        """The `EquilibriumStart` of the scene; None if it does not start from an equilibrium."""
        return next((start for start in self.start if isinstance(start, EquilibriumStart)), None)

    @property
    def body_starts(self) -> list[InitialVelocity | NodalState]:
        """Starts that belong to one body each, without `EquilibriumStart`."""
        return [start for start in self.start if not isinstance(start, EquilibriumStart)]

    def beam(self, name: str) -> BeamBody:
        """Return the beam of this name, or raise UnknownNameError."""
        return named("beam", name, self.beams)

    def member(self, name: str) -> BeamBody | RigidBody:
        """Return the beam or rigid body of this name, or raise UnknownNameError."""
        require_text("beam or body", name)
        return self._members.get(name) or named("beam or body", name, self.members)

    @cached_property
    def _members(self) -> dict[str, BeamBody | RigidBody]:
        return {body.name: body for body in self.members}

    @cached_property
    def by_attachment(self) -> tuple[BeamBody | RigidBody, ...]:
        """All beams and rigid bodies, each after the body that it is attached to.

        Bodies that are attached to one another in a circle are left out.
        """
        carried: dict[str, list[BeamBody | RigidBody]] = {}
        ordered = list[BeamBody | RigidBody]()
        for body in self.members:
            if body.attached is None:
                ordered.append(body)
            else:
                carried.setdefault(body.attached.beam, []).append(body)
        for body in ordered:  # The list grows during the loop.
            ordered.extend(carried.get(body.name, ()))
        return tuple(ordered)

    @cached_property
    def kinks(self) -> dict[str, tuple[int, ...]]:
        """Inner nodes of each flexible beam whose slope along the beam may jump.

        They are the declared nodes and the nodes that a joint, load or mass acts on, where section
        forces jump.
        """
        fractions: dict[str, set[float]] = {beam.name: set(beam.kinks) for beam in self.beams}
        for part in self.parts.values():
            for point in () if isinstance(part, RigidBody) else part.points:
                if point.fraction is not None:
                    fractions[point.beam].add(point.fraction)
        soft = (beam for beam in self.beams if not beam.rigid and beam.element.can_kink)
        return {beam.name: tuple(sorted(beam.inner_nodes(fractions[beam.name]))) for beam in soft}

    @cached_property
    def parts(self) -> dict[str, Part | RigidBody]:
        """Bodies, joints and loads (those of the start included) by name."""
        return {x.name: x for x in self._all_parts() if not isinstance(x, BeamBody)}

    @cached_property
    def start_of(self) -> dict[str, InitialVelocity | NodalState]:
        """Declared starts by name of the body; other bodies start at rest in the reference."""
        return {start.body: start for start in self.body_starts}

    def owners(self) -> tuple[str, ...]:
        """Return the names of all owners of design numbers: beams, bodies, joints, loads, scene."""
        return (*(beam.name for beam in self.beams), *self.parts, SCENE)

    def numbers(self, owner: str) -> dict[str, float]:
        """Return the numbers of an owner that can be design targets, by parameter name.

        For a beam they are its placement and initial velocity, without parameters of elements; for
        a rigid body also its parameters. For joints, loads and point masses they are their
        parameters and the coordinates of their points, then the default position on the ground; for
        the owner ``"scene"`` gravity.

        Raises UnknownNameError.
        """
        require_text("owner", owner)
        if owner == SCENE:
            return self.parameters()
        part = self.parts.get(owner)
        if isinstance(part, Part):
            numbers = part.parameters() | part.point_numbers()
            return numbers | on_ground(part, self.member).parameters()
        if part is None and owner not in (beam.name for beam in self.beams):
            raise UnknownNameError("beam, body, joint or load", owner, self.owners())
        start = self.start_of.get(owner)
        motion = start.parameters() if isinstance(start, InitialVelocity) else {}
        numbers = {} if part is None else part.parameters()
        return numbers | self.member(owner).placement() | motion

    def resolve(self, text: str) -> Target:
        """Return the `Target` of a text; UnknownNameError if the scene does not have it."""
        target = parse_target(text)
        if self.is_of_elements(target):
            self.beam(target.owner).check_target(target.parameter, target.element)
            return target
        numbers = self.numbers(target.owner)
        if target.indexed not in numbers:
            beams = (beam for beam in self.beams if beam.name == target.owner)
            names = [name for beam in beams for name in beam.parameter_names()]
            known = [f"{target.owner}.{name}" for name in (*names, *numbers)]
            raise UnknownNameError("design target", str(target), known)
        part = self.parts.get(target.owner)
        if isinstance(part, Part):
            self._check_point_target(part, target)
        return target

    def place_of(self, point: MaterialPoint) -> Array:
        """Return the position of a point in the declared reference configuration, (d,); m."""
        return reference_place(point, self.member)

    def with_grounds(self, targets: Iterable[str]) -> Self:
        """Return the same scene with `ground` declared in parts whose ground is a target.

        A `ground` that was left out becomes the position of the point in the declared reference
        configuration; so the scene is the same until the target changes. A declared ground
        is fixed in all components.
        """
        resolved = [self.resolve(text) for text in targets]
        owners = {target.owner for target in resolved if target.parameter in TARGETS}
        if not owners:
            return self

        def written(parts: Iterable[_AnyPart]) -> tuple[_AnyPart, ...]:
            return tuple(on_ground(x, self.member) if x.name in owners else x for x in parts)

        return replace(self, joints=written(self.joints), loads=written(self.loads))  # type: ignore[type-var]

    def is_of_elements(self, target: Target) -> bool:
        """Whether a target is a parameter of the elements of a beam."""
        beams = (beam for beam in self.beams if beam.name == target.owner)
        return any(target.parameter in beam.parameter_names() for beam in beams)

    def first_elements(self) -> dict[str, int]:
        """Return the index, among all elements of the scene, of the first element of each beam."""
        counts = np.cumsum([0] + [beam.element_count for beam in self.beams])
        return {beam.name: int(k) for beam, k in zip(self.beams, counts, strict=False)}

    def with_values(self, values: Mapping[str | DesignVariable, float]) -> Self:
        """Return the same scene with other parameter values.

        InvalidInputError, UnknownNameError naming the variable or target whose value a part cannot
        take, such as a negative height.

        Parameters
        ----------
        values : mapping
            ``{"beam.parameter": value}`` or ``{"beam.parameter[element]": value}``; a
            `DesignVariable` as a key moves all its targets. A ``ground_x`` of a joint whose ground
            was left out declares the ground: its other components are set to the present position.

        Returns
        -------
        Scene
            The changed scene, with `assemble`, so that bodies are moved onto their joints.
        """
        require_kind("with_values", values, (Mapping,), "For example {'rod.height': 0.06}.")
        changes = [change for key, value in values.items() for change in self._changes(key, value)]
        return self.with_grounds(str(target) for _, target, _ in changes)._changed(changes)

    def refuse_values(self, values: Mapping[str | DesignVariable, float]) -> None:
        """Raise the exceptions of `with_values`, making only the parts that change.

        The whole scene is made only if its own checks could find errors that the parts do not: if
        points, sections with points off the axis, or the scene itself change.
        """
        changes_of: dict[str, list[_Change]] = {}
        for key, value in values.items():
            for change in self._changes(key, value):
                changes_of.setdefault(change[1].owner, []).append(change)
        for owner, changes in changes_of.items():
            part = self._members.get(owner) or self.parts.get(owner)
            start = self.start_of.get(owner)
            known = start.parameters() if isinstance(start, InitialVelocity) else ()
            started = any(target.parameter in known for _, target, _ in changes)
            whole = started or owner in self._off_axis
            if part is None or whole or not _takes(part, changes):
                self.with_values(values)
                return

    @cached_property
    def _off_axis(self) -> set[str]:
        """Names of the beams with points off the axis, which must lie in their sections."""
        parts = (part for part in self.parts.values() if not isinstance(part, RigidBody))
        points = [point for part in parts for point in part.points]
        points += [body.attached for body in self.members if body.attached is not None]
        return {point.beam for point in points if point.y != 0 or point.z != 0}

    @cached_property
    def _moved(self) -> dict[DesignVariable, list[tuple[Target, float, float]]]:
        """Cache of the targets of design variables, each with its factor and offset."""
        return {}

    def _changes(self, key: str | DesignVariable, value: float) -> list[_Change]:
        """Return (name in errors, target, value) for each target that a variable's value sets."""
        if isinstance(key, DesignVariable):
            where = f"design variable {key.name!r}"
            require_finite(where, value)
            if key not in self._moved:
                self._moved[key] = [
                    (self.resolve(text), key.factor(text), self.offset(key, text))
                    for text in key.targets
                ]
            return [(where, x, factor * value + rest) for x, factor, rest in self._moved[key]]
        target = self.resolve(key)
        require_finite(key, value)
        return [(key, target, value)]

    def _changed(self, changes: Iterable[_Change]) -> Self:
        """Return the scene with targets changed, all targets of one part together."""
        changes_of: dict[str, list[_Change]] = {}
        for change in changes:
            changes_of.setdefault(change[1].owner, []).append(change)
        parts = {part.name: part for part in self._all_parts()}
        starts = list(self.start)
        for k, start in enumerate(starts):
            if isinstance(start, InitialVelocity) and start.body in changes_of:
                known = start.parameters()
                moving = [c for c in changes_of[start.body] if c[1].parameter in known]
                starts[k] = _with_numbers(start, moving)
                changes_of[start.body] = [c for c in changes_of[start.body] if c not in moving]
        scene = _with_numbers(self, changes_of.pop(SCENE, []))
        parts |= {
            name: _with_values(parts[name], changes_of[name])
            for name in changes_of
            if changes_of[name]
        }
        loads = [part for part in parts.values() if isinstance(part, Load)]
        return replace(  # type: ignore[type-var]
            scene,
            beams=tuple(part for part in parts.values() if isinstance(part, BeamBody)),
            bodies=tuple(p for p in parts.values() if isinstance(p, RigidBody | PointMass)),
            joints=tuple(part for part in parts.values() if isinstance(part, Joint)),
            loads=tuple(loads[: len(self.loads)]),
            start=tuple(
                s.with_loads(loads) if isinstance(s, EquilibriumStart) else s for s in starts
            ),
            assemble=True,
        )

    def value(self, variable: DesignVariable) -> float:
        """Return the current value of a design variable.

        InvalidInputError if its targets hold different values, so that it has no single value.
        """
        require_kind("value, variable", variable, (DesignVariable,), "Give a DesignVariable.")
        if variable.shares:
            first = next(iter(variable.targets))
            return self._single(first) / variable.factor(first)
        values = [value for text in variable.targets for value in self._held(text)]
        if max(values) - min(values) > _SAME * max(map(abs, values)):
            raise InvalidInputError(
                f"design variable {variable.name!r}",
                "all its targets must hold one and the same value",
                sorted(set(values)),
                "Set them equal with `with_values`, or use one variable per target.",
            )
        return values[0]

    def offset(self, variable: DesignVariable, text: str) -> float:
        """Return the constant part of a target: its value minus its factor times the variable."""
        if not variable.shares or text == next(iter(variable.targets)):
            return 0.0
        held, share = self._single(text), variable.factor(text) * self.value(variable)
        return 0.0 if abs(held - share) <= _SAME * abs(held) else held - share

    def _single(self, text: str) -> float:
        held = self._held(text)
        if max(held) - min(held) > _SAME * max(map(abs, held)):
            rule = "elements that one variable changes must have one value"
            repair = "Name the elements, as in 'rod.height[2]', or use `distributed_variables`."
            raise InvalidInputError(f"design target {text}", rule, sorted(set(held)), repair)
        return held[0]

    def _held(self, text: str) -> list[float]:
        """Return the current values of a target, one per element if elements differ."""
        target = self.resolve(text)
        if not self.is_of_elements(target):
            return [float(self.numbers(target.owner)[target.indexed])]
        beam, rows = self.beam(target.owner), self.target_elements(target)
        which = beam.parameter_names()[target.parameter]
        if which is ElementParameter.LENGTH:
            return [float(np.sum(beam.reference().lengths))]
        return self.element_parameters[rows, which].tolist()

    def target_elements(self, target: Target) -> Array:
        """Return the indices, among all elements of the scene, of the elements of a target.

        Raises InvalidInputError, UnknownNameError.
        """
        beam = self.beam(target.owner)
        beam.check_target(target.parameter, target.element)
        elements = self.first_elements()[beam.name] + np.arange(beam.element_count)
        return elements if target.element is None else elements[[target.element]]

    @cached_property
    def element_parameters(self) -> Array:
        """Parameters of all elements, shape (n, 10); columns: `ElementParameter`."""
        rows = [beam.element_parameters() for beam in self.beams]
        parameters = np.concatenate([np.zeros((0, len(ElementParameter))), *rows])
        parameters.setflags(write=False)
        return parameters

    def _all_parts(self) -> tuple[_Part, ...]:
        """Return all parts, and loads of `EquilibriumStart` that do not act during the motion."""
        loads = () if self.rest is None else self.rest.loads or ()
        resting = [load for load in loads if not any(load is kept for kept in self.loads)]
        return (*self.beams, *self.bodies, *self.joints, *self.loads, *resting)

    def _check_point_target(self, part: Part, target: Target) -> None:
        """Raise InvalidInputError for a point that cannot move both ways or is at a kink."""
        field, _, coordinate = target.parameter.rpartition("_")
        point = part.point_fields().get(field)
        if point is None:
            return
        where, element = f"design target {target}", self.elements.at(point)
        if point.fraction is None or coordinate != "fraction":
            axes = "xyz"[: element.d] if point.fraction is None else "yz"[: element.n_s - 2]
            if coordinate not in axes:
                rule = f"points of {point.beam!r} move along {' and '.join(axes) or 'it'} only"
                raise InvalidInputError(
                    where, rule, coordinate, "Remove this variable from `design`."
                )
            return
        nodes = self.beam(point.beam).reference().fractions
        at_node = bool(np.any(np.abs(nodes - point.fraction) < 1e-9))
        slopes = any(
            vector == Normal(point)
            or (isinstance(vector, tuple) and vector[0] == point and vector[1] > Quantity.POSITION)
            for vector in part.vectors(self.elements)
        )
        if point.fraction in (0.0, 1.0) or (at_node and (slopes or element.can_kink)):
            raise InvalidInputError(
                where,
                "the point must lie inside an element, to move both ways"
                if point.fraction in (0.0, 1.0)
                else "slopes have a kink at a node, so the point must lie inside an element",
                point.fraction,
                "Place it elsewhere, or let the length of the beam be the variable.",
            )


#: Name in error messages, target and value of a change.
_Change = tuple[str, Target, float]
#: Parts of a scene that design variables drive.
_Part: TypeAlias = BeamBody | RigidBody | Part


def _with_values(part: _Part, changes: list[_Change]) -> _Part:
    """Return the part with numbers changed together; errors name the target as written."""
    with _in_words_of(changes):
        if isinstance(part, BeamBody):
            return part.with_values(_of_beam(changes))
        if isinstance(part, RigidBody):
            placement = part.placement()
            moved = {t.parameter: value for _, t, value in changes if t.parameter in placement}
            part = part.with_placement(moved) if moved else part
            changes = [change for change in changes if change[1].parameter not in placement]
        return _with_numbers(part, changes)


def _takes(part: _Part, changes: list[_Change]) -> bool:
    """Raise the exceptions of `_with_values`; return whether the points of the part stay."""
    if isinstance(part, BeamBody):
        with _in_words_of(changes):
            part.refuse_values(_of_beam(changes))
        return True
    if isinstance(part, RigidBody):
        placement = part.placement()
        if any(target.parameter in placement for _, target, _ in changes):
            _with_values(part, changes)
            return True
        with _in_words_of(changes):
            part.refuse_values({target.indexed: value for _, target, value in changes})
        return True
    changed = _with_values(part, changes)
    return isinstance(changed, Part) and part.points == changed.points


def _of_beam(changes: list[_Change]) -> list[tuple[str, int | None, float]]:
    return [(target.parameter, target.element, value) for _, target, value in changes]


@contextmanager
def _in_words_of(changes: list[_Change]) -> Iterator[None]:
    """Raise InvalidInputError again, naming the changes that caused it as the user wrote them."""
    try:
        yield
    except InvalidInputError as error:
        named = [c for c in changes if error.where.endswith(f".{c[1].parameter}")] or changes
        where = ", ".join(dict.fromkeys(change[0] for change in named))
        raise InvalidInputError(where, error.rule, error.got, error.repair) from error


_AnyPart = TypeVar("_AnyPart", bound=Part)
_Numbered = TypeVar("_Numbered", bound=Designable)


def _with_numbers(owner: _Numbered, changes: list[_Change]) -> _Numbered:
    return owner.with_parameters({target.indexed: value for _, target, value in changes})
