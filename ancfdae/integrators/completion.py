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

from collections.abc import Sequence
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
    where they vanish. `factors` are one matrix for each state.
    """

    system: MechanicalSystem
    factors: Sequence[Factorization]
    t: Array
    states: States
    moved: tuple[Array, Array]
    local: Linearisation
    held_q: Array | None
    rates: tuple[Array, Array] | None

    @staticmethod
    def of(
        system: MechanicalSystem,
        factors: Sequence[Factorization],
        t: Array,
        states: States,
        moved: tuple[Array, Array],
    ) -> Completion:
        """Linearise accelerations and multipliers at states; `factors` are those of M and Phi_q."""
        traits, held_q, rates = system.traits, None, None
        if not (traits.constant_mass and traits.linear_constraints):
            held_q = system.linearise(t, states[0], None, *moved).f_q
        if not traits.constant_constraints:
            motion = list(zip(t.tolist(), *states[:3], strict=True))
            first = np.array([system.constraint_q(s, q, v) for s, q, v, _ in motion])
            rates = first, np.array([system.constraint_q(*x) for x in motion])
        local = system.linearise(t, *states)
        return Completion(system, factors, t, states, moved, local, held_q, rates)

    @cached_property
    def _partials(self) -> tuple[Array, Array, Array]:
        """Design partials of f_0 and f, and of Phi' and Phi''."""
        system, t, (q, v, a, lam) = self.system, self.t, self.states
        held = system.design_partials(t, q, None, *self.moved).f_b
        sides = np.zeros((2, len(t), system.n_lam, system.n_b))
        if self.rates is not None:
            for k, s in enumerate(t.tolist()):
                sides[0, k] = system.constraint_total(s, (q[k], v[k]))
                sides[1, k] = system.constraint_total(s, (q[k], v[k], a[k]))
        return held, system.design_partials(t, q, v, a, lam).f_b, sides

    def total(self, k: int, q_b: Array, V_b: Array) -> tuple[Array, Array, Array]:
        """Return v_b, a_b and lam_b of state k from q_b and V_b."""
        system, local, (held_b, f_b, sides) = self.system, self.local, self._partials
        K, B = system.pattern.dot, system.constraint_pattern.dot
        right, side, side_a = system.mass_times(self.states[0][k], V_b) - held_b[k], *sides[:, k]
        if self.held_q is not None:
            right = right - K(self.held_q[k], q_b)
        if self.rates is not None:
            side = side + B(self.rates[0][k], q_b)
        v_b = solve(self.factors[k], right, -side)[0]
        right = f_b[k] + K(local.f_q[k], q_b)
        if local.f_v is not None:
            right = right + K(local.f_v[k], v_b)
        if self.rates is not None:
            side_a = side_a + B(self.rates[1][k], q_b) + 2 * B(self.rates[0][k], v_b)
        return v_b, *solve(self.factors[k], -right, -side_a)

    def back(
        self, k: int, on_q: Array, on_v: Array, on_a: Array | None, on_lam: Array | None
    ) -> tuple[Array, ...]:
        """Transpose of `total`: return covectors on q and V, and four that `pull_back` takes."""
        system, local, factors = self.system, self.local, self.factors[k]
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        w, y = still, none = np.zeros(system.n_q), np.zeros(system.n_lam)
        if on_a is not None or on_lam is not None:
            parts = (zero if x is None else x for x, zero in ((on_a, still), (on_lam, none)))
            w, y = solve_transposed(factors, *parts)
            on_q = on_q - K(local.f_q[k], w)
            if local.f_v is not None:
                on_v = on_v - K(local.f_v[k], w)
            if self.rates is not None:
                on_q = on_q - B(self.rates[1][k], y)
                on_v = on_v - 2 * B(self.rates[0][k], y)
        m, z = solve_transposed(factors, on_v, none)
        if self.held_q is not None:
            on_q = on_q - K(self.held_q[k], m)
        if self.rates is not None:
            on_q = on_q - B(self.rates[0][k], z)
        return on_q, system.mass_times(self.states[0][k], m), m, z, w, y

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
