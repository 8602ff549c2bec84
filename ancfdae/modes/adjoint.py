"""Eigenvalue derivatives pulled back on the configuration: no design variable until the end.

The product of a covector [y, nu] with the derivative of [F(z) x + Phi_q^T mu, Phi_q x], z, x and mu
held, is linear in q_b and lam_b: on_q . q_b + on_lam . lam_b + on_b. Its parts are rates of
f = M a + Phi_q^T lam - Q along motions, as in `totals`, transposed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from ancfdae.modes.linearised import Linearised, split
from ancfdae.numerics.arrays import STEP, Array

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
        system, at = self.small.system, self.small.at
        on_q = -system.pattern.dot_transposed(system.force_q_times_q(at.q, x, at.t), y)
        on_b = -system.pull_back_force_q_times(at.q, x, at.t, y)
        total = self._packed(on_q, on_b)
        return total if system.linear_constraints else total + self._curvature(y, x)

    def _curvature(self, y: Array, x: Array) -> Array:
        """Pull back y^T (Phi_q^T lam)_q x, without the part of prescribed motions."""
        return self._joint_rate(y, x) - self._joint_rate(y, np.zeros_like(x))

    def _joint_rate(self, y: Array, v: Array) -> Array:
        """Pull back y^T (dPhi_q^T/dt) lam; third derivatives of Phi are symmetric."""
        system, at = self.small.system, self.small.at
        moved = system.constraint_force_rate(at.q + 1j * STEP * y, v, at.lam, at.t)
        on_lam = system.constraint_pattern.dot(system.constraint_q_rate(at.q, v, at.t), y)
        still, lam_b = np.zeros((system.n_q, system.n_b)), np.zeros((system.n_lam, system.n_b))
        states = (at.q, v, at.lam, at.t)
        on_b = y @ system.constraint_force_rate_total(*states, still, still, lam_b)
        return np.concatenate([moved.imag / STEP, on_lam, on_b])

    def _damping(self, y: Array, x: Array) -> Array:
        """Pull back y^T D x, without the part of forces that depend on time."""
        return self._force_rate(y, x) - self._force_rate(y, np.zeros_like(x))

    def _force_rate(self, y: Array, a: Array) -> Array:
        system, at = self.small.system, self.small.at
        still, none = np.zeros(system.n_q), np.zeros(system.n_lam)
        along = (at.q, still, still, none)
        on_q = system.force_rate_partials(at.t, along, a)[0]
        on_b = system.pull_back_rate(at.t, along, a, y)
        return self._packed(system.pattern.dot_transposed(on_q, y), on_b)

    def _mass(self, y: Array, x: Array) -> Array:
        system, at = self.small.system, self.small.at
        on_b = system.pull_back_inertia(at.t, at.q, x, np.zeros(system.n_lam), y)
        if system.constant_mass:
            return self._packed(np.zeros(system.n_q), on_b)
        return self._packed(system.pattern.dot_transposed(system.inertia_q(at.q, x), y), on_b)

    def _joints(self, x: Array, mu: Array) -> Array:
        """Pull back x^T Phi_q^T mu."""
        system, at = self.small.system, self.small.at
        on_b = system.pull_back_inertia(at.t, at.q, np.zeros(system.n_q), mu, x)
        if system.linear_constraints:
            return self._packed(np.zeros(system.n_q), on_b)
        return self._packed(
            system.pattern.dot_transposed(system.constraint_force_q(at.q, mu, at.t), x), on_b
        )

    def _packed(self, on_q: Array, on_b: Array) -> Array:
        return np.concatenate([on_q, np.zeros(self.small.system.n_lam), on_b])


def pulled_back(small: Linearised, pull_back: PullBack, total: Array) -> Array:
    """Return the design derivative of a packed covector, real or complex, shape (n_b,)."""
    n, m = small.system.n_q, small.system.n_lam
    return split(lambda on: pull_back(on[:n], on[n : n + m], on[n + m :]), total)


def _bilinear(product: Callable[[Array, Array], Array], y: Array, x: Array) -> Array:
    """Apply a product that is bilinear over the real numbers to complex vectors."""
    return split(lambda y: split(lambda x: product(y, x), x), y)
