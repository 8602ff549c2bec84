"""States with their rates as one value that can be moved, and directions of them.

The protocol of a mechanical system, by which integrators and sensitivity methods see it.

    M(q, b) a + Phi_q^T lam = Q(t, q, v, b),     Phi(t, q, b) = 0          (eq. 1)

Q holds every force that is not inertia M a: for a mass that depends on q, the quadratic velocity
forces too. The residual of the first equation is f = M a + Phi_q^T lam - Q.

Integrators and sensitivity methods see this and nothing else: no beam, no joint. Matrices are
value vectors on a fixed `SparsityPattern`, by default ``matrix.ravel()``.

**Eleven values** say what a system is; they are abstract here, and written in operations that
accept complex numbers: its sizes, its design variables, `start`, `mass`, `force` and `constraint`,
and their first derivatives, `force_along` of the force and `constraint_q` of the constraints. A
mass that depends on q adds `mass_along`. **Everything else** follows by complex steps and products;
it may be overridden where a formula is faster, and `check_system` compares each override with the
default that it replaces.

**Rates.** The constraints and their time derivatives are one object by order: a motion
(q, v, a, j) is given up to the rates needed, and the order is the number of rates in it.

    constraint(t, q, v, a)       d^2 Phi/dt^2 = Phi_q a + (Phi_q v)_q v + 2 Phi_qt v + Phi_tt
    constraint_q(t, q, v, a)     d^2 Phi_q/dt^2 = (d^2 Phi/dt^2)_q

With the last rate zero, minus this is the right side of Phi_q v = nu, Phi_q a = gamma and
Phi_q j = S.

**Names.** A partial ``X_y`` has shape X.shape + y.shape. A ``_total`` is the derivative with
respect to the design variables along given derivatives of its arguments, F_x x_b + F_b. A
``pull_back`` is its transpose: from covectors to the design. ``_along`` is the derivative along a
direction of (t, q, v).
"""

from __future__ import annotations

import abc
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations.complex_steps import ComplexSteps
from ancfdae.equations.contact_record import ContactRecord
from ancfdae.equations.naming import Naming
from ancfdae.errors.checks import require_array, require_finite, require_flag
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import listed
from ancfdae.kernels import CalledPlan, ListPlan, OperationList, Plan
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import SparsityPattern

#: (q, v, a, lam) at an instant, or their derivatives.
States: TypeAlias = tuple[Array, Array, Array, Array]


class StateDirection(NamedTuple):
    """A direction of (t, q, v): along the motion it is (1, v, a)."""

    t: float
    q: Array
    v: Array


class Motion(NamedTuple):
    """State at one instant, or a change of it; what a quantity does not depend on is zero."""

    q: Array
    v: Array
    a: Array
    lam: Array
    t: Any

    def plus(self, e: float, change: Motion) -> Motion:
        """Add e times a change."""
        return Motion(*(x + e * dx for x, dx in zip(self, change, strict=True)))


@final
@dataclass(frozen=True)
class SystemProperties:
    """Properties of a system that hold in every state, such as a constant mass.

    Attributes
    ----------
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
    project_start : bool
        Whether an inconsistent start is projected instead of refused.
    routed : bool
        Whether a guide or a rope may leave its route, so that runs ask `off_route`.
    force_round_off : float
        Size of the round-off in Q in the norm sqrt(sum Q^2 / weights); zero where it is that of
        Q itself. Newton corrections that stop shrinking at this size are accepted.
    breakpoints : tuple of float
        Instants between which forces and constraints are smooth in time: a step under error control
        ends at each, for it could miss what lies between two of them.
    """

    constant_mass: bool = False
    linear_constraints: bool = False
    constant_constraints: bool = False
    velocity_forces: bool = True
    symmetric: bool = False
    project_start: bool = False
    routed: bool = False
    force_round_off: float = 0.0
    breakpoints: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        *flags, round_off, breakpoints = fields(self)
        for flag in flags:
            require_flag(f"SystemProperties.{flag.name}", getattr(self, flag.name))
        require_finite(f"SystemProperties.{round_off.name}", self.force_round_off)
        require_array(f"SystemProperties.{breakpoints.name}", self.breakpoints)


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
    """Partials with respect to the design at k instants with everything else held.

    f_b = (M a)_b + (Phi_q^T lam)_b - Q_b has the shape (k, n_q, n_b), Phi_b (k, n_lam, n_b).
    """

    f_b: Array
    Phi_b: Array


