"""Observables of material points: positions, slopes, their rates, accelerations, rotation.

**The acceleration** of a point follows from the equations of motion in every state:

    M a = Q(t, q, v) - Phi_q^T lam    (eq. 1)

makes a component w^T a of the acceleration a function of the state, z^T (Q - Phi_q^T lam) with M z
= w. Along any change of state and design, f = M a + Phi_q^T lam - Q stays zero: its derivative is
w_b^T a - z^T (f_q dq + f_v dv + Phi_q^T dlam + f_b), a held in f.

**The angular velocity** of a body at a point. The slopes r_k are the columns of F, the rotation and
deformation of the body. F' F^-1 is the velocity gradient; its skew part rotates a neighbourhood of
the point at

    omega = 1/2 sum_k g_k x r_k',    g_k . r_l = delta_kl,

half the vorticity, which is the angular velocity of a rigid body. It does not depend on the lengths
and angles of the slopes in the reference. A cable has only the slope along it: omega is the
angular velocity of its tangent, r_x x r_x' / |r_x|^2, without the spin about it.

**Sliding joints** have the distance that the guide has slid along its beam, and its rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import scipy

from ancfdae.assembly.naming import PointVector, SceneNaming
from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_text
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.sensitivity.observables.expression import analytic
from ancfdae.sensitivity.observables.observable import (
    Columns,
    Leaf,
    LeafGradient,
    Named,
    Observable,
    States,
    known_naming,
    known_scene,
    require_index,
)


def position(point: MaterialPoint, axis: int) -> Observable:
    """Return a component of the position of a point such as ``beam.at_end``; m.

    Axes 0, 1 and 2 are x, y and z.
    """
    return VectorComponent(point, Quantity.POSITION, axis)


def velocity(point: MaterialPoint, axis: int) -> Observable:
    """Return a component of the velocity of a point; m/s. Axes 0, 1 and 2 are x, y and z."""
    return VectorComponent(point, Quantity.POSITION, axis, rate=True)


def slope(point: MaterialPoint, along: int, axis: int) -> Observable:
    """Return a component of a slope vector dr/dx, dr/dy or dr/dz of a point; dimensionless.

    `along` is 0 for the tangent, 1 and 2 for the slopes along the section's height and width; axes
    0, 1 and 2 are x, y and z.
    """
    require_index("slope, along", along)
    return VectorComponent(point, Quantity(along + 1), axis)


def deflection(point: MaterialPoint, frame_at: MaterialPoint) -> Observable:
    """Return the deflection of a point in a frame that moves with the centre line; m.

    The frame sits at `frame_at` with its first axis along the x-y part of the tangent there;
    the deflection is the component of point - frame_at along its second axis, which is the
    first one turned by +90 degrees about z. In space the z components play no part.
    """
    t_x, t_y = slope(frame_at, 0, 0), slope(frame_at, 0, 1)
    arm_x, arm_y = (position(point, i) - position(frame_at, i) for i in (0, 1))
    return (t_x * arm_y - t_y * arm_x) / (t_x * t_x + t_y * t_y) ** 0.5


def slope_angle(point: MaterialPoint) -> Observable:
    """Return the angle of the tangent in the x-y plane, from x towards y; rad.

    It starts between -pi and pi and is continuous in time over full turns, provided that the
    tangent rotates by less than half a turn between neighbouring time points.
    """
    t_x, t_y = slope(point, 0, 0), slope(point, 0, 1)
    angle = t_y.combined(analytic(np.arctan2), (t_y, t_x))
    return angle + Turns(angle)


def axial_strain(point: MaterialPoint) -> Observable:
    """Return the Green-Lagrange strain along the beam, (r_x . r_x / |r_ox|^2 - 1)/2; dimensionless.

    r_ox is the slope in the reference configuration; off the centre line of curved and twisted
    beams, and between their nodes, it is not of unit length.
    """
    x, y, z = (VectorComponent(point, Quantity.SLOPE_X, i, may_lack=True) for i in range(3))
    return 0.5 * ((x * x + y * y + z * z) / ReferenceSquare(point) - 1.0)


@final
@dataclass(frozen=True)
class Turns(Leaf):
    """Full turns since the start of the run of an angle that lies between -pi and pi; rad."""

    remembers: ClassVar[bool] = True

    angle: Observable

    def check_leaf(self, system: Named) -> None:
        """Raise if the system lacks the angle that is counted."""
        self.angle.check(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return full turns, (k,), rad: one more or less where the angle jumps by half a turn."""
        angle = self.angle.value(system, states).real
        turns = 2 * np.pi * np.round((np.unwrap(angle) - angle) / (2 * np.pi))
        return np.asarray(turns + states.past.get(self, 0.0))

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return no partials: the number of turns is piecewise constant."""
        return LeafGradient()


@final
@dataclass(frozen=True)
class ReferenceSquare(Leaf):
    """Squared length of the slope r_ox along a beam in the reference configuration."""

    point: MaterialPoint

    def check_leaf(self, system: Named) -> None:
        """Raise InvalidInputError unless `system` is an assembled scene."""
        known_scene(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the squared reference slope |r_ox|^2 at every time point, shape (k,)."""
        r_ox, _ = known_scene(system).inputs.in_reference(self.point, Quantity.SLOPE_X)
        return np.full(len(states.t), np.sum(r_ox * r_ox))

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partials of |r_ox|^2 in the design variables, 2 r_ox . r_oxb."""
        r_ox, r_oxb = known_scene(system).inputs.in_reference(self.point, Quantity.SLOPE_X)
        return LeafGradient(b=np.tile(2 * r_ox @ r_oxb, (len(states.t), 1)))


@final
@dataclass(frozen=True)
class VectorComponent(Leaf):
    """A component of a position or slope vector, or of its time derivative if `rate`.

    If it `may_lack`, components that do not exist in the plane are zero.
    """

    point: MaterialPoint
    quantity: Quantity
    axis: int
    rate: bool = False
    may_lack: bool = False

    def __post_init__(self) -> None:
        require_point("observable, point", self.point)
        require_index("observable, axis", self.axis)

    def check_leaf(self, system: Named) -> None:
        """Raise unless the scene has the point, the slope and the axis."""
        naming = known_naming(system)
        naming.layout.body(self.point.beam)
        if not self.may_lack:
            require_index("observable, axis", self.axis, naming.layout.d)
        if self.quantity is not Quantity.POSITION:
            require_index("slope, along", int(self.quantity) - 1, naming.layout.d)
        naming.vector(self.point, self.quantity)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the component, weights times coordinates or velocities, shape (k,)."""
        _, x, weights, _ = self._combination(system, states)
        return np.asarray(x @ weights)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the weights, and their design derivatives times coordinates or velocities."""
        columns, x, weights, weights_b = self._combination(system, states)
        rows, b = Columns(columns, weights[None]), x @ weights_b if np.any(weights_b) else None
        return LeafGradient(v=rows, b=b) if self.rate else LeafGradient(q=rows, b=b)

    def _combination(self, system: Named, states: States) -> tuple[Array, Array, Array, Array]:
        """Return columns of nonzero weight, the states there, weights and their derivatives."""
        naming = known_naming(system)
        vector = naming.vector(self.point, self.quantity)
        # A weight is a power of the length times a number, and vanishes with its derivative.
        used = (vector.weights != 0) & (self.axis < naming.layout.d)
        columns = vector.vectors[used] * naming.layout.d + self.axis
        x = (states.v if self.rate else states.q)[:, columns]
        return columns, x, vector.weights[used], vector.weights_b[used]


# -- accelerations -----------------------------------------------------------------------------


def acceleration(point: MaterialPoint, axis: int) -> Observable:
    """Return a component of the acceleration of a point; m/s^2.

    Axes 0, 1 and 2 are x, y and z. It follows from positions, velocities and multipliers by the
    equations of motion. In a scene with a rotating frame it is relative to that frame.
    """
    return Acceleration(point, axis)


@final
@dataclass(frozen=True)
class Acceleration(Leaf):
    """A component of the acceleration of a material point."""

    point: MaterialPoint
    axis: int

    def __post_init__(self) -> None:
        require_point("acceleration, point", self.point)
        require_index("acceleration, axis", self.axis)

    def check_leaf(self, system: Named) -> None:
        """Raise unless `system` is an assembled scene that has the point and the axis."""
        naming = known_scene(system).naming
        require_index("acceleration, axis", self.axis, naming.layout.d)
        naming.vector(self.point, Quantity.POSITION)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the acceleration z^T (Q - Phi_q^T lam), M z = w, shape (k,); m/s^2."""
        scene = known_scene(system)
        return _applied_forces(scene, states) @ self._solved(scene)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return partials -z^T f_q, -z^T f_v, -z^T Phi_q^T and w_b^T a - z^T f_b."""
        scene = known_scene(system)
        z, columns = self._solved(scene), slice(None)
        forces = _applied_forces(scene, states)
        a = np.ascontiguousarray(_mass_factors(scene).solve(forces.T).T)
        pattern, n_t = scene.pattern, len(states.t)
        local = scene.linearise(states.t, states.q, states.v, a, states.lam)
        q = -np.array([pattern.dot_transposed(f_q, z) for f_q in local.f_q])
        v = local.f_v
        v = None if v is None else -np.array([pattern.dot_transposed(f_v, z) for f_v in v])
        lam = -np.array([scene.constraint_pattern.dot(Phi_q, z) for Phi_q in local.Phi_q])
        vector, d = scene.naming.vector(self.point, Quantity.POSITION), scene.naming.layout.d
        b = a[:, vector.vectors * d + self.axis] @ vector.weights_b
        f_b = scene.design_partials(states.t, states.q, states.v, a, states.lam).f_b
        b -= np.einsum("n,knb->kb", z, f_b)
        return LeafGradient(
            q=Columns(columns, q),
            v=None if v is None else Columns(columns, v),
            lam=Columns(columns, lam.reshape(n_t, scene.n_lam)),
            b=b,
        )

    def _solved(self, scene: AncfSystem) -> Array:
        """Return z with M z = w, w the weights of the component, shape (n_q,)."""
        vector, d = scene.naming.vector(self.point, Quantity.POSITION), scene.naming.layout.d
        w = np.zeros(scene.n_q, dtype=vector.weights.dtype)
        w[vector.vectors * d + self.axis] = vector.weights
        return np.asarray(_mass_factors(scene).solve(w))


def _mass_factors(scene: AncfSystem) -> scipy.sparse.linalg.SuperLU:
    """Return the factors of the mass matrix, which is the same in all states of a scene."""
    return scipy.sparse.linalg.splu(scene.pattern.csr(scene.mass(scene.start()[0])).tocsc())


def _applied_forces(scene: AncfSystem, states: States) -> Array:
    """Return Q - Phi_q^T lam in k states, shape (k, n_q)."""
    pattern, rows = scene.constraint_pattern, scene.constraints_q(states.t, states.q)
    Q = [scene.force(*state) for state in zip(states.t.tolist(), states.q, states.v, strict=True)]
    held = [pattern.dot_transposed(Phi_q, lam) for Phi_q, lam in zip(rows, states.lam, strict=True)]
    return np.array(Q) - np.array(held)


# -- angular velocity --------------------------------------------------------------------------


def angular_velocity(point: MaterialPoint, axis: int = 2) -> Observable:
    """Return a component of the angular velocity of a body at a point; rad/s.

    Axes 0, 1 and 2 are x, y and z; a planar scene has 2 alone. In a beam it is the mean rate of
    rotation of all directions of the material, in a cable the rate of its tangent.
    """
    return AngularVelocity(point, axis)


@final
@dataclass(frozen=True)
class AngularVelocity(Leaf):
    """A component of the angular velocity of a body at a material point."""

    point: MaterialPoint
    axis: int

    def __post_init__(self) -> None:
        require_point("angular_velocity, point", self.point)
        require_index("angular_velocity, axis", self.axis)

    def check_leaf(self, system: Named) -> None:
        """Raise for a point that does not exist, and in the plane for axes other than z."""
        naming = known_naming(system)
        if naming.layout.d == 2 and self.axis != 2:
            raise InvalidInputError(
                "angular_velocity, axis",
                "must be 2, the z axis, in the plane",
                self.axis,
                "Leave the axis out: it is 2 by default.",
            )
        self._slopes(naming)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return component `axis` of the angular velocity omega, shape (k,); rad/s."""
        naming = known_naming(system)
        slopes, d = self._slopes(naming), naming.layout.d
        F, rates = (_stacked(slopes, x, d) for x in (states.q, states.v))
        return _spin(F, rates)[:, self.axis]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return partials by complex steps in the slopes and in their rates."""
        naming = known_naming(system)
        slopes, d = self._slopes(naming), naming.layout.d
        F, rates = (_stacked(slopes, x, d) for x in (states.q, states.v))
        n_t, n_q = states.q.shape
        q, v, b = np.zeros((n_t, n_q)), np.zeros((n_t, n_q)), np.zeros((n_t, system.n_b))
        for k, slope in enumerate(slopes):
            for i in range(d):
                step = np.zeros((len(slopes), d))
                step[k, i] = STEP
                columns = slope.vectors * d + i
                by_F = _spin(F + 1j * step, rates)[:, self.axis].imag / STEP
                by_rate = _spin(F, rates + 1j * step)[:, self.axis].imag / STEP
                for rows, x, by in ((q, states.q, by_F), (v, states.v, by_rate)):
                    rows[:, columns] += by[:, None] * slope.weights
                    b += by[:, None] * (x[:, columns] @ slope.weights_b)
        everywhere = slice(None)
        return LeafGradient(q=Columns(everywhere, q), v=Columns(everywhere, v), b=b)

    def _slopes(self, naming: SceneNaming) -> list[PointVector]:
        """Return the directions of a rigid body, or the slopes that a beam has at the point."""
        body, axes = naming.layout.body(self.point.beam), range(naming.layout.d)
        beam = next((x for x in naming.layout.beams if x.name == body.name), None)
        if beam is None or beam.rigid is not None:
            return [naming.direction(body.name, k + 1) for k in axes]
        return [naming.vector(self.point, Quantity(k + 1)) for k in axes[: beam.element.n_s - 1]]


def _stacked(slopes: list[PointVector], states: Array, d: int) -> Array:
    """Return n slopes, or their rates, at k states, shape (k, n, d)."""
    return np.stack([slope.of(states, d) for slope in slopes], axis=1)


def _spin(F: Array, rates: Array) -> Array:
    """Return omega, (k, 3), rad/s, from slopes r_k and their rates, (k, n, d) each.

    In the plane e_z is the third slope.
    """
    plane = ((0, 0), (0, 0), (0, 3 - F.shape[2]))
    F, rates = np.pad(F, plane), np.pad(rates, plane)
    if F.shape[1] == 1:
        tangent = F[:, 0]
        return np.cross(tangent, rates[:, 0]) / np.sum(tangent**2, axis=1)[:, None]
    if F.shape[1] == 2:
        e_z = np.broadcast_to([[[0.0, 0.0, 1.0]]], (len(F), 1, 3))
        F, rates = np.concatenate([F, e_z], axis=1), np.concatenate([rates, 0 * e_z], axis=1)
    volume = np.sum(F[:, 0] * np.cross(F[:, 1], F[:, 2]), axis=1)
    turning = sum(np.cross(np.cross(F[:, k - 2], F[:, k - 1]), rates[:, k]) for k in range(3))
    return np.asarray(turning / (2 * volume[:, None]))


def slide_distance(joint: str) -> Observable:
    """Return how far the guide of a `SlidingJoint` has slid along its beam since t = 0; m.

    The distance is measured along the beam in the reference configuration.
    """
    return _Slide(joint, rate=False)


def slide_speed(joint: str) -> Observable:
    """Return the rate at which the guide of a `SlidingJoint` slides along its beam; m/s."""
    return _Slide(joint, rate=True)


@final
@dataclass(frozen=True)
class _Slide(Leaf):
    """The distance that a sliding joint has moved along its beam, or its rate."""

    joint: str
    rate: bool

    def __post_init__(self) -> None:
        require_text("slide_speed, joint" if self.rate else "slide_distance, joint", self.joint)

    def check_leaf(self, system: Named) -> None:
        """Raise UnknownNameError unless the scene has a sliding joint of this name."""
        self._column(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the distance, m, or speed, m/s, of the guide at the states, shape (k,)."""
        return (states.v if self.rate else states.q)[:, self._column(system)]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partial one in the column of the slide coordinate, or of its rate."""
        one = Columns(np.array([self._column(system)]), np.ones((1, 1)))
        return LeafGradient(v=one) if self.rate else LeafGradient(q=one)

    def _column(self, system: Named) -> int:
        layout = known_naming(system).layout
        return layout.d * layout.slider(self.joint).first_vector
