"""A phase of a run with events as a mechanical system of its own.

A phase begins at the time t_0 with q_0 and v_0 and lasts D, and all three depend on the design. The
phase is integrated over its own time tau in [0, D_0], where D_0 is the number D at this design,
with sigma = D / D_0:

    t = t_0 + sigma tau,   q(tau),   w = dq/dtau = sigma v,   alpha = sigma^2 a,
    M alpha / sigma^2 + Phi_q^T lam = Q(t, q, w / sigma),   Phi(t, q) = 0.

sigma = 1, so states, forces and matrices equal the ones of the system itself, and integrators and
kernels need no change. Only derivatives in D are new: D stretches all steps by one factor, and
f = M a + Phi_q^T lam - Q has

    f_D = ((Phi_q^T lam - Q)_t tau + Q_v v - 2 M a) / D,   Phi_D = Phi_t tau / D,
    w_D = v / D + v_D.

The derivative in t_0 is f_t and Phi_t. A number of steps in the phase that does not change makes
this the exact derivative of the discrete motion, by every integrator and every method that
differentiates one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from math import comb
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.equations import (
    DesignPartials,
    LaterSystem,
    Linearisation,
    MechanicalSystem,
    StateDirection,
    planned,
)
from ancfdae.equations.plans import CalledPlan, ListPlan, Plan
from ancfdae.equations.solution_parts import ContactRecord, MissedContact
from ancfdae.equations.system import States, called_plan, constraint_q_along, residual_along
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.complex_step import scaled_derivative

# Distances in time, in parts of the phase, after which a value that changes with time differs.
_BESIDE = (1e-3, -1e-2, 0.1)
#: Name of the design variable D that a phase adds to the variables of its system.
DURATION = "duration of the phase"


class PhaseStart(NamedTuple):
    """Time, coordinates and velocities at the start of a phase, with derivatives.

    The derivatives t_b (n,), q_b and v_b (n_q, n) are with respect to the design variables of the
    system and, if there are more columns, to further numbers on which only starts depend.
    """

    t: complex
    q: Array
    v: Array
    t_b: Array
    q_b: Array
    v_b: Array

    @staticmethod
    def held(t: complex, q: Array, v: Array, n_b: int) -> PhaseStart:
        """Return a phase start t, q, v that does not depend on the design."""
        none = np.zeros((len(q), n_b))
        return PhaseStart(t, q, v, np.zeros(n_b), none, none)

    def free(self, n_b: int) -> PhaseStart:
        """Return the start with its t, q and v as 1 + 2 n_q additional design variables."""
        n = len(self.q)
        ahead, unit = np.zeros((n, n_b + 1)), np.eye(n)
        q_b = np.hstack([ahead, unit, 0 * unit])
        return self._replace(
            t_b=np.eye(1, n_b + 1 + 2 * n, n_b)[0], q_b=q_b, v_b=np.hstack([ahead, 0 * unit, unit])
        )


@final
class PhaseSystem(LaterSystem):
    """A system from the start of a phase on, in the time of the phase; see the module.

    Its design variables are the variables of the system, then D, then further numbers of the start.
    `first` is True for the phase that begins with the start of the system. This start is projected
    only where the system allows it; all later starts are.
    """

    def __init__(
        self, base: MechanicalSystem, start: PhaseStart, duration: complex, first: bool
    ) -> None:
        self.base, self._start, self._duration, self._first = base, start, duration, first
        self._scale = duration / np.real(duration)
        self._ahead = base.n_b
        count = len(start.t_b) - base.n_b
        more = tuple(f"number {i} of the start" for i in range(1, count + 1))
        self.design_names = (*base.design_names, DURATION, *more)
        self.b = np.concatenate([base.b, [duration], np.zeros(count)])
        self.n_q, self.n_lam, self.naming = base.n_q, base.n_lam, base.naming
        self.reach, self.vector_size = base.reach, base.vector_size
        self.called_functions, self.has_loops = base.called_functions, base.has_loops
        self.divides = base.divides
        t_0 = float(np.real(start.t))
        self.traits = replace(
            base.traits,
            project_start=base.traits.project_start or not first,
            breakpoints=tuple(t - t_0 for t in base.traits.breakpoints),
        )
        self.pattern, self.constraint_pattern = base.pattern, base.constraint_pattern
        self.weights, self.constraint_names = base.weights, base.constraint_names

    # -- the start, and other values of the design -------------------------------------------------

    def with_values(self, b: Array) -> PhaseSystem:
        """Return the same phase at other values b; the start follows along its derivatives."""
        n = self._ahead
        return self._moved(self.base.with_values(b[:n]), np.asarray(b) - self.b)

    def _moved(self, base: MechanicalSystem, change: Array) -> PhaseSystem:
        n, (t, q, v, t_b, q_b, v_b) = self._ahead, self._start
        db = np.delete(change, n)
        start = PhaseStart(t + t_b @ db, q + q_b @ db, v + v_b @ db, t_b, q_b, v_b)
        system = PhaseSystem(base, start, self._duration, self._first)
        system._scale = self._scale + change[n] / np.real(self._duration)
        system.b = self.b + change
        return system

    def _at_step(self, i: int) -> PhaseSystem:
        if i not in self._steps:
            base = self.base._at_step(i) if i < self._ahead else self.base
            self._steps[i] = self._moved(base, 1j * STEP * np.eye(self.n_b)[i])
        return self._steps[i]

    @cached_property
    def _steps(self) -> dict[int, PhaseSystem]:
        return {}

    def _total(self, value: Callable[..., Array], *states: tuple[Array, Array]) -> Array:
        """Return total design derivatives of `value`, (m, n_b), at `states`, pairs of x and x_b.

        Numbers of the start act through states only.
        """
        n = self._ahead
        moved = np.zeros(self.n_b, dtype=bool)
        moved[: n + 1] = True
        moved[n + 1 :] = self._start.t_b[n:] != 0
        for _, x_b in states:
            moved |= np.any(x_b != 0, axis=0)
        total = np.zeros((len(value(self, *(x for x, _ in states))), self.n_b))
        for i in np.flatnonzero(moved).tolist():
            at = (x + 1j * STEP * x_b[:, i] for x, x_b in states)
            total[:, i] = np.imag(value(self._at_step(i), *at)) / STEP
        return total

    def start(self) -> tuple[Array, Array]:
        """Return the start of the phase in its own time: q_0 and w_0 = sigma v_0, (n_q,) each."""
        return self._start.q, self._scale * self._start.v

    def start_b(self) -> tuple[Array, Array]:
        """Return the derivatives of q_0 and w_0 with respect to the design, (n_q, n_b) each."""
        n, (_, q, v, _, q_b, v_b) = self._ahead, self._start
        none, stretch = np.zeros(len(q)), v / self._duration
        return np.insert(q_b, n, none, axis=1), np.insert(v_b, n, stretch, axis=1)

    def _time(self, tau: float) -> tuple[float, float]:
        """Return the time of the system, s, and its imaginary part at a complex design."""
        t = complex(self._start.t + self._scale * tau)
        return t.real, t.imag

    def _times(self, tau: Array) -> Array:
        """Return times of the system, shape (k,), s, from times of the phase."""
        return np.real(self._start.t + self._scale * tau)

    @cached_property
    def time_b(self) -> tuple[Array, Array]:
        """Derivatives of t_0 and of sigma with respect to the design, (n_b,) each."""
        n, t_b = self._ahead, np.insert(self._start.t_b, self._ahead, 0.0)
        return t_b, np.eye(1, self.n_b, n)[0] / np.real(self._duration)

    def contacts(self) -> ContactRecord | None:
        """Return a record of the contacts of the system, in the time of the phase."""
        own = self.base.contacts()
        return None if own is None else _PhaseContacts(self, own)

    def states_of(self, tau: Array, *states: Array) -> tuple[Array, ...]:
        """Return time, q and v of the system from tau, q and w of the phase, as rows."""
        return self._times(tau), *states[:1], *(x.real for x in self._rates(*states[1:]))

    # -- values ------------------------------------------------------------------------------------

    @property
    def later_plan(self) -> Plan | ListPlan | CalledPlan:
        """The plan of the system with time from t_0 on; callbacks at a complex design."""
        own, t_0 = planned(self.base), float(np.real(self._start.t))
        if isinstance(own, CalledPlan) or np.iscomplexobj(self.b):
            return called_plan(self)
        if isinstance(own, ListPlan):
            return own._replace(start=t_0)
        joints, loads = own.joint_factors, own.load_factors
        shifted = joints and (lambda t, orders: joints(t_0 + t, orders))
        return own._replace(joint_factors=shifted, load_factors=lambda t: loads(t_0 + t))

    def mass(self, q: Array) -> Array:
        """Return the mass matrix in phase time, M / sigma^2, entries on the pattern, (nnz,)."""
        return self._slowed(self.base.mass(q))

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return the derivative of M / sigma^2 along dq, shape (nnz,)."""
        return self._slowed(self.base.mass_along(q, dq))

    def mass_times(self, q: Array, x: Array) -> Array:
        """Return M x / sigma^2 for a vector, (n_q,), or for columns, (n_q, k)."""
        return self._slowed(self.base.mass_times(q, x))

    def _slowed(self, M: Array) -> Array:
        return M if self._scale == 1 else M / self._scale**2

    def _rates(self, *rates: Array) -> tuple[Array, ...]:
        """Return rates of the system, (v, a, ...), from rates in phase time, (w, alpha, ...)."""
        if self._scale == 1:
            return rates
        return tuple(x / self._scale ** (k + 1) for k, x in enumerate(rates))

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the force Q(t_0 + sigma tau, q, w / sigma), shape (n_q,)."""
        (time, late), (v,) = self._time(t), self._rates(v)
        Q = self.base.force(time, q, v)
        return Q + 1j * late * self.base.force_along(time, q, v, _in_time(q)) if late else Q

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of Q along a direction of (tau, q, w), shape (n_q,)."""
        (v,), (dv,) = self._rates(v), self._rates(direction.v)
        # Its part in time may be complex as its other parts are.
        dt: Any = self._scale * direction.t
        along = StateDirection(dt, direction.q, dv)
        return self._over_time(t, lambda s: self.base.force_along(s, q, v, along))

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi or its derivative of order n in tau, sigma^n d^n Phi/dt^n, shape (n_lam,)."""
        q, rates = motion[0], self._rates(*motion[1:])
        value = self._over_time(t, lambda s: self.base.constraint(s, q, *rates))
        return value if self._scale == 1 else self._scale ** len(rates) * value

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return the values of Phi_q or of its derivative in tau, shape (nnz,)."""
        q, rates = motion[0], self._rates(*motion[1:])
        value = self._over_time(t, lambda s: self.base.constraint_q(s, q, *rates))
        return value if self._scale == 1 else self._scale ** len(rates) * value

    def _over_time(self, tau: float, value: Callable[[float], Array]) -> Array:
        """Return a value, in its shape, at time tau; an imaginary part acts to first order.

        Laws of time need not accept complex numbers, and have three derivatives only.
        """
        time, late = self._time(tau)
        now = value(time)
        if not late or self._stands_still(value, time, now):
            return now
        return now + 1j * late * scaled_derivative(lambda s: value(time + s))

    def _stands_still(self, value: Callable[[float], Array], time: float, now: Array) -> bool:
        """Return whether a function of time has the same value at some neighbouring times."""
        D = float(np.real(self._duration))
        return all(np.array_equal(value(time + x * D), now) for x in _BESIDE)

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return the Jacobians of the system, which serve Newton's method at a complex design."""
        return self.base.linearise(self._times(t), q, v, a, lam)

    def constraints_q(self, t: Array, *motion: Array) -> Array:
        """Return the values of Phi_q or its time derivative at k time points, shape (k, nnz)."""
        return self.base.constraints_q(self._times(t), *motion)

    # -- derivatives with respect to the design ----------------------------------------------------

    def design_partials(
        self, t: Array, q: Array, v: Array | None, a: Array, lam: Array
    ) -> DesignPartials:
        """Return the partials of f and Phi at k time points; without the force Q if v is None."""
        n, time = self._ahead, self._times(t)
        own = self.base.design_partials(time, q, v, a, lam)
        f_t, f_scale, Phi_t = self._partials_in_time(time, q, v, a, lam)
        t_b, scale_b = self.time_b
        late = t_b + t[:, None] * scale_b
        f_b = f_t[:, :, None] * late[:, None] + f_scale[:, :, None] * scale_b
        Phi_b = Phi_t[:, :, None] * late[:, None]
        f_b[:, :, :n] += own.f_b
        Phi_b[:, :, :n] += own.Phi_b
        return DesignPartials(f_b, Phi_b)

    def _partials_in_time(
        self, time: Array, q: Array, v: Array | None, a: Array, lam: Array
    ) -> tuple[Array, Array, Array]:
        """Return f_t, f_sigma at a fixed time, and Phi_t at k time points, as rows."""
        base, still = self.base, np.zeros_like(q[0])
        f_t, f_scale, Phi_t = np.zeros_like(a), np.zeros_like(a), np.zeros_like(lam)
        for k, s in enumerate(time.tolist()):
            f_scale[k] = -2 * base.mass_times(q[k], a[k])
            Phi_t[k] = base.constraint(s, q[k], still)
            if v is None:
                turned = constraint_q_along(base, s, q[k], _in_time(q[k]))
                f_t[k] = base.constraint_pattern.dot_transposed(turned, lam[k])
                continue
            states = q[k], v[k], a[k], lam[k]
            f_t[k] = residual_along(base, s, states, _in_time(q[k]))
            if base.traits.velocity_forces:
                along = StateDirection(0.0, still, v[k])
                f_scale[k] += base.force_along(s, q[k], v[k], along)
        return f_t, f_scale, Phi_t

    def pull_back(
        self,
        t: Array,
        states: tuple[Array, Array | None, Array, Array],
        covectors: tuple[Array, Array],
    ) -> Array:
        """Return the sum over k time points of f_b^T mu + Phi_b^T zeta, shape (n_b,)."""
        n, time, (mu, zeta) = self._ahead, self._times(t), covectors
        f_t, f_scale, Phi_t = self._partials_in_time(time, *states)
        on_time = np.sum(f_t * mu, axis=1) + np.sum(Phi_t * zeta, axis=1)
        t_b, scale_b = self.time_b
        total = np.sum(on_time) * t_b + (t @ on_time + np.sum(f_scale * mu)) * scale_b
        total[:n] += self.base.pull_back(time, states, covectors)
        return np.asarray(total)

    def force_and_total(self, t: float, q_rows: Array, v_rows: Array) -> Array:
        """Return Q and its total derivatives with respect to the design as rows, (1 + n_b, n_q)."""
        n, time = self._ahead, self._time(t)[0]
        q, v = q_rows[0], v_rows[0]
        known = self.base.force_and_total(time, q_rows[: n + 1], v_rows[: n + 1])
        t_b, scale_b = self.time_b
        rows = [*known]
        for j in range(self.n_b):
            late = float(t_b[j] + t * scale_b[j])
            if j < n:
                if late:
                    rows[1 + j] = rows[1 + j] + late * self.base.force_along(
                        time, q, v, _in_time(q)
                    )
                continue
            along = StateDirection(late, q_rows[1 + j], v_rows[1 + j] - scale_b[j] * v)
            rows.append(self.base.force_along(time, q, v, along))
        return np.array(rows)

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None = None
    ) -> Array:
        """Return the total derivative of `constraint` with respect to the design, (n_lam, n_b)."""
        if np.iscomplexobj(self.b):
            return super().constraint_total(t, motion, motion_b)
        n, (time, _), total = self._ahead, self._time(t), np.zeros((self.n_lam, self.n_b))
        ahead = None if motion_b is None else tuple(x[:, :n] for x in motion_b)
        total[:, :n] = self.base.constraint_total(time, motion, ahead)
        total += self._in_start_and_length(lambda phase: phase.constraint(t, *motion))
        # d^k Phi/dt^k moves with the rate of order j of the coordinates by (k over j) times the
        # rate of order k - j of Phi_q.
        k, dot = len(motion) - 1, self.constraint_pattern.dot
        for j, x_b in enumerate(motion_b or ()):
            if np.any(x_b[:, n:]):
                B = self.base.constraint_q(time, *motion[: k - j + 1])
                total[:, n:] += comb(k, j) * dot(B, x_b[:, n:])
        return total

    def along_total(
        self,
        t: float,
        states: States,
        direction: StateDirection,
        states_b: States,
        direction_b: tuple[Array, Array],
    ) -> Array:
        """Return the total design derivative of `residual_along`, shape (n_q, n_b)."""
        if np.iscomplexobj(self.b):
            return super().along_total(t, states, direction, states_b, direction_b)
        n, (time, _) = self._ahead, self._time(t)
        x, x_b = (*states, *direction[1:]), (*states_b, *direction_b)
        ahead: Any = tuple(each[:, :n] for each in x_b)
        total = np.zeros((self.n_q, self.n_b))
        total[:, :n] = self.base.along_total(time, states, direction, ahead[:4], ahead[4:])
        total += self._in_start_and_length(
            lambda phase: residual_along(phase, t, states, direction)
        )
        for i in range(n, self.n_b):
            if any(np.any(each[:, i]) for each in x_b):
                moved = [y + 1j * STEP * y_b[:, i] for y, y_b in zip(x, x_b, strict=True)]
                q, v, a, lam, dq, dv = moved
                along, at = StateDirection(direction.t, dq, dv), (q, v, a, lam)
                total[:, i] += np.imag(residual_along(self, t, at, along)) / STEP
        return total

    def along_pull_back(
        self, t: float, states: States, direction: StateDirection, mu: Array
    ) -> tuple[Array, Array, Array]:
        """Return the partials of mu . `residual_along` with respect to q, v and b."""
        if np.iscomplexobj(self.b):
            return super().along_pull_back(t, states, direction, mu)
        n, (time, _) = self._ahead, self._time(t)
        on_q, on_v, own = self.base.along_pull_back(time, states, direction, mu)
        on_b = self._in_start_and_length(
            lambda phase: mu @ residual_along(phase, t, states, direction)
        )
        on_b[:n] += own
        return on_q, on_v, on_b

    def _in_start_and_length(self, value: Callable[[PhaseSystem], Array]) -> Array:
        """Return the derivative of a value in t_0 and sigma, fixed state, (..., n_b)."""
        t_b, scale_b = self.time_b
        late, long = (np.imag(value(phase)) / STEP for phase in self._later_and_longer)
        return np.asarray(np.multiply.outer(late, t_b) + np.multiply.outer(long, scale_b))

    @cached_property
    def _later_and_longer(self) -> tuple[PhaseSystem, PhaseSystem]:
        """The phase with a small imaginary step of t_0, and with one of sigma."""
        later = self._start._replace(t=self._start.t + 1j * STEP)
        first = PhaseSystem(self.base, later, self._duration, self._first)
        second = PhaseSystem(self.base, self._start, self._duration, self._first)
        second._scale = self._scale + 1j * STEP
        return first, second

    # -- what is known of the system ---------------------------------------------------------------

    def require_derivatives_at(self, t: float, q: Array, v: Array) -> None:
        """Raise InvalidInputError if a called function has no derivative at a state."""
        self.base.require_derivatives_at(self._time(t)[0], q, v)

    def breakpoints(self, t_end: float) -> tuple[float, ...]:
        """Return the breakpoints of the system from the start of the phase on; s."""
        t_0 = float(np.real(self._start.t))
        return tuple(t - t_0 for t in self.base.breakpoints(t_0 + t_end))

    def over_time(self, t: Array) -> Array:
        """Return samples of forces and constraints that depend on time, shape (k, n)."""
        return self.base.over_time(self._times(t))

    def centred(self, q: Array) -> Array:
        """Return coordinates, (n_q,), that do not depend on where the system stands."""
        return self.base.centred(q)

    def folded(self, q: Array) -> str:
        """Return the names of parts that are folded at q, as text."""
        return self.base.folded(q)

    def coarse(self, states: Array, moving: bool = False) -> dict[str, float]:
        """Return the parts whose mesh is too coarse in states, rows of q, with its error."""
        return self.base.coarse(states, moving)

    def strained(self, q: Array) -> dict[str, float]:
        """Return the parts strained beyond the range of their laws at q, with their strains."""
        return self.base.strained(q)

    def stress_force(self, q: Array) -> Array:
        """Return the part of Q at rest, (n_q,), that vanishes in bodies free of stress."""
        return self.base.stress_force(q)

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return the follower loads at tau and q, (n_q,), and their Jacobian, (nnz,)."""
        return self.base.following_load(self._time(t)[0], q)

    def off_root(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first of k states in which a constraint holds at a wrong root."""
        return self.base.off_root(self._times(t), q)

    def opened(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first of k states that opens an equation left out."""
        return self.base.opened(self._times(t), q)

    def mirrored(self, q: Array) -> tuple[int, str] | None:
        """Return the first of k states in which a part is mirrored or folded."""
        return self.base.mirrored(q)

    def off_route(self, t: Array, q: Array, v: Array) -> tuple[int, str] | None:
        """Return the first of k states in which a guide or rope has left its route."""
        return self.base.off_route(self._times(t), q, v)

    def divisors(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Return the divisors in formulas in k states, (k, n) by the name of the formula."""
        return self.base.divisors(self._times(t), q, v)

    def turn_rate(self, t: Array) -> Array:
        """Return the largest rate at which constraints prescribe an angle, (k,); rad/s."""
        return self.base.turn_rate(self._times(t))


def _in_time(q: Array) -> StateDirection:
    """Return the direction of time at a fixed state."""
    return StateDirection(1.0, np.zeros_like(q), np.zeros_like(q))


@final
class _PhaseContacts(ContactRecord):
    """The contact record of a phase, in the time of the phase."""

    def __init__(self, phase: PhaseSystem, own: ContactRecord) -> None:
        self._phase, self._own = phase, own

    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Record the next states of the phase."""
        self._own.follow(*self._phase.states_of(t, q, v))

    def passes(self, t: Array, q: Array, v: Array) -> bool:
        """Return whether surfaces touch between two time points of the phase."""
        return self._own.passes(*self._phase.states_of(t, q, v))

    def missed(self) -> MissedContact | None:
        """Return the first contact that the steps of the phase miss; None without one."""
        missed = self._own.missed()
        if missed is None:
            return None
        return missed._replace(time=missed.time - self._phase.states_of(np.zeros(1))[0].item())
