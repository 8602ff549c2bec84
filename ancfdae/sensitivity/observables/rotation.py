"""The angular velocity of a body at a material point.

The slopes r_k are the columns of F, by which a body turns and deforms. F' F^-1 is the gradient of
velocities; its skew part turns a neighbourhood of the point by

    omega = 1/2 sum_k g_k x r_k',    g_k . r_l = delta_kl,

half the vorticity, which is the angular velocity of a rigid body. It does not depend on how long
and how oblique the slopes are in the reference. A cable has only the slope along it: omega is the
angular velocity of its tangent, r_x x r_x' / |r_x|^2, without the spin about it.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.naming import PointVector, SceneNaming
from ancfdae.equations import MechanicalSystem
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.sensitivity.observables.observable import Columns, Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import Named, States, known_naming, require_index


def angular_velocity(point: MaterialPoint, axis: int = 2) -> Observable:
    """Return a component of the angular velocity of a body at a point; rad/s.

    Axes 0, 1 and 2 are x, y and z; a scene in the plane has 2 alone. In a beam the material turns
    at this rate in the mean of all directions, and in a cable the tangent does.
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
        """Refuse a point that does not exist, and axes other than z in the plane."""
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
        """Return a component of omega, shape (k,)."""
        naming = known_naming(system)
        slopes, d = self._slopes(naming), naming.layout.d
        F, rates = (_stacked(slopes, x, d) for x in (states.q, states.v))
        return _spin(F, rates)[:, self.axis]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Differentiate in every component of the slopes and of their rates."""
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
        """Return the directions of something rigid, or the slopes that a beam has at the point."""
        body, axes = naming.layout.body(self.point.beam), range(naming.layout.d)
        beam = next((x for x in naming.layout.beams if x.name == body.name), None)
        if beam is None or beam.rigid is not None:
            return [naming.direction(body.name, k + 1) for k in axes]
        return [naming.vector(self.point, Quantity(k + 1)) for k in axes[: beam.element.n_s - 1]]


def _stacked(slopes: list[PointVector], states: Array, d: int) -> Array:
    """Return the slopes, or their rates, in k states, shape (k, n, d)."""
    return np.stack([slope.of(states, d) for slope in slopes], axis=1)


def _spin(F: Array, rates: Array) -> Array:
    """Return omega from slopes r_k and their rates, (k, n, d) each; shape (k, 3).

    The plane adds a third slope, e_z.
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