class MechanicalSystem(ComplexSteps):
    """A constrained mechanical system at given values of its design variables.

    Attributes
    ----------
    n_q, n_lam : int
        Numbers of coordinates and constraints.
    design_names : tuple of str
    b : array, shape (n_b,)
        Values of the design variables; complex in a complex-step run.
    """

    n_lam: int
    traits: SystemProperties = SystemProperties()
    #: Distance from the origin of places that forces refer to beside the coordinates; zero if none.
    reach: float = 0.0
    #: Names of points and joints for the solution; None for a system without any.
    naming: Naming | None = None
    #: Components of a vector: every `vector_size` coordinates in a row are those of one vector in
    #: space, and tolerances of a step are relative to its size. One where there are no vectors.
    vector_size: int = 1
    #: Names of functions of a user that are called with complex numbers at each evaluation.
    called_functions: tuple[str, ...] = ()
    #: Names of controllers with states: velocities of coordinates that do not stand still in an
    #: equilibrium.
    controllers: tuple[str, ...] = ()
    #: Whether joints may close loops; a tree of bodies keeps the rank of Phi_q.
    has_loops: bool = True
    #: Whether Phi is known not to depend on time by itself.
    scleronomic: bool = False

    @cached_property
    def pattern(self) -> SparsityPattern:
        """Pattern (n_q x n_q) of M, (M a)_q, Q_q, Q_v, (Phi_q^T lam)_q together; here full."""
        return SparsityPattern.full((self.n_q, self.n_q))

    @cached_property
    def constraint_pattern(self) -> SparsityPattern:
        """Pattern (n_lam x n_q) of Phi_q; full by default."""
        return SparsityPattern.full((self.n_lam, self.n_q))

    @cached_property
    def weights(self) -> Array:
        """Positive weights, (n_q,), of coordinates in norms and scalings; here M's diagonal."""
        M = self.mass(self.start()[0])
        return np.asarray(M[self.pattern.diagonal].real, dtype=float)

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """For every constraint the joint it belongs to, length n_lam; numbers by default."""
        return tuple(f"constraint {i}" for i in range(1, self.n_lam + 1))

    # -- the values that a system is -------------------------------------------------------------

    @abc.abstractmethod
    def start(self) -> tuple[Array, Array]:
        """Return the start (q, v) as declared, before any projection; shapes (n_q,)."""

    @abc.abstractmethod
    def mass(self, q: Array) -> Array:
        """Return the values of M on `pattern`, shape (nnz,)."""

    @abc.abstractmethod
    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the force Q(t, q, v), shape (n_q,): all forces but M a; to be written."""

    @abc.abstractmethod
    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of Q along a direction, Q_q dq + Q_v dv + Q_t dt, shape (n_q,)."""

    @abc.abstractmethod
    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi or its time derivative of order 1 to 3, shape (n_lam,)."""

    @abc.abstractmethod
    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return Phi_q or its time derivative on `constraint_pattern`; write orders 0 and 1.

        It is also the partial of `constraint` of the same order with respect to q. Of orders 2 and
        3, which the transposed start asks for, this is a complex step of `constraint`: call it by
        ``super()`` where there is no formula.
        """
        pattern = self.constraint_pattern
        return self._by_coordinate(
            lambda q: self.constraint(t, q, *motion[1:]), motion[0], pattern, *motion[1:]
        )

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return the values of M_q dq on `pattern`; to be written unless the mass is constant."""
        if self.traits.constant_mass:
            return np.zeros(self.pattern.size)
        raise InvalidInputError(
            f"{type(self).__name__}.mass_along",
            "must be written where the mass depends on q",
            "no such method",
            "Write it, or declare traits = SystemProperties(constant_mass=True).",
        )

    # -- values with their derivatives -------------------------------------------------------------

    def start_b(self) -> tuple[Array, Array]:
        """Return the partials of `start`; shapes (n_q, n_b)."""
        both = self._total(lambda system: np.concatenate(system.start()))
        return both[: self.n_q], both[self.n_q :]

    def start_pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return q_b^T on_q + v_b^T on_v for the partials of `start`, shape (n_b,)."""
        q_b, v_b = self.start_b()
        return np.asarray(on_q @ q_b + on_v @ v_b)

    def mass_times(self, q: Array, x: Array) -> Array:
        """Return M x for a vector or for columns."""
        return self.pattern.dot(self.mass(q), x)

    def force_and_total(self, t: float, q_rows: Array, v_rows: Array) -> Array:
        """Return Q and its total derivatives with respect to the design as rows, (1 + n_b, n_q).

        The first rows of both are the state, the others its derivatives; shape (1 + n_b, n_q).
        """
        states = ((x[0], x[1:].T) for x in (q_rows, v_rows))
        total = self._total(lambda system, q, v: system.force(t, q, v), *states)
        return np.concatenate([self.force(t, q_rows[0], v_rows[0])[None], total.T])

    def require_derivatives_at(self, t: float, q: Array, v: Array) -> None:
        """Refuse functions that are called and lack a derivative at a state; by default none."""

    def breakpoints(self, t_end: float) -> tuple[float, ...]:
        """Return the times, in s, at which steps under error control end in a run to `t_end`.

        By default the breakpoints of `traits`.
        """
        return self.traits.breakpoints

    def over_time(self, t: Array) -> Array:
        """Return forces and constraints at times t, shape (k, n), with the start's state held.

        They show how Q and Phi depend on time by itself: changes that are too fast for the steps of
        a run are found by comparing neighbouring times. By default Q and Phi at the start.
        """
        q, v = self.start()
        return np.array([np.append(self.force(s, q, v), self.constraint(s, q)) for s in t.tolist()])

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return the loads in Q that turn with the motion, at rest, and their Jacobian in q.

        Shape (n_q,), and values on `pattern`. A search for an equilibrium scales them; other loads
        it takes as they are at its start.
        """
        return np.zeros_like(q), np.zeros(self.pattern.size)

    def stress_force(self, q: Array) -> Array:
        """Return the part of Q at rest that vanishes where bodies are free of stress.

        Coordinates are rounded, and stiff bodies turn that into forces. By default zero: a system
        of equations has no bodies.
        """
        return np.zeros_like(q)

    def centred(self, q: Array) -> Array:
        """Return coordinates that do not change if the system stands elsewhere, of its size.

        Here q: a system of equations has no place.
        """
        return q

    def folded(self, q: Array) -> str:
        """Say which parts are folded at q, in a way that no body can be; empty where none is.

        Forces may be in balance there nevertheless. A search for an equilibrium does not accept
        such a state.
        """
        return ""

    def coarse(self, q: Array) -> dict[str, float]:
        """Return the parts whose mesh is too coarse at q, with the error of the energy of each."""
        return {}

    def strained(self, q: Array) -> dict[str, float]:
        """Return the parts strained beyond the range of their laws at q, each with its strain."""
        return {}

    def contacts(self) -> ContactRecord | None:
        """Return a new record of the contacts of one run; None for a system without contacts."""
        return None

    def constraints_q(self, t: Array, *motion: Array) -> Array:
        """Return the values of `constraint_q` at k time points, (k, nnz), from rows, (k, n_q)."""
        return np.array([self.constraint_q(*x) for x in zip(t.tolist(), *motion, strict=True)])

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None = None
    ) -> Array:
        """Return the total derivative of `constraint` with respect to the design, (n_lam, n_b).

        Along the derivatives of the motion, (n_q, n_b) each; without them the motion is held.
        """
        if motion_b is None:
            return self._total(lambda system: system.constraint(t, *motion))
        pairs = zip(motion, motion_b, strict=True)
        return self._total(lambda system, *x: system.constraint(t, *x), *pairs)

    # -- prescribed turns --------------------------------------------------------------------------

    def off_root(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first of k instants at which a constraint holds at a wrong root, and its name.

        The equation of a prescribed angle holds half a turn off as well. t has the shape (k,), q
        (k, n_q). None if all roots are right; by default, of constraints with one root.
        """
        return None

    def mirrored(self, q: Array) -> tuple[int, str] | None:
        """Return the index of the first mirrored, folded or crushed state, and what is, in words.

        q has the shape (k, n_q). A body is mirrored where its orientation differs from that in the
        first state, folded where it is bent back on itself, and crushed where its law gives way.
        Steps may end there, for the strain energy is finite, but no motion leads there. The words
        begin with a verb and end with a remedy. None if no state is, and by default.
        """
        return None

    def off_route(self, t: Array, q: Array, v: Array) -> tuple[int, str] | None:
        """Return the first of k states up to which a part has left its route, and in words how.

        q and v have the shape (k, n_q). It is called if the system is `routed`. None if no part is.
        """
        return None

    def turn_rate(self, t: Array) -> Array:
        """Return the largest rate at which constraints prescribe an angle, (k,); rad/s."""
        return np.zeros(len(t))

    # -- the residual f = M a + Phi_q^T lam - Q ----------------------------------------------------

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return the Jacobians of f and Phi at k instants; states are rows (k, n).

        If v is None the force Q is left out: they are those of M a + Phi_q^T lam and Phi.
        """
        traits, instants = self.traits, list(_instants(t, q, v, a, lam))
        M = np.array([self.mass(x) for x in (q[:1] if traits.constant_mass else q)])
        Phi_q = np.array([self.constraint_q(s, x) for s, (x, *_) in instants])
        f_q = np.array([self._residual_q(s, *states) for s, states in instants])
        if v is None or not traits.velocity_forces:
            return Linearisation(M, f_q, None, Phi_q)
        f_v = np.array([self._residual_v(*state) for state in zip(t.tolist(), q, v, strict=True)])
        return Linearisation(M, f_q, f_v, Phi_q)

    def design_partials(
        self, t: Array, q: Array, v: Array | None, a: Array, lam: Array
    ) -> DesignPartials:
        """Return the partials of f and Phi with respect to the design at k instants.

        If v is None the force Q is left out: they are those of M a + Phi_q^T lam and Phi.
        """
        f_b, Phi_b = [], []
        for s, states in _instants(t, q, v, a, lam):
            f_b.append(self._total(lambda system, s=s, x=states: residual(system, s, *x)))
            Phi_b.append(self.constraint_total(s, states[:1]))
        return DesignPartials(np.array(f_b), np.array(Phi_b))

    def pull_back(
        self,
        t: Array,
        states: tuple[Array, Array | None, Array, Array],
        covectors: tuple[Array, Array],
    ) -> Array:
        """Return the sum over k instants of f_b^T mu + Phi_b^T zeta, shape (n_b,).

        The states are (q, v, a, lam) and the covectors (mu, zeta), arrays with k rows; v as in
        `design_partials`.
        """
        partials = self.design_partials(t, *states)
        mu, zeta = covectors
        on_f = np.einsum("knb,kn->b", partials.f_b, mu)
        return np.asarray(on_f + np.einsum("knb,kn->b", partials.Phi_b, zeta))

    def along_total(
        self,
        t: float,
        states: States,
        direction: StateDirection,
        states_b: States,
        direction_b: tuple[Array, Array],
    ) -> Array:
        """Return the total derivative of `residual_along` with respect to the design, (n_q, n_b).

        Along derivatives of (q, v, a, lam), and of q and v of the direction, (n, n_b) each.
        """

        def value(system: MechanicalSystem, *x: Array) -> Array:
            q, v, a, lam, dq, dv = x
            return residual_along(system, t, (q, v, a, lam), StateDirection(direction.t, dq, dv))

        x, x_b = (*states, *direction[1:]), (*states_b, *direction_b)
        return self._total(value, *zip(x, x_b, strict=True))

    def along_pull_back(
        self, t: float, states: States, direction: StateDirection, mu: Array
    ) -> tuple[Array, Array, Array]:
        """Return the partials of mu . `residual_along` with respect to q, v and b.

        Accelerations, multipliers and the direction are held fixed.
        """
        q, v, a, lam = states
        beside = (*states, *direction[1:])

        def along(q: Array, v: Array) -> Array:
            return residual_along(self, t, (q, v, a, lam), direction)

        on_b = mu @ self._total(lambda system: residual_along(system, t, (q, v, a, lam), direction))
        dot = self.pattern.dot_transposed
        on_q = dot(self._by_coordinate(lambda x: along(x, v), q, self.pattern, *beside), mu)
        if not self.traits.velocity_forces:
            return on_q, np.zeros_like(mu), on_b
        on_v = self._by_coordinate(lambda x: along(q, x), v, self.pattern, *beside)
        return on_q, dot(on_v, mu), on_b

    def _residual_q(self, t: float, q: Array, v: Array | None, a: Array, lam: Array) -> Array:
        beside = v, a, lam
        return self._by_coordinate(
            lambda x: residual(self, t, x, *beside), q, self.pattern, *beside
        )

    def _residual_v(self, t: float, q: Array, v: Array) -> Array:
        return self._by_coordinate(lambda x: -self.force(t, q, x), v, self.pattern, q)


class PlannedSystem(MechanicalSystem):
    """A system that a kernel can march by itself."""

    @property
    @abc.abstractmethod
    def plan(self) -> Plan | None:
        """Arrays of the system for kernels; None where kernels call its functions instead."""


class ListedSystem(MechanicalSystem):
    """A system whose accelerations a kernel finds by itself, from lists of operations."""

    @abc.abstractmethod
    def index_1(self, derivatives: bool) -> tuple[OperationList, ...]:
        """Return the lists of `kernels/index_1.h`, with or without lists of design derivatives."""

    @property
    @abc.abstractmethod
    def list_plan(self) -> ListPlan:
        """The lists that a kernel integrates."""


def require_no_controllers(where: str, system: MechanicalSystem, repair: str) -> None:
    """Raise InvalidInputError if the system has controllers with states."""
    if system.controllers:
        rule = "must have no controllers with states, which are not at rest in an equilibrium"
        raise InvalidInputError(where, rule, listed(map(repr, system.controllers)), repair)


class LaterSystem(MechanicalSystem):
    """A system from a later time on, which a kernel marches by the plan of the system itself."""

    @property
    @abc.abstractmethod
    def later_plan(self) -> Plan | ListPlan | CalledPlan:
        """The plan with its time shifted; its own functions where there is no other plan."""


def planned(system: MechanicalSystem) -> Plan | ListPlan | CalledPlan:
    """Return the system as kernels take it: arrays, lists of operations, or functions to call."""
    if isinstance(system, LaterSystem):
        return system.later_plan
    if isinstance(system, ListedSystem):
        return system.list_plan
    plan = system.plan if isinstance(system, PlannedSystem) else None
    return plan or called_plan(system)


def called_plan(system: MechanicalSystem) -> CalledPlan:
    """Return a system by its functions; they run with the GIL while a kernel takes steps."""

    def tangents(t: float, *states: Array) -> tuple[Array, Array | None]:
        local = system.linearise(np.array([t]), *(x[None] for x in states))
        return local.f_q[0], None if local.f_v is None else local.f_v[0]

    values = system.mass, system.constraint_q, system.constraint, system.force
    functions = *values, tangents, system.following_load
    B, K = (x.rows_of(np.zeros(x.size)) for x in (system.constraint_pattern, system.pattern))
    weights, velocity = system.weights, system.traits.velocity_forces
    return CalledPlan(functions, weights, 1 / weights, B, K, velocity)


def residual(
    system: MechanicalSystem, t: float, q: Array, v: Array | None, a: Array, lam: Array
) -> Array:
    """Return f = M a + Phi_q^T lam - Q, shape (n_q,); without v, f + Q."""
    value = system.mass_times(q, a) + reaction(system, t, q, lam)
    return value if v is None else value - system.force(t, q, v)


def reaction(system: MechanicalSystem, t: float, q: Array, lam: Array) -> Array:
    """Return Phi_q^T lam, shape (n_q,)."""
    return system.constraint_pattern.dot_transposed(system.constraint_q(t, q), lam)


def residual_along(
    system: MechanicalSystem, t: float, states: States, direction: StateDirection
) -> Array:
    """Return the derivative of f along a direction of (t, q, v) with a and lam held, (n_q,)."""
    q, v, a, lam = states
    moved = system.constraint_pattern.dot_transposed(
        constraint_q_along(system, t, q, direction), lam
    )
    value = moved - system.force_along(t, q, v, direction)
    if system.traits.constant_mass:
        return value
    return value + system.pattern.dot(system.mass_along(q, direction.q), a)


def constraint_q_along(
    system: MechanicalSystem, t: float, q: Array, direction: StateDirection
) -> Array:
    """Return the derivative of Phi_q along a direction on `constraint_pattern`.

    dPhi_q/dt = (Phi_q v)_q + Phi_qt is affine in v: what it is at rest belongs to time.
    """
    rate = system.constraint_q(t, q, direction.q)
    if direction.t == 1:
        return rate
    return rate - (1 - direction.t) * system.constraint_q(t, q, 0 * direction.q)


def _instants(
    t: Array, q: Array, v: Array | None, a: Array, lam: Array
) -> Iterator[tuple[float, tuple[Array, Array | None, Array, Array]]]:
    """Yield time and states of one instant after the other."""
    for k, s in enumerate(t.tolist()):
        yield s, (q[k], None if v is None else v[k], a[k], lam[k])
