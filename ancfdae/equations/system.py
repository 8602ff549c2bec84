"""The base class of mechanical systems, by which integrators and sensitivity methods see them.

    M(q, b) a + Phi_q^T lam = Q(t, q, v, b),     Phi(t, q, b) = 0          (eq. 1)

Q holds every force except the inertia M a; for a mass that depends on q it includes the quadratic
velocity forces. The residual of the first equation is f = M a + Phi_q^T lam - Q.

Integrators and sensitivity methods use nothing else: they know no beam and no joint. Matrices are
value vectors on a fixed `SparsityPattern`, by default ``matrix.ravel()``.

**Eleven values** define a system; they are abstract here, and implemented in operations that accept
complex numbers: its sizes, its design variables, `start`, `mass`, `force` and `constraint`, and the
first derivatives `force_along` of the force and `constraint_q` of the constraints. A mass that
depends on q adds `mass_along`. **Everything else** follows by complex steps and products; it may be
overridden where a formula is faster, and `check_system` compares each override with the default
that it replaces.

**Rates.** The constraints and their time derivatives are one method by order: a motion (q, v, a, j)
is given up to the rates needed, and the order is the number of rates in it.

    constraint(t, q, v, a)       d^2 Phi/dt^2 = Phi_q a + (Phi_q v)_q v + 2 Phi_qt v + Phi_tt
    constraint_q(t, q, v, a)     d^2 Phi_q/dt^2 = (d^2 Phi/dt^2)_q

With the last rate zero, minus these are the right-hand sides of Phi_q v = nu, Phi_q a = gamma and
Phi_q j = S.

**Names.** A partial ``X_y`` has shape X.shape + y.shape. A ``_total`` is the derivative with
respect to the design variables along given derivatives of its arguments, F_x x_b + F_b. A
``pull_back`` is its transpose: from adjoint vectors to the design. ``_along`` is the derivative
along a direction of (t, q, v).
"""

from __future__ import annotations

import abc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations.complex_steps import ComplexSteps
from ancfdae.equations.naming import Naming
from ancfdae.equations.plans import CalledPlan, DesignPlan, FactorTable, ListPlan, Plan
from ancfdae.equations.solution_parts import ContactRecord, LeftOut
from ancfdae.errors.checks import require_array, require_finite, require_flag
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import OperationList
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import SparsityPattern

#: (q, v, a, lam) at one time, or their derivatives.
States: TypeAlias = tuple[Array, Array, Array, Array]


class StateDirection(NamedTuple):
    """A direction (dt, dq, dv) in the space of (t, q, v); along the motion it is (1, v, a)."""

    t: float
    q: Array
    v: Array


class Motion(NamedTuple):
    """State (q, v, a, lam, t) at one time, or a change of it."""

    q: Array
    v: Array
    a: Array
    lam: Array
    t: Any

    def plus(self, e: float, change: Motion) -> Motion:
        """Return the state plus e times a change."""
        return Motion(*(x + e * dx for x, dx in zip(self, change, strict=True)))


