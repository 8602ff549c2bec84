"""Mass matrices that depend on q: the first state of a run at which M has lost its definiteness."""

from __future__ import annotations

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.integrators.recorder import Rows
from ancfdae.numerics.arrays import Array

# Eigenvalue of M, scaled to a diagonal of one, below which M is negative in a direction, over the
# largest one.
_NEGATIVE = -1e-10
# Most entries of matrices that are examined together.
_ENTRIES = 2**20


def indefinite(system: MechanicalSystem, rows: Rows) -> int | None:
    """Return the first row at which M is negative in more directions than at row 0, or None.

    Only directions z that the constraints permit count, Phi_q z = 0: a coordinate without mass may
    be held by a constraint. M cannot lose its definiteness along a motion, because accelerations
    are infinite where it is singular; only a step of finite length passes over that.
    """
    block = max(_ENTRIES // system.n_q**2, 1)
    for k in range(0, len(rows.t) - 1, block):
        found = _first(system, Rows(*(x[k : k + block + 1] for x in rows)))
        if found is not None:
            return k + found
    return None


def _first(system: MechanicalSystem, rows: Rows) -> int | None:
    """Return the result of `indefinite` for rows whose matrices fit into memory together."""
    t, q, _ = rows
    local = system.linearise(t, q, None, 0 * q, np.zeros((len(t), system.n_lam)))
    mass = system.pattern.dense(local.M.real)
    # Scaling by a congruence, which keeps signs: entries have the units of their coordinates.
    scale = np.sqrt(np.abs(np.diagonal(mass, axis1=1, axis2=2)))
    scale = np.where(scale > 0, scale, 1.0)
    proof = mass = mass / scale[:, :, None] / scale[:, None, :]
    held = np.zeros((len(mass), 0, system.n_q))
    if system.n_lam:
        held = system.constraint_pattern.dense(local.Phi_q.real)
        held = held / scale[:, None, :]
        held /= np.maximum(np.linalg.norm(held, axis=2, keepdims=True), np.finfo(float).tiny)
        # If z^T (M + Phi_q^T Phi_q) z > 0 for all z, then z^T M z > 0 where Phi_q z = 0.
        proof = mass + held.swapaxes(1, 2) @ held
    if not np.isfinite(proof).all():
        return None  # The integrator finds values that are not finite.
    try:
        np.linalg.cholesky(proof)
        return None
    except np.linalg.LinAlgError:
        negative = np.array([_negative(*pair) for pair in zip(mass, held, strict=True)])
    more = negative > negative[0]
    return int(np.argmax(more)) if more.any() else None


def _negative(mass: Array, held: Array) -> int:
    """Return the number of directions z with Phi_q z = 0 in which M is negative."""
    free = scipy.linalg.null_space(held) if len(held) else np.eye(len(mass))
    values = np.linalg.eigvalsh(free.T @ mass @ free)
    return int(np.sum(values < _NEGATIVE * np.abs(values).max(initial=0.0)))
