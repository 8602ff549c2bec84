"""Adjoint of the index-1 form, as ordinary differential equations.

Along a motion, a and lam are functions of (q, v, b, t) through

    g_1 = M a + Phi_q^T lam - Q = 0,    g_2 = Phi_q a - gamma = 0.

A functional whose derivative is x_a . a_b + x_lam . lam_b is pulled back onto q_b, v_b and b by

    [ M      Phi_q^T ]^T [ mu   ]   [ x_a   ]
    [ Phi_q  0       ]   [ zeta ] = [ x_lam ],

    on_q = -((g_1)_q^T mu + (g_2)_q^T zeta)     (g_2)_q = d^2Phi_q/dt^2
    on_v = -((g_1)_v^T mu + (g_2)_v^T zeta)     (g_2)_v = 2 dPhi_q/dt
    on_b = -((g_1)_b^T mu + (g_2)_b^T zeta).

With the covectors p_q, p_v of q_b and v_b and the objective int H(q, v, lam) dt, the adjoint
equations, backward from the end, are

    p_q' = -on_q - H_q,    p_v' = -p_q - on_v - H_v,    x_a = p_v,  x_lam = H_lam,

and the gradient is int (on_b) dt + p_q(0) q_b(0) + p_v(0) v_b(0). A value at one instant adds its
partials to p_q and p_v there, that in lam through the same pull-back with x_a = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators.index_1 import Accelerations
from ancfdae.numerics.arrays import Array
from ancfdae.protocol import MechanicalSystem


@final
@dataclass(frozen=True)
class PulledBack:
    """Covectors on q_b, v_b and b."""

    q: Array
    v: Array
    b: Array


@final
class AdjointEquations:
    """Pulls covectors on accelerations and multipliers back at one instant; it has `lam`."""

    def __init__(
        self, system: MechanicalSystem, accelerations: Accelerations, t: float, q: Array, v: Array
    ) -> None:
        self._system, self._t, self._q, self._v = system, t, q, v
        self._a, self.lam = accelerations.solve(t, q, v)
        self._factors = accelerations.factors(t, q)
        a, lam = self._a, self.lam
        local = system.linearise(np.array([t]), q[None], v[None], a[None], lam[None])
        self._f_q = local.f_q[0]
        self._f_v = None if local.f_v is None else local.f_v[0]
        self._rate = system.constraint_q_rate(q, v, t)
        self._second_rate = system.constraint_q_second_rate(q, v, a, t)

    def pull_back(self, x_a: Array, x_lam: Array) -> PulledBack:
        """Return on_q, on_v and on_b."""
        mu, zeta = self._covectors(np.concatenate([x_a, x_lam]))
        on_q, on_v = self._on_states(mu, zeta)
        return PulledBack(on_q, on_v, self._on_design(mu, zeta))

    def matrices(self) -> tuple[Array, Array]:
        """Return the derivatives of on_q and on_v in x_a, shape (n_q, n_q)."""
        n_q, n_lam = self._system.n_q, self._system.n_lam
        mu, zeta = self._covectors(np.eye(n_q + n_lam, n_q))
        return self._on_states(mu, zeta)

    def _covectors(self, right: Array) -> tuple[Array, Array]:
        x = self._factors.solve_transposed(right)
        return x[: self._system.n_q], x[self._system.n_q :]

    def _on_states(self, mu: Array, zeta: Array) -> tuple[Array, Array]:
        K, B = self._system.pattern, self._system.constraint_pattern
        on_q = -K.dot_transposed(self._f_q, mu) - B.dot_transposed(self._second_rate, zeta)
        on_v = -2 * B.dot_transposed(self._rate, zeta)
        if self._f_v is not None:
            on_v = on_v - K.dot_transposed(self._f_v, mu)
        return on_q, on_v

    def _on_design(self, mu: Array, zeta: Array) -> Array:
        system, t, q, v, a = self._system, self._t, self._q, self._v, self._a
        states = (q[None], v[None], a[None], self.lam[None])
        none = np.zeros((1, system.n_lam))
        force = system.pull_back(np.array([t]), states, (mu[None], none))
        return np.asarray(-force - zeta @ system.constraint_rate_b(t, q, v, a))
