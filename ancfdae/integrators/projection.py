"""Nearest state on the constraints, for integrators whose positions or velocities drift.

In the norm of M at the state itself,

    M dq + Phi_q^T sigma = 0,   Phi_q dq = -Phi,
    M dv + Phi_q^T sigma = 0,   Phi_q dv = nu - Phi_q v,

one Newton step: the drift of one integration step is small, and its square is round-off. The
matrix is that at the state before, the right side of the second line is at the moved q. The
design derivatives of the state are moved onto the derivatives of the constraints in the same way.
"""

from __future__ import annotations

import numpy as np

from ancfdae.integrators.accelerations import Accelerations
from ancfdae.integrators.point import Point
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization
from ancfdae.system import MechanicalSystem


def project(
    system: MechanicalSystem, accelerations: Accelerations, t: float, point: Point
) -> Point:
    """Return the state moved onto the constraints.

    Raises
    ------
    SingularMatrix
    """
    factors = accelerations.factors(t, point.q)
    q = point.q - _nearest(factors, system.n_q, system.constraint(point.q, t))
    B, pattern = system.constraint_q(q, t), system.constraint_pattern
    v = point.v - _nearest(
        factors, system.n_q, pattern.dot(B, point.v) - system.velocity_side(q, t)
    )
    if point.q_b is None or point.v_b is None:
        return Point(q, v)
    defect = pattern.dot(B, point.q_b) + system.constraint_b(q, t)
    q_b = point.q_b - _nearest(factors, system.n_q, defect)
    defect = system.constraint_q_times_total(q, v, t, q_b) + pattern.dot(B, point.v_b)
    defect = defect - system.velocity_side_total(q, t, q_b)
    return Point(q, v, q_b, point.v_b - _nearest(factors, system.n_q, defect))


def _nearest(factors: Factorization, n_q: int, defect: Array) -> Array:
    """Smallest change x with Phi_q x = defect; also for columns."""
    zero = np.zeros((n_q, *defect.shape[1:]))
    return factors.solve(np.concatenate([zero, defect]))[:n_q]
