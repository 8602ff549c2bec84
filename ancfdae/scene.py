"""Scene: a frozen declaration of exactly what is to be modelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from ancfdae.bodies import PARAMETER_NAMES, BeamBody
from ancfdae.design import DesignVariable, Target, parse_target
from ancfdae.elements import ElementParameter
from ancfdae.errors import InvalidInput, UnknownName, require_finite, require_vector
from ancfdae.joints import Joint
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class RigidMotion:
    """Initial velocity of a beam: a rigid-body motion.

    v = velocity + angular_velocity x (r - about); slopes turn along.

    Parameters
    ----------
    beam : str
        Name of the beam.
    angular_velocity : float or sequence of float
        A number in the plane, three components in space; rad/s.
    about : sequence of float
        Reference point; m.
    velocity : sequence of float, optional
        Velocity of the reference point, zero by default; m/s.
    """

    beam: str
    angular_velocity: float | Sequence[float]
    about: Sequence[float]
    velocity: Sequence[float] | None = None


@final
@dataclass(frozen=True)
class NodeState:
    """Initial coordinates and velocities of a beam, node by node.

    Parameters
    ----------
    beam : str
        Name of the beam.
    coordinates : array, shape (n + 1, n_s, d)
        Position and slopes of every node.
    velocities : array, shape (n + 1, n_s, d), optional
        Zero by default.
    """

    beam: str
    coordinates: Array
    velocities: Array | None = None


@final
@dataclass(frozen=True)
class Scene:
    """Beams, joints and gravity, and how they start.

    Nothing but what is declared is prepared or integrated: a planar scene has no spatial
    coordinate, a scene without gravity no load.

    Parameters
    ----------
    beams : sequence of BeamBody
        All planar or all spatial.
    joints : sequence of Joint
    gravity : sequence of float, optional
        Acceleration of gravity; m/s^2.
    start : sequence of RigidMotion or NodeState
        Initial motion; beams not named start at rest in the reference configuration.
    project_start : bool
        Whether a start that violates the constraints is moved onto them (the nearest one in
        the norm of the mass matrix) instead of being refused.

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
    start: Sequence[RigidMotion | NodeState] = field(default=())
    project_start: bool = False

    def __post_init__(self) -> None:
        """Freeze the sequences and validate."""
        object.__setattr__(self, "beams", tuple(self.beams))
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "start", tuple(self.start))
        self._check_beams()
        self._check_joints()
        if self.gravity is not None:
            require_vector("Scene.gravity", self.gravity, (self.dimension,))
        for motion in self.start:
            self._check_start(motion)

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return self.beams[0].dimension

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

    def first_elements(self) -> dict[str, int]:
        """Return the scene-wide number of the first element of each beam."""
        counts = np.cumsum([0] + [beam.element_count for beam in self.beams])
        return {beam.name: int(k) for beam, k in zip(self.beams, counts, strict=False)}

    def with_values(self, values: Mapping[str, float]) -> Scene:
        """Return the same scene with other parameter values.

        Parameters
        ----------
        values : mapping
            ``{"beam.parameter": value}`` or ``{"beam.parameter[element]": value}``.

        Raises
        ------
        InvalidInput, UnknownName
        """
        beams = {beam.name: beam for beam in self.beams}
        for text, value in values.items():
            target = parse_target(text)
            owner = self.beam(target.owner).name
            require_finite(text, value)
            beams[owner] = beams[owner].with_value(target.parameter, target.element, value)
        return replace(self, beams=tuple(beams.values()))

    def value(self, variable: DesignVariable) -> float:
        """Return the current value of a design variable.

        Raises
        ------
        InvalidInput
            If its targets hold different values, so that it has no single one.
        """
        parameters = self.element_parameters()
        values = set()
        for text in variable.targets:
            target = parse_target(text)
            beam = self.beam(target.owner)
            rows, which = self.target_elements(target), PARAMETER_NAMES[target.parameter]
            if which is ElementParameter.LENGTH:
                values.add(float(np.sum(beam.reference().lengths)))
            else:
                values.update(parameters[rows, which].tolist())
        if len(values) != 1:
            raise InvalidInput(
                f"design variable {variable.name!r}",
                "all its targets must hold one and the same value",
                sorted(values),
                "Set them equal with `with_values`, or use one variable per target.",
            )
        return values.pop()

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
        """Return the parameters of all elements, shape (n, 6), columns as `ElementParameter`."""
        return np.concatenate([beam.element_parameters() for beam in self.beams])

    def _check_beams(self) -> None:
        if not self.beams:
            raise InvalidInput("Scene.beams", "needs at least one beam", "none", "Add a beam.")
        for beam in self.beams:
            if not isinstance(beam, BeamBody):
                raise InvalidInput("Scene.beams", "takes beams", repr(beam), "Add a Beam.")
        _require_unique("beam", [beam.name for beam in self.beams])
        dimensions = {beam.dimension for beam in self.beams}
        if len(dimensions) > 1:
            raise InvalidInput(
                "Scene.beams",
                "must be all planar or all spatial",
                {beam.name: beam.dimension for beam in self.beams},
                "Give every beam points with the same number of components.",
            )

    def _check_joints(self) -> None:
        for joint in self.joints:
            if not isinstance(joint, Joint):
                raise InvalidInput("Scene.joints", "takes joints", repr(joint), "Add a Pin.")
        _require_unique("joint", [joint.name for joint in self.joints])
        known = [beam.name for beam in self.beams]
        for joint in self.joints:
            for point in joint.points:
                if point.beam not in known:
                    raise UnknownName(f"joint {joint.name!r}, beam", point.beam, known)
                self._check_inside(joint, point.beam, point.y, point.fraction, point.z)
            for equation in joint.equations(self.dimension):
                if equation.value is not None:
                    require_vector(f"joint {joint.name!r}", equation.value, (self.dimension,))

    def _check_inside(self, joint: Joint, name: str, y: float, fraction: float, z: float) -> None:
        beam = self.beam(name)
        if self.dimension == 2 and z != 0.0:
            raise InvalidInput(
                f"joint {joint.name!r}", "a planar beam has no z axis", f"z = {z}", "Leave z out."
            )
        # Half an extent, widened by round-off so that the surface itself belongs to the beam.
        half = 0.5 * beam.element_parameters()[:, 3:5].max(axis=0) * (1 + 1e-12)
        if abs(y) > half[0] or abs(z) > half[1]:
            raise InvalidInput(
                f"joint {joint.name!r}",
                f"the point must lie in the section (|y| <= {half[0]:.6g}, |z| <= {half[1]:.6g})",
                f"y = {y}, z = {z} at fraction {fraction}",
                "Move the point into the beam.",
            )

    def _check_start(self, motion: RigidMotion | NodeState) -> None:
        beam = self.beam(motion.beam)
        if isinstance(motion, RigidMotion):
            require_vector(f"start of {beam.name!r}, about", motion.about, (self.dimension,))
            if motion.velocity is not None:
                require_vector(
                    f"start of {beam.name!r}, velocity", motion.velocity, (self.dimension,)
                )
            spin = np.atleast_1d(np.asarray(motion.angular_velocity, dtype=float))
            size = 1 if self.dimension == 2 else 3
            require_vector(f"start of {beam.name!r}, angular_velocity", spin.tolist(), (size,))
            return
        wanted = (beam.element_count + 1, beam.element.n_s, self.dimension)
        for what, array in (("coordinates", motion.coordinates), ("velocities", motion.velocities)):
            if array is None:
                continue
            if np.shape(array) != wanted or not np.all(np.isfinite(array)):
                raise InvalidInput(
                    f"start of {beam.name!r}, {what}",
                    f"must be finite numbers of shape {wanted}",
                    f"shape {np.shape(array)}",
                    "Give position and slopes of every node.",
                )


def _require_unique(kind: str, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidInput(
            f"Scene.{kind}s", f"every {kind} needs a name of its own", twice, "Rename one."
        )
