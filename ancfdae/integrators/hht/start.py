"""Second-order start of the recurrence of HHT-I3: its value, its derivative and the transpose.

a_n stands for q'' at t_n + alpha h, so a_0 looks back from the consistent start by s = -alpha h,

    a_0 = a - s j,      j = q'''(0),

and a smooth error of (2) in the constraints, C h^3 Phi_q q''' per step with C = -(1 + 3
alpha^2)/12, forces Phi_q v_n to be C h^2 Phi_q q''' throughout. A start with Phi_q v_0 = 0 would
reach that value through a transient of first order in the multipliers; starting with it leaves them
second order:

    v_0 = v + dv,   M dv + Phi_q^T eta = 0,   Phi_q dv = C h^2 S.

**Damping.** Where damping makes a mode decay at a rate d faster than 1/h, q''' = -d q'' is huge,
and extrapolation backward along it is useless. Then the acceleration a time s later is taken first,

    a+ = a + s j_1,   M j_1 + Phi_q^T lam' = Q_q v + Q_v a+ + Q_t - (Phi_q')^T lam - M' a,
                      Phi_q j_1 = S(a),

which is one implicit Euler step for Q_v: (M - s Q_v) j_1 = ...; from there the same once more, with
a+ for a, gives j_2, and

    a_0 = a+ - 2 s j_2,      S = S(a+) in dv.

In the mode a+ = a/(1 + s d) and a_0 = a (1 + 3 s d)/(1 + s d)^2: below 9/8 a at any step, and
tending to zero with the mode for s d >> 1. For s d << 1 both differ by O(h^2) from the formulas
without damping, and v_0 by O(h^3): the order stays two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem, StateDirection, reaction
from ancfdae.equations.saddle_points import (
    held_pull_back,
    held_q,
    held_total,
    jerk_side,
    solve,
    solve_transposed,
)
from ancfdae.equations.system import residual_along
from ancfdae.integrators.hht.equations import Coefficients, Node, NodeSensitivity, constraint_error
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.start import Covectors, InitialSensitivity, InitialState
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization


@final
@dataclass(frozen=True)
class _Jerk:
    """The third derivative of q at an acceleration a (j_1 or j_2 of the module), and lam'."""

    a: Array
    jerk: Array
    lam_rate: Array

    @staticmethod
    def of(
        system: MechanicalSystem, x: InitialState, a: Array, s: float, factors: Factorization
    ) -> _Jerk:
        """Return the third derivative at the acceleration a; `factors` belong to M - s Q_v.

        The force is -f' along the motion, with Q_v times the given acceleration; (dM/dt) a = (M
        a)_q v uses the acceleration of the state.
        """
        side, states = jerk_side(system, x.t, x.q, x.v, a), (x.q, x.v, x.a, x.lam)
        force = -residual_along(system, x.t, states, StateDirection(1.0, x.v, a))
        jerk, lam_rate = solve(factors, force, side)
        if jerk.dtype.kind == "c":
            # Q_v is that of the real part; one more sweep adds the effect of its imaginary part.
            along = StateDirection(1.0, x.v, a + s * jerk)
            force = -residual_along(system, x.t, states, along) - system.mass_times(x.q, jerk)
            force = force - reaction(system, x.t, x.q, lam_rate)
            moved = system.constraint_pattern.dot(system.constraint_q(x.t, x.q), jerk)
            more, lam_more = solve(factors, force, side - moved)
            jerk, lam_rate = jerk + more, lam_rate + lam_more
        return _Jerk(a, jerk, lam_rate)


