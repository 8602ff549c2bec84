"""Rotation of bodies since the reference configuration: directions, and angles about an axis.

The slopes r_k of a material point are F r_ok, r_ok in the reference, and F transforms every
direction of the reference; of a rigid body F is its rotation. A body that rotates about the axis a
relative to another one has G = F'^T F (F' = 1 for the ground), and its angle is the angle of the
rotation about a that is nearest to G,

    angle = atan2(a . sum_k e_k x G e_k, tr G - a . G a),

which is exact for a rotation about a, and for any F = c R with a number c.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from ancfdae.assembly.naming import PointVector
from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_direction
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.sensitivity.observables.expression import angle_of
from ancfdae.sensitivity.observables.observable import (
    Columns,
    Leaf,
    LeafGradient,
    Named,
    Observable,
    States,
    known_scene,
    require_index,
)
from ancfdae.sensitivity.observables.points import Turns


def orientation(point: MaterialPoint, direction: Sequence[float], axis: int) -> Observable:
    """Return a component of the unit vector along a direction that is fixed in a body.

    Parameters
    ----------
    point : MaterialPoint
        Point of a rigid body or of a beam, whose directions differ along it when it is bent.
    direction : sequence of float
        The direction in the reference configuration, two or three components; of any length,
        dimensionless.
    axis : int
        Component, 0, 1 and 2 for x, y and z. ``orientation(p, e_j, i)`` is the entry ij of the
        rotation matrix of a rigid body.
    """
    require_direction("orientation, direction", direction)
    return Orientation((point,), tuple(direction), axis)


def rotation_angle(
    point: MaterialPoint,
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    other: MaterialPoint | None = None,
) -> Observable:
    """Return the angle about an axis by which a body has rotated since the reference; rad.

    It starts between -pi and pi and is continuous in time over full turns, provided that the body
    rotates by less than half a turn between neighbouring time points. In the joint of two bodies,
    such as a `Revolute`, it is the angle of the joint.

    Parameters
    ----------
    point : MaterialPoint
        Point of the body; for a beam, of the section whose rotation is observed.
    axis : sequence of float
        The axis in the reference configuration, which is fixed in `other`; in the plane z.
    other : MaterialPoint, optional
        Point of the body relative to which the angle is taken; by default the ground.
    """
    require_direction("rotation_angle, axis", axis, (3,))
    points = (point,) if other is None else (point, other)
    angle = RotationAngle(points, tuple(axis))
    return angle + Turns(angle)


#: Perturbations of component i of slope k of point p, by (p, k, i): in the state and the reference.
Changes: TypeAlias = Mapping[tuple[int, int, int], tuple[complex, complex]]


@dataclass(frozen=True)
class Rotated(Leaf, abc.ABC):
    """A function of the deformation gradients F at some material points."""

    points: tuple[MaterialPoint, ...]

    @property
    @abc.abstractmethod
    def _where(self) -> str:
        """Name of the observable in error messages."""

    @abc.abstractmethod
    def _of(self, F: list[Array]) -> Array:
        """Return the values, (k,), from F of each point, (k, d, d), real or complex."""

    def check_leaf(self, system: Named) -> None:
        """Raise for points that do not exist, and for cables, whose sections have no rotation."""
        naming = known_scene(system).naming
        for point in self.points:
            beams = (beam for beam in naming.layout.beams if beam.name == point.beam)
            if any(beam.element.n_s - 1 < naming.layout.d for beam in beams):
                raise InvalidInputError(
                    f"{self._where}, point",
                    "must belong to a rigid body or a beam whose sections turn",
                    f"a point of the cable {point.beam!r}",
                    "Use slope_angle or slope, which need the tangent alone.",
                )

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the values of the orientation or angle at the states, shape (k,)."""
        return self._value(known_scene(system), states, {})

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return partials by complex steps in the slopes of the states and of the reference."""
        scene, d = known_scene(system), known_scene(system).naming.layout.d
        n_t, n_q = states.q.shape
        q, b = np.zeros((n_t, n_q)), np.zeros((n_t, system.n_b))
        for p, point in enumerate(self.points):
            for k, slope in enumerate(self._slopes(scene, point)):
                reference_b = scene.inputs.in_reference(point, Quantity(k + 1))[1]
                for i in range(d):
                    columns = slope.vectors * d + i
                    by = self._value(scene, states, {(p, k, i): (1j * STEP, 0.0)}).imag / STEP
                    q[:, columns] += by[:, None] * slope.weights
                    b += by[:, None] * (states.q[:, columns] @ slope.weights_b)
                    if np.any(reference_b[i]):
                        change = {(p, k, i): (0.0, 1j * STEP)}
                        by = self._value(scene, states, change).imag / STEP
                        b += by[:, None] * reference_b[i]
        return LeafGradient(q=Columns(slice(None), q), b=b)

    def _value(self, scene: AncfSystem, states: States, changes: Changes) -> Array:
        """Return the observable, (k,), with `changes` of slopes of the state and the reference."""
        d, turned = scene.naming.layout.d, []
        for p, point in enumerate(self.points):
            now = np.stack([slope.of(states.q, d) for slope in self._slopes(scene, point)], axis=1)
            begun = np.array(
                [scene.inputs.in_reference(point, Quantity(k + 1))[0] for k in range(d)]
            )
            if changes:
                now, begun = now.astype(complex), begun.astype(complex)
            for (which, k, i), (by, by_reference) in changes.items():
                if which == p:
                    now[:, k, i] += by
                    begun[k, i] += by_reference
            turned.append(np.swapaxes(np.linalg.inv(begun) @ now, 1, 2))
        return self._of(turned)

    def _slopes(self, scene: AncfSystem, point: MaterialPoint) -> list[PointVector]:
        axes = range(scene.naming.layout.d)
        return [scene.naming.vector(point, Quantity(k + 1)) for k in axes]


@final
@dataclass(frozen=True)
class Orientation(Rotated):
    """A component of the unit vector along a direction that is fixed in a body."""

    direction: tuple[float, ...]
    axis: int

    def __post_init__(self) -> None:
        require_point("orientation, point", self.points[0])
        require_direction("orientation, direction", self.direction)
        require_index("orientation, axis", self.axis)

    @property
    def _where(self) -> str:
        return "orientation"

    def check_leaf(self, system: Named) -> None:
        """Raise unless the scene has the point, the direction and the axis."""
        super().check_leaf(system)
        d = known_scene(system).naming.layout.d
        if len(self.direction) < d or any(self.direction[d:]):
            rule = f"must have {d} components, as the scene has"
            repair = "For example (1, 0), or in space (1, 0, 0)."
            raise InvalidInputError("orientation, direction", rule, self.direction, repair)
        require_index("orientation, axis", self.axis, d)

    def _of(self, F: list[Array]) -> Array:
        carried = F[0] @ np.array(self.direction[: F[0].shape[1]], dtype=float)
        return np.asarray(carried[:, self.axis] / np.sqrt(np.sum(carried**2, axis=1)))


@final
@dataclass(frozen=True)
class RotationAngle(Rotated):
    """Angle about an axis of a point relative to the ground or another point, from -pi to pi."""

    axis: tuple[float, ...]

    def __post_init__(self) -> None:
        for point in self.points:
            require_point("rotation_angle, point", point)
        require_direction("rotation_angle, axis", self.axis, (3,))

    @property
    def _where(self) -> str:
        return "rotation_angle"

    def check_leaf(self, system: Named) -> None:
        """Raise for points that do not exist, and in the plane for axes other than z."""
        super().check_leaf(system)
        if known_scene(system).naming.layout.d == 2 and (self.axis[0] or self.axis[1]):
            rule, repair = "must be along z in the plane", "Leave the axis out."
            raise InvalidInputError("rotation_angle, axis", rule, self.axis, repair)

    def _of(self, F: list[Array]) -> Array:
        in_space = [_in_space(each) for each in F]
        G = in_space[0] if len(F) == 1 else np.swapaxes(in_space[1], 1, 2) @ in_space[0]
        a = np.array(self.axis) / np.linalg.norm(self.axis)
        turn = np.stack([G[:, k - 1, k - 2] - G[:, k - 2, k - 1] for k in range(3)], axis=1)
        return angle_of(turn @ a, np.trace(G, axis1=1, axis2=2) - G @ a @ a)


def _in_space(F: Array) -> Array:
    """Return the deformation gradient F in space, (k, 3, 3), with e_z unchanged if F is planar."""
    if F.shape[1] == 3:
        return F
    whole = np.zeros((len(F), 3, 3), F.dtype)
    whole[:, :2, :2], whole[:, 2, 2] = F, 1.0
    return whole
