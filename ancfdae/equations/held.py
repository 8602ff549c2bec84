"""Derivatives of M a + Phi_q^T lam with a and lam held, and right sides that they make up."""

import numpy as np

from ancfdae.equations.system import MechanicalSystem
from ancfdae.numerics.arrays import Array, only


def held_q(system: MechanicalSystem, t: float, q: Array, a: Array, lam: Array) -> Array:
    """Values of (M a + Phi_q^T lam)_q on the system's pattern."""
    if system.traits.constant_mass and system.traits.linear_constraints:
        return np.zeros(system.pattern.size)
    return only(system.linearise(np.array([t]), q[None], None, a[None], lam[None]).f_q)


def held_total(
    system: MechanicalSystem, t: float, q: Array, a: Array, lam: Array, q_b: Array
) -> Array:
    """Total derivative of M a + Phi_q^T lam with respect to the design, shape (n_q, n_b)."""
    partials = system.design_partials(np.array([t]), q[None], None, a[None], lam[None])
    total = only(partials.f_b)
    if system.traits.constant_mass and system.traits.linear_constraints:
        return total
    return total + system.pattern.dot(held_q(system, t, q, a, lam), q_b)


def held_pull_back(
    system: MechanicalSystem, t: float, q: Array, a: Array, lam: Array, mu: Array
) -> Array:
    """Return mu^T (M a + Phi_q^T lam)_b, shape (n_b,)."""
    none = np.zeros((1, len(lam)))
    return system.pull_back(np.array([t]), (q[None], None, a[None], lam[None]), (mu[None], none))


def held_totals(
    system: MechanicalSystem, t: float, q: Array, v: Array, x: Array
) -> tuple[Array, Array | None]:
    """Total derivatives of M a + Phi_q^T lam and d^2 Phi/dt^2 with x = (a, lam) held.

    q and v are a state above its derivatives, as rows; so are the results, (n_b, n_q) and
    (n_b, n_lam), the second None for zero. With Q_total they make the right sides

    M a_b + Phi_q^T lam_b = Q_total - (M a + Phi_q^T lam)_total
    Phi_q a_b             = -(d^2 Phi/dt^2)_total
    """
    n_q, q_b = system.n_q, q[1:].T
    force = held_total(system, t, q[0], x[:n_q], x[n_q:], q_b).T
    if system.traits.constant_constraints:
        return force, None
    motion = q[0], v[0], x[:n_q]
    return force, system.constraint_total(t, motion, (q_b, v[1:].T, np.zeros_like(q_b))).T


def force_total(
    system: MechanicalSystem, t: float, q: Array, v: Array, q_b: Array, v_b: Array
) -> Array:
    """Total derivative of Q with respect to the design, shape (n_q, n_b)."""
    rows = (np.concatenate([x[None], x_b.T]) for x, x_b in ((q, q_b), (v, v_b)))
    return system.force_and_total(t, *rows)[1:].T


def velocity_side(system: MechanicalSystem, t: float, q: Array) -> Array:
    """Return nu in Phi_q v = nu, that is -Phi_t, shape (n_lam,)."""
    return -system.constraint(t, q, np.zeros_like(q))


def acceleration_side(system: MechanicalSystem, t: float, q: Array, v: Array) -> Array:
    """Return gamma in Phi_q a = gamma: -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt."""
    return -system.constraint(t, q, v, np.zeros_like(q))


def jerk_side(system: MechanicalSystem, t: float, q: Array, v: Array, a: Array) -> Array:
    """Return S in Phi_q q''' = S."""
    return -system.constraint(t, q, v, a, np.zeros_like(q))
