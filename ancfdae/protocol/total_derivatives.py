"""Total design derivatives of the terms of eq. (1), with a vector held or moving along."""

from __future__ import annotations

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.protocol import MechanicalSystem


def inertia_total(system: MechanicalSystem, q: Array, a: Array, q_b: Array) -> Array:
    """Total design derivative of M a with a held, shape (n_q, n_b)."""
    total = system.mass_b_times(q, a)
    if system.constant_mass:
        return total
    return total + system.pattern.dot(system.inertia_q(q, a), q_b)


def constraint_force_total(
    system: MechanicalSystem, q: Array, lam: Array, t: float, q_b: Array
) -> Array:
    """Total design derivative of Phi_q^T lam with lam held, shape (n_q, n_b)."""
    total = system.constraint_force_b(q, lam, t)
    if system.linear_constraints:
        return total
    return total + system.pattern.dot(system.constraint_force_q(q, lam, t), q_b)


def held_totals(
    system: MechanicalSystem,
    t: float,
    state: tuple[Array, Array, Array, Array],
    q_b: Array,
    v_b: Array,
) -> tuple[Array, Array | None]:
    """Total derivatives of M a + Phi_q^T lam and Phi_q a - gamma with a and lam held.

    Shapes (n_q, n_b) and (n_lam, n_b); the second is None for zero. The state is (q, v, a, lam).
    """
    q, v, a, lam = state
    force = inertia_total(system, q, a, q_b)
    if system.constant_constraints:
        return force, None
    force = force + constraint_force_total(system, q, lam, t, q_b)
    side = system.constraint_q_times_total(q, a, t, q_b)
    return force, side - system.acceleration_side_total(q, v, t, q_b, v_b)


def acceleration_totals(
    system: MechanicalSystem,
    t: float,
    state: tuple[Array, Array, Array, Array],
    q_b: Array,
    v_b: Array,
) -> tuple[Array, Array]:
    """Right sides of the saddle-point system for a_b and lam_b, (n_q, n_b) and (n_lam, n_b).

    M a_b + Phi_q^T lam_b = Q_total - (M a + Phi_q^T lam)_total
    Phi_q a_b             = -(Phi_q a - gamma)_total,     a and lam held in the totals.
    """
    force, side = held_totals(system, t, state, q_b, v_b)
    total = system.force_total(state[0], state[1], t, q_b, v_b) - force
    return total, np.zeros((system.n_lam, system.n_b)) if side is None else -side
