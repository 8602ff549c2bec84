"""Sizes of the unknowns, so that error control is free of units.

Coordinates are compared in the weighted form sqrt(w_i) q_i, which has one unit for all of them.
The scale of q is the root mean square of the start in that form; that of v is the speed that the
start has or that its accelerations reach over that length; that of the multipliers follows from
the forces at the start through the rows of Phi_q.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators.start import InitialState
from ancfdae.numerics.arrays import Array, real_norm
from ancfdae.protocol import MechanicalSystem


@final
@dataclass(frozen=True)
class Scales:
    """Positive sizes of q, v, forces and design variables, one per unknown.

    `row` is the length of the rows of Phi_q in the norm of the inverse weights; position, speed and
    load are the common sizes of sqrt(w) q, sqrt(w) v and Q / sqrt(w).
    """

    q: Array
    v: Array
    force: Array
    row: Array
    position: float
    speed: float
    load: float
    b: Array

    @property
    def lam(self) -> Array:
        """Size of the multipliers."""
        return self.load / self.row

    @property
    def eta(self) -> Array:
        """Size of the multipliers that keep positions on the constraints (GGL)."""
        return self.speed / self.row

    @staticmethod
    def of(system: MechanicalSystem, initial: InitialState, t_end: float) -> Scales:
        """Return the sizes for a run from the given start to `t_end`."""
        t, q = initial.t, initial.q
        root, count = np.sqrt(system.weights), np.sqrt(system.n_q)
        reaction = system.constraint_force(q, initial.lam, t)
        Q = system.force(q, initial.v, t)
        inverse = 1 / system.weights
        load = max(real_norm(x, inverse) for x in (Q, reaction)) / count
        load = max(load, real_norm(initial.a, system.weights) / count)
        v_0 = real_norm(initial.v, system.weights) / count
        position = real_norm(q, system.weights) / count
        position = position or v_0 * t_end or load * t_end**2 or 1.0
        speed = max(v_0, min(load * t_end, np.sqrt(position * load))) or position / t_end
        load = load or speed / t_end
        pattern = system.constraint_pattern
        squared = system.constraint_q(q, t).real ** 2 * inverse[pattern.columns]
        row = np.sqrt(np.bincount(pattern.rows, squared, minlength=system.n_lam))
        return Scales(
            q=position / root,
            v=speed / root,
            force=load * root,
            row=row,
            position=position,
            speed=speed,
            load=load,
            b=np.where(system.b.real == 0, 1.0, np.abs(system.b.real)),
        )