@final
@dataclass(frozen=True)
class SystemProperties:
    """Properties that a system declares to hold in every state, such as a constant mass.

    Attributes
    ----------
    constant_mass : bool
        Whether M does not depend on q; it is then formed once.
    linear_constraints : bool
        Whether Phi is linear in q, so that (Phi_q^T lam)_q vanishes.
    constant_constraints : bool
        Whether Phi is linear in q and the same at all times and designs: Phi_q q minus a constant,
        with one Phi_q.
    velocity_forces : bool
        Whether Q depends on v.
    symmetric : bool
        Whether M, (M a)_q, Q_q, Q_v and (Phi_q^T lam)_q are symmetric matrices; systems of
        equations then take less than half the time.
    project_start : bool
        Whether an inconsistent start is projected instead of raising an error.
    routed : bool
        Whether a guide or a rope may leave its route, so that runs call `off_route`.
    leaves_out : bool
        Whether pairs of bodies that are far from each other are left out, so that runs call
        `along`, and follow the pairs by `left_out`.
    rows_left_out : bool
        Whether redundant equations of joints are left out, which a change of the design may break:
        derivatives call `require_derivatives_at`.
    slender : bool
        Whether flexible elements are so long for their height that membrane locking is possible;
        gradients of runs then check their meshes.
    force_round_off : float
        Round-off of Q in the norm sqrt(sum Q^2 / weights); zero if it is the round-off of Q
        itself. Newton corrections that stop decreasing at this level are accepted.
    breakpoints : tuple of float
        Times between which forces and constraints are smooth functions of time; s. A step under
        error control ends at each of them, because it could miss a pulse between two of them.
    """

    constant_mass: bool = False
    linear_constraints: bool = False
    constant_constraints: bool = False
    velocity_forces: bool = True
    symmetric: bool = False
    project_start: bool = False
    routed: bool = False
    leaves_out: bool = False
    rows_left_out: bool = False
    slender: bool = False
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
    """Jacobians of f and Phi at k times as values on the system's patterns, shape (k, nnz).

    f = M a + Phi_q^T lam - Q at fixed a. M has one row if the mass is constant; f_v is None if f
    does not depend on v.
    """

    M: Array
    f_q: Array
    f_v: Array | None
    Phi_q: Array


