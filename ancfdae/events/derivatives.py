"""Derivatives of a run with events: forward along the phases, and their transpose backward.

A phase passes on the time t_e, q_e and v_e of its end. With its duration D as one more design
variable (`phase_system`), the end of a phase whose event has the function g follows from

    g_x x_D + g_t = 0 in D:   D_b = -(g_x x_b + g_t t_0,b + g_b) / (g_x x_D + g_t),

where x_b are derivatives at fixed D. A phase that ends at a given time has D_b = -t_0,b. Then x_b +
x_D D_b are the derivatives of all states of the phase, t_0,b + D_b is the derivative of t_e, and
the jump is differentiated (`impact`). Backward, adjoint vectors pass the transposed jump, the
transposed phase, whose start is free there, and D.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.equations.solution_parts import Sensitivities
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.events.contact_rows import gap_partials
from ancfdae.events.functions import Partials, along_run, at_end
from ancfdae.events.impact import Directions
from ancfdae.events.kinds import Event
from ancfdae.events.objectives import PhasePartials
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.events.phases import Jump, Phase, PhasedRun
from ancfdae.events.strikes import Strike, order_matters
from ancfdae.integrators.integrator import Seeds
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.method import UnfinishedRunError, finished

# A function grazes zero if its rate there is below this times the largest rate in the phase.
_GRAZES = 1e-6
# Derivatives of a gap count as zero below these fractions of their terms: at the start, and at the
# end of a phase, which is located by iteration.
_CLOSED, _TOGETHER = 1e-10, 1e-6


@final
@dataclass(frozen=True)
class PhaseDerivatives:
    """A phase with the design derivatives of its start, its duration and all its states.

    Derivatives of the time points are t_b, (k, n_b). `strikes_b` are derivatives of the time,
    (n_b,), and of the impulses, (m, n_b), of each of the strikes at the end of the phase.
    `in_duration` are derivatives of q, v and lam in D, for a phase that ends at a given time.
    """

    phase: Phase
    start_b: Array
    duration_b: Array
    states: Sensitivities
    t_b: Array
    strikes_b: tuple[tuple[Array, Array], ...] = ()
    in_duration: tuple[Array, Array, Array] | None = None


class _Start(NamedTuple):
    """Derivatives of time, q and v at the start of a phase: (n_b,), (n_q, n_b) twice."""

    t_b: Array
    q_b: Array
    v_b: Array


def differentiated(run: PhasedRun) -> tuple[PhasedRun, list[PhaseDerivatives]]:
    """Return a finished run with events, and design derivatives of each phase (direct)."""
    found = list(_each_differentiated(run, run.phases))
    return replace(run, phases=tuple(x.phase for x in found)), found


def _each_differentiated(run: PhasedRun, phases: Iterable[Phase]) -> Iterator[PhaseDerivatives]:
    """Yield the derivatives of one phase after the other, of `phases` with all their states."""
    system = run.phases[0].mode.system
    start = _Start(np.zeros(system.n_b), *system.start_b())
    if run.before is not None:
        require_closed_start(system, run.before)
        start, _ = _after(run.before, start)
    for phase in phases:
        done, end = _through(phase, start)
        if done.phase.jump is not None:
            _happen_together(done, end)
            start, strikes_b = _after(done.phase.jump, end)
            done = replace(done, strikes_b=strikes_b)
        yield done


def _through(phase: Phase, start: _Start) -> tuple[PhaseDerivatives, _Start]:
    """Return the derivatives of a phase, and the derivatives of time, q and v at its end."""
    base, (t, q, v), D = phase.mode.system, phase.state, phase.duration
    system = PhaseSystem(base, PhaseStart(t, q, v, *start), D, phase.first)
    run = _differentiated(phase, system)
    phase, n, s = replace(phase, run=replace(run, sensitivities=None)), base.n_b, run.sensitivities
    assert s is not None
    states = [s.q_b, s.v_b.copy(), s.a_b.copy(), s.lam_b]
    # Derivatives of dq/dtau and d^2q/dtau^2, tau the time of the phase, become v_b and a_b.
    states[1][..., n] -= run.v / D
    states[2][..., n] -= 2 * run.a / D
    D_b = -start.t_b
    if phase.event is not None:
        g_t, g_b, g_D = _crossing(phase, [x[-1] for x in states], n)
        D_b = -(g_b + g_t * start.t_b) / (g_D + g_t)
    q_b, v_b, a_b, lam_b = (x[..., :n] + x[..., n:] * D_b for x in states)
    t_b = start.t_b + np.outer(run.t / D, D_b)
    sensitivities = Sensitivities(base.design_names, base.b, q_b, v_b, a_b, lam_b)
    in_D = None
    if phase.event is None:
        in_D = states[0][..., n], states[1][..., n], states[3][..., n]
    done = PhaseDerivatives(phase, start.t_b, D_b, sensitivities, t_b, in_duration=in_D)
    return done, _Start(start.t_b + D_b, q_b[-1], v_b[-1])


def _crossing(phase: Phase, last: Sequence[Array], n: int) -> tuple[float, Array, float]:
    """Return g_t, and the derivatives of the event function g in b and D; reject grazing."""
    assert phase.event is not None
    q_b, v_b, _, lam_b = last
    _, p = at_end(phase.mode.system, phase.event.crossing[0], phase.t_end, phase.run)
    total = p.q @ q_b + p.v @ v_b + p.lam @ lam_b
    require_crossing(phase, float(total[n]) + p.t)
    return p.t, total[:n] + p.b, float(total[n])


def require_crossing(phase: Phase, rate: float) -> None:
    """Raise InvalidInputError if an event only grazes zero: its time then has no derivative."""
    assert phase.event is not None
    system, function = phase.mode.system, phase.event.crossing[0]
    largest = np.max(np.abs(along_run(system, function, phase.t_0, phase.run).rate))
    if not abs(rate) > _GRAZES * largest:
        where = f"event {phase.event.name!r} at t = {phase.t_end:.6g}"
        rule = "must cross zero to have a derivative"
        got = f"a function that touches it, at a rate of {rate:.1e}"
        repair = "Neighbouring designs have another number of events. Change the design or the end."
        raise InvalidInputError(where, rule, got, repair)


def require_closed_start(system: MechanicalSystem, jump: Jump) -> None:
    """Raise InvalidInputError for impacts at the start whose gaps depend on the design."""
    q_b, _ = system.start_b()
    for strike in jump.strikes:
        time, q, v = strike.struck.state
        for impact in strike.struck.impacts:
            p = gap_partials(system, impact, (float(np.real(time)), q, v))
            parts = np.abs(p.q) @ np.abs(q_b) + np.abs(p.b)
            if np.any(np.abs(p.q @ q_b + p.b) > _CLOSED * parts):
                where = f"impact {impact.name!r} at the start"
                rule = "must have a gap that stays zero when the design changes"
                repair = "Start with the bodies apart, so that the impact has a time of its own."
                raise InvalidInputError(where, rule, "a gap that depends on the design", repair)


def require_one_time(run: PhasedRun, phases: Iterable[Phase]) -> None:
    """Raise InvalidInputError for a run in which times of events coincide at this design only.

    `phases` are the phases of the run with all their states.
    """
    if any(phase.jump is not None and len(phase.jump.events) > 1 for phase in run.phases):
        for _ in _each_differentiated(run, phases):
            pass


def _happen_together(done: PhaseDerivatives, end: _Start) -> None:
    """Raise InvalidInputError for events whose times coincide at this design only.

    Their order changes with the design, and the jump as a whole belongs to one of them. Impacts
    that do not act on each other may have times of their own.
    """
    phase, moved = done.phase, _directions(end)
    assert phase.jump is not None
    struck, apart = set[Event](), False
    for strike in phase.jump.strikes:
        apart = apart or (strike.wait is not None and _is_apart(strike.wait.gap, moved, strike))
        at, (t, q, v) = strike.arrived(moved), strike.struck.state
        for impact in strike.struck.impacts:
            gap = gap_partials(strike.mode.system, impact, (float(np.real(t)), q, v))
            if impact is not phase.event and _is_apart(gap, at, strike):
                raise _apart(phase, impact)
        struck |= set(strike.struck.impacts)
        moved, _ = strike.along(moved)
    if apart and (
        any(x.wait is None for x in phase.jump.strikes[1:])
        or order_matters(phase.jump.strikes, _directions(end))
    ):
        raise _apart(phase, phase.jump.strikes[1].struck.impacts[0])
    for event in phase.jump.events:
        if event is not phase.event and event not in struck and _missed(done, end, event):
            raise _apart(phase, event)


def _is_apart(gap: Partials, moved: Directions, strike: Strike) -> bool:
    """Return whether a closed gap changes along the directions in which the state moves."""
    _, _, v = strike.struck.state
    ahead = np.outer(v, moved.t)
    terms = np.abs(gap.q) @ (np.abs(moved.q - ahead) + np.abs(ahead))
    total = gap.q @ moved.q + gap.t * moved.t + gap.b @ moved.b
    terms = terms + np.abs(gap.t * moved.t) + np.abs(gap.b) @ np.abs(moved.b)
    return bool(np.any(np.abs(total) > _TOGETHER * terms))


def _missed(done: PhaseDerivatives, end: _Start, event: Event) -> bool:
    """Return whether an event function is not zero at the end of a phase at other designs."""
    phase, run, lam_b = done.phase, done.phase.run, done.states.lam_b[-1]
    # Derivatives at a fixed time, and those from the change of the time of the event.
    moved = [np.outer(rate[-1], end.t_b) for rate in (run.v, run.a)]
    q_b, v_b = ((x_b - more, more) for x_b, more in zip((end.q_b, end.v_b), moved, strict=True))
    _, p = at_end(phase.mode.system, event.crossing[0], phase.t_end, run)
    pairs = *((p.q, x) for x in q_b), *((p.v, x) for x in v_b), (p.lam, lam_b)
    terms = [on[:, None] * x_b for on, x_b in pairs]
    every = np.concatenate([*terms, [p.b, p.t * end.t_b]])
    return bool(np.any(np.abs(every.sum(axis=0)) > _TOGETHER * np.abs(every).sum(axis=0)))


def _apart(phase: Phase, event: Event) -> InvalidInputError:
    """Return the error for an event that coincides with another one at this design only."""
    where = f"event {event.name!r} at t = {phase.t_end:.6g}"
    rule = "must happen together with the other event of that time at neighbouring designs"
    got = "a time that changes otherwise with the design"
    repair = "Move a part so that the times differ, or take FiniteDifference()."
    return InvalidInputError(where, rule, got, repair)


def _differentiated(phase: Phase, system: PhaseSystem) -> Solution:
    """Return the run of a phase with derivatives; UnfinishedRunError if the pass fails."""
    integrator = phase.integrator
    if isinstance(integrator, SteppedIntegrator):
        run = integrator.differentiate(system, phase.run)
    else:
        run = integrator.integrate(system, phase.duration, sensitivities=True)
    if run.sensitivities is None:
        raise UnfinishedRunError(run)
    return finished(run)


def _after(jump: Jump, end: _Start) -> tuple[_Start, tuple[tuple[Array, Array], ...]]:
    """Return the derivatives after a jump, and of times and impulses of its strikes."""
    moved, strikes_b = _directions(end), []
    for strike in jump.strikes:
        moved, impulses_b = strike.along(moved)
        strikes_b.append((moved.t, impulses_b))
    return _Start(*moved[:3]), tuple(strikes_b)


def _directions(end: _Start) -> Directions:
    """Return the derivatives in all design variables as directions."""
    return Directions(*end, np.eye(len(end.t_b)))


# -- backward --------------------------------------------------------------------------------------


class _Covectors(NamedTuple):
    """Derivatives of a number (adjoint) in time, q and v at one time point."""

    t: float
    q: Array
    v: Array


@final
class BackwardPass:
    """The gradient of an objective, from the last phase of a run to the first one (adjoint).

    `in_end` is the derivative in the end of the run; zero where an event ends it.
    """

    def __init__(self, system: MechanicalSystem) -> None:
        n_q = system.n_q
        self._on = _Covectors(0.0, np.zeros(n_q), np.zeros(n_q))
        self._gradient, self.in_end = np.zeros(system.n_b), 0.0

    def through(self, phase: Phase, p: PhasePartials) -> None:
        """Pull back through a phase, and the jump at its end, with partials along the phase."""
        if phase.jump is not None:
            self._on, on_b = _before(phase.jump, self._on)
            self._gradient += on_b
        self._on, on_b, in_D = _back_through(phase, p, self._on)
        self._gradient += on_b
        if phase.event is None:
            self.in_end = in_D

    def to_start(self, system: MechanicalSystem, before: Jump | None) -> Array:
        """Return the gradient, (n_b,), after the transposed start of the run and its impacts."""
        if before is not None:
            require_closed_start(system, before)
            self._on, on_b = _before(before, self._on)
            self._gradient += on_b
        return self._gradient + system.start_pull_back(self._on.q, self._on.v)


def _before(jump: Jump, on: _Covectors) -> tuple[_Covectors, Array]:
    """Return the adjoint vectors before a jump, and its contribution to the gradient, (n_b,)."""
    n, gradient = jump.mode.system.n_q, np.zeros(jump.mode.system.n_b)
    for strike in reversed(jump.strikes):
        moved, _ = strike.along(Directions.all_of(strike.mode.system))
        total = on.t * moved.t + on.q @ moved.q + on.v @ moved.v
        on = _Covectors(total[0], total[1 : n + 1], total[n + 1 : 2 * n + 1])
        gradient += total[2 * n + 1 :]
    return on, gradient


def _back_through(
    phase: Phase, p: PhasePartials, on: _Covectors
) -> tuple[_Covectors, Array, float]:
    """Return adjoint vectors at the start of a phase from those at its end; parts in b and D."""
    base, n = phase.mode.system, phase.mode.system.n_b
    total = _pulled_back(phase, p.q, p.v, p.lam, on)
    # D is variable n, t_0 the next one.
    total[:n] += p.b
    total[n : n + 2] += p.duration + on.t, p.start + on.t
    in_D = float(total[n])
    if phase.event is None:
        total[n + 1] -= total[n]
    else:
        _, g = at_end(base, phase.event.crossing[0], phase.t_end, phase.run)
        lam = np.zeros_like(phase.run.lam)
        lam[-1] = g.lam
        crossing = _pulled_back(phase, None, None, lam, _Covectors(0.0, g.q, g.v))
        crossing[:n] += g.b
        crossing[n : n + 2] += g.t
        require_crossing(phase, float(crossing[n]))
        total -= total[n] / crossing[n] * crossing
    q, v = np.split(total[n + 2 :], 2)
    return _Covectors(float(total[n + 1]), q, v), total[:n], in_D


def _pulled_back(
    phase: Phase, q: Array | None, v: Array | None, lam: Array | None, end: _Covectors
) -> Array:
    """Return derivatives in b, D, t_0, q_0 and v_0, shape (n_b + 2 + 2 n_q,), from partials."""
    base, run, D, integrator = phase.mode.system, phase.run, phase.duration, phase.integrator
    assert isinstance(integrator, SteppedIntegrator)
    start = PhaseStart.held(*phase.state, base.n_b).free(base.n_b)
    # A free start may violate constraints: it is projected onto them.
    system = PhaseSystem(base, start, D, first=False)
    q, v = (np.zeros_like(run.q) if x is None else x.copy() for x in (q, v))
    q[-1] += end.q
    v[-1] += end.v
    total = integrator.pull_back(system, run, Seeds(q, v, lam)).copy()
    # From dq/dtau, tau the time of the phase, to v.
    total[base.n_b] -= np.sum(v * run.v) / D
    return total
