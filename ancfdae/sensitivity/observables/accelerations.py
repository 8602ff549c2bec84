"""The acceleration of a material point, which the equations of motion give in every state.

    M a = Q(t, q, v) - Phi_q^T lam    (eq. 1)

makes a component w^T a of the acceleration a function of the state, z^T (Q - Phi_q^T lam) with
M z = w. Along any change of state and design, f = M a + Phi_q^T lam - Q stays zero: its derivative
is w_b^T a - z^T (f_q dq + f_v dv + Phi_q^T dlam + f_b), a held in f.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Columns, Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import Named, States, known_scene, require_index


def acceleration(point: MaterialPoint, axis: int) -> Observable:
    """Return a component of the acceleration of a point; m/s^2.

    Axes 0, 1 and 2 are x, y and z. It follows from positions, velocities and multipliers by the
    equations of motion, and is relative to the frame where the scene turns with one.
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
        """Refuse a point or an axis that does not exist, or a solution without its system."""
        naming = known_scene(system).naming
        require_index("acceleration, axis", self.axis, naming.layout.d)
        naming.vector(self.point, Quantity.POSITION)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return z^T (Q - Phi_q^T lam), shape (k,)."""
        scene = known_scene(system)
        return _applied_forces(scene, states) @ self._solved(scene)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return -z^T f_q, -z^T f_v, -z^T Phi_q^T and w_b^T a - z^T f_b."""
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
        """Return z with M z = w, the weights of the component, shape (n_q,)."""
        vector, d = scene.naming.vector(self.point, Quantity.POSITION), scene.naming.layout.d
        w = np.zeros(scene.n_q, dtype=vector.weights.dtype)
        w[vector.vectors * d + self.axis] = vector.weights
        return np.asarray(_mass_factors(scene).solve(w))


def _mass_factors(scene: AncfSystem) -> scipy.sparse.linalg.SuperLU:
    """Factorise the mass, the same in all states of a scene."""
    return scipy.sparse.linalg.splu(scene.pattern.csr(scene.mass(scene.start()[0])).tocsc())


def _applied_forces(scene: AncfSystem, states: States) -> Array:
    """Return Q - Phi_q^T lam in k states, shape (k, n_q)."""
    pattern, rows = scene.constraint_pattern, scene.constraints_q(states.t, states.q)
    Q = [scene.force(*state) for state in zip(states.t.tolist(), states.q, states.v, strict=True)]
    held = [pattern.dot_transposed(Phi_q, lam) for Phi_q, lam in zip(rows, states.lam, strict=True)]
    return np.array(Q) - np.array(held)
