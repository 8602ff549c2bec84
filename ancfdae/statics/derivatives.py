"""Design derivatives of an equilibrium, direct and transposed.

K q_b + Phi_q^T lam_b = Q_b - (Phi_q^T lam)_b,      K = (Phi_q^T lam)_q - Q_q
Phi_q q_b             = -Phi_b
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.saddle_points import solve, solve_transposed
from ancfdae.statics.balance import Balance


@final
class Tangent:
    """The factorised tangent of an equilibrium; raises SingularMatrix where there is none."""

    def __init__(self, system: MechanicalSystem, t: float, q: Array, lam: Array) -> None:
        balance = Balance(system, t, q, lam)
        self._system, self._t = system, np.array([t])
        zero = np.zeros_like(q)
        self._state = (q[None], zero[None], zero[None], lam[None])
        self._factors: Factorization = balance.factor(balance.tangent(1.0, q, lam), q)

    def sensitivities(self) -> tuple[Array, Array]:
        """Return q_b and lam_b, shapes (n_q, n_b) and (n_lam, n_b)."""
        partials = self._system.design_partials(self._t, *self._state)
        return solve(self._factors, -partials.f_b[0], -partials.Phi_b[0])

    def pull_back(self, on_q: Array, on_lam: Array) -> Array:
        """Return q_b^T on_q + lam_b^T on_lam by one transposed solve, shape (n_b,)."""
        mu, zeta = solve_transposed(self._factors, on_q, on_lam)
        gradient: Array = -self._system.pull_back(self._t, self._state, (mu[None], zeta[None]))
        return gradient
