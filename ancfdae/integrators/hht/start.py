"""Second-order start of the recurrence of HHT-I3: its value, its derivative and the transpose.

a_n stands for q'' at t_n + alpha h, so a_0 looks back from the consistent start by s = -alpha h,

    a_0 = a - s j,      j = q'''(0),

and a smooth error of (2) in the constraints, C h^3 Phi_q q''' per step with
C = -(1 + 3 alpha^2)/12, forces Phi_q v_n to carry C h^2 Phi_q q''' for ever. A start with
Phi_q v_0 = 0 would reach that value through a transient of first order in the multipliers;
starting with it leaves them second order:

    v_0 = v + dv,   M dv + Phi_q^T eta = 0,   Phi_q dv = C h^2 S.

**Damping.** Where damping makes a mode decay at a rate d faster than 1/h, q''' = -d q'' is huge,
and looking back along it explodes. Then the acceleration a time s later is taken first,

    a+ = a + s j_1,   M j_1 + Phi_q^T lam' = Q_q v + Q_v a+ + Q_t - (Phi_q')^T lam - M' a,
                      Phi_q j_1 = S(a),

which is one implicit Euler step for Q_v: (M - s Q_v) j_1 = ...; from there the same once more, with
a+ for a, gives j_2, and

    a_0 = a+ - 2 s j_2,      S = S(a+) in dv.

In the mode a+ = a/(1 + s d) and a_0 = a (1 + 3 s d)/(1 + s d)^2: below 9/8 a at any step, and
falling to zero with what is left after the decay. For s d << 1 both differ by O(h^2) from the
formulas without it, and v_0 by O(h^3): the order stays two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators.hht.equations import Coefficients, Node, NodeSensitivity, constraint_error
from ancfdae.integrators.start import Covectors, InitialSensitivity, InitialState, curvature
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.saddle_points import solve, solve_transposed
from ancfdae.protocol.total_derivatives import constraint_force_total, inertia_total


@final
@dataclass(frozen=True)
class _Jerk:
    """The third derivative at an acceleration (j_1 or j_2 of the module description).

    Attributes
    ----------
    a, jerk : array, shape (n_q,)
    lam_rate : array, shape (n_lam,)
    """

    a: Array
    jerk: Array
    lam_rate: Array

    @staticmethod
    def of(
        system: MechanicalSystem, x: InitialState, a: Array, s: float, factors: Factorization
    ) -> _Jerk:
        """Solve for it; the factors are those of M - s Q_v."""
        side = system.jerk_side(x.q, x.v, a, x.t)
        jerk, lam_rate = solve(factors, _force_rates(system, x, a), side)
        if jerk.dtype.kind == "c":
            # Q_v is that of the real part; what its imaginary part does comes by one more sweep.
            force = _force_rates(system, x, a + s * jerk) - system.mass_times(x.q, jerk)
            force = force - system.constraint_force(x.q, lam_rate, x.t)
            moved = system.constraint_pattern.dot(system.constraint_q(x.q, x.t), jerk)
            more, lam_more = solve(factors, force, side - moved)
            jerk, lam_rate = jerk + more, lam_rate + lam_more
        return _Jerk(a, jerk, lam_rate)


@final
@dataclass(frozen=True)
class RecurrenceStart:
    """The start for a first step of given coefficients.

    Attributes
    ----------
    system : MechanicalSystem
    s : float
        -alpha h.
    scale : float
        C h^2.
    initial : InitialState
        The consistent start.
    jerks : tuple of _Jerk
        One, or two where forces depend on velocities.
    dv : array, shape (n_q,)
    eta : array, shape (n_lam,)
    factors, damped : Factorization
        Of M and of M - s Q_v, with Phi_q.
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
    def of(
        system: MechanicalSystem, matrices: SaddlePoint, c: Coefficients, initial: InitialState
    ) -> RecurrenceStart:
        """Solve the equations of the module description.

        Raises
        ------
        SingularMatrix
        """
        x, s, scale = initial, -c.alpha * c.h, constraint_error(c)
        M, Phi_q = system.mass(x.q), system.constraint_q(x.q, x.t)
        factors = damped = matrices.factor(M, Phi_q)
        if system.velocity_forces:
            damped = matrices.factor(M - s * system.force_v(x.q, x.v, x.t), Phi_q)
        jerks = [_Jerk.of(system, x, x.a, s, damped)]
        if system.velocity_forces:
            jerks.append(_Jerk.of(system, x, x.a + s * jerks[0].jerk, s, damped))
        side = scale * system.jerk_side(x.q, x.v, jerks[-1].a, x.t)
        dv, eta = solve(factors, np.zeros_like(x.v), side)
        return RecurrenceStart(system, s, scale, x, tuple(jerks), dv, eta, factors, damped)

    @property
    def node(self) -> Node:
        """The state that the first step starts from."""
        x, last = self.initial, self.jerks[-1]
        a = last.a - len(self.jerks) * self.s * last.jerk
        return Node(x.t, x.q, x.v + self.dv, a, x.lam, x.a)

    def sensitivity(self, derivative: InitialSensitivity) -> NodeSensitivity:
        """Differentiate `node`; the derivative is that of the consistent start."""
        system, x, s = self.system, self.initial, self.s
        t, q, v, q_b, v_b = x.t, x.q, x.v, derivative.q_b, derivative.v_b
        a_b = derivative.a_b
        j_b = self.jerk_total(self.jerks[0], derivative, a_b)
        for jerk in self.jerks[1:]:
            a_b = a_b + s * j_b
            j_b = self.jerk_total(jerk, derivative, a_b)
        # M dv_b + Phi_q^T eta_b = -(M dv)_total - (Phi_q^T eta)_total
        # Phi_q dv_b = C h^2 S_total - (Phi_q dv)_total
        right = -inertia_total(system, q, self.dv, q_b)
        right = right - constraint_force_total(system, q, self.eta, t, q_b)
        side = system.jerk_side_total(q, v, self.jerks[-1].a, t, q_b, v_b, a_b)
        side = self.scale * side - system.constraint_q_times_total(q, self.dv, t, q_b)
        dv_b, _ = solve(self.factors, right, side)
        a_0b = a_b - len(self.jerks) * s * j_b
        return NodeSensitivity(q_b, v_b + dv_b, a_0b, derivative.lam_b, derivative.a_b)

    def jerk_total(self, jerk: _Jerk, derivative: InitialSensitivity, a_b: Array) -> Array:
        """Differentiate a third derivative along a_b of the acceleration that it is taken at.

        Q_v (a + s j) has the derivative s Q_v j_b, which stands in the matrix.
        """
        system, x, j = self.system, self.initial, jerk.jerk
        t, q, v, q_b, v_b = x.t, x.q, x.v, derivative.q_b, derivative.v_b
        right = system.force_rate_total(q, v, jerk.a + self.s * j, t, q_b, v_b, a_b)
        turning = system.constraint_force_rate_total(q, v, x.lam, t, q_b, v_b, derivative.lam_b)
        right = right - turning - inertia_total(system, q, j, q_b)
        right = right - constraint_force_total(system, q, jerk.lam_rate, t, q_b)
        if not system.constant_mass:
            right = right - system.inertia_rate_total(q, v, x.a, q_b, v_b, derivative.a_b)
        side = system.jerk_side_total(q, v, jerk.a, t, q_b, v_b, a_b)
        side = side - system.constraint_q_times_total(q, j, t, q_b)
        return solve(self.damped, right, side)[0]

    def pull_back(self, back: NodeSensitivity) -> Covectors:
        """Transpose of `sensitivity`: from covectors on the node to those on the consistent start.

        With P = Phi_q j - S, the third time derivative of Phi, the rules are P_q = (Phi_q)^(3),
        P_v = 3 Phi_q'' and P_a = 3 Phi_q'; f'_q and f'_v are those of `force_rate_partials`.
        """
        total, on_a = self._pull_back_shift(back.v_b)
        on_a = on_a + back.a_b
        on_jerk = -len(self.jerks) * self.s * back.a_b
        for jerk in reversed(self.jerks):
            through, on_same = self._pull_back_jerk(jerk, on_jerk)
            total, on_a = total.plus(through), on_a + on_same
            on_jerk = self.s * on_a  # The acceleration of the second is a + s j of the first.
        own = Covectors(back.q_b, back.v_b, on_a + back.A_b, 0 * total.lam, 0 * total.b)
        return total.plus(own)

    def _pull_back_shift(self, on_dv: Array) -> tuple[Covectors, Array]:
        """Pull a covector on dv back; the one on the acceleration in S comes beside the others."""
        system, x, scale = self.system, self.initial, self.scale
        t, q, v, a, dv = x.t, x.q, x.v, self.jerks[-1].a, self.dv
        still, B = np.zeros_like(v), system.constraint_pattern.dot_transposed
        m, z = solve_transposed(self.factors, on_dv, np.zeros_like(x.lam))
        turned = system.constraint_q_rate(q, dv, t) - system.constraint_q_rate(q, still, t)
        third = system.constraint_q_third_rate(q, v, a, still, t)
        on_q = B(turned + scale * third, z) + curvature(system, t, q, dv, self.eta, m)
        sides_b = scale * system.constraint_rate_b(t, q, v, a, still)
        sides_b = sides_b + system.constraint_rate_b(t, q, dv)
        sides_b = sides_b - system.constraint_rate_b(t, q, still)
        on_b = z @ sides_b + system.pull_back_inertia(t, q, dv, self.eta, m)
        on_v = 3 * scale * B(system.constraint_q_second_rate(q, v, a, t), z)
        on_a = -3 * scale * B(system.constraint_q_rate(q, v, t), z)
        return Covectors(-on_q, -on_v, still, np.zeros_like(x.lam), -on_b), on_a

    def _pull_back_jerk(self, jerk: _Jerk, on_jerk: Array) -> tuple[Covectors, Array]:
        """Pull a covector on a third derivative back; that on its acceleration comes beside."""
        system, x = self.system, self.initial
        t, q, v, a, lam, j = x.t, x.q, x.v, x.a, x.lam, jerk.jerk
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        m, z = solve_transposed(self.damped, on_jerk, np.zeros_like(lam))
        states, later = (q, v, a, lam), jerk.a + self.s * j
        f_q, f_v, M_rate = system.force_rate_partials(t, states, later)
        first = system.constraint_q_rate(q, v, t)
        on_q = K(f_q, m) + curvature(system, t, q, j, jerk.lam_rate, m)
        on_q = on_q + B(system.constraint_q_third_rate(q, v, jerk.a, j, t), z)
        on_v = K(f_v, m) + 3 * B(system.constraint_q_second_rate(q, v, jerk.a, t), z)
        on_same, on_a = 3 * B(first, z), np.zeros_like(a)
        if system.velocity_forces:
            on_same = on_same - K(system.force_v(q, v, t), m)
        if not system.constant_mass:
            on_a = K(M_rate, m)
        on_b = z @ system.constraint_rate_b(t, q, v, jerk.a, j)
        on_b = on_b + system.pull_back_inertia(t, q, j, jerk.lam_rate, m)
        on_b = on_b + system.pull_back_rate(t, states, later, m)
        on_lam = system.constraint_pattern.dot(first, m)
        return Covectors(-on_q, -on_v, -on_a, -on_lam, -on_b), -on_same


def _force_rates(system: MechanicalSystem, state: InitialState, a: Array) -> Array:
    """Return the right side of the equation for j, with Q_v times the given acceleration.

    (dM/dt) a = (M a)_q v takes that of the state.
    """
    t, q, v = state.t, state.q, state.v
    rate = system.force_rate(q, v, a, t) - system.constraint_force_rate(q, v, state.lam, t)
    if system.constant_mass:
        return rate
    return rate - system.pattern.dot(system.inertia_q(q, state.a), v)
