"""Design derivatives of K x, D x and M x with x held, and of their products with a covector.

All follow from rates of the forces along motions: with velocities x and v = 0 elsewhere

    dQ/dt = Q_q x,     d(Phi_q^T)/dt lam = (Phi_q^T lam)_q x

Forces may depend on velocities, so x is scaled down until its square vanishes against one: then
Q_q at v = x is exactly Q_q at rest. The same with accelerations x gives Q_v x.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.modes.linearised import Linearised
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.protocol.total_derivatives import constraint_force_total, inertia_total


@final
@dataclass(frozen=True)
class Totals:
    """Total design derivatives along q_b and lam_b of a configuration.

    Attributes
    ----------
    small : Linearised
    """

    small: Linearised

    def stiffness(self, x: Array) -> Array:
        """Return the derivative of K x, shape (n_q, n_b)."""
        system, at = self.small.system, self.small.at
        still, none = np.zeros(system.n_q), np.zeros_like(self.small.q_b)

        def force(x: Array) -> Array:
            states = (at.q, STEP * x, still, at.t)
            return system.force_rate_total(*states, self.small.q_b, none, none) / STEP

        total = -_split(force, x)
        if system.linear_constraints:
            return total

        def reaction(x: Array) -> Array:
            states = (at.q, x, at.lam, at.t)
            return system.constraint_force_rate_total(
                *states, self.small.q_b, none, self.small.lam_b
            )

        return total + _split(lambda x: reaction(x) - reaction(still), x)

    def damping(self, x: Array) -> Array:
        """Return the derivative of D x, shape (n_q, n_b)."""
        system, at = self.small.system, self.small.at
        still, none = np.zeros(system.n_q), np.zeros_like(self.small.q_b)

        def force(x: Array) -> Array:
            return system.force_rate_total(at.q, still, x, at.t, self.small.q_b, none, none)

        return -_split(force, x)

    def mass(self, x: Array) -> Array:
        """Return the derivative of M x, shape (n_q, n_b)."""
        system, at = self.small.system, self.small.at
        return _split(lambda x: inertia_total(system, at.q, x, self.small.q_b), x)

    def pencil(self, z: complex, x: Array, mu: Array) -> tuple[Array, Array]:
        """Return the derivatives of F(z) x + Phi_q^T mu and of Phi_q x with z, x and mu held."""
        system, at = self.small.system, self.small.at
        force, mass = self.stiffness(x), self.mass(x)
        if self.small.D is None:
            force = force - z * mass
        else:
            force = force + z * z * mass + z * self.damping(x)
        reaction = _split(
            lambda mu: constraint_force_total(system, at.q, mu, at.t, self.small.q_b), mu
        )
        side = _split(lambda x: system.constraint_q_times_total(at.q, x, at.t, self.small.q_b), x)
        return force + reaction, side


def require_steady(small: Linearised) -> None:
    """Refuse forces that change in time by themselves: their rates are not Q_q v alone.

    Raises
    ------
    InvalidInput
    """
    system, at = small.system, small.at
    still = np.zeros(system.n_q)
    if np.any(system.force_rate(at.q, still, still, at.t)):
        raise InvalidInput(
            "derivatives of modes",
            "need forces that do not depend on time",
            "a force that changes at rest",
            "Hold it at its value at this time.",
        )


def _split(linear: Callable[[Array], Array], x: Array) -> Array:
    """Apply a function that is linear over the real numbers to a complex vector."""
    if x.dtype.kind != "c":
        return linear(x)
    return linear(x.real) + 1j * linear(x.imag)
