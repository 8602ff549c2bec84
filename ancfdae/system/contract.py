"""The protocol between a mechanical system and everything that integrates it.

    M(b) a + Phi_q^T lam = Q(q, v, t, b),     Phi(q, t, b) = 0          (eq. 1)

Integrators and sensitivity methods see this and nothing else: no beam, no
joint. Matrices are value vectors on a fixed `Pattern`; for a small system of
your own use ``Pattern.full((n, n))`` and return ``matrix.ravel()``.

A partial ``X_y`` has shape X.shape + y.shape. A name that ends in ``_total``
is the derivative in the design variables *along* given derivatives of its
arguments: ``F_total(x, ..., x_b) = F_x x_b + F_b``.
"""

from __future__ import annotations

import abc
from typing import Self

from ancfdae.layout import Naming
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern


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
        Pattern (n_q x n_q) of M, Q_q, Q_v and (Phi_q^T lam)_q together.
    constraint_pattern : Pattern
        Pattern (n_lam x n_q) of Phi_q.
    weights : array, shape (n_q,)
        Positive real weights that turn coordinates of different units into comparable ones;
        usually the diagonal of M. Convergence tests and scalings use them.
    constraint_names : tuple of str
        For every constraint the joint it belongs to, length n_lam.
    linear_constraints : bool
        Whether Phi is linear in q, so that (Phi_q^T lam)_q vanishes.
    velocity_forces : bool
        Whether Q depends on v.
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
    linear_constraints: bool
    velocity_forces: bool
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
    def mass(self) -> Array:
        """Return the values of M on `pattern`."""

    @abc.abstractmethod
    def mass_times(self, x: Array) -> Array:
        """Return M x for a vector or for columns."""

    @abc.abstractmethod
    def mass_b_times(self, a: Array) -> Array:
        """Return (M a)_b with a held, shape (n_q, n_b)."""

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
        """Return Phi_q^T lam, shape (n_q,), or its columns for columns of lam."""

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
