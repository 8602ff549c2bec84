"""Design derivatives of K x, D x and M x with x held, along those of the configuration.

With v = 0, (Phi_q^T lam)_q x is the rate of Phi_q^T lam along velocities x, lam held, and Q_v x
that of Q along accelerations x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.modes.linearised import Linearised, split
from ancfdae.numerics.arrays import Array
from ancfdae.protocol.total_derivatives import constraint_force_total, inertia_total


@final
@dataclass(frozen=True)
class Totals:
    """Total design derivatives along q_b and lam_b of a configuration."""

    small: Linearised

    def stiffness(self, x: Array) -> Array:
        """Return the derivative of K x, shape (n_q, n_b)."""
        system, at, q_b = self.small.system, self.small.at, self.small.q_b
        total = -split(lambda x: system.force_q_times_total(at.q, x, at.t, q_b), x)
        if system.linear_constraints:
            return total
        none = np.zeros_like(q_b)

        def reaction(x: Array) -> Array:
            states = (at.q, x, at.lam, at.t)
            return system.constraint_force_rate_total(*states, q_b, none, self.small.lam_b)

        # Without the part of prescribed motions.
        return total + split(lambda x: reaction(x) - reaction(np.zeros_like(x)), x)

    def damping(self, x: Array) -> Array:
        """Return the derivative of D x, shape (n_q, n_b)."""
        system, at, q_b = self.small.system, self.small.at, self.small.q_b
        still, none = np.zeros(system.n_q), np.zeros_like(q_b)

        def force(x: Array) -> Array:
            return system.force_rate_total(at.q, still, x, at.t, q_b, none, none)

        return -split(lambda x: force(x) - force(still), x)

    def mass(self, x: Array) -> Array:
        """Return the derivative of M x, shape (n_q, n_b)."""
        system, at = self.small.system, self.small.at
        return split(lambda x: inertia_total(system, at.q, x, self.small.q_b), x)

    def pencil(self, z: complex, x: Array, mu: Array) -> tuple[Array, Array]:
        """Return the derivatives of F(z) x + Phi_q^T mu and of Phi_q x with z, x and mu held."""
        system, at = self.small.system, self.small.at
        force, mass = self.stiffness(x), self.mass(x)
        if self.small.D is None:
            force = force - z * mass
        else:
            force = force + z * z * mass + z * self.damping(x)
        reaction = split(
            lambda mu: constraint_force_total(system, at.q, mu, at.t, self.small.q_b), mu
        )
        side = split(lambda x: system.constraint_q_times_total(at.q, x, at.t, self.small.q_b), x)
        return force + reaction, side
