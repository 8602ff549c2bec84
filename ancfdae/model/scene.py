"""The class `Scene`: an immutable declaration of a mechanism."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.errors.checks import (
    named,
    require_flag,
    require_kind,
    require_sequence,
    require_unique,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import listed
from ancfdae.model.bodies import (
    BeamBody,
    MaterialPoint,
    RigidBody,
    require_in_section,
    require_point,
)
from ancfdae.model.joints.joint import FormulaJoint, Joint
from ancfdae.model.loads.load import Load
from ancfdae.model.parts import PointMass
from ancfdae.model.scene_design import SCENE, SceneDesign
from ancfdae.model.starts import EquilibriumStart, InitialVelocity, NodalState, Start, checked_start
from ancfdae.model.turning_frame import RotatingFrame, require_frame


@final
@dataclass(frozen=True)
class Scene(SceneDesign):
    """A mechanism: beams, rigid bodies, joints, loads, gravity and initial conditions.

    Only what is declared is prepared and integrated: a planar scene has no spatial
    coordinate, a scene without damping no velocity Jacobian.

    Parameters
    ----------
    beams : sequence of BeamBody
        Beams and cables; with the rigid bodies all planar or all spatial.
    joints : sequence of Joint
    loads : sequence of Load
    gravity : sequence of float, optional
        Acceleration of gravity; m/s^2.
    start : sequence of InitialVelocity, NodalState or EquilibriumStart
        Initial motion; beams and bodies not named start at rest in the reference configuration.
        With `EquilibriumStart` the mechanism starts from a static equilibrium.
    assemble : bool
        Whether bodies that do not meet their joints as declared are moved onto them by rigid
        motions, with the smallest rotations, instead of raising an error; velocities likewise. At
        other designs than the declared one they always are.
    lead : sequence of str
        Beams that keep their orientation when bodies are assembled, so that other bodies rotate.
    project_start : bool
        Whether joints that rigid motions cannot close are closed by deforming bodies (the nearest
        state in the norm of the mass matrix) instead of raising an error; includes `assemble`.
    bodies : sequence of RigidBody or PointMass
    frame : RotatingFrame, optional
        Steadily rotating frame in which the whole scene is declared; by default an inertial frame.
    left_out : sequence of (str, int)
        Joint equations that are not imposed because other ones imply them, as `drop_redundant`
        finds them: the name of a joint and the number of its equation, counted from 0. A run ends
        where one of them opens.

    Raises
    ------
    InvalidInputError
        If dimensions are mixed, names are duplicated, or a vector has the wrong size.
    UnknownNameError
        If a joint or a start names a beam that does not exist.
    """

    beams: Sequence[BeamBody] = ()
    joints: Sequence[Joint] = ()
    gravity: Sequence[float] | None = None
    start: Sequence[Start] = ()
    loads: Sequence[Load] = ()
    assemble: bool = False
    lead: Sequence[str] = ()
    project_start: bool = False
    bodies: Sequence[RigidBody | PointMass] = ()
    frame: RotatingFrame | None = None
    left_out: Sequence[tuple[str, int]] = ()

    design_fields = (("gravity", require_vector), ("frame", require_frame))

    def __post_init__(self) -> None:
        """Store the sequences as tuples and check all bodies, joints, loads and names."""
        self._freeze("beams", (BeamBody,), "Add a Beam.")
        self._freeze("bodies", (RigidBody, PointMass), "Add a RigidBody.")
        self._freeze("joints", (Joint,), "Add a Pin.")
        self._freeze("loads", (Load,), "Add a PointForce.")
        self._freeze(
            "start", (InitialVelocity, NodalState, EquilibriumStart), "Add a InitialVelocity."
        )
        for name in ("assemble", "project_start"):
            require_flag(f"Scene.{name}", getattr(self, name))
        self._check_members()
        self._check_parts()
        if self.left_out:
            self._check_left_out()
        self._check_assembly()
        if self.gravity is not None:
            require_vector("Scene.gravity", self.gravity, (self.dimension,))
        if self.frame is not None:
            require_frame("Scene.frame", self.frame)
            self.frame.check(self.dimension, self.gravity)
            names = [load.name for load in self.loads if load.states]
            if names:
                rule, repair = (
                    "must have no load with states",
                    "Declare the scene in a frame at rest.",
                )
                raise InvalidInputError("Scene.frame", rule, listed(names), repair)
        object.__setattr__(self, "start", tuple(map(self._checked_start, self.start)))
        if self.rest is not None:
            self._check_rest(self.rest)

    def __repr__(self) -> str:
        beams = listed(f"{beam.name} ({beam.element_count} elements)" for beam in self.beams)
        kinds = (self.bodies, self.joints, self.loads)
        bodies, joints, loads = (listed(part.name for part in x) for x in kinds)
        lines = [
            f"Scene in the {'plane' if self.dimension == 2 else 'space'}",
            f"beams: {beams}",
            f"bodies: {bodies}",
            f"joints: {joints}",
            f"loads: {loads}",
            f"gravity: {'none' if self.gravity is None else tuple(self.gravity)}",
        ]
        if self.frame is not None:
            lines.append(f"in a {self.frame}")
        if self.left_out:  # One text for each joint: ``hinge (3, 4)``.
            rows: dict[str, list[str]] = {}
            for name, row in self.left_out:
                rows.setdefault(name, []).append(str(row))
            joined = (f"{name} ({', '.join(numbers)})" for name, numbers in rows.items())
            lines.append(f"equations left out: {listed(joined)}")
        return "\n".join(lines)

    def at_rest(self) -> Scene | None:
        """Return the scene whose equilibrium is the start of the motion; None without one."""
        rest = self.rest
        if rest is None:
            return None
        # With the same kinks, so that it has the same coordinates under other loads.
        beams = [beam.with_kinks(self.kinks.get(beam.name, ())) for beam in self.beams]
        return replace(
            self,
            beams=beams,
            loads=self.loads if rest.loads is None else rest.loads,
            gravity=self.gravity if rest.gravity is None else rest.gravity,
            start=[start for start in self.start if start is not rest],
        )

    def _freeze(self, name: str, kinds: tuple[type, ...], repair: str) -> None:
        """Store a sequence field as a tuple; InvalidInputError for an entry of another class."""
        parts = require_sequence(f"Scene.{name}", getattr(self, name))
        for part in parts:
            require_kind(f"Scene.{name}", part, kinds, repair)
        object.__setattr__(self, name, parts)

    def _check_members(self) -> None:
        """Raise InvalidInputError for no body, mixed dimensions, a name or a body's start twice."""
        if not self.members:
            rule, repair = "needs at least one beam or rigid body", "Add a Beam or a RigidBody."
            raise InvalidInputError("Scene.beams and bodies", rule, "none", repair)
        dimensions = {body.name: body.dimension for body in self.members}
        if len(set(dimensions.values())) > 1:
            rule = "must be all planar or all spatial"
            repair = "Give all of them points with the same number of components."
            raise InvalidInputError("Scene.beams and bodies", rule, dimensions, repair)
        rule, repair = "every part needs a name of its own", "Rename one of the two parts."
        for field in ("beams", "bodies", "joints"):
            names = [part.name for part in getattr(self, field)]
            require_unique(f"Scene.{field}", rule, names, repair)
        names = [part.name for part in self._all_parts()]
        require_unique("Scene", rule, names, repair)
        if SCENE in names:
            raise InvalidInputError("Scene", "'scene' names the scene itself", SCENE, repair)
        rule, repair = "every beam and body starts once", "Keep one of them."
        require_unique("Scene.start", rule, [start.body for start in self.body_starts], repair)

    def _check_parts(self) -> None:
        elements = self.elements
        for part in self.parts.values():
            if isinstance(part, RigidBody):
                continue
            where = f"{part.role} {part.name!r}"
            for name in part.whole_beams:
                named(f"{where}, beam", name, self.beams)
            for name in part.whole_bodies:
                named(f"{where}, body", name, [x for x in self.bodies if isinstance(x, RigidBody)])
            part.check_space(elements)
            for point in part.points:
                self._check_point(where, point)

    def _check_left_out(self) -> None:
        """Store `left_out` as pairs; InvalidInputError for unknown joints and formula joints."""
        pairs = require_sequence("Scene.left_out", self.left_out)
        repair = "For example left_out=[('hinge', 3)], as drop_redundant(scene) finds them."
        for pair in pairs:
            if not (isinstance(pair, (tuple, list)) and len(pair) == 2):
                rule = "must hold pairs of the name of a joint and the number of an equation"
                raise InvalidInputError("Scene.left_out", rule, repr(pair), repair)
            require_kind("Scene.left_out, equation", pair[1], (int, np.integer), repair)
            joint = named("Scene.left_out, joint", pair[0], self.joints)
            if isinstance(joint, FormulaJoint) and joint.row_count(self.dimension) != 1:
                rule = "of a joint by formulas only a single equation can be left out"
                raise InvalidInputError("Scene.left_out", rule, repr(pair[0]), repair)
        object.__setattr__(self, "left_out", tuple((name, int(row)) for name, row in pairs))

    def _check_point(self, where: str, point: MaterialPoint) -> None:
        """Raise InvalidInputError for a point outside the sections of the elements it lies in.

        Points of rigid bodies may lie anywhere.
        """
        require_point(where, point, self.dimension)
        beam = self._members.get(point.beam) or named(f"{where}, beam", point.beam, self.members)
        if (point.fraction is None) != isinstance(beam, RigidBody):
            raise InvalidInputError(
                where,
                "a point of a beam has a fraction, one of a rigid body a place x, y, z",
                point,
                "Write beam.at(fraction) or body.at(x, y).",
            )
        if isinstance(beam, RigidBody) or point.fraction is None:
            return
        nodes = beam.reference().fractions
        starts, ends = nodes[:-1], nodes[1:]
        # Widened by round-off, so that nodes belong to both elements.
        touched = (starts <= point.fraction + 1e-12) & (point.fraction - 1e-12 <= ends)
        require_in_section(where, point, beam.half_extents(np.flatnonzero(touched)))

    def _checked_start(self, start: Start) -> Start:
        if isinstance(start, EquilibriumStart):
            return start
        body = self.member(start.body)
        return checked_start(start, body, self.dimension, self.kinks.get(body.name, ()))

    def _check_rest(self, rest: EquilibriumStart) -> None:
        """Raise InvalidInputError if an `EquilibriumStart` is given with initial velocities."""
        if rest.gravity is not None:
            require_vector("EquilibriumStart.gravity", rest.gravity, (self.dimension,))
        starts = self.body_starts
        moving = any(isinstance(s, InitialVelocity) or s.velocities is not None for s in starts)
        if len(self.start) - len(starts) > 1 or moving:
            raise InvalidInputError(
                "Scene.start",
                "EquilibriumStart stands alone or with node states without velocities",
                listed(type(start).__name__ for start in self.start),
                "Leave out what moves; the search starts from a NodalState.",
            )
        for joint in self.joints:
            numbers = np.array(list(joint.parameters().values()))
            if joint.states and np.any(joint.initial_states(numbers)):
                rule = "guides must not slide at the start from an equilibrium"
                value = f"a speed of {joint.name!r}"
                raise InvalidInputError("Scene.start", rule, value, "Leave out its speed.")

    def _check_assembly(self) -> None:
        """Check the names in `lead`, and that no bodies are attached to one another in a circle."""
        object.__setattr__(self, "lead", require_sequence("Scene.lead", self.lead))
        for name in self.lead:
            self.member(name)
        for body in self.members:
            if body.attached is not None:
                self._check_point(f"start of {body.name!r}", body.attached)
        ordered = {body.name for body in self.by_attachment}
        for body in self.members:
            if body.name not in ordered:
                rule, repair = "bodies may not start at one another", "Give one a place."
                circle = [body.name]
                while (point := self.member(circle[-1]).attached) and point.beam not in circle:
                    circle.append(point.beam)
                raise InvalidInputError(f"start of {body.name!r}", rule, circle, repair)