@final
@dataclass(frozen=True)
class DesignPartials:
    """Partials of f and Phi with respect to the design at k times, at fixed t, q, v, a and lam.

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
    #: Largest distance from the origin of positions, besides q, that forces refer to; zero if none.
    reach: float = 0.0
    #: Names of points and joints for the solution; None for a system without any.
    naming: Naming | None = None
    #: Components of a vector: `vector_size` consecutive coordinates form one vector in space, and
    #: tolerances of a step are relative to its norm. One if coordinates form no vectors.
    vector_size: int = 1
    #: Names of functions of a user that are called with complex numbers at each evaluation.
    called_functions: tuple[str, ...] = ()
    #: Names of controllers with states; states are velocities of coordinates, which are not zero in
    #: an equilibrium.
    controllers: tuple[str, ...] = ()
    #: Indices of the coordinates whose velocities are the states of controllers.
    state_places: Array = np.zeros(0, dtype=int)
    #: Whether joints may close loops; in a tree of bodies Phi_q keeps its rank.
    has_loops: bool = True
    #: Whether Phi is known not to depend explicitly on time.
    scleronomic: bool = False
    #: Whether formulas may be infinite where `divisors` vanish, so that runs call this method.
    divides: bool = False

    @cached_property
    def pattern(self) -> SparsityPattern:
        """Pattern of M, (M a)_q, Q_q, Q_v and (Phi_q^T lam)_q, (n_q, n_q); full by default."""
        return SparsityPattern.full((self.n_q, self.n_q))

    @cached_property
    def constraint_pattern(self) -> SparsityPattern:
        """Pattern (n_lam x n_q) of Phi_q; full by default."""
        return SparsityPattern.full((self.n_lam, self.n_q))

    @cached_property
    def weights(self) -> Array:
        """Positive weights, (n_q,), of coordinates in norms and scalings; the diagonal of M."""
        M = self.mass(self.start()[0])
        return np.asarray(M[self.pattern.diagonal].real, dtype=float)

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """Name of the joint of every constraint equation, n_lam in all; numbers by default."""
        return tuple(f"constraint {i}" for i in range(1, self.n_lam + 1))

    # -- the values that a system is -------------------------------------------------------------

    @abc.abstractmethod
    def start(self) -> tuple[Array, Array]:
        """Return q and v at t = 0 as declared, before any projection; shape (n_q,) each."""

    @abc.abstractmethod
    def mass(self, q: Array) -> Array:
        """Return the values of M on `pattern`, shape (nnz,)."""

    @abc.abstractmethod
    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the force Q(t, q, v), shape (n_q,): all forces except the inertia M a."""

    @abc.abstractmethod
    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of Q along a direction, Q_q dq + Q_v dv + Q_t dt, shape (n_q,)."""

    @abc.abstractmethod
    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi, (n_lam,), or its time derivative of the order of the rates in `motion`."""

    @abc.abstractmethod
    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return the values of Phi_q, or of its time derivative, on `constraint_pattern`, (nnz,).

        It is also the partial in q of `constraint` of the same order. Implement orders 0 and 1.
        Orders 2 and 3, needed at the start of the adjoint, are here a complex step of `constraint`:
        call it by ``super()`` if there is no formula.
        """
        pattern = self.constraint_pattern
        return self._by_coordinate(
            lambda q: self.constraint(t, q, *motion[1:]), motion[0], pattern, *motion[1:]
        )

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return the values of M_q dq on `pattern`; implement it unless the mass is constant."""
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
        """Return the design derivatives of `start`, shape (n_q, n_b) each."""
        both = self._total(lambda system: np.concatenate(system.start()))
        return both[: self.n_q], both[self.n_q :]

    def start_pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return q_b^T on_q + v_b^T on_v for the design derivatives of `start`, shape (n_b,)."""
        q_b, v_b = self.start_b()
        return np.asarray(on_q @ q_b + on_v @ v_b)

    def mass_times(self, q: Array, x: Array) -> Array:
        """Return M x for a vector x, shape (n_q,), or for columns, (n_q, k)."""
        return self.pattern.dot(self.mass(q), x)

    def force_and_total(self, t: float, q_rows: Array, v_rows: Array) -> Array:
        """Return Q and its total design derivatives as rows, shape (1 + n_b, n_q).

        The first rows of `q_rows` and `v_rows` are the state, the others its design derivatives.
        """
        states = ((x[0], x[1:].T) for x in (q_rows, v_rows))
        total = self._total(lambda system, q, v: system.force(t, q, v), *states)
        return np.concatenate([self.force(t, q_rows[0], v_rows[0])[None], total.T])

    def require_derivatives_at(self, t: float, q: Array, v: Array) -> None:
        """Raise InvalidInputError if the motion has no derivative at a state.

        A function of the user may lack one there, or a change of the design opens a joint of which
        redundant equations are left out. By default it raises nothing.
        """

    def breakpoints(self, t_end: float) -> tuple[float, ...]:
        """Return the times, s, at which error-controlled steps must end in a run to `t_end`.

        By default the breakpoints of `traits`.
        """
        return self.traits.breakpoints

    def over_time(self, t: Array) -> Array:
        """Return forces and constraints at times t in the state of the start, shape (k, n).

        They show how Q and Phi depend explicitly on time: changes that are too fast for the steps
        of a run are found by comparing neighbouring times.
        """
        q, v = self.start()
        return np.array([np.append(self.force(s, q, v), self.constraint(s, q)) for s in t.tolist()])

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return the follower loads in Q at zero velocity, and their Jacobian in q.

        Shape (n_q,), and values on `pattern`. A search for equilibrium scales them with the load
        factor; other loads are scaled as they are at the start.
        """
        return np.zeros_like(q), np.zeros(self.pattern.size)

    def stress_force(self, q: Array) -> Array:
        """Return the part of Q at zero velocity that vanishes in stress-free bodies, (n_q,).

        It measures round-off: rounded coordinates of stiff bodies cause forces. By default zero.
        """
        return np.zeros_like(q)

    def centred(self, q: Array) -> Array:
        """Return coordinates that do not depend on where the system is in space, (n_q,).

        By default q itself.
        """
        return q

    def folded(self, q: Array) -> str:
        """Return a text naming bodies folded at q, as no body can be; empty if there are none.

        Forces may be in equilibrium there nevertheless. A search for equilibrium rejects such a
        state.
        """
        return ""

    def coarse(self, states: Array, moving: bool = False) -> dict[str, float]:
        """Return, by name, bodies whose mesh is too coarse in states, rows of q, with its error.

        The error is relative to the energy. `moving` leaves out bodies that inertia may shape.
        """
        return {}

    def strained(self, q: Array) -> dict[str, float]:
        """Return, by name, the bodies strained beyond the validity of their laws, with strains."""
        return {}

    def contacts(self) -> ContactRecord | None:
        """Return a new record of the contacts of one run; None for a system without contacts."""
        return None

    def along(self, q: Array, wider: float = 1.0) -> MechanicalSystem:
        """Return the same system in the form that computes forces in states q, (k, n_q).

        It is called if the system `leaves_out` pairs of bodies; by default it is itself. `wider`
        multiplies the distance up to which pairs are near.
        """
        return self

    @final
    def in_all_states(self) -> MechanicalSystem:
        """Return the system in the form that computes forces in all states, with all pairs."""
        return self.along(self.start()[0][None], np.inf) if self.traits.leaves_out else self

    def left_out(self) -> Sequence[LeftOut]:
        """Return searches for pairs of bodies that touch but are left out; by default none."""
        return ()

    def constraints_q(self, t: Array, *motion: Array) -> Array:
        """Return the values of `constraint_q` at k times, (k, nnz), for rows of the motion."""
        return np.array([self.constraint_q(*x) for x in zip(t.tolist(), *motion, strict=True)])

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None = None
    ) -> Array:
        """Return the total design derivative of `constraint`, shape (n_lam, n_b).

        `motion_b` holds the derivatives of the motion, (n_q, n_b) each; if None the motion is
        fixed.
        """
        if motion_b is None:
            return self._total(lambda system: system.constraint(t, *motion))
        pairs = zip(motion, motion_b, strict=True)
        return self._total(lambda system, *x: system.constraint(t, *x), *pairs)

    # -- prescribed angles -------------------------------------------------------------------------

    def off_root(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first of k times at which a constraint holds at a wrong root, and its name.

        The equation of a prescribed angle holds half a turn off as well. t has the shape (k,), q
        (k, n_q). None if all roots are right, as by default.
        """
        return None

    def mirrored(self, q: Array) -> tuple[int, str] | None:
        """Return the index of the first mirrored, folded or crushed state, and a message.

        q has the shape (k, n_q). A body is mirrored if its orientation differs from the first
        state, folded if it is bent back on itself, and crushed if its force decreases with
        compression. Steps may lead there, because the strain energy is finite, but no motion does.
        The message begins with a verb and ends with a remedy. None if all states are intact, as by
        default.
        """
        return None

    def off_route(self, t: Array, q: Array, v: Array) -> tuple[int, str] | None:
        """Return the first of k states up to which a part left its route, and a message.

        q and v have the shape (k, n_q). It is called if the system is `routed`. None if all parts
        stay on their routes.
        """
        return None

    def opened(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first of k states that opens a joint with equations left out, and its name.

        q has the shape (k, n_q). It is called if the system has `rows_left_out`. None if all joints
        are closed, as by default.
        """
        return None

    def divisors(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Return the divisors in formulas in k states, (k, n) by the name of the formula.

        Products are given by their factors, and powers and roots by their bases. A formula may be
        infinite where one of them vanishes.
        """
        return {}

    def turn_rate(self, t: Array) -> Array:
        """Return the largest rate at which constraints prescribe an angle at t, (k,); rad/s."""
        return np.zeros(len(t))

    # -- the residual f = M a + Phi_q^T lam - Q ----------------------------------------------------

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return the Jacobians of f and Phi at k times; states are rows, (k, n).

        If v is None the force Q is left out: the Jacobians are those of M a + Phi_q^T lam and Phi.
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
        """Return the partials of f and Phi with respect to the design at k times.

        If v is None the force Q is left out: the partials are those of M a + Phi_q^T lam and Phi.
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
        """Return the sum over k times of f_b^T mu + Phi_b^T zeta, shape (n_b,).

        The `states` are (q, v, a, lam) and the adjoint vectors `covectors` (mu, zeta), arrays with
        k rows; v may be None as in `design_partials`.
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
        """Return the total design derivative of `residual_along`, shape (n_q, n_b).

        `states_b` are the derivatives of (q, v, a, lam), `direction_b` those of q and v of the
        direction, (n, n_b) each.
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
    """A system that a kernel can integrate by itself, from arrays."""

    @property
    @abc.abstractmethod
    def plan(self) -> Plan | None:
        """Arrays of the system for kernels; None if kernels must call its functions instead."""

    @property
    @abc.abstractmethod
    def design_plan(self) -> DesignPlan:
        """Design derivatives of the arrays of `plan`."""

    @property
    @abc.abstractmethod
    def timed(self) -> bool:
        """Whether factors of joints or loads in `plan` change with time."""

    @abc.abstractmethod
    def factor_table(self, t: Array, derivatives: bool) -> FactorTable:
        """Return the factors of joints and loads at times t, (k,), with design partials or None."""


class ListedSystem(MechanicalSystem):
    """A system that a kernel can integrate by itself, from lists of operations."""

    @abc.abstractmethod
    def index_1(self, derivatives: bool) -> tuple[OperationList, ...]:
        """Return the operation lists of `kernels/index_1.h`, with or without derivatives."""

    @property
    @abc.abstractmethod
    def list_plan(self) -> ListPlan:
        """Operation lists with which a kernel evaluates the equations of motion in a time step."""

    @abc.abstractmethod
    def constraint_partials(self, t: Array, *motion: Array) -> Array:
        """Return the design derivatives of `constraint` at k times, shape (k, n_lam, n_b)."""


class LaterSystem(MechanicalSystem):
    """A system that starts at a later time, with the shifted plan of the original system."""

    @property
    @abc.abstractmethod
    def later_plan(self) -> Plan | ListPlan | CalledPlan:
        """Plan of the system with its time shifted; a plan of its functions if it has no other."""


def planned(system: MechanicalSystem) -> Plan | ListPlan | CalledPlan:
    """Return the plan of a system for kernels: arrays, lists of operations, or functions."""
    if isinstance(system, LaterSystem):
        return system.later_plan
    if isinstance(system, ListedSystem):
        return system.list_plan
    plan = system.plan if isinstance(system, PlannedSystem) else None
    return plan or called_plan(system)


def called_plan(system: MechanicalSystem) -> CalledPlan:
    """Return the plan of a system by its functions, which run with the GIL in a kernel."""

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
    """Return f = M a + Phi_q^T lam - Q, shape (n_q,); without the force Q if v is None."""
    value = system.mass_times(q, a) + reaction(system, t, q, lam)
    return value if v is None else value - system.force(t, q, v)


def reaction(system: MechanicalSystem, t: float, q: Array, lam: Array) -> Array:
    """Return Phi_q^T lam, minus the generalised forces of the constraints, shape (n_q,)."""
    return system.constraint_pattern.dot_transposed(system.constraint_q(t, q), lam)


def residual_along(
    system: MechanicalSystem, t: float, states: States, direction: StateDirection
) -> Array:
    """Return the derivative of f along a direction of (t, q, v) at fixed a and lam, (n_q,)."""
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
    """Return the derivative of Phi_q along a direction on `constraint_pattern`, (nnz,).

    dPhi_q/dt = (Phi_q v)_q + Phi_qt is affine in v; its value at v = 0 is the part due to time.
    """
    rate = system.constraint_q(t, q, direction.q)
    if direction.t == 1:
        return rate
    return rate - (1 - direction.t) * system.constraint_q(t, q, 0 * direction.q)


def _instants(
    t: Array, q: Array, v: Array | None, a: Array, lam: Array
) -> Iterator[tuple[float, tuple[Array, Array | None, Array, Array]]]:
    """Yield t and the state (q, v, a, lam) for one time after another."""
    for k, s in enumerate(t.tolist()):
        yield s, (q[k], None if v is None else v[k], a[k], lam[k])
