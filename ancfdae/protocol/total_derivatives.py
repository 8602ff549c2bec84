"""Total design derivatives of the terms of eq. (1), with a vector held or moving along."""

from __future__ import annotations

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
    system: MechanicalSystem, t: float, q: Array, v: Array, x: Array
) -> tuple[Array, Array | None]:
    """Total derivatives of M a + Phi_q^T lam and Phi_q a - gamma with x = (a, lam) held.

    q and v are a state above its derivatives, as rows; so are the results, (n_b, n_q) and
    (n_b, n_lam), the second None for zero. With Q_total they make the right sides

    M a_b + Phi_q^T lam_b = Q_total - (M a + Phi_q^T lam)_total
    Phi_q a_b             = -(Phi_q a - gamma)_total
    """
    state, q_b, a = q[0], q[1:].T, x[: system.n_q]
    force = inertia_total(system, state, a, q_b)
    if system.constant_constraints:
        return force.T, None
    force = force + constraint_force_total(system, state, x[system.n_q :], t, q_b)
    side = system.constraint_q_times_total(state, a, t, q_b)
    return force.T, (side - system.acceleration_side_total(state, v[0], t, q_b, v[1:].T)).T
