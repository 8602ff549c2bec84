"""Second-order start of the recurrence of HHT-I3: its value, its derivative and the transpose.

a_n stands for q'' at t_n + alpha h, so a_0 looks back from the consistent start by s = -alpha h,

    a_0 = a - s j,      j = q'''(0),

and a smooth error of (2) in the constraints, C h^3 Phi_q q''' per step with
C = -(1 + 3 alpha^2)/12, forces Phi_q v_n to carry C h^2 Phi_q q''' for ever. A start with
Phi_q v_0 = 0 would reach that value through a transient of first order in the multipliers;
starting with it leaves them second order:

    v_0 = v + dv,   M dv + Phi_q^T eta = 0,   Phi_q dv = C h^2 S.

**Damping.** Where damping makes a mode decay at a rate d faster than 1/h, q''' = -d q'' is huge,
and looking back along it explodes. So both look at the acceleration a time s later,

    a+ = a + s j,   Phi_q j = S(a),
    M j + Phi_q^T lam' = Q_q v + Q_v a+ + Q_t - (Phi_q')^T lam - M' a,

which is one implicit Euler step for Q_v: (M - s Q_v) j = ..., and S = S(a+) in dv. In the mode j
is -d a/(1 + s d), so that a_0 = a (1 + 2 s d)/(1 + s d) stays below 2 a at any step, and
a+ = a/(1 + s d) falls to what is left after the decay. For s d << 1 j differs by O(h), a_0 and v_0
by O(h^2) and O(h^3) from the formulas without it: the order stays two. Without velocity forces
nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators.hht.equations import Coefficients, Node, NodeSensitivity, constraint_error
from ancfdae.integrators.start import (
    Covectors,
    InitialSensitivity,
    InitialState,
    curvature,
    force_rates,
    solve,
    solve_transposed,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.total_derivatives import constraint_force_total, inertia_total


@final
@dataclass(frozen=True)
class RecurrenceStart:
    """The start for a first step of given coefficients.

    Attributes
    ----------
    system : MechanicalSystem
    c : Coefficients
    initial : InitialState
        The consistent start.
    jerk, later : array, shape (n_q,)
        j and a+ of the module description.
    lam_rate : array, shape (n_lam,)
    dv : array, shape (n_q,)
    eta : array, shape (n_lam,)
    factors, damped : Factorization
        Of M and of M - s Q_v, with Phi_q.
    """

    system: MechanicalSystem
    c: Coefficients
    initial: InitialState
    jerk: Array
    later: Array
    lam_rate: Array
    dv: Array
    eta: Array
    factors: Factorization
    damped: Factorization

    @staticmethod
    def of(
        system: MechanicalSystem, matrices: SaddlePoint, c: Coefficients, initial: InitialState
    ) -> RecurrenceStart:
        """Solve the equations of the module description.

        Raises
        ------
        SingularMatrix
        """
        x, s = initial, -c.alpha * c.h
        M, Phi_q = system.mass(x.q), system.constraint_q(x.q, x.t)
        factors = damped = matrices.factor(M, Phi_q)
        if system.velocity_forces and s > 0:
            damped = matrices.factor(M - s * system.force_v(x.q, x.v, x.t), Phi_q)
        side = system.jerk_side(x.q, x.v, x.a, x.t)
        jerk, lam_rate = solve(damped, force_rates(system, x, x.a), side)
        if jerk.dtype.kind == "c":
            # Q_v is that of the real part; what its imaginary part does comes by one more sweep.
            force = force_rates(system, x, x.a + s * jerk) - system.mass_times(x.q, jerk)
            force = force - system.constraint_force(x.q, lam_rate, x.t)
            moved = system.constraint_pattern.dot(Phi_q, jerk)
            more, lam_more = solve(damped, force, side - moved)
            jerk, lam_rate = jerk + more, lam_rate + lam_more
        later = x.a + s * jerk
        side = constraint_error(c) * system.jerk_side(x.q, x.v, later, x.t)
        dv, eta = solve(factors, np.zeros_like(jerk), side)
        return RecurrenceStart(system, c, x, jerk, later, lam_rate, dv, eta, factors, damped)

    @property
    def node(self) -> Node:
        """The state that the first step starts from."""
        x, s = self.initial, -self.c.alpha * self.c.h
        return Node(x.t, x.q, x.v + self.dv, x.a - s * self.jerk, x.lam, x.a)

    def sensitivity(self, derivative: InitialSensitivity) -> NodeSensitivity:
        """Differentiate `node`; the derivative is that of the consistent start."""
        system, x, s = self.system, self.initial, -self.c.alpha * self.c.h
        q_b, v_b, a_b = derivative.q_b, derivative.v_b, derivative.a_b
        t, q, v, a, j = x.t, x.q, x.v, x.a, self.jerk
        right = system.force_rate_total(q, v, self.later, t, q_b, v_b, a_b)
        right = right - system.constraint_force_rate_total(
            q, v, x.lam, t, q_b, v_b, derivative.lam_b
        )
        if not system.constant_mass:
            right = right - system.inertia_rate_total(q, v, a, q_b, v_b, a_b)
        right = right - inertia_total(system, q, j, q_b)
        right = right - constraint_force_total(system, q, self.lam_rate, t, q_b)
        side = system.jerk_side_total(q, v, a, t, q_b, v_b, a_b)
        side = side - system.constraint_q_times_total(q, j, t, q_b)
        j_b, _ = solve(self.damped, right, side)
        # M dv_b + Phi_q^T eta_b = -(M dv)_total - (Phi_q^T eta)_total
        # Phi_q dv_b = C h^2 S_total - (Phi_q dv)_total
        right = -inertia_total(system, q, self.dv, q_b)
        right = right - constraint_force_total(system, q, self.eta, t, q_b)
        side = system.jerk_side_total(q, v, self.later, t, q_b, v_b, a_b + s * j_b)
        side = constraint_error(self.c) * side
        side = side - system.constraint_q_times_total(q, self.dv, t, q_b)
        dv_b, _ = solve(self.factors, right, side)
        return NodeSensitivity(q_b, v_b + dv_b, a_b - s * j_b, derivative.lam_b, a_b)

    def pull_back(self, back: NodeSensitivity) -> Covectors:
        """Transpose of `sensitivity`: from covectors on the node to those on the consistent start.

        With P = Phi_q j - S, the third time derivative of Phi, the rules are P_q = (Phi_q)^(3),
        P_v = 3 Phi_q'' and P_a = 3 Phi_q'; with f = M a + Phi_q^T lam - Q and f' its rate along
        (v, a+) they are f'_q = (f_q)', f'_v = f_q + (f_v)', f'_a = M' + f_v, f'_lam = (Phi_q^T)'.
        """
        s = -self.c.alpha * self.c.h
        shift, on_later = self._pull_back_shift(back.v_b)
        jerk = self._pull_back_jerk(s * (on_later - back.a_b))
        return Covectors(
            q=back.q_b + shift.q + jerk.q,
            v=back.v_b + shift.v + jerk.v,
            a=back.a_b + back.A_b + on_later + jerk.a,
            lam=jerk.lam,
            b=shift.b + jerk.b,
        )

    def _pull_back_shift(self, on_dv: Array) -> tuple[Covectors, Array]:
        """Pull a covector on dv back; the one on a+ is returned beside the others."""
        system, x, scale = self.system, self.initial, constraint_error(self.c)
        t, q, v, later, dv = x.t, x.q, x.v, self.later, self.dv
        still, B = np.zeros_like(v), system.constraint_pattern.dot_transposed
        m, z = solve_transposed(self.factors, on_dv, np.zeros_like(x.lam))
        turned = system.constraint_q_rate(q, dv, t) - system.constraint_q_rate(q, still, t)
        third = system.constraint_q_third_rate(q, v, later, still, t)
        on_q = B(turned + scale * third, z) + curvature(system, t, q, dv, self.eta, m)
        sides_b = scale * system.constraint_rate_b(t, q, v, later, still)
        sides_b = sides_b + system.constraint_rate_b(t, q, dv)
        sides_b = sides_b - system.constraint_rate_b(t, q, still)
        on_b = z @ sides_b + system.pull_back_inertia(t, q, dv, self.eta, m)
        on_v = 3 * scale * B(system.constraint_q_second_rate(q, v, later, t), z)
        on_later = -3 * scale * B(system.constraint_q_rate(q, v, t), z)
        return Covectors(-on_q, -on_v, still, np.zeros_like(x.lam), -on_b), on_later

    def _pull_back_jerk(self, on_jerk: Array) -> Covectors:
        system, x = self.system, self.initial
        t, q, v, a, lam, j = x.t, x.q, x.v, x.a, x.lam, self.jerk
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        m, z = solve_transposed(self.damped, on_jerk, np.zeros_like(lam))
        local = system.linearise(np.array([t]), q[None], v[None], a[None], lam[None])
        rate = system.linearise_rate(t, (q, v, a, lam), (v, self.later))
        first = system.constraint_q_rate(q, v, t)
        on_q = K(rate.f_q[0], m) + curvature(system, t, q, j, self.lam_rate, m)
        on_q = on_q + B(system.constraint_q_third_rate(q, v, a, j, t), z)
        on_v = K(local.f_q[0], m) + 3 * B(system.constraint_q_second_rate(q, v, a, t), z)
        on_a = 3 * B(first, z)
        if rate.f_v is not None and local.f_v is not None:
            on_v, on_a = on_v + K(rate.f_v[0], m), on_a + K(local.f_v[0], m)
        if not system.constant_mass:
            on_a = on_a + K(rate.M[0], m)
        on_b = z @ system.constraint_rate_b(t, q, v, a, j)
        on_b = on_b + system.pull_back_inertia(t, q, j, self.lam_rate, m)
        on_b = on_b + system.pull_back_rate(t, (q, v, a, lam), (v, self.later), m)
        return Covectors(-on_q, -on_v, -on_a, -system.constraint_pattern.dot(first, m), -on_b)
