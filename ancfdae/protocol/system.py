"""The protocol between a mechanical system and everything that integrates it.

    M(q, b) a + Phi_q^T lam = Q(q, v, t, b),     Phi(q, t, b) = 0          (eq. 1)

Q holds every force that is not inertia M a: for a mass that depends on q, the
quadratic velocity forces too.

Integrators and sensitivity methods see this and nothing else: no beam, no
joint. Matrices are value vectors on a fixed `Pattern`; for a small system of
your own use ``Pattern.full((n, n))`` and return ``matrix.ravel()``.

A partial ``X_y`` has shape X.shape + y.shape. A name that ends in ``_total``
is the derivative in the design variables *along* given derivatives of its
arguments: ``F_total(x, ..., x_b) = F_x x_b + F_b``.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Self, final

import numpy as np

from ancfdae.naming import Naming
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern

# Imaginary step of derivatives along a motion: its square vanishes against one.
_STEP = 1e-40


@final
@dataclass(frozen=True)
class Linearisation:
    """Jacobians at k instants as values on the system's patterns.

    Attributes
    ----------
    M : array, shape (k, nnz) or (1, nnz)
        One row if the mass is constant.
    f_q : array, shape (k, nnz)
        f = M a + Phi_q^T lam - Q with a held.
    f_v : array, shape (k, nnz), or None
        None where f does not depend on v.
    Phi_q : array, shape (k, nnz of the constraint pattern)
    """

    M: Array
    f_q: Array
    f_v: Array | None
    Phi_q: Array


@final
@dataclass(frozen=True)
class DesignPartials:
    """Design partials at k instants with everything else held.

    Attributes
    ----------
    f_b : array, shape (k, n_q, n_b)
        (M a)_b + (Phi_q^T lam)_b - Q_b.
    Phi_b : array, shape (k, n_lam, n_b)
    """

    f_b: Array
    Phi_b: Array


class MechanicalSystem(abc.ABC):
    """A constrained mechanical system at given values of its design variables.

    Attributes
    ----------
    n_q, n_lam, n_b : int
        Numbers of coordinates, constraints and design variables.
    design_names : tuple of str
        Names of the design variables, length n_b.
    b : array, shape (n_b,)
        Their values; complex in a complex-step run.
    pattern : Pattern
        Pattern (n_q x n_q) of M, (M a)_q, Q_q, Q_v and (Phi_q^T lam)_q together.
    constraint_pattern : Pattern
        Pattern (n_lam x n_q) of Phi_q.
    weights : array, shape (n_q,)
        Positive real weights that turn coordinates of different units into comparable ones;
        usually the diagonal of M. Convergence tests and scalings use them.
    constraint_names : tuple of str
        For every constraint the joint it belongs to, length n_lam.
    constant_mass : bool
        Whether M does not depend on q; it is then formed once.
    linear_constraints : bool
        Whether Phi is linear in q, so that (Phi_q^T lam)_q vanishes.
    velocity_forces : bool
        Whether Q depends on v.
    force_round_off : float
        Size of the round-off in Q in the norm sqrt(sum Q^2 / weights); zero where it is that of
        Q itself. Newton corrections that stop shrinking at this size are accepted.
    project_start : bool
        Whether an inconsistent start is projected instead of refused.
    naming : Naming or None
        Names of points and joints for the solution; None for a system without any.
    """

    n_q: int
    n_lam: int
    n_b: int
    design_names: tuple[str, ...]
    b: Array
    pattern: Pattern
    constraint_pattern: Pattern
    weights: Array
    constraint_names: tuple[str, ...]
    constant_mass: bool
    linear_constraints: bool
    velocity_forces: bool
    force_round_off: float
    project_start: bool
    naming: Naming | None

    @abc.abstractmethod
    def with_values(self, b: Array) -> Self:
        """Return the same system at other values of the design variables, real or complex."""

    # -- start ---------------------------------------------------------------------------------

    @abc.abstractmethod
    def start(self) -> tuple[Array, Array]:
        """Return the start (q, v) as declared, before any projection; shapes (n_q,)."""

    @abc.abstractmethod
    def start_b(self) -> tuple[Array, Array]:
        """Return the partials of `start`; shapes (n_q, n_b)."""

    # -- inertia -------------------------------------------------------------------------------

    @abc.abstractmethod
    def mass(self, q: Array) -> Array:
        """Return the values of M on `pattern`."""

    @abc.abstractmethod
    def mass_times(self, q: Array, x: Array) -> Array:
        """Return M x for a vector or for columns."""

    @abc.abstractmethod
    def mass_b_times(self, q: Array, a: Array) -> Array:
        """Return (M a)_b with q and a held, shape (n_q, n_b)."""

    @abc.abstractmethod
    def inertia_q(self, q: Array, a: Array) -> Array:
        """Return the values of (M a)_q with a held; asked for only unless `constant_mass`."""

    @abc.abstractmethod
    def inertia_rate_total(
        self, q: Array, v: Array, a: Array, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of (dM/dt) a, that is of (M a)_q v, (n_q, n_b).

        Asked for only unless `constant_mass`.
        """

    # -- forces --------------------------------------------------------------------------------

    @abc.abstractmethod
    def force(self, q: Array, v: Array, t: float) -> Array:
        """Return Q, shape (n_q,)."""

    @abc.abstractmethod
    def force_q(self, q: Array, v: Array, t: float) -> Array:
        """Return the values of Q_q on `pattern`."""

    @abc.abstractmethod
    def force_v(self, q: Array, v: Array, t: float) -> Array:
        """Return the values of Q_v on `pattern`; asked for only if `velocity_forces`."""

    @abc.abstractmethod
    def force_b(self, q: Array, v: Array, t: float) -> Array:
        """Return Q_b, shape (n_q, n_b)."""

    def force_total(self, q: Array, v: Array, t: float, q_b: Array, v_b: Array) -> Array:
        """Return the total design derivative of Q, shape (n_q, n_b).

        Override it where Q_q q_b is cheaper than Q_q.
        """
        total = self.force_b(q, v, t) + self.pattern.dot(self.force_q(q, v, t), q_b)
        if self.velocity_forces:
            total = total + self.pattern.dot(self.force_v(q, v, t), v_b)
        return total

    @abc.abstractmethod
    def force_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return dQ/dt along the motion, Q_q v + Q_v a + Q_t, shape (n_q,)."""

    @abc.abstractmethod
    def force_rate_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of `force_rate`, shape (n_q, n_b)."""

    # -- constraints ---------------------------------------------------------------------------

    @abc.abstractmethod
    def constraint(self, q: Array, t: float) -> Array:
        """Return Phi, shape (n_lam,)."""

    @abc.abstractmethod
    def constraint_q(self, q: Array, t: float) -> Array:
        """Return the values of Phi_q on `constraint_pattern`."""

    @abc.abstractmethod
    def constraint_b(self, q: Array, t: float) -> Array:
        """Return Phi_b, shape (n_lam, n_b)."""

    @abc.abstractmethod
    def constraint_force(self, q: Array, lam: Array, t: float) -> Array:
        """Return Phi_q^T lam, shape (n_q,)."""

    @abc.abstractmethod
    def constraint_force_q(self, q: Array, lam: Array, t: float) -> Array:
        """Return the values of (Phi_q^T lam)_q; asked for only unless `linear_constraints`."""

    @abc.abstractmethod
    def constraint_force_b(self, q: Array, lam: Array, t: float) -> Array:
        """Return (Phi_q^T lam)_b with q and lam held, shape (n_q, n_b)."""

    @abc.abstractmethod
    def constraint_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Return the total design derivative of Phi_q x with x held, shape (n_lam, n_b)."""

    @abc.abstractmethod
    def constraint_q_rate(self, q: Array, v: Array, t: float) -> Array:
        """Return the values of dPhi_q/dt = (Phi_q v)_q + Phi_qt on `constraint_pattern`.

        It is also (dPhi/dt)_q, and half of (d^2 Phi/dt^2)_v.
        """

    @abc.abstractmethod
    def constraint_q_second_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return the values of d^2 Phi_q/dt^2 on `constraint_pattern`; also (d^2 Phi/dt^2)_q."""

    @abc.abstractmethod
    def velocity_side(self, q: Array, t: float) -> Array:
        """Return nu in Phi_q v = nu, that is -Phi_t, shape (n_lam,)."""

    @abc.abstractmethod
    def velocity_side_total(self, q: Array, t: float, q_b: Array) -> Array:
        """Return the total design derivative of `velocity_side`, shape (n_lam, n_b)."""

    @abc.abstractmethod
    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """Return gamma in Phi_q a = gamma: -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt."""

    @abc.abstractmethod
    def acceleration_side_total(
        self, q: Array, v: Array, t: float, q_b: Array, v_b: Array
    ) -> Array:
        """Return the total design derivative of `acceleration_side`, shape (n_lam, n_b)."""

    @abc.abstractmethod
    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return S in Phi_q q''' = S: d(gamma)/dt - (dPhi_q/dt) a, shape (n_lam,)."""

    @abc.abstractmethod
    def jerk_side_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of `jerk_side`, shape (n_lam, n_b)."""

    @abc.abstractmethod
    def constraint_force_rate(self, q: Array, v: Array, lam: Array, t: float) -> Array:
        """Return (dPhi_q^T/dt) lam along the motion, shape (n_q,)."""

    @abc.abstractmethod
    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Return the total design derivative of `constraint_force_rate`, shape (n_q, n_b)."""

    # -- rates for the transpose of the start ----------------------------------------------------

    def start_pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return `start_b` contracted with covectors on q and v, shape (n_b,)."""
        q_b, v_b = self.start_b()
        total: Array = on_q @ q_b + on_v @ v_b
        return total

    def constraint_q_third_rate(self, q: Array, v: Array, a: Array, jerk: Array, t: float) -> Array:
        """Return the values of d^3 Phi_q/dt^3 on `constraint_pattern`."""
        step = 1j * _STEP
        moved = (q + step * v, v + step * a, a + step * jerk)
        later = self.constraint_q_second_rate(*moved, t + step)  # type: ignore[arg-type]
        return np.asarray(later.imag / _STEP)

    def constraint_rate_b(
        self, t: float, q: Array, v: Array, a: Array | None = None, jerk: Array | None = None
    ) -> Array:
        """Return the design partial of dPhi/dt, d^2 Phi/dt^2 or d^3 Phi/dt^3, (n_lam, n_b).

        The order is the number of rates given; they are held.
        """
        still = np.zeros((self.n_q, self.n_b))
        if a is None:
            side = self.velocity_side_total(q, t, still)
            return self.constraint_q_times_total(q, v, t, still) - side
        if jerk is None:
            side = self.acceleration_side_total(q, v, t, still, still)
            return self.constraint_q_times_total(q, a, t, still) - side
        side = self.jerk_side_total(q, v, a, t, still, still, still)
        return self.constraint_q_times_total(q, jerk, t, still) - side

    def linearise_rate(
        self, t: float, state: tuple[Array, Array, Array, Array], rates: tuple[Array, Array]
    ) -> Linearisation:
        """Return the time derivative of `linearise` at one instant, a and lam held.

        Parameters
        ----------
        t : float
        state : (q, v, a, lam)
        rates : (array, array), shape (n_q,)
            Rates of q and v.
        """
        (q, v, a, lam), step = state, 1j * _STEP
        moved = (q + step * rates[0], v + step * rates[1], a, lam)
        local = self.linearise(np.array([t + step]), *(x[None] for x in moved))
        f_v = None if local.f_v is None else local.f_v.imag / _STEP
        M, f_q, Phi_q = (x.imag / _STEP for x in (local.M, local.f_q, local.Phi_q))
        return Linearisation(M, f_q, f_v, Phi_q)

    def pull_back_inertia(self, t: float, q: Array, a: Array, lam: Array, mu: Array) -> Array:
        """Return mu^T (M a + Phi_q^T lam)_b with q, a and lam held, shape (n_b,)."""
        total: Array = mu @ (self.mass_b_times(q, a) + self.constraint_force_b(q, lam, t))
        return total

    def pull_back_rate(
        self,
        t: float,
        state: tuple[Array, Array, Array, Array],
        rates: tuple[Array, Array],
        mu: Array,
    ) -> Array:
        """Return mu^T of the time derivative of f_b along the rates of q and v, shape (n_b,).

        f_b is the design partial of M a + Phi_q^T lam - Q with everything else held; a and lam are
        held in time too.
        """
        (q, v, a, lam), (v_now, a_now) = state, rates
        still, none = np.zeros((self.n_q, self.n_b)), np.zeros((self.n_lam, self.n_b))
        rate_b = self.constraint_force_rate_total(q, v_now, lam, t, still, still, none)
        rate_b = rate_b - self.force_rate_total(q, v, a_now, t, still, still, still)
        if not self.constant_mass:
            rate_b = rate_b + self.inertia_rate_total(q, v_now, a, still, still, still)
        total: Array = mu @ rate_b
        return total

    # -- many instants at once -----------------------------------------------------------------

    @abc.abstractmethod
    def linearise(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> Linearisation:
        """Linearise f = M a + Phi_q^T lam - Q and Phi at k instants; states are rows (k, n)."""

    @abc.abstractmethod
    def design_partials(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> DesignPartials:
        """Return the design partials of f = M a + Phi_q^T lam - Q and Phi at k instants."""

    @abc.abstractmethod
    def pull_back(
        self,
        t: Array,
        states: tuple[Array, Array, Array, Array],
        covectors: tuple[Array, Array],
    ) -> Array:
        """Return the sum over instants of f_b^T mu + Phi_b^T zeta, shape (n_b,).

        Parameters
        ----------
        t : array, shape (k,)
        states : (q, v, a, lam), arrays with k rows
        covectors : (mu, zeta), arrays with k rows
        """


class OneByOneSystem(MechanicalSystem):
    """A system that handles many instants by a loop over them; enough for small ones."""

    @final
    def linearise(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> Linearisation:
        """Linearise instant by instant."""
        M: list[Array] = []
        f_q, f_v, Phi_q = [], [], []
        for time, q_k, v_k, a_k, lam_k in zip(t, q, v, a, lam, strict=True):
            value = -self.force_q(q_k, v_k, time)
            if not self.linear_constraints:
                value = value + self.constraint_force_q(q_k, lam_k, time)
            if not self.constant_mass:
                value = value + self.inertia_q(q_k, a_k)
            f_q.append(value)
            if not (M and self.constant_mass):
                M.append(self.mass(q_k))
            Phi_q.append(self.constraint_q(q_k, time))
            if self.velocity_forces:
                f_v.append(-self.force_v(q_k, v_k, time))
        rates = np.array(f_v) if self.velocity_forces else None
        return Linearisation(np.array(M), np.array(f_q), rates, np.array(Phi_q))

    @final
    def design_partials(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> DesignPartials:
        """Differentiate instant by instant."""
        f_b, Phi_b = [], []
        for time, q_k, v_k, a_k, lam_k in zip(t, q, v, a, lam, strict=True):
            reaction_b = self.constraint_force_b(q_k, lam_k, time)
            f_b.append(self.mass_b_times(q_k, a_k) + reaction_b - self.force_b(q_k, v_k, time))
            Phi_b.append(self.constraint_b(q_k, time))
        return DesignPartials(np.array(f_b), np.array(Phi_b))

    @final
    def pull_back(
        self,
        t: Array,
        states: tuple[Array, Array, Array, Array],
        covectors: tuple[Array, Array],
    ) -> Array:
        """Contract the design partials."""
        partials = self.design_partials(t, *states)
        mu, zeta = covectors
        total: Array = np.einsum("knb,kn->b", partials.f_b, mu)
        total = total + np.einsum("knb,kn->b", partials.Phi_b, zeta)
        return total
