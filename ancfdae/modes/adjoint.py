"""Eigenvalue derivatives pulled back on the configuration: no design variable until the end.

The product of a covector [y, nu] with the derivative of [F(z) x + Phi_q^T mu, Phi_q x], z, x and mu
held, is linear in q_b and lam_b: on_q . q_b + on_lam . lam_b + on_b. Its parts are rates of
f = M a + Phi_q^T lam - Q along motions, as in `totals`, transposed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from ancfdae.equations import StateDirection
from ancfdae.equations.held import held_pull_back, held_q
from ancfdae.equations.system import constraint_q_along
from ancfdae.modes.linearised import Linearised, split
from ancfdae.numerics.arrays import Array

# Takes covectors on q, lam and b; returns the design derivative, shape (n_b,).
PullBack: TypeAlias = Callable[[Array, Array, Array], Array]


@final
@dataclass(frozen=True)
class Transposed:
    """Products of covectors with total derivatives, each (on_q, on_lam, on_b) in one array."""

    small: Linearised

    def pencil(self, y: Array, z: complex, x: Array, mu: Array) -> Array:
        """Pull back [y, nu]^T [F(z) x + Phi_q^T mu, Phi_q x], with z, x and mu held."""
        n = self.small.system.n_q
        force, nu = y[:n], y[n:]
        total = _bilinear(self._stiffness, force, x)
        if self.small.D is None:
            total = total - z * _bilinear(self._mass, force, x)
        else:
            total = total + z * z * _bilinear(self._mass, force, x)
            total = total + z * _bilinear(self._damping, force, x)
        return total + _bilinear(self._joints, force, mu) + _bilinear(self._joints, x, nu)

    def _stiffness(self, y: Array, x: Array) -> Array:
        """Pull back y^T K x."""
        still = np.zeros(self.small.system.n_q)
        return self._along(y, StateDirection(0.0, x, still))

    def _damping(self, y: Array, x: Array) -> Array:
        """Pull back y^T D x."""
        still = np.zeros(self.small.system.n_q)
        return self._along(y, StateDirection(0.0, still, x))

    def _along(self, y: Array, direction: StateDirection) -> Array:
        system, at = self.small.system, self.small.at
        still = np.zeros(system.n_q)
        states = at.q, still, still, at.lam
        on_q, _, on_b = system.along_pull_back(at.t, states, direction, y)
        on_lam = system.constraint_pattern.dot(constraint_q_along(system, at.t, at.q, direction), y)
        return np.concatenate([on_q, on_lam, on_b])

    def _mass(self, y: Array, x: Array) -> Array:
        return self._held(y, x, np.zeros(self.small.system.n_lam))

    def _joints(self, x: Array, mu: Array) -> Array:
        """Return the gradient of x^T Phi_q^T mu in q, lam and b, at fixed x and mu."""
        return self._held(x, np.zeros(self.small.system.n_q), mu)

    def _held(self, y: Array, a: Array, lam: Array) -> Array:
        """Return the gradient of y^T (M a + Phi_q^T lam) in q, lam and b, at fixed y, a and lam."""
        system, at = self.small.system, self.small.at
        on_b = held_pull_back(system, at.t, at.q, a, lam, y)
        on_q = system.pattern.dot_transposed(held_q(system, at.t, at.q, a, lam), y)
        return np.concatenate([on_q, np.zeros(system.n_lam), on_b])


def pulled_back(small: Linearised, pull_back: PullBack, total: Array) -> Array:
    """Return the design derivative of a packed covector, real or complex, shape (n_b,)."""
    n, m = small.system.n_q, small.system.n_lam
    return split(lambda on: pull_back(on[:n], on[n : n + m], on[n + m :]), total)


def _bilinear(product: Callable[[Array, Array], Array], y: Array, x: Array) -> Array:
    """Apply a product that is bilinear over the real numbers to complex vectors."""
    return split(lambda y: split(lambda x: product(y, x), x), y)
