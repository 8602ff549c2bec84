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

from ancfdae.equations.motion import Motion, StateDirection
from ancfdae.equations.system import MechanicalSystem, SystemProperties
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import SparsityPattern


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
        self.weights, given = system.weights, system.traits
        self.traits = SystemProperties(given.constant_mass, velocity_forces=given.velocity_forces)
        # Partials of s.
        q, v, b_sizes = (np.cos(np.arange(len(x))) / x for x in (sizes.q, sizes.v, sizes.b))
        self._q, self._v, self._t = q, v, 1 / sizes.time
        self._grown = np.exp(b_sizes @ (b - system.b))

    def with_values(self, b: Array) -> Generic:
        """Return the same generic system at other design values."""
        return Generic(self._of, self._m, self._sizes, b)

    def start(self) -> tuple[Array, Array]:
        """Return start values of q and v that have the sizes of the system's own."""
        return self._sizes.q * self._grown, self._sizes.v * self._grown

    def mass(self, q: Array) -> Array:
        """M = diag(w) e^s, values on the pattern."""
        values = np.zeros(self.pattern.size)
        values[self.pattern.diagonal] = self.weights
        return values * (self._grown if self.traits.constant_mass else self._grown_at(q))

    def mass_along(self, q: Array, dq: Array) -> Array:
        """M_q dq = M s_q dq, values on the pattern."""
        return self.mass(q) * (self._q @ dq)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Q = F e^s, shape (n_q,)."""
        along_v = self._v @ (v - self._m.v) if self.traits.velocity_forces else 0.0
        return self._sizes.force * self._grown_at(q, t) * np.exp(along_v)

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Q ds, the derivative of Q along (dt, dq, dv), shape (n_q,)."""
        dt, dq, dv = direction
        along_v = self._v @ dv if self.traits.velocity_forces else 0.0
        return self.force(t, q, v) * (self._q @ dq + along_v + self._t * dt)

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return Q as a load that turns with the motion, and Q_q on the pattern."""
        Q = self.force(t, q, self._m.v)
        return Q, self._product(self.pattern, Q)

    def constraint(self, t: float, *motion: Array) -> Array:
        """Phi = C e^s, and its time derivatives by the chain rule."""
        q, *rates = motion
        v, a, j = (self._q @ x for x in (*rates, *3 * [0.0 * q])[:3])
        v = v + self._t
        growth = [1.0, v, v**2 + a, v**3 + 3 * v * a + j][len(rates)]
        return self._sizes.constraint * self._grown_at(q, t) * growth

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Phi_q = Phi s_q, and so of the rates."""
        return self._product(self.constraint_pattern, self.constraint(t, *motion))

    def _grown_at(self, q: Array, t: float | None = None) -> Array:
        s = self._q @ (q - self._m.q) + (0.0 if t is None else self._t * (t - self._m.t))
        return np.asarray(self._grown * np.exp(s))

    def _product(self, pattern: SparsityPattern, values: Array) -> Array:
        return np.asarray(values[pattern.rows] * self._q[pattern.columns])
