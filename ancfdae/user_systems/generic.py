"""A system in which everything depends on everything, of the sizes of another.

Its members are what those of the other would be at a guess: an entry that is far smaller is a
difference of larger terms, or round-off in place of zero. With the sum s of all arguments over
their sizes, zero at the state,

    M = diag(w) e^s,     Q = F e^s,     Phi = C e^s,

and every derivative is one of s times the value.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern
from ancfdae.protocol.motion import Motion
from ancfdae.protocol.system import MechanicalSystem


class Sizes(NamedTuple):
    """Sizes of the arguments of a system, and of its forces and constraints."""

    q: Array
    v: Array
    b: Array
    time: float
    force: Array
    constraint: Array


@final
class Generic(MechanicalSystem):
    """A system of the sizes and patterns of another, at one state of it."""

    def __init__(self, system: MechanicalSystem, m: Motion, sizes: Sizes, b: Array) -> None:
        self._of, self._m, self._sizes, self.b = system, m, sizes, b
        self.n_q, self.n_lam, self.design_names = system.n_q, system.n_lam, system.design_names
        self.pattern, self.constraint_pattern = system.pattern, system.constraint_pattern
        self.weights, self.constant_mass = system.weights, system.constant_mass
        self.velocity_forces = system.velocity_forces
        # Partials of s.
        q, v, b_sizes = (np.cos(np.arange(len(x))) / x for x in (sizes.q, sizes.v, sizes.b))
        self._q, self._v, self._t = q, v, 1 / sizes.time
        self._grown = np.exp(b_sizes @ (b - system.b))

    def with_values(self, b: Array) -> Generic:
        """Return it at other design values."""
        return Generic(self._of, self._m, self._sizes, b)

    def start(self) -> tuple[Array, Array]:
        """Sizes of q and v."""
        return self._sizes.q * self._grown, self._sizes.v * self._grown

    def mass(self, q: Array) -> Array:
        """diag(w) e^s."""
        diagonal = np.arange(self.n_q)
        values = np.zeros(self.pattern.size)
        values[self.pattern.index(diagonal, diagonal)] = self.weights
        return values * (self._grown if self.constant_mass else self._grown_at(q))

    def inertia_q(self, q: Array, a: Array) -> Array:
        """M a s_q."""
        return self._product(self.pattern, self.mass_times(q, a))

    def force(self, q: Array, v: Array, t: float) -> Array:
        """F e^s."""
        along_v = self._v @ (v - self._m.v) if self.velocity_forces else 0.0
        force: Array = self._sizes.force * self._grown_at(q, t) * np.exp(along_v)
        return force

    def force_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Q ds/dt."""
        along_v = self._v @ a if self.velocity_forces else 0.0
        return self.force(q, v, t) * (self._q @ v + along_v + self._t)

    def force_q_times(self, q: Array, x: Array, t: float) -> Array:
        """Q s_q x."""
        return self.force(q, 0 * q, t) * (self._q @ x)

    def following_load(self, q: Array, t: float) -> Array:
        """All of Q."""
        return self.force(q, self._m.v, t)

    def following_load_q(self, q: Array, t: float) -> Array:
        """Q_q."""
        return self._product(self.pattern, self.following_load(q, t))

    def constraint(self, q: Array, t: float) -> Array:
        """C e^s."""
        constraint: Array = self._sizes.constraint * self._grown_at(q, t)
        return constraint

    def constraint_q(self, q: Array, t: float) -> Array:
        """Phi s_q."""
        return self._product(self.constraint_pattern, self.constraint(q, t))

    def constraint_q_rate(self, q: Array, v: Array, t: float) -> Array:
        """Phi_q ds/dt."""
        return self.constraint_q(q, t) * (self._q @ v + self._t)

    def velocity_side(self, q: Array, t: float) -> Array:
        """-Phi s_t."""
        return -self.constraint(q, t) * self._t

    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """-Phi (ds/dt)^2."""
        return -self.constraint(q, t) * (self._q @ v + self._t) ** 2

    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """-Phi ((ds/dt)^3 + 3 ds/dt d^2s/dt^2)."""
        rate = self._q @ v + self._t
        return -self.constraint(q, t) * (rate**3 + 3 * rate * (self._q @ a))

    def _grown_at(self, q: Array, t: float | None = None) -> Array:
        s = self._q @ (q - self._m.q) + (0.0 if t is None else self._t * (t - self._m.t))
        return np.asarray(self._grown * np.exp(s))

    def _product(self, pattern: Pattern, values: Array) -> Array:
        return np.asarray(values[pattern.rows] * self._q[pattern.columns])