@final
@dataclass(frozen=True)
class RecurrenceStart:
    """The start of the recurrence for a first step h: s = -alpha h, scale = C h^2, the jerks.

    `factors` belong to M, `damped` to M - s Q_v, each with Phi_q.
    """

    system: MechanicalSystem
    s: float
    scale: float
    initial: InitialState
    jerks: tuple[_Jerk, ...]
    dv: Array
    eta: Array
    factors: Factorization
    damped: Factorization

    @staticmethod
    def of(problem: InitialValueProblem, c: Coefficients) -> RecurrenceStart:
        """Return the start for a first step with the coefficients c; see the module."""
        system, matrices, x = problem.system, problem.matrices, problem.initial
        s, scale = -c.alpha * c.h, constraint_error(c)
        M, Phi_q = system.mass(x.q), system.constraint_q(x.t, x.q)
        factors = damped = matrices.factor(M, Phi_q)
        if system.traits.velocity_forces:
            damped = matrices.factor(M + s * _damping(system, x), Phi_q)
        jerks = [_Jerk.of(system, x, x.a, s, damped)]
        if system.traits.velocity_forces:
            jerks.append(_Jerk.of(system, x, x.a + s * jerks[0].jerk, s, damped))
        side = scale * jerk_side(system, x.t, x.q, x.v, jerks[-1].a)
        dv, eta = solve(factors, np.zeros_like(x.v), side)
        return RecurrenceStart(system, s, scale, x, tuple(jerks), dv, eta, factors, damped)

    @property
    def node(self) -> Node:
        """The node from which the first step starts."""
        x, last = self.initial, self.jerks[-1]
        a = last.a - len(self.jerks) * self.s * last.jerk
        return Node(x.t, x.q, x.v + self.dv, a, x.lam, x.a)

    def sensitivity(self, derivative: InitialSensitivity) -> NodeSensitivity:
        """Return the derivatives of `node` from those of the consistent start."""
        system, x, s = self.system, self.initial, self.s
        t, q, v, q_b, v_b = x.t, x.q, x.v, derivative.q_b, derivative.v_b
        a_b = derivative.a_b
        j_b = self.jerk_total(self.jerks[0], derivative, a_b)
        for jerk in self.jerks[1:]:
            a_b = a_b + s * j_b
            j_b = self.jerk_total(jerk, derivative, a_b)
        # M dv_b + Phi_q^T eta_b = -(M dv + Phi_q^T eta)_total
        # Phi_q dv_b = C h^2 S_total - (Phi_q dv)_total, Phi_q dv = Phi'(q, dv) - Phi'(q, 0)
        right = -held_total(system, t, q, self.dv, self.eta, q_b)
        still, held = np.zeros_like(q), np.zeros_like(q_b)
        motion, motion_b = (q, v, self.jerks[-1].a, still), (q_b, v_b, a_b, held)
        side = self.scale * system.constraint_total(t, motion, motion_b)
        side = side + system.constraint_total(t, (q, self.dv), (q_b, held))
        side = side - system.constraint_total(t, (q, still), (q_b, held))
        dv_b, _ = solve(self.factors, right, -side)
        a_0b = a_b - len(self.jerks) * s * j_b
        return NodeSensitivity(q_b, v_b + dv_b, a_0b, derivative.lam_b, derivative.a_b)

    def jerk_total(self, jerk: _Jerk, derivative: InitialSensitivity, a_b: Array) -> Array:
        """Return total design derivatives of a third derivative of q, (n_q, n_b), from a_b.

        Q_v (a + s j) has the derivative s Q_v j_b, which is part of the matrix.
        """
        system, x, j = self.system, self.initial, jerk.jerk
        t, q, v, q_b, v_b = x.t, x.q, x.v, derivative.q_b, derivative.v_b
        states_b = q_b, v_b, derivative.a_b, derivative.lam_b
        along = StateDirection(1.0, v, jerk.a + self.s * j)
        right = -system.along_total(t, (q, v, x.a, x.lam), along, states_b, (v_b, a_b))
        right = right - held_total(system, t, q, j, jerk.lam_rate, q_b)
        side = system.constraint_total(t, (q, v, jerk.a, j), (q_b, v_b, a_b, np.zeros_like(q_b)))
        return solve(self.damped, right, -side)[0]

    def pull_back(self, back: NodeSensitivity) -> Covectors:
        """Return adjoint vectors of the consistent start from those of the node.

        This is the transpose of `sensitivity`. With P = Phi_q j - S, the third time derivative of
        Phi, the rules are P_q = (Phi_q)^(3), P_v = 3 Phi_q'' and P_a = 3 Phi_q'.
        """
        total, on_a = self._pull_back_shift(back.v_b)
        on_a = on_a + back.a_b
        on_jerk = -len(self.jerks) * self.s * back.a_b
        for jerk in reversed(self.jerks):
            through, on_same = self._pull_back_jerk(jerk, on_jerk)
            total, on_a = total.plus(through), on_a + on_same
            on_jerk = self.s * on_a  # The acceleration of the second is a + s j of the first.
        on_start = Covectors(back.q_b, back.v_b, on_a + back.A_b, 0 * total.lam, 0 * total.b)
        return total.plus(on_start)

    def _pull_back_shift(self, on_dv: Array) -> tuple[Covectors, Array]:
        """Return adjoint vectors of the start, and of the acceleration in S, from one of dv."""
        system, x, scale = self.system, self.initial, self.scale
        t, q, v, a, dv = x.t, x.q, x.v, self.jerks[-1].a, self.dv
        still, B = np.zeros_like(v), system.constraint_pattern.dot_transposed
        m, z = solve_transposed(self.factors, on_dv, np.zeros_like(x.lam))
        turned = system.constraint_q(t, q, dv) - system.constraint_q(t, q, still)
        third = system.constraint_q(t, q, v, a, still)
        on_q = B(turned + scale * third, z)
        on_q = on_q + system.pattern.dot_transposed(held_q(system, t, q, dv, self.eta), m)
        sides_b = scale * system.constraint_total(t, (q, v, a, still))
        sides_b = sides_b + system.constraint_total(t, (q, dv))
        sides_b = sides_b - system.constraint_total(t, (q, still))
        on_b = z @ sides_b + held_pull_back(system, t, q, dv, self.eta, m)
        on_v = 3 * scale * B(system.constraint_q(t, q, v, a), z)
        on_a = -3 * scale * B(system.constraint_q(t, q, v), z)
        return Covectors(-on_q, -on_v, still, np.zeros_like(x.lam), -on_b), on_a

    def _pull_back_jerk(self, jerk: _Jerk, on_jerk: Array) -> tuple[Covectors, Array]:
        """Return adjoint vectors of the start, and of the jerk's acceleration, from its own."""
        system, x = self.system, self.initial
        (t, q, v, a, lam), j = x, jerk.jerk
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        m, z = solve_transposed(self.damped, on_jerk, np.zeros_like(lam))
        states, along = (q, v, a, lam), StateDirection(1.0, v, jerk.a + self.s * j)
        f_q, f_v, on_b = system.along_pull_back(t, states, along, m)
        # The direction (v, a) moves with the state.
        local = system.linearise(np.array([t]), q[None], v[None], a[None], lam[None])
        first = system.constraint_q(t, q, v)
        on_q = f_q + K(held_q(system, t, q, j, jerk.lam_rate), m)
        on_q = on_q + B(system.constraint_q(t, q, v, jerk.a, j), z)
        on_v = f_v + K(local.f_q[0], m) + 3 * B(system.constraint_q(t, q, v, jerk.a), z)
        on_same, on_a = 3 * B(first, z), np.zeros_like(a)
        if local.f_v is not None:
            on_same = on_same + K(local.f_v[0], m)
        if not system.traits.constant_mass:
            on_a = K(system.mass_along(q, v), m)
        on_b = on_b + z @ system.constraint_total(t, (q, v, jerk.a, j))
        on_b = on_b + held_pull_back(system, t, q, j, jerk.lam_rate, m)
        on_lam = system.constraint_pattern.dot(first, m)
        return Covectors(-on_q, -on_v, -on_a, -on_lam, -on_b), -on_same


def _damping(system: MechanicalSystem, x: InitialState) -> Array:
    """Return -Q_v at the real part of the start, entries on the pattern, (nnz,)."""
    states = (y.real[None] for y in (x.q, x.v, x.a, x.lam))
    f_v = system.linearise(np.array([x.t]), *states).f_v
    assert f_v is not None
    return only(f_v)
