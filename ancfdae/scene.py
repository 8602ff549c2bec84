"""Scene: a frozen declaration of exactly what is to be modelled."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, final

import numpy as np

from ancfdae.bodies import BeamBody, Point, Quantity, require_point
from ancfdae.design import Designable, DesignVariable, Target, parse_target
from ancfdae.elements import ElementParameter
from ancfdae.errors import (
    InvalidInput,
    UnknownName,
    require_finite,
    require_kind,
    require_sequence,
    require_vector,
)
from ancfdae.joints import Joint
from ancfdae.loads import Load
from ancfdae.numerics.arrays import Array
from ancfdae.parts import CentreLine, Part
from ancfdae.starts import AtRest, NodeState, RigidMotion, Start, checked_start
from ancfdae.text import listed

# Two targets hold the same value up to this relative difference: a length is summed from its n
# elements, which moves it by n eps; this admits 4500 elements.
_SAME = 1e-12
# Owner of the design targets of the scene itself, as in "scene.gravity_y".
_SCENE = "scene"


@final
@dataclass(frozen=True)
class Scene(Designable):
    """Beams, joints, loads and gravity, and how they start.

    Only what is declared is prepared and integrated: a planar scene has no spatial
    coordinate, a scene without damping no velocity Jacobian.

    Parameters
    ----------
    beams : sequence of BeamBody
        All planar or all spatial.
    joints : sequence of Joint
    loads : sequence of Load
    gravity : sequence of float, optional
        Acceleration of gravity; m/s^2.
    start : sequence of RigidMotion, NodeState or AtRest
        Initial motion; beams not named start at rest in the reference configuration. With `AtRest`
        everything starts from an equilibrium.
    assemble : bool
        Whether bodies that do not meet their joints as declared are moved onto them by rigid
        motions, with the least turns, instead of being refused; velocities likewise. Where the
        design is not that of the declaration they always are.
    lead : sequence of str
        Beams that keep their orientation when bodies are assembled: others turn.
    project_start : bool
        Whether what rigid motions cannot close is moved onto the joints (the nearest state in the
        norm of the mass matrix, which strains the bodies) instead of being refused; includes
        `assemble`.

    Raises
    ------
    InvalidInput
        If dimensions are mixed, names are duplicated, or a vector has the wrong size.
    UnknownName
        If a joint or a start names a beam that does not exist.
    """

    beams: Sequence[BeamBody]
    joints: Sequence[Joint] = ()
    gravity: Sequence[float] | None = None
    start: Sequence[Start] = ()
    loads: Sequence[Load] = ()
    assemble: bool = False
    lead: Sequence[str] = ()
    project_start: bool = False

    design_fields = (("gravity", require_vector),)

    def __post_init__(self) -> None:
        """Freeze the sequences and validate."""
        self._freeze("beams", (BeamBody,), "Add a Beam.")
        self._freeze("joints", (Joint,), "Add a Pin.")
        self._freeze("loads", (Load,), "Add a PointForce.")
        self._freeze("start", (RigidMotion, NodeState, AtRest), "Add a RigidMotion.")
        self._check_beams()
        self._check_names()
        self._check_parts()
        self._check_assembly()
        if self.gravity is not None:
            require_vector("Scene.gravity", self.gravity, (self.dimension,))
        object.__setattr__(self, "start", tuple(map(self._checked_start, self.start)))
        self._check_rest()

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return self.beams[0].dimension

    def __repr__(self) -> str:
        """Return the names of all parts."""
        beams = listed(f"{beam.name} ({beam.element_count} elements)" for beam in self.beams)
        joints, loads = (listed(part.name for part in x) for x in (self.joints, self.loads))
        where = "plane" if self.dimension == 2 else "space"
        return (
            f"Scene in the {where}\nbeams: {beams}\njoints: {joints}\nloads: {loads}\n"
            f"gravity: {'none' if self.gravity is None else tuple(self.gravity)}"
        )

    def beam(self, name: str) -> BeamBody:
        """Return the beam of this name.

        Raises
        ------
        UnknownName
        """
        for beam in self.beams:
            if beam.name == name:
                return beam
        raise UnknownName("beam", name, (beam.name for beam in self.beams))

    def parts(self) -> dict[str, Part]:
        """Return joints and loads, of the start at rest too; their numbers can be targets."""
        return {part.name: part for part in (*self.joints, *self.loads, *self._rest_loads())}

    @property
    def rest(self) -> AtRest | None:
        """How the scene starts from an equilibrium, None if it does not."""
        return next((start for start in self.start if isinstance(start, AtRest)), None)

    def at_rest(self) -> Scene | None:
        """Return the scene whose equilibrium the motion starts from, None without `AtRest`."""
        rest = self.rest
        if rest is None:
            return None
        return replace(
            self,
            loads=self.loads if rest.loads is None else rest.loads,
            gravity=self.gravity if rest.gravity is None else rest.gravity,
            start=[start for start in self.start if start is not rest],
        )

    def start_of(self, beam: str) -> RigidMotion | NodeState | None:
        """Return how a beam starts, None if from rest in the reference configuration."""
        own = (start for start in self.start if not isinstance(start, AtRest))
        return next((start for start in own if start.beam == beam), None)

    def owners(self) -> tuple[str, ...]:
        """Return the names of everything that has `numbers`."""
        return (*(beam.name for beam in self.beams), *self.parts(), _SCENE)

    def numbers(self, owner: str) -> dict[str, float]:
        """Return the numbers beside those of elements that can be design targets, by parameter.

        Of a beam its placement and its initial velocity, of joints and loads their parameters, of
        the owner ``"scene"`` gravity.

        Raises
        ------
        UnknownName
        """
        if owner == _SCENE:
            return self.parameters()
        parts = self.parts()
        if owner in parts:
            return parts[owner].parameters() | parts[owner].point_numbers()
        if owner not in (beam.name for beam in self.beams):
            raise UnknownName("beam, joint or load", owner, self.owners())
        start = self.start_of(owner)
        motion = start.parameters() if isinstance(start, RigidMotion) else {}
        return self.beam(owner).placement() | motion

    def resolve(self, text: str) -> Target:
        """Read a target and refuse one that the scene does not have.

        Raises
        ------
        InvalidInput, UnknownName
        """
        target = parse_target(text)
        if self.is_of_elements(target):
            self.beam(target.owner).check_target(target.parameter, target.element)
            return target
        numbers = self.numbers(target.owner)
        if target.element is not None:
            raise InvalidInput(
                f"design target {target}",
                "only beams have elements",
                f"[{target.element}]",
                f"Use {target.owner}.{target.parameter}.",
            )
        if target.parameter not in numbers:
            beams = (beam for beam in self.beams if beam.name == target.owner)
            names = [name for beam in beams for name in beam.parameter_names()]
            known = [f"{target.owner}.{name}" for name in (*names, *numbers)]
            raise UnknownName("design target", str(target), known)
        if target.owner in self.parts():
            self._check_point_target(target)
        return target

    def is_of_elements(self, target: Target) -> bool:
        """Whether a target names a parameter of elements of a beam."""
        beams = (beam for beam in self.beams if beam.name == target.owner)
        return any(target.parameter in beam.parameter_names() for beam in beams)

    def first_elements(self) -> dict[str, int]:
        """Return the scene-wide number of the first element of each beam."""
        counts = np.cumsum([0] + [beam.element_count for beam in self.beams])
        return {beam.name: int(k) for beam, k in zip(self.beams, counts, strict=False)}

    def with_values(self, values: Mapping[str, float]) -> Scene:
        """Return the same scene with other parameter values.

        Parameters
        ----------
        values : mapping
            ``{"beam.parameter": value}`` or ``{"beam.parameter[element]": value}``; a
            `DesignVariable` as a key moves all its targets.

        Returns
        -------
        Scene
            With `assemble`, so that bodies follow.

        Raises
        ------
        InvalidInput, UnknownName
        """
        require_kind("with_values", values, (Mapping,), "For example {'rod.height': 0.06}.")
        return self._changed(
            change for key, value in values.items() for change in self._changes(key, value)
        )

    def check_values(self, design: Sequence[DesignVariable], values: Sequence[float]) -> None:
        """Refuse values that design variables cannot take, such as a negative height.

        Each part is checked alone; whether all parts still fit together is not checked.

        Raises
        ------
        InvalidInput
            Naming the variable.
        """
        self._changed(
            change
            for variable, value in zip(design, values, strict=True)
            for change in self._changes(variable, value)
        )

    def _changes(self, key: str | DesignVariable, value: float) -> list[_Change]:
        """Return (what errors name, target, value) of everything that a value changes."""
        if isinstance(key, DesignVariable):
            where = f"design variable {key.name!r}"
            require_finite(where, value)
            return [
                (where, self.resolve(text), key.factor(text) * value + self.offset(key, text))
                for text in key.targets
            ]
        target = self.resolve(key)
        require_finite(key, value)
        return [(key, target, value)]

    def _changed(self, changes: Iterable[_Change]) -> Scene:
        """Return the scene with targets changed, all targets of a part at once."""
        own: dict[str, list[_Change]] = {}
        for change in changes:
            own.setdefault(change[1].owner, []).append(change)
        parts: dict[str, BeamBody | Part] = {part.name: part for part in self._all_parts()}
        starts = list(self.start)
        for k, start in enumerate(starts):
            if isinstance(start, RigidMotion) and start.beam in own:
                known = start.parameters()
                moving = [c for c in own[start.beam] if c[1].parameter in known]
                starts[k] = _with_numbers(start, moving)
                own[start.beam] = [c for c in own[start.beam] if c not in moving]
        scene = _with_numbers(self, own.pop(_SCENE, []))
        parts |= {name: _with_values(parts[name], own[name]) for name in own if own[name]}
        loads = [part for part in parts.values() if isinstance(part, Load)]
        return replace(
            scene,
            beams=tuple(part for part in parts.values() if isinstance(part, BeamBody)),
            joints=tuple(part for part in parts.values() if isinstance(part, Joint)),
            loads=tuple(loads[: len(self.loads)]),
            start=tuple(s.with_loads(loads) if isinstance(s, AtRest) else s for s in starts),
            assemble=True,
        )

    def value(self, variable: DesignVariable) -> float:
        """Return the current value of a design variable.

        Raises
        ------
        InvalidInput
            If its targets hold different values, so that it has no single one.
        """
        if variable.shares:
            first = next(iter(variable.targets))
            return self._single(first) / variable.factor(first)
        values = [value for text in variable.targets for value in self._held(text)]
        if max(values) - min(values) > _SAME * max(map(abs, values)):
            raise InvalidInput(
                f"design variable {variable.name!r}",
                "all its targets must hold one and the same value",
                sorted(set(values)),
                "Set them equal with `with_values`, or use one variable per target.",
            )
        return values[0]

    def offset(self, variable: DesignVariable, text: str) -> float:
        """Return what a target holds beside its factor times the variable."""
        if not variable.shares or text == next(iter(variable.targets)):
            return 0.0
        held, share = self._single(text), variable.factor(text) * self.value(variable)
        return 0.0 if abs(held - share) <= _SAME * abs(held) else held - share

    def _single(self, text: str) -> float:
        held = self._held(text)
        if max(held) - min(held) > _SAME * max(map(abs, held)):
            rule, repair = "must hold one value to move by a factor", "Name its elements."
            raise InvalidInput(f"design target {text}", rule, sorted(set(held)), repair)
        return held[0]

    def _held(self, text: str) -> list[float]:
        """Return what a target holds; of a beam whose elements differ several values."""
        target = self.resolve(text)
        if not self.is_of_elements(target):
            return [float(self.numbers(target.owner)[target.parameter])]
        beam, rows = self.beam(target.owner), self.target_elements(target)
        which = beam.parameter_names()[target.parameter]
        if which is ElementParameter.LENGTH:
            return [float(np.sum(beam.reference().lengths))]
        held: list[float] = self.element_parameters()[rows, which].tolist()
        return held

    def target_elements(self, target: Target) -> Array:
        """Return the scene-wide numbers of the elements that a target writes to.

        Raises
        ------
        InvalidInput, UnknownName
        """
        beam = self.beam(target.owner)
        beam.check_target(target.parameter, target.element)
        elements = self.first_elements()[beam.name] + np.arange(beam.element_count)
        return elements if target.element is None else elements[[target.element]]

    def element_parameters(self) -> Array:
        """Return the parameters of all elements, shape (n, 9), columns as `ElementParameter`."""
        return np.concatenate([beam.element_parameters() for beam in self.beams])

    def _all_parts(self) -> tuple[BeamBody | Part, ...]:
        return (*self.beams, *self.joints, *self.loads, *self._rest_loads())

    def _rest_loads(self) -> tuple[Load, ...]:
        """Return the loads of the start at rest that are not those of the motion."""
        loads = () if self.rest is None else self.rest.loads or ()
        return tuple(load for load in loads if not any(load is own for own in self.loads))

    def _check_point_target(self, target: Target) -> None:
        """Refuse to move a point that cannot move both ways, or past a node that slopes kink at."""
        field, _, coordinate = target.parameter.rpartition("_")
        part = self.parts()[target.owner]
        point = part.point_fields().get(field)
        if point is None:
            return
        where, element = f"design target {target}", self.beam(point.beam).element
        if coordinate != "fraction":
            known = [q.name[-1].lower() for q in element.quantities[2:]]
            if coordinate not in known:
                raise InvalidInput(
                    where, f"{element.name} has no such axis", coordinate, "Leave it out."
                )
            return
        ends = np.cumsum(self.beam(point.beam).reference().lengths)
        nodes = np.concatenate([[0.0], ends / ends[-1]])
        at_node = bool(np.any(np.abs(nodes - point.fraction) < 1e-9))
        slopes = any(
            vector[1] is not Quantity.POSITION
            for vector in part.vectors(element)
            if not isinstance(vector, CentreLine) and vector[0] == point
        )
        if point.fraction in (0.0, 1.0) or (at_node and slopes):
            raise InvalidInput(
                where,
                "the point must lie inside an element, to move both ways"
                if point.fraction in (0.0, 1.0)
                else "slopes have a kink at a node, so the point must lie inside an element",
                point.fraction,
                "Place it elsewhere, or let the length of the beam be the variable.",
            )

    def _check_assembly(self) -> None:
        """Refuse names that are no beams, and beams that start at one another in a circle."""
        object.__setattr__(self, "lead", require_sequence("Scene.lead", self.lead))
        for name in self.lead:
            self._check_beam("Scene.lead", name)
        for beam in self.beams:
            seen = [beam.name]
            while (point := self.beam(seen[-1]).attached) is not None:
                self._check_point(f"start of {seen[-1]!r}", point)
                if point.beam in seen:
                    rule, repair = "beams may not start at one another", "Give one a place."
                    raise InvalidInput(f"start of {beam.name!r}", rule, seen, repair)
                seen.append(point.beam)

    def _freeze(self, name: str, kinds: tuple[type, ...], repair: str) -> None:
        """Turn a sequence of parts into a tuple and refuse what is none of them."""
        parts = require_sequence(f"Scene.{name}", getattr(self, name))
        for part in parts:
            require_kind(f"Scene.{name}", part, kinds, repair)
        object.__setattr__(self, name, parts)

    def _check_names(self) -> None:
        """Refuse names that stand for two parts, and beams that start twice."""
        rule, repair = "every part needs a name of its own", "Rename one."
        _require_unique("Scene.beams", rule, [beam.name for beam in self.beams], repair)
        _require_unique("Scene.joints", rule, [joint.name for joint in self.joints], repair)
        _require_unique("Scene", rule, [part.name for part in self._all_parts()], repair)
        if _SCENE in (part.name for part in self._all_parts()):
            raise InvalidInput("Scene", "'scene' names the scene itself", _SCENE, repair)
        starts = [start.beam for start in self.start if not isinstance(start, AtRest)]
        _require_unique("Scene.start", "every beam starts once", starts, "Keep one of them.")

    def _check_beams(self) -> None:
        if not self.beams:
            raise InvalidInput("Scene.beams", "needs at least one beam", "none", "Add a beam.")
        dimensions = {beam.dimension for beam in self.beams}
        if len(dimensions) > 1:
            raise InvalidInput(
                "Scene.beams",
                "must be all planar or all spatial",
                {beam.name: beam.dimension for beam in self.beams},
                "Give every beam points with the same number of components.",
            )
        elements = {beam.name: beam.element.name for beam in self.beams}
        if len(set(elements.values())) > 1:
            raise InvalidInput(
                "Scene.beams", "must all be of one element", elements, "Choose the same for all."
            )

    def _check_parts(self) -> None:
        element = self.beams[0].element
        for part in self.parts().values():
            where = f"{part.role} {part.name!r}"
            part.check_space(element)
            if part.whole_beam is not None:
                self._check_beam(where, part.whole_beam)
            for point in part.points:
                self._check_point(where, point)

    def _check_beam(self, where: str, name: str) -> None:
        known = [beam.name for beam in self.beams]
        if name not in known:
            raise UnknownName(f"{where}, beam", name, known)

    def _check_point(self, where: str, point: Point) -> None:
        """Refuse a point outside the sections of the element, or the two elements, it lies in."""
        require_point(where, point, self.dimension)
        self._check_beam(where, point.beam)
        beam = self.beam(point.beam)
        ends = np.cumsum(beam.reference().lengths)
        ends /= ends[-1]
        starts = np.concatenate([[0.0], ends[:-1]])
        # Widened by round-off, so that nodes belong to both elements and the surface to the beam.
        touched = (starts <= point.fraction + 1e-12) & (point.fraction - 1e-12 <= ends)
        half = [extent * (1 + 1e-12) for extent in beam.half_extents(np.flatnonzero(touched))]
        if abs(point.y) > half[0] or abs(point.z) > half[1]:
            raise InvalidInput(
                where,
                f"the point must lie in the section (|y| <= {half[0]:.6g}, |z| <= {half[1]:.6g})",
                f"y = {point.y}, z = {point.z} at fraction {point.fraction}",
                "Move the point into the beam.",
            )

    def _checked_start(self, start: Start) -> Start:
        if isinstance(start, AtRest):
            return start
        return checked_start(start, self.beam(start.beam), self.dimension)

    def _check_rest(self) -> None:
        """Refuse a start at rest that moves."""
        rests = [start for start in self.start if isinstance(start, AtRest)]
        if not rests:
            return
        if rests[0].gravity is not None:
            require_vector("AtRest.gravity", rests[0].gravity, (self.dimension,))
        beams = [start for start in self.start if not isinstance(start, AtRest)]
        moving = any(isinstance(s, RigidMotion) or s.velocities is not None for s in beams)
        if len(rests) > 1 or moving:
            raise InvalidInput(
                "Scene.start",
                "AtRest stands alone or with node states without velocities",
                listed(type(start).__name__ for start in self.start),
                "Leave out what moves; a NodeState tells where the search starts.",
            )


#: What errors name, target and value.
_Change = tuple[str, Target, float]


def _with_values(part: BeamBody | Part, changes: list[_Change]) -> BeamBody | Part:
    """Return the part with numbers changed together; errors name what the user wrote."""
    try:
        if isinstance(part, BeamBody):
            return part.with_values([(t.parameter, t.element, value) for _, t, value in changes])
        return _with_numbers(part, changes)
    except InvalidInput as error:
        # The one that the error speaks of, or all that do not fit together.
        named = [c for c in changes if error.where.endswith(f".{c[1].parameter}")] or changes
        where = ", ".join(dict.fromkeys(change[0] for change in named))
        raise InvalidInput(where, error.rule, error.got, error.repair) from error


_Numbered = TypeVar("_Numbered", bound=Designable)


def _with_numbers(owner: _Numbered, changes: list[_Change]) -> _Numbered:
    for _, target, value in changes:
        owner = owner.with_parameter(target.parameter, value)
    return owner


def _require_unique(where: str, rule: str, names: list[str], repair: str) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidInput(where, rule, twice, repair)
