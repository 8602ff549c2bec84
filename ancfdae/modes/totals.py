"""Design derivatives of K x, D x and M x with x held, along those of the configuration.

With f = M a + Phi_q^T lam - Q at rest, K x and D x are its derivatives along the directions
(0, x, 0) and (0, 0, x) of (t, q, v).
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import StateDirection
from ancfdae.equations.held import held_total
from ancfdae.modes.linearised import Linearised, split
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Totals:
    """Total design derivatives along q_b and lam_b of a configuration."""

    small: Linearised

    def stiffness(self, x: Array) -> Array:
        """Return the derivative of K x, shape (n_q, n_b)."""
        still = np.zeros(self.small.system.n_q)
        return split(lambda x: self._along(StateDirection(0.0, x, still)), x)

    def damping(self, x: Array) -> Array:
        """Return the derivative of D x, shape (n_q, n_b)."""
        still = np.zeros(self.small.system.n_q)
        return split(lambda x: self._along(StateDirection(0.0, still, x)), x)

    def _along(self, direction: StateDirection) -> Array:
        small, at = self.small, self.small.at
        still, held = np.zeros(small.system.n_q), np.zeros_like(small.q_b)
        states, states_b = (at.q, still, still, at.lam), (small.q_b, held, held, small.lam_b)
        return small.system.along_total(at.t, states, direction, states_b, (held, held))

    def mass(self, x: Array) -> Array:
        """Return the derivative of M x, shape (n_q, n_b)."""
        none = np.zeros(self.small.system.n_lam)
        return split(lambda x: self._held(x, none), x)

    def _held(self, a: Array, lam: Array) -> Array:
        small, at = self.small, self.small.at
        return held_total(small.system, at.t, at.q, a, lam, small.q_b)

    def pencil(self, z: complex, x: Array, mu: Array) -> tuple[Array, Array]:
        """Return the derivatives of F(z) x + Phi_q^T mu and of Phi_q x with z, x and mu held."""
        system = self.small.system
        force, mass = self.stiffness(x), self.mass(x)
        if self.small.D is None:
            force = force - z * mass
        else:
            force = force + z * z * mass + z * self.damping(x)
        still = np.zeros(system.n_q)
        reactions = split(lambda mu: self._held(still, mu), mu)
        return force + reactions, split(lambda x: self._rate(x) - self._rate(0 * x), x)

    def _rate(self, x: Array) -> Array:
        """Differentiate Phi' along a velocity x that is held."""
        small, at = self.small, self.small.at
        motion_b = small.q_b, np.zeros_like(small.q_b)
        return small.system.constraint_total(at.t, (at.q, x), motion_b)
