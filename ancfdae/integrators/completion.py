"""States completed: velocities on their constraints, then accelerations and multipliers.

Of positions q on the constraints and velocities V that may miss theirs,

    M (v - V) + Phi_q^T sigma = 0,   Phi_q v = nu(q),
    M a + Phi_q^T lam = Q(q, v),     Phi_q a = gamma(q, v).

With Phi' = Phi_q v - nu, Phi'' = Phi_q a - gamma, f for M a + Phi_q^T lam - Q, f_0 for
M (v - V) + Phi_q^T sigma with v - V and sigma held, and (Phi')_q = Phi_q', (Phi'')_v = 2 Phi_q',

    M v_b + Phi_q^T sigma_b = M V_b - f_0,q q_b - f_0,b,         Phi_q v_b = -(Phi'_q q_b + Phi'_b)
    M a_b + Phi_q^T lam_b = -(f_q q_b + f_v v_b + f_b),
    Phi_q a_b = -(Phi''_q q_b + 2 Phi'_q v_b + Phi''_b).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias, final

import numpy as np

from ancfdae.equations import Linearisation, MechanicalSystem
from ancfdae.equations.held import acceleration_side
from ancfdae.equations.saddle_points import solve, solve_transposed
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

# q, v, a and lam of k instants, as rows.
States: TypeAlias = tuple[Array, Array, Array, Array]


def completed(
    system: MechanicalSystem, factors: Factorization, t: float, q: Array, V: Array
) -> tuple[Array, Array, Array]:
    """Return v, a and lam; `factors` are those of M and Phi_q at q."""
    v = V - solve(factors, np.zeros_like(V), system.constraint(t, q, V))[0]
    return v, *solve(factors, system.force(t, q, v), acceleration_side(system, t, q, v))


@final
@dataclass(frozen=True)
class Completion:
    """k completed states, linearised.

    `moved` holds v - V and sigma. `rates` are Phi'_q and Phi''_q, `held_q` is f_0,q; both None
    where they vanish.
    """

    system: MechanicalSystem
    t: Array
    states: States
    moved: tuple[Array, Array]
    local: Linearisation
    held_q: Array | None
    rates: tuple[Array, Array] | None

    @staticmethod
    def of(
        system: MechanicalSystem, t: Array, states: States, moved: tuple[Array, Array]
    ) -> Completion:
        """Linearise accelerations and multipliers at states."""
        traits, held_q, rates = system.traits, None, None
        if not (traits.constant_mass and traits.linear_constraints):
            held_q = system.linearise(t, states[0], None, *moved).f_q
        if not traits.constant_constraints:
            q, v, a, _ = states
            rates = system.constraints_q(t, q, v), system.constraints_q(t, q, v, a)
        local = system.linearise(t, *states)
        return Completion(system, t, states, moved, local, held_q, rates)

    @cached_property
    def partials(self) -> tuple[Array, Array, Array]:
        """Design partials of f_0 and f, and of Phi' and Phi''."""
        system, t, (q, v, a, lam) = self.system, self.t, self.states
        held = system.design_partials(t, q, None, *self.moved).f_b
        sides = np.zeros((2, len(t), system.n_lam, system.n_b))
        if self.rates is not None:
            for k, s in enumerate(t.tolist()):
                sides[0, k] = system.constraint_total(s, (q[k], v[k]))
                sides[1, k] = system.constraint_total(s, (q[k], v[k], a[k]))
        return held, system.design_partials(t, q, v, a, lam).f_b, sides

    def total(self, factors: Factorization, q_b: Array, V_b: Array) -> tuple[Array, Array, Array]:
        """Return v_b, a_b and lam_b of one state from q_b and V_b, by the factors of M and Phi_q.

        The kernel completes the stages of runs (`stage_passes.h`).
        """
        system, local, (held_b, f_b, sides) = self.system, self.local, self.partials
        K, B = system.pattern.dot, system.constraint_pattern.dot
        right, side, side_a = system.mass_times(self.states[0][0], V_b) - held_b[0], *sides[:, 0]
        if self.held_q is not None:
            right = right - K(self.held_q[0], q_b)
        if self.rates is not None:
            side = side + B(self.rates[0][0], q_b)
        v_b = solve(factors, right, -side)[0]
        right = f_b[0] + K(local.f_q[0], q_b)
        if local.f_v is not None:
            right = right + K(local.f_v[0], v_b)
        if self.rates is not None:
            side_a = side_a + B(self.rates[1][0], q_b) + 2 * B(self.rates[0][0], v_b)
        return v_b, *solve(factors, -right, -side_a)

    def back(
        self, factors: Factorization, on_q: Array, on_v: Array, on_a: Array, on_lam: Array
    ) -> tuple[Array, ...]:
        """Transpose of `total`: return covectors on q and V, and four that `pull_back` takes."""
        system, local = self.system, self.local
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        w, y = solve_transposed(factors, on_a, on_lam)
        on_q = on_q - K(local.f_q[0], w)
        if local.f_v is not None:
            on_v = on_v - K(local.f_v[0], w)
        if self.rates is not None:
            on_q = on_q - B(self.rates[1][0], y)
            on_v = on_v - 2 * B(self.rates[0][0], y)
        m, z = solve_transposed(factors, on_v, np.zeros_like(on_lam))
        if self.held_q is not None:
            on_q = on_q - K(self.held_q[0], m)
        if self.rates is not None:
            on_q = on_q - B(self.rates[0][0], z)
        return on_q, system.mass_times(self.states[0][0], m), m, z, w, y

    def pull_back(self, m: Array, z: Array, w: Array, y: Array) -> Array:
        """Return the direct part of the gradient, (n_b,), from adjoint vectors `back`, (k, n)."""
        system, t, (q, v, a, _) = self.system, self.t, self.states
        none = np.zeros_like(z)
        total = system.pull_back(t, (q, None, *self.moved), (m, none))
        if w.any():
            total = total + system.pull_back(t, self.states, (w, none))
        if self.rates is not None:
            for k, s in enumerate(t.tolist()):
                total = total + z[k] @ system.constraint_total(s, (q[k], v[k]))
                if y[k].any():
                    total = total + y[k] @ system.constraint_total(s, (q[k], v[k], a[k]))
        return -total
