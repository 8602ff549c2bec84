"""Rigid bodies that the steps of a run turn otherwise than their angular velocities say.

Steps alias rotations as samples alias waves: a body that turns by a radian or more in a step may
turn backwards or stop, while its directions stay orthogonal. A step that follows a rotation turns
the body by the integral of its angular velocity omega,

    h (omega_0 + omega_1)/2 + h^2 (omega_0' - omega_1')/12,

to the fifth order in h.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations.solution import Solution
from ancfdae.numerics.arrays import Array

# Largest difference of the turn in a step from the integral of the angular velocity, and of all
# turns of a run about their axes, rad.
_STEP, _RUN = 0.5, 0.5
# Rates of directions, rad per step, below which a body is not looked at.
_SLOW = 0.05


def turned_apart(system: AncfSystem, run: Solution) -> tuple[str, float] | None:
    """Return the name of a rigid body whose turns differ from its angular velocity, and a turn.

    The turn is the largest one in a step by its angular velocity, rad. The result is None if all
    bodies agree. Turns of a whole run do not count where joints move by laws: a driven body may
    have right positions and wrong velocities.
    """
    d, ends = system.naming.layout.d, slice(None, None, run.degree)
    h, free = np.diff(run.t[ends])[:, None], system.scleronomic
    for body in system.naming.layout.bodies:
        if body.count > body.stride:
            continue  # A beam that bends.
        columns = slice(d * (body.first_vector + 1), d * (body.first_vector + body.count))
        if np.abs(run.v[:, columns]).max() * h.max() < _SLOW:
            continue
        D, V, A = (x.real[ends, columns].reshape(-1, d, d) for x in (run.q, run.v, run.a))
        spin, rise = (_axial(D, x) for x in (V, A))
        turns = h * (spin[:-1] + spin[1:]) / 2 + h**2 * (rise[:-1] - rise[1:]) / 12
        sizes = np.linalg.norm(turns, axis=1)
        moved = np.tile(np.eye(3), (len(h), 1, 1))
        moved[:, :d, :d] = np.swapaxes(D[1:], 1, 2) @ D[:-1]
        gaps = (Rotation.from_rotvec(-turns) * Rotation.from_matrix(moved)).as_rotvec()
        along = np.sum(gaps * turns, axis=1) / np.where(sizes > 0, sizes, 1.0)
        if np.linalg.norm(gaps, axis=1).max() > _STEP or (free and abs(along.sum()) > _RUN):
            return body.name, float(sizes.max())
    return None


def _axial(D: Array, rates: Array) -> Array:
    """Return half the sum of d_k x r_k of directions d_k, (n, d, d), and vectors r_k, (n, 3).

    It is omega if r_k are the rates of the directions.
    """
    S = np.swapaxes(D, 1, 2) @ rates
    crossed = np.zeros((len(S), 3))
    for axis in range(3) if D.shape[2] == 3 else (2,):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        crossed[:, axis] = S[:, i, j] - S[:, j, i]
    return crossed / 2
