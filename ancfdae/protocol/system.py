"""The protocol between a mechanical system and everything that integrates it.

    M(q, b) a + Phi_q^T lam = Q(q, v, t, b),     Phi(q, t, b) = 0          (eq. 1)

Q holds every force that is not inertia M a: for a mass that depends on q, the
quadratic velocity forces too.

Integrators and sensitivity methods see this and nothing else: no beam, no
joint. Matrices are value vectors on a fixed `Pattern`, by default ``matrix.ravel()``.

A partial ``X_y`` has shape X.shape + y.shape. A name that ends in ``_total``
is the derivative in the design variables *along* given derivatives of its
arguments: ``F_total(x, ..., x_b) = F_x x_b + F_b``.

What is abstract must be written, with operations that accept complex numbers;
everything else follows from it by complex steps and products, and may be
overridden where a formula is faster.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.naming import Naming
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import Pattern
from ancfdae.protocol.complex_steps import ComplexSteps


@final
@dataclass(frozen=True)
class Linearisation:
    """Jacobians at k instants as values on the system's patterns, shape (k, nnz).

    f = M a + Phi_q^T lam - Q with a held. M has one row if the mass is constant; f_v is None where
    f does not depend on v.
    """

    M: Array
    f_q: Array
    f_v: Array | None
    Phi_q: Array


@final
@dataclass(frozen=True)
class DesignPartials:
    """Design partials at k instants with everything else held.

    f_b = (M a)_b + (Phi_q^T lam)_b - Q_b has the shape (k, n_q, n_b), Phi_b (k, n_lam, n_b).
    """

    f_b: Array
    Phi_b: Array


class MechanicalSystem(ComplexSteps):
    """A constrained mechanical system at given values of its design variables.

    Attributes
    ----------
    n_q, n_lam, n_b : int
        Numbers of coordinates, constraints and design variables.
    design_names : tuple of str
    b : array, shape (n_b,)
        Values of the design variables; complex in a complex-step run.
    pattern : Pattern
        Pattern (n_q x n_q) of M, (M a)_q, Q_q, Q_v and (Phi_q^T lam)_q together; full by default.
    constraint_pattern : Pattern
        Pattern (n_lam x n_q) of Phi_q; full by default.
    weights : array, shape (n_q,)
        Positive real weights that turn coordinates of different units into comparable ones; by
        default the diagonal of M at the start. Convergence tests and scalings use them.
    constraint_names : tuple of str
        For every constraint the joint it belongs to, length n_lam; numbers by default.
    constant_mass : bool
        Whether M does not depend on q; it is then formed once.
    linear_constraints : bool
        Whether Phi is linear in q, so that (Phi_q^T lam)_q vanishes.
    constant_constraints : bool
        Whether they are linear and the same at all times and designs: all that remains is Phi_q q
        minus a constant, with one Phi_q.
    velocity_forces : bool
        Whether Q depends on v.
    symmetric : bool
        Whether M, (M a)_q, Q_q, Q_v and (Phi_q^T lam)_q are symmetric matrices; systems of
        equations then take less than half the time.
    force_round_off : float
        Size of the round-off in Q in the norm sqrt(sum Q^2 / weights); zero where it is that of
        Q itself. Newton corrections that stop shrinking at this size are accepted.
    project_start : bool
        Whether an inconsistent start is projected instead of refused.
    naming : Naming or None
        Names of points and joints for the solution; None for a system without any.
    """

    n_lam: int
    constant_mass: bool = False
    linear_constraints: bool = False
    constant_constraints: bool = False
    velocity_forces: bool = True
    symmetric: bool = False
    force_round_off: float = 0.0
    project_start: bool = False
    naming: Naming | None = None

    @cached_property
    def pattern(self) -> Pattern:
        """Pattern of the mass and all tangents."""
        return Pattern.full((self.n_q, self.n_q))

    @cached_property
    def constraint_pattern(self) -> Pattern:
        """Pattern of Phi_q."""
        return Pattern.full((self.n_lam, self.n_q))

    @cached_property
    def weights(self) -> Array:
        """Diagonal of M at the start."""
        diagonal = np.arange(self.n_q)
        M = self.mass(self.start()[0])
        return np.asarray(M[self.pattern.index(diagonal, diagonal)].real, dtype=float)

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """Numbers."""
        return tuple(f"constraint {i}" for i in range(1, self.n_lam + 1))

    # -- start ---------------------------------------------------------------------------------

    @abc.abstractmethod
    def start(self) -> tuple[Array, Array]:
        """Return the start (q, v) as declared, before any projection; shapes (n_q,)."""

    def start_b(self) -> tuple[Array, Array]:
        """Return the partials of `start`; shapes (n_q, n_b)."""
        both = self.along(lambda s: np.concatenate(s.start()))
        return both[: self.n_q], both[self.n_q :]

    def start_pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return q_b^T on_q + v_b^T on_v for the partials of `start`, shape (n_b,)."""
        q_b, v_b = self.start_b()
        return np.asarray(on_q @ q_b + on_v @ v_b)

    # -- inertia -------------------------------------------------------------------------------

    @abc.abstractmethod
    def mass(self, q: Array) -> Array:
        """Return the values of M on `pattern`."""

    def mass_times(self, q: Array, x: Array) -> Array:
        """Return M x for a vector or for columns."""
        return self.pattern.dot(self.mass(q), x)

    def mass_b_times(self, q: Array, a: Array) -> Array:
        """Return (M a)_b with q and a held, shape (n_q, n_b)."""
        return self.along(lambda s: s.mass_times(q, a))

    def inertia_q(self, q: Array, a: Array) -> Array:
        """Return the values of (M a)_q with a held; to be written unless `constant_mass`."""
        if self.constant_mass:
            return np.zeros(self.pattern.size)
        raise InvalidInput(
            f"{type(self).__name__}.inertia_q",
            "must be written where the mass depends on q",
            "no such method",
            "Write it, or declare constant_mass = True.",
        )

    def inertia_rate_total(
        self, q: Array, v: Array, a: Array, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of (dM/dt) a = (M a)_q v, (n_q, n_b)."""
        return self.along(
            lambda s, q, v, a: s.pattern.dot(s.inertia_q(q, a), v), (q, q_b), (v, v_b), (a, a_b)
        )

    # -- forces --------------------------------------------------------------------------------

    @abc.abstractmethod
    def force(self, q: Array, v: Array, t: float) -> Array:
        """Return Q, shape (n_q,)."""

    def force_q(self, q: Array, v: Array, t: float) -> Array:
        """Return the values of Q_q on `pattern`."""
        return self._by_coordinate(lambda x: self.force(x, v, t), q, self.pattern)

    def force_v(self, q: Array, v: Array, t: float) -> Array:
        """Return the values of Q_v on `pattern`; asked for only if `velocity_forces`."""
        return self._by_coordinate(lambda x: self.force(q, x, t), v, self.pattern)

    def force_b(self, q: Array, v: Array, t: float) -> Array:
        """Return Q_b, shape (n_q, n_b)."""
        return self.along(lambda s: s.force(q, v, t))

    def force_total(self, q: Array, v: Array, t: float, q_b: Array, v_b: Array) -> Array:
        """Return the total design derivative of Q, shape (n_q, n_b)."""
        return self.along(lambda s, q, v: s.force(q, v, t), (q, q_b), (v, v_b))

    def force_and_total(self, q_rows: Array, v_rows: Array, t: float) -> Array:
        """Return Q and its total design derivatives as rows, shape (1 + n_b, n_q).

        The first rows of both are the state, the others its derivatives; shape (1 + n_b, n_q).
        """
        total = self.force_total(q_rows[0], v_rows[0], t, q_rows[1:].T, v_rows[1:].T)
        return np.concatenate([self.force(q_rows[0], v_rows[0], t)[None], total.T])

    def following_load(self, q: Array, t: float) -> Array:
        """Return the loads in Q that turn with the motion, at rest, shape (n_q,).

        A search for an equilibrium scales them; other loads it takes as they are at its start.
        """
        return np.zeros_like(q)

    def following_load_q(self, q: Array, t: float) -> Array:
        """Return the values of the partial of `following_load` on `pattern`."""
        return np.zeros(self.pattern.size)

    @abc.abstractmethod
    def force_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return dQ/dt along the motion, Q_q v + Q_v a + Q_t, shape (n_q,)."""

    def force_rate_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of `force_rate`, shape (n_q, n_b)."""
        return self.along(lambda s, *x: s.force_rate(*x, t), (q, q_b), (v, v_b), (a, a_b))

    # -- forces at rest ------------------------------------------------------------------------

    def force_q_times(self, q: Array, x: Array, t: float) -> Array:
        """Return Q_q x at v = 0, shape (n_q,); asked for by derivatives of modes.

        It is dQ/dt along a velocity x; where Q depends on velocities, along one so small that its
        square vanishes against one.

        Raises
        ------
        InvalidInput
            If Q depends on velocities and on time: Q_t would drown it. It is to be written then.
        """
        still = np.zeros_like(x)
        at_rest = self.force_rate(q, still, still, t)
        if not self.velocity_forces:
            return self.force_rate(q, x, still, t) - at_rest
        if np.any(at_rest):
            raise InvalidInput(
                f"{type(self).__name__}.force_q_times",
                "must be written where forces depend on velocities and on time",
                "no such method",
                "Write it: Q_q x at v = 0.",
            )
        return self.force_rate(q, STEP * x, still, t) / STEP

    def force_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Return the total design derivative of `force_q_times` with x held, (n_q, n_b)."""
        return self.along(lambda s, q: s.force_q_times(q, x, t), (q, q_b))

    def force_q_times_q(self, q: Array, x: Array, t: float) -> Array:
        """Return the values of (Q_q x)_q at v = 0, x held, on `pattern`."""
        return self._by_coordinate(lambda y: self.force_q_times(y, x, t), q, self.pattern)

    def pull_back_force_q_times(self, q: Array, x: Array, t: float, mu: Array) -> Array:
        """Return mu^T (Q_q x)_b at v = 0 with q and x held, shape (n_b,)."""
        total: Array = mu @ self.force_q_times_total(q, x, t, np.zeros((self.n_q, self.n_b)))
        return total

    # -- constraints ---------------------------------------------------------------------------

    @abc.abstractmethod
    def constraint(self, q: Array, t: float) -> Array:
        """Return Phi, shape (n_lam,)."""

    @abc.abstractmethod
    def constraint_q(self, q: Array, t: float) -> Array:
        """Return the values of Phi_q on `constraint_pattern`."""

    def constraint_b(self, q: Array, t: float) -> Array:
        """Return Phi_b, shape (n_lam, n_b)."""
        return self.along(lambda s: s.constraint(q, t))

    def constraint_force(self, q: Array, lam: Array, t: float) -> Array:
        """Return Phi_q^T lam, shape (n_q,)."""
        return self.constraint_pattern.dot_transposed(self.constraint_q(q, t), lam)

    def constraint_force_q(self, q: Array, lam: Array, t: float) -> Array:
        """Return the values of (Phi_q^T lam)_q; asked for only unless `linear_constraints`."""
        return self._by_coordinate(lambda x: self.constraint_force(x, lam, t), q, self.pattern)

    def constraint_force_b(self, q: Array, lam: Array, t: float) -> Array:
        """Return (Phi_q^T lam)_b with q and lam held, shape (n_q, n_b)."""
        return self.along(lambda s: s.constraint_force(q, lam, t))

    def constraint_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Return the total design derivative of Phi_q x with x held, shape (n_lam, n_b)."""
        return self.along(lambda s, q: s.constraint_pattern.dot(s.constraint_q(q, t), x), (q, q_b))

    @abc.abstractmethod
    def constraint_q_rate(self, q: Array, v: Array, t: float) -> Array:
        """Return the values of dPhi_q/dt = (Phi_q v)_q + Phi_qt on `constraint_pattern`.

        It is also (dPhi/dt)_q, and half of (d^2 Phi/dt^2)_v.
        """

    def constraint_q_second_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return the values of d^2 Phi_q/dt^2 on `constraint_pattern`; also (d^2 Phi/dt^2)_q."""
        return self._by_coordinate(
            lambda x: self._constraint_rate(t, x, v, a), q, self.constraint_pattern
        )

    @abc.abstractmethod
    def velocity_side(self, q: Array, t: float) -> Array:
        """Return nu in Phi_q v = nu, that is -Phi_t, shape (n_lam,)."""

    def velocity_side_total(self, q: Array, t: float, q_b: Array) -> Array:
        """Return the total design derivative of `velocity_side`, shape (n_lam, n_b)."""
        return self.along(lambda s, q: s.velocity_side(q, t), (q, q_b))

    @abc.abstractmethod
    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """Return gamma in Phi_q a = gamma: -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt."""

    def acceleration_side_total(
        self, q: Array, v: Array, t: float, q_b: Array, v_b: Array
    ) -> Array:
        """Return the total design derivative of `acceleration_side`, shape (n_lam, n_b)."""
        return self.along(lambda s, q, v: s.acceleration_side(q, v, t), (q, q_b), (v, v_b))

    @abc.abstractmethod
    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return S in Phi_q q''' = S: d(gamma)/dt - (dPhi_q/dt) a, shape (n_lam,)."""

    def jerk_side_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of `jerk_side`, shape (n_lam, n_b)."""
        return self.along(lambda s, *x: s.jerk_side(*x, t), (q, q_b), (v, v_b), (a, a_b))

    def constraint_force_rate(self, q: Array, v: Array, lam: Array, t: float) -> Array:
        """Return (dPhi_q^T/dt) lam along the motion, shape (n_q,)."""
        return self.constraint_pattern.dot_transposed(self.constraint_q_rate(q, v, t), lam)

    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Return the total design derivative of `constraint_force_rate`, shape (n_q, n_b)."""
        states = (q, q_b), (v, v_b), (lam, lam_b)
        return self.along(lambda s, *x: s.constraint_force_rate(*x, t), *states)

    # -- for the transpose of the start --------------------------------------------------------

    def constraint_q_third_rate(self, q: Array, v: Array, a: Array, jerk: Array, t: float) -> Array:
        """Return the values of d^3 Phi_q/dt^3 on `constraint_pattern`; also (d^3 Phi/dt^3)_q."""
        return self._by_coordinate(
            lambda x: self._constraint_rate(t, x, v, a, jerk), q, self.constraint_pattern
        )

    def constraint_rate_b(self, t: float, q: Array, *rates: Array) -> Array:
        """Return the design partial of a time derivative of Phi, states held, (n_lam, n_b).

        Its order, 1 to 3, is the number of time derivatives of q that are given.
        """
        return self.along(lambda s: s._constraint_rate(t, q, *rates))

    def _constraint_rate(self, t: float, q: Array, *rates: Array) -> Array:
        moving = self.constraint_pattern.dot(self.constraint_q(q, t), rates[-1])
        side: Callable[..., Array] = self.jerk_side
        if len(rates) < 3:
            side = self.velocity_side if len(rates) == 1 else self.acceleration_side
        return moving - side(q, *rates[:-1], t)

    def force_rate_partials(
        self, t: float, states: tuple[Array, ...], later: Array
    ) -> tuple[Array, Array, Array]:
        """Return values of f'_q, f'_v and dM/dt, with f' the rate of f = M a + Phi_q^T lam - Q.

        The states are (q, v, a, lam); a and lam are held in time. The acceleration by which
        velocities change, `later`, need not be a.
        """
        q, v, a, lam = states

        def rate(q: Array, v: Array) -> Array:
            return self._held_rate(t, (q, v, a, lam), later)

        f_q = self._by_coordinate(lambda x: rate(x, v), q, self.pattern)
        f_v = self._by_coordinate(lambda x: rate(q, x), v, self.pattern)
        return f_q, f_v, self._by_number(lambda s: self.mass(q + s * v))

    def pull_back_rate(self, t: float, states: tuple[Array, ...], later: Array, mu: Array) -> Array:
        """Return mu^T f'_b with states held, shape (n_b,); f' as in `force_rate_partials`."""
        return np.asarray(mu @ self.along(lambda s: s._held_rate(t, states, later)))

    def _held_rate(self, t: float, states: tuple[Array, ...], later: Array) -> Array:
        q, v, a, lam = states
        rate = self.constraint_force_rate(q, v, lam, t) - self.force_rate(q, v, later, t)
        if self.constant_mass:
            return rate
        return rate + self.pattern.dot(self.inertia_q(q, a), v)

    def pull_back_inertia(self, t: float, q: Array, a: Array, lam: Array, mu: Array) -> Array:
        """Return mu^T (M a + Phi_q^T lam)_b with q, a and lam held, shape (n_b,)."""
        return np.asarray(mu @ (self.mass_b_times(q, a) + self.constraint_force_b(q, lam, t)))

    # -- many instants at once -----------------------------------------------------------------

    def linearise(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> Linearisation:
        """Linearise f = M a + Phi_q^T lam - Q and Phi at k instants; states are rows (k, n)."""
        M = np.array([self.mass(x) for x in (q[:1] if self.constant_mass else q)])
        Phi_q = np.array([self.constraint_q(x, s) for s, x in zip(t, q, strict=True)])
        f_q, f_v = [], []
        for time, q_k, v_k, a_k, lam_k in zip(t, q, v, a, lam, strict=True):
            value = -self.force_q(q_k, v_k, time)
            if not self.linear_constraints:
                value = value + self.constraint_force_q(q_k, lam_k, time)
            if not self.constant_mass:
                value = value + self.inertia_q(q_k, a_k)
            f_q.append(value)
            if self.velocity_forces:
                f_v.append(-self.force_v(q_k, v_k, time))
        return Linearisation(M, np.array(f_q), np.array(f_v) if f_v else None, Phi_q)

    def design_partials(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> DesignPartials:
        """Return the design partials of f = M a + Phi_q^T lam - Q and Phi at k instants."""
        f_b, Phi_b = [], []
        for time, q_k, v_k, a_k, lam_k in zip(t, q, v, a, lam, strict=True):
            reaction_b = self.constraint_force_b(q_k, lam_k, time)
            f_b.append(self.mass_b_times(q_k, a_k) + reaction_b - self.force_b(q_k, v_k, time))
            Phi_b.append(self.constraint_b(q_k, time))
        return DesignPartials(np.array(f_b), np.array(Phi_b))

    def pull_back(
        self, t: Array, states: tuple[Array, Array, Array, Array], covectors: tuple[Array, Array]
    ) -> Array:
        """Return the sum over k instants of f_b^T mu + Phi_b^T zeta, shape (n_b,).

        The states are (q, v, a, lam) and the covectors (mu, zeta), arrays with k rows.
        """
        partials = self.design_partials(t, *states)
        mu, zeta = covectors
        on_f = np.einsum("knb,kn->b", partials.f_b, mu)
        return np.asarray(on_f + np.einsum("knb,kn->b", partials.Phi_b, zeta))
