"""Single terms of the equations of a system, out of what the contract gives together.

A term with its arguments, time first; a `_total` takes the derivatives of the states behind them.
"""

import numpy as np

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations.held import (
    acceleration_side,
    force_total,
    held_pull_back,
    held_q,
    jerk_side,
    velocity_side,
)
from ancfdae.equations.motion import StateDirection
from ancfdae.equations.system import constraint_q_along, reaction

__all__ = [
    "acceleration_side",
    "acceleration_side_total",
    "constraint_b",
    "constraint_force",
    "constraint_force_b",
    "constraint_force_q",
    "constraint_force_rate",
    "constraint_force_rate_total",
    "constraint_q_times_total",
    "force_b",
    "force_q",
    "force_q_times",
    "force_rate",
    "force_rate_total",
    "force_total",
    "force_v",
    "held_pull_back",
    "inertia_q",
    "jerk_side",
    "jerk_side_total",
    "mass_b_times",
    "velocity_side",
    "velocity_side_total",
]

constraint_force = reaction


def _none(system):
    return np.zeros(system.n_q), np.zeros(system.n_lam)


def _linearised(system, t, q, v, a, lam):
    v = None if v is None else v[None]
    return system.linearise(np.array([t]), q[None], v, a[None], lam[None])


def _by_design(system, t, q, v, a, lam):
    v = None if v is None else v[None]
    return system.design_partials(np.array([t]), q[None], v, a[None], lam[None]).f_b[0]


def force_q(system, t, q, v):
    """Q_q on the pattern."""
    return -_linearised(system, t, q, v, *_none(system)).f_q[0]


def force_v(system, t, q, v):
    """Q_v on the pattern."""
    f_v = _linearised(system, t, q, v, *_none(system)).f_v
    return np.zeros(system.pattern.size) if f_v is None else -f_v[0]


def force_b(system, t, q, v):
    """Q_b."""
    return -_by_design(system, t, q, v, *_none(system))


def mass_b_times(system, q, a):
    """(M a)_b."""
    return _by_design(system, 0.0, q, None, a, _none(system)[1])


def inertia_q(system, q, a):
    """(M a)_q on the pattern."""
    return held_q(system, 0.0, q, a, _none(system)[1])


def constraint_b(system, t, q):
    """Phi_b."""
    return system.constraint_total(t, (q,))


def constraint_force_q(system, t, q, lam):
    """(Phi_q^T lam)_q on the pattern."""
    return held_q(system, t, q, _none(system)[0], lam)


def constraint_force_b(system, t, q, lam):
    """(Phi_q^T lam)_b."""
    return _by_design(system, t, q, None, _none(system)[0], lam)


def velocity_side_total(system, t, q, q_b):
    """Total derivative of -Phi_t."""
    return -system.constraint_total(t, (q, 0 * q), (q_b, 0 * q_b))


def acceleration_side_total(system, t, q, v, q_b, v_b):
    """Total derivative of the right side of Phi_q a."""
    return -system.constraint_total(t, (q, v, 0 * q), (q_b, v_b, 0 * q_b))


def jerk_side_total(system, t, q, v, a, q_b, v_b, a_b):
    """Total derivative of the right side of Phi_q q'''."""
    return -system.constraint_total(t, (q, v, a, 0 * q), (q_b, v_b, a_b, 0 * q_b))


def constraint_q_times_total(system, t, q, x, q_b):
    """Total derivative of Phi_q x with x held."""
    rate = system.constraint_total(t, (q, x), (q_b, 0 * q_b))
    return rate + velocity_side_total(system, t, q, q_b)


def force_rate(system, t, q, v, a):
    """dQ/dt along the motion."""
    return system.force_along(t, q, v, StateDirection(1.0, v, a))


def force_q_times(system, t, q, x):
    """Q_q x at rest."""
    return system.force_along(t, q, 0 * q, StateDirection(0.0, x, 0 * q))


def force_rate_total(system, t, q, v, a, q_b, v_b, a_b):
    """Total derivative of dQ/dt."""
    return -_rate_total(system, t, (q, v, a), _none(system)[1], (q_b, v_b, a_b), None)


def constraint_force_rate(system, t, q, v, lam):
    """(dPhi_q^T/dt) lam."""
    rate = constraint_q_along(system, t, q, StateDirection(1.0, v, 0 * v))
    return system.constraint_pattern.dot_transposed(rate, lam)


def constraint_force_rate_total(system, t, q, v, lam, q_b, v_b, lam_b):
    """Total derivative of (dPhi_q^T/dt) lam, as what it adds to that of f'."""
    if isinstance(system, AncfSystem):  # Without the round-off of the elastic forces.
        states, states_b = (q, v, lam), (q_b, v_b, lam_b)
        return system._constraints.force_along_total(t, states, states_b, 1.0)
    states, states_b = (q, v, 0 * q), (q_b, v_b, 0 * q_b)
    whole = _rate_total(system, t, states, lam, states_b, lam_b)
    return whole - _rate_total(system, t, states, 0 * lam, states_b, None)


def _rate_total(system, t, states, lam, states_b, lam_b):
    """Total derivative of f' without the rate of M."""
    (q, v, a), (q_b, v_b, a_b) = states, states_b
    lam_b = np.zeros((system.n_lam, system.n_b)) if lam_b is None else lam_b
    at, at_b = (q, v, 0 * q, lam), (q_b, v_b, 0 * q_b, lam_b)
    return system.along_total(t, at, StateDirection(1.0, v, a), at_b, (v_b, a_b))
