"""Runs with events: one phase after the other, each of which ends exactly where an event happens.

A phase is integrated over a window of time until a function of an event crosses zero in it. Then
its duration D is found to round-off, by Newton's method on the function at the end of runs of
length D. In these all steps of the phase are stretched by the same factor, so that no step is short
and the integrator keeps its order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast, final

import numpy as np

from ancfdae.equations import Solution
from ancfdae.equations.contact_record import MissedContact
from ancfdae.errors.kinds import InconsistentStartError, InvalidInputError
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.events.crossing import Crossing, first_crossing
from ancfdae.events.functions import AlongRun, along_run, gap_at
from ancfdae.events.impact import uncoupled
from ancfdae.events.kinds import EndEvent, Event, Impact, ModeSystem, Switch
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.events.strikes import Strike, allowed, is_pressed
from ancfdae.integrators.high_order import INTERVALS, HighOrder
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.step_control import FixedSteps, PrescribedSteps
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.progress import progress_bar

#: Impacts that follow each other within this fraction of the run count as rest.
REST = 1e-8
# Most events of a run.
_MOST = 100_000
# Gaps that close within this part of the run after the first one close with it.
_TOGETHER = 1e-12
# Corrections of D: most of Newton's, and most where a bracket is halved, too.
_CORRECTIONS, _HALVED = 30, 100
# Corrections after which a time with the other sign is tried, since zeros of higher order are slow.
_SLOW = 10
# The size of a correction against the time that is round-off; its size against D where it has
# stopped shrinking, and the value at a zero against the values before it.
_ROUND_OFF, _ACCEPTED = 4e-16, 1e-6
# Round-off of a function against the size of what it is made of; a gap that is negative by this
# part of it where a mode begins is refused.
_NOISE, _NEGATIVE = 1e-14, 1e-9
# A rate after an impact that is this part of the rates before it is zero.
_STANDS = 1e-12
# A gap that is below this part of its coordinates in a whole phase is held by a joint there.
_HELD = 1e-11
# A gap that opens by this part of its coordinates only, in more phases in a row than these, is at
# rest. Bodies that move together have single impacts of round-off size.
_RESTING, _CLOSED_PHASES = 1e-15, 20
# A zero is double if a correction, or this part of D, changes the rate by a tenth of it.
_DOUBLE = 1e-9
# Part of the run before its end in which an event counts as one after the end.
_AT_END = 1e-15
# Times that a phase is located anew because another event happens before.
_ANEW = 8
# The first window, as a part of the run, and how windows grow: by the length of the last phase.
_FIRST, _GROWTH = 1 / 8, 2.0
# Least number of intervals that an integrator of high order reports in a phase.
_INTERVALS = 4
# Most steps into which a window is divided because no event was found in longer ones.
_FINEST = 512
# Most impacts one after the other at one time.
_CHAIN = 1000
# Phases in a row that are as short as rest, of whatever events.
_SHORT = 200
# Phases, in two halves, after which the number of all events is foreseen, if durations of
# the second half are not shorter by this factor than in the first half.
_FORESEEN, _STEADY = 400, 0.9
_MANY = (
    f"At the rate of the last {_FORESEEN} events there would be more than {_MOST} until the end. "
    "Give impacts a lower restitution, and rest=..., the name of a mode with a joint that keeps "
    "the gap closed."
)
# A mode whose joints are farther off than this part of the mechanism cannot be switched to.
_CLOSED = 1e-6


@final
@dataclass(frozen=True)
class Jump:
    """The events between two phases, and the mode that follows; `ends` the run.

    Impacts that close further gaps at the same time are followed by the impacts of these gaps.
    """

    events: tuple[Event, ...]
    strikes: tuple[Strike, ...]
    mode: ModeSystem
    ends: bool = False

    def velocities(self, v: Array) -> Array:
        """Return the velocities after the jump, shape (n_q,)."""
        return self.strikes[-1].velocities if self.strikes else v


@final
@dataclass(frozen=True)
class Phase:
    """A phase of a run: from a state (t_0, q_0, v_0) for a time `duration`, by an integrator.

    `run` counts time from t_0 on; None before it is taken. `event` is what ended the phase, None
    for a given time; `jump` is what follows, None at the end of the run.
    """

    mode: ModeSystem
    state: tuple[float, Array, Array]
    first: bool
    duration: float
    integrator: Integrator
    run: Solution
    event: Event | None = None
    jump: Jump | None = None

    @staticmethod
    def planned(
        mode: ModeSystem,
        state: tuple[float, Array, Array],
        first: bool,
        duration: float,
        integrator: Integrator,
    ) -> Phase:
        """Return a phase that has not been integrated."""
        return Phase(mode, state, first, duration, integrator, cast("Solution", None))

    @property
    def t_0(self) -> float:
        """Time at the start of the phase; s."""
        return self.state[0]

    @property
    def t_end(self) -> float:
        """Time at the end of the phase; s."""
        return self.state[0] + self.duration

    @property
    def times(self) -> Array:
        """Times from the start of the run on, (k,); of a finished phase the last one is its end."""
        t = self.t_0 + self.run.t
        return np.append(t[:-1], self.t_end) if self.run.outcome.success else t

    @property
    def last(self) -> tuple[float, Array, Array]:
        """Time, coordinates and velocities at the end of the phase."""
        return self.t_end, self.run.q[-1], self.run.v[-1]

    @property
    def system(self) -> PhaseSystem:
        """The system from the start of the phase on, with a start that the design does not move."""
        start = PhaseStart.held(*self.state, self.mode.system.n_b)
        return PhaseSystem(self.mode.system, start, self.duration, self.first)


@final
@dataclass(frozen=True)
class PhasedRun:
    """All phases of a run, impacts before the first one, and how the last one ended."""

    before: Jump | None
    phases: tuple[Phase, ...]
    outcome: RunOutcome


@final
@dataclass(frozen=True)
class Beginning:
    """Where a run goes on: mode, state, the events that have just happened, the phase before it."""

    mode: str
    state: tuple[float, Array, Array]
    happened: tuple[Event, ...]
    duration: float


@final
class PhaseMarch:
    """Runs through the phases of one run at a real design."""

    def __init__(
        self, modes: Mapping[str, ModeSystem], t_end: float, integrator: Integrator
    ) -> None:
        self._modes, self._t_end, self._integrator = modes, t_end, integrator
        self._window, self._size = t_end * _FIRST, 0.0

    def run(self, mode: ModeSystem, progress: bool, begins: Beginning | None = None) -> PhasedRun:
        """Integrate from the start of a mode to the end; a failure keeps the phases before it.

        With `begins` the run continues from there.
        """
        with progress_bar(progress, total=self._t_end, unit="s") as bar:
            if begins is None:
                return self._from_start(mode, bar)
            self._window = max(_GROWTH * begins.duration, REST * self._t_end)
            phase = self._modes[begins.mode], begins.state, begins.happened
            return self._through(None, phase, False, bar)

    def _from_start(self, mode: ModeSystem, bar: Any) -> PhasedRun:
        """Run from the start of a mode, after impacts of gaps that close there."""
        q, v = mode.system.start()
        before = self._at_start(mode, q, v)
        after = v if before is None else before.velocities(v)
        phase = mode, (0.0, q, after), _impacts(before)
        return self._through(before, phase, before is None, bar)

    def _through(
        self,
        before: Jump | None,
        begins: tuple[ModeSystem, tuple[float, Array, Array], Sequence[Event]],
        first: bool,
        bar: Any,
    ) -> PhasedRun:
        """Integrate all phases from a mode, a state, and the events that have just happened."""
        mode, state, happened = begins
        phases: list[Phase] = []
        short = closed = 0
        while len(phases) < _MOST:
            phase = self._phase(mode, state, first, happened)
            if not phase.run.outcome.success:
                return self._ended(before, [*phases, phase], phase.run.outcome)
            event, system = phase.event, mode.system
            sizes = (norm(system.centred(x), system.weights) for x in phase.run.q[[0, -1]])
            self._size = max(self._size, *sizes)
            if event is None:
                return self._ended(before, [*phases, phase], None)
            short = short + 1 if _short(phase, self._t_end) else 0
            at_once = phase.duration <= _ROUND_OFF * self._t_end
            again = isinstance(event, Impact) and event in happened
            closed = closed + 1 if again and _stays_closed(phase, event) else 0
            rests = again and (short > 0 or closed > _CLOSED_PHASES)
            if at_once:
                if not (rests and phases):
                    return self._accumulated(before, phases, phase, event)
                # The gap has not opened since the last impact.
                phase = phases.pop()
            if self._too_many(phases):
                return self._ended(
                    before, phases, self._outcome(Verdict.EVENT_LIMIT, phases, _MANY)
                )
            if (rests and not event.leads_to) or short > _SHORT:
                return self._accumulated(before, [*phases, phase], phase, event)
            jump = self._jump(phase, event, rests)
            if not jump.ends and self._t_end - phase.t_end <= _AT_END * self._t_end:
                # The run ends before it.
                return self._ended(before, [*phases, replace(phase, event=None)], None)
            phase = replace(phase, jump=jump)
            phases.append(phase)
            bar.update(phase.duration)
            if jump.ends:
                return self._ended(before, phases, None)
            state = phase.t_end, phase.run.q[-1], jump.velocities(phase.run.v[-1])
            mode, first, happened = jump.mode, False, jump.events
        return self._ended(before, phases, self._outcome(Verdict.EVENT_LIMIT, phases, ""))

    def _too_many(self, phases: Sequence[Phase]) -> bool:
        """Return whether events follow steadily, too fast to reach the end of the run."""
        if len(phases) < _FORESEEN:
            return False
        durations = np.array([phase.duration for phase in phases[-_FORESEEN:]])
        before, after = np.split(durations, 2)
        steady = np.sum(after) > _STEADY * np.sum(before)
        left = (self._t_end - phases[-1].t_end) / np.mean(after)
        return bool(steady and len(phases) + left > _MOST)

    # -- one phase -----------------------------------------------------------------------------

    def _phase(
        self,
        mode: ModeSystem,
        state: tuple[float, Array, Array],
        first: bool,
        happened: Sequence[Event],
    ) -> Phase:
        """Return the phase that begins in a state, up to its event or the end of the run."""
        left, finer = self._t_end - state[0], 1
        window = min(left, self._window) if mode.events else left
        while True:
            integrator = _in_steps(self._for_phase(state[0], window), window, finer)
            phase = _integrated(Phase.planned(mode, state, first, window, integrator))
            found = self._first(phase, happened)
            if found is not None:
                located = self._located(phase, found, happened)
                lost = located.run.outcome.verdict is Verdict.EVENT_NOT_LOCATED
                if not lost or finer >= _FINEST:
                    self._window = max(_GROWTH * located.duration, REST * self._t_end)
                    return located
                # Steps as long as the phase do not show the motion in it.
                window, finer = min(window, _GROWTH * found[1].time), 8 * finer
            elif window >= left or not phase.run.outcome.success:
                return replace(phase, integrator=integrator.frozen(phase.run))
            else:
                window = min(left, _GROWTH * window)

    def _for_phase(self, t: float, window: float) -> Integrator:
        """Return the integrator of a phase of length `window`, s, that begins at t."""
        integrator = self._integrator
        if not isinstance(integrator, HighOrder):
            return integrator
        count = (integrator.intervals or INTERVALS) * window / self._t_end
        stops = tuple(x - t for x in integrator.stops if x > t)
        return replace(integrator, intervals=max(_INTERVALS, math.ceil(count)), stops=stops)

    def _first(self, phase: Phase, happened: Sequence[Event]) -> tuple[Event, Crossing] | None:
        """Return the first event in a phase and its time from the start of the phase on."""
        found: tuple[Event, Crossing] | None = None
        if len(phase.run.t) < 2:
            return None
        for event in phase.mode.events:
            g, rate, size = _function(phase, event)
            # A gap is open at the start of a phase, or it opens, or it closes at once.
            side, gap = None, isinstance(event, Impact)
            if gap:
                side = 1.0
            elif event in happened and abs(g[0]) <= _ACCEPTED * np.max(np.abs(g)):
                side = float(np.sign(rate[0])) or None
            noise = _NOISE * size + _ROUND_OFF * self._t_end * np.abs(rate)
            at = first_crossing(phase.run.t, g, rate, event.crossing[1], side, noise, gap)
            if at is not None and (found is None or at.time < found[1].time):
                found = event, at
        return found

    def _located(
        self, phase: Phase, found: tuple[Event, Crossing], happened: Sequence[Event]
    ) -> Phase:
        """Return the phase up to an event that its run has passed, ended there to round-off."""
        for _ in range(_ANEW):
            event, crossing = found
            if _ROUND_OFF * self._t_end >= crossing.time:
                return replace(phase, event=event, duration=0.0)
            steps = _StretchedSteps(phase.integrator, phase.run, crossing.time)
            left = self._t_end - phase.t_0
            located = _ended_at(replace(phase, event=event), steps, crossing, left)
            earlier = self._first(located, happened) if located.run.outcome.success else None
            least = _TOGETHER * self._t_end
            if earlier is None or earlier[1].time >= located.duration - least:
                return located
            found = earlier
        return located

    # -- what happens at its end -------------------------------------------------------------------

    def _at_start(self, mode: ModeSystem, q: Array, v: Array) -> Jump | None:
        """Return the impacts of gaps that are closed and closing at the start of the run."""
        closing = self._closing(mode, 0.0, q, v, begins=True)
        strikes = self._struck(mode, closing, False, (0.0, q, v))
        events = tuple(dict.fromkeys(x for each in strikes for x in each.struck.impacts))
        return Jump(events, strikes, mode) if strikes else None

    def _struck(
        self,
        mode: ModeSystem,
        impacts: Sequence[Impact],
        plastic: bool,
        state: tuple[float, Array, Array],
        first: Event | None = None,
    ) -> tuple[Strike, ...]:
        """Return impacts, followed by impacts of touching gaps with a negative rate after them.

        `first` is the event that ended the phase. Impacts that do not act on it, nor on each other,
        have times of their own beside the design.
        """
        (t, q, v), found = state, list[Strike]()
        groups = [tuple(impacts)] if impacts else []
        if any(x.takes_all for x in impacts):
            groups = self._with_touching(mode, impacts, state)
        elif first in impacts and len(impacts) > 1:
            groups = uncoupled(mode.system, impacts, state)
        for group in sorted(groups, key=lambda group: first not in group):
            found.append(Strike.of(mode, group, plastic, (t, q, v), apart=len(found) > 0))
            v = found[-1].velocities
        closing = list(impacts)
        while closing:
            before, closing = closing, self._closing(mode, t, q, v, state[2])
            if plastic:
                closing = [x for x in closing if x not in before]
            if closing:
                found.append(Strike.of(mode, closing, plastic, (t, q, v), apart=False))
                v = found[-1].velocities
            if len(found) > _CHAIN:
                rule = "must end after some impacts at one time"
                got = f"more than {_CHAIN} at t = {t:.6g}"
                repair = "Give the gaps a distance, or the impacts a lower restitution."
                raise InvalidInputError(f"impacts of {closing[0].name!r}", rule, got, repair)
        return tuple(found)

    def _with_touching(
        self, mode: ModeSystem, impacts: Sequence[Impact], state: tuple[float, Array, Array]
    ) -> list[tuple[Impact, ...]]:
        """Return groups of impacts and of the closed gaps that see their impulses."""
        (t, q, v), touching = state, list(impacts)
        for event in mode.events:
            if isinstance(event, Impact) and event not in impacts:
                g, _, size, _ = gap_at(mode.system, event.gap, t, q, v)
                if g <= _NEGATIVE * size:
                    touching.append(event)
        groups = uncoupled(mode.system, touching, state) if len(touching) > 1 else [tuple(impacts)]
        return [tuple(group) for group in groups if any(x in impacts for x in group)]

    def _closing(
        self, mode: ModeSystem, t: float, q: Array, *v: Array, begins: bool = False
    ) -> list[Impact]:
        """Return the impacts whose gaps are closed at a time and have a negative rate.

        The first velocities belong to that time; further ones are velocities before impacts.
        Where a run or a mode `begins`, gaps that are negative beyond round-off are refused.
        """
        closing = []
        for event in mode.events:
            if isinstance(event, Impact):
                g, u, size, speed = gap_at(mode.system, event.gap, t, q, *v)
                near = abs(u) * _TOGETHER * self._t_end + _NOISE * size
                if begins and -g > (near if t == 0 else _NEGATIVE * size):
                    begin = f"where mode {mode.name!r} begins, t = {t:.6g}" if t else "at the start"
                    where = f"gap of {event.name!r} {begin}"
                    repair = "Begin with bodies apart, or change the sign of the gap."
                    raise InvalidInputError(where, "must not be negative", f"{g:.6g}", repair)
                if u < -_NOISE * speed and g <= near:
                    closing.append(event)
        return closing

    def _jump(self, phase: Phase, event: Event, rests: bool) -> Jump:
        """Return the jump at the end of a phase, by an event and all others of the same time."""
        mode, (t, q, v) = phase.mode, phase.last
        events = [event, *(x for x in self._with_it(phase) if x is not event)]
        impacts = [x for x in events if isinstance(x, Impact)]
        strikes = self._struck(mode, impacts, rests, (t, q, v), event)
        further = (x for each in strikes for x in each.struck.impacts)
        events = list(dict.fromkeys([*events, *further]))
        ends = any(isinstance(x, EndEvent) for x in events)
        targets = [x.to for x in events if isinstance(x, Switch)]
        pressed = event if rests and isinstance(event, Impact) else None
        if not targets and not rests:
            pressed = self._pressed(strikes)
        if pressed is not None:
            targets += self._rest(pressed, strikes, phase)
        if targets and not ends:
            # Integrators keep the velocities of joints that open with an error.
            on_joints = strikes[-1].velocities if strikes else allowed(mode.system, t, q, v).v
            mode, on_joints = self._mode(targets[0], phase, on_joints)
            # Gaps that only the new mode has, or that its joints close.
            closing = self._closing(mode, t, q, on_joints, begins=True)
            closing = [x for x in closing if x not in events and not _is_held(phase, x)]
            state = t, q, strikes[-1].velocities if strikes else v
            strikes += self._struck(mode, closing, False, state)
            events += closing
        return Jump(tuple(events), strikes, mode, ends)

    def _pressed(self, strikes: Sequence[Strike]) -> Impact | None:
        """Return an impact after which its gap stays closed, because accelerations press it.

        The impact leaves no rate of the gap, and its second derivative is negative there.
        """
        for impact in (x for each in strikes for x in each.struck.impacts if x.leads_to):
            system, (t, q, before) = strikes[-1].mode.system, strikes[0].struck.state
            time, v = float(np.real(t)), strikes[-1].velocities
            _, u, _, speed = gap_at(system, impact.gap, time, q, v, before)
            if abs(u) <= _STANDS * speed and is_pressed(system, impact, (time, q, v)):
                return impact
        return None

    def _rest(self, impact: Impact, strikes: Sequence[Strike], phase: Phase) -> list[str]:
        """Return the mode in which a gap stays closed, by whether its last impact slid."""
        slides = [x.struck.slides(impact) for x in strikes if impact in x.struck.impacts]
        name = impact.rest_after(slides[-1] if slides else 0.0)
        if name is None:
            motion = "sticks" if not slides or slides[-1] == 0 else f"slides by {slides[-1]:+.0f}"
            where = f"Impact.rest of {impact.name!r} at t = {phase.t_end:.6g}"
            rule = "must name a mode for each way in which the gap stays closed"
            raise InvalidInputError(where, rule, f"none for a contact that {motion}")
        return [name]

    def _with_it(self, phase: Phase) -> list[Event]:
        """Return the events of a mode whose functions are zero at the end of a phase."""
        mode, (t, q, v) = phase.mode, phase.last
        found: list[Event] = list(self._closing(mode, t, q, v))
        for event in mode.events:
            function, direction = event.crossing
            if not isinstance(event, Impact):
                along = along_run(mode.system, function, phase.t_0, phase.run)
                g, rate = along.value[-1], along.rate[-1]
                near = abs(g) <= abs(rate) * _TOGETHER * self._t_end
                if near and rate and direction in (0, np.sign(rate)):
                    found.append(event)
        return found

    def _mode(self, name: str, phase: Phase, v: Array) -> tuple[ModeSystem, Array]:
        """Return the mode that follows a phase, and velocities v as its joints allow them.

        A mode whose joints are not closed there is refused.
        """
        mode, (t, q, _) = self._modes[name], phase.last
        system = mode.system
        try:
            state = allowed(system, t, q, v)
            moved, v = norm(state.q - q, system.weights), state.v
        except InconsistentStartError:
            moved = math.inf
        if moved > _CLOSED * self._size:
            rule = f"its joints must be closed where it begins, at t = {t:.6g}"
            repair = "Let the function of the event be zero where they are closed."
            got = (
                f"coordinates that must move by {moved / (self._size or 1.0):.1e} of the mechanism"
            )
            raise InvalidInputError(f"mode {name!r}", rule, got, repair)
        return mode, v

    # -- how it ends -------------------------------------------------------------------------------

    def _outcome(self, verdict: Verdict, phases: Sequence[Phase], advice: str) -> RunOutcome:
        steps = sum(x.run.statistics.steps for x in phases)
        return RunOutcome(verdict, phases[-1].t_end, steps, 0.0, advice=advice)

    def _accumulated(
        self, before: Jump | None, phases: Sequence[Phase], phase: Phase, event: Event
    ) -> PhasedRun:
        """Return the run up to where events have no time between them."""
        if not phases:
            rule, got = "must leave a time before the first event", f"{event.name!r} at once"
            repair = "Begin in a mode in which a joint keeps the gap closed."
            raise InvalidInputError("start", rule, got, repair)
        advice = f"The event {event.name!r} follows itself, or others, at once."
        if isinstance(event, Impact):
            advice = (
                f"Impacts {event.name!r} follow each other faster and faster. Give it rest=..., "
                "the name of a mode with a joint that keeps the gap closed."
            )
        outcome = self._outcome(Verdict.EVENTS_ACCUMULATE, phases, advice)
        return PhasedRun(before, tuple(phases), outcome)

    def _ended(
        self, before: Jump | None, phases: Sequence[Phase], outcome: RunOutcome | None
    ) -> PhasedRun:
        ended = self._outcome(Verdict.FINISHED, phases, "")
        missed = self._missed_contact(phases) if outcome is None else None
        if outcome is not None:
            time = phases[-1].t_0 + phases[-1].run.outcome.time
            ended = replace(outcome, time=time, step=ended.step)
        elif missed is not None:
            ended = self._outcome(Verdict.MISSED_CONTACT, phases, missed.advice)
            ended = replace(ended, time=missed.time)
        return PhasedRun(before, tuple(phases), ended)

    def _missed_contact(self, phases: Sequence[Phase]) -> MissedContact | None:
        """Return the first contact that steps do not resolve, across the phases of one mode.

        Each phase was judged by itself, without contacts in which it begins or ends.
        """
        if len(phases) < 2 or not isinstance(self._integrator, SteppedIntegrator):
            return None
        system, record = phases[0].mode.system, phases[0].mode.system.contacts()
        for phase in phases:
            if phase.mode.system is not system:
                missed = None if record is None else record.missed()
                if missed is not None:
                    return missed
                system, record = phase.mode.system, phase.mode.system.contacts()
            if record is not None:
                record.follow(phase.times, phase.run.q, phase.run.v)
        return None if record is None else record.missed()


def _impacts(jump: Jump | None) -> tuple[Event, ...]:
    return () if jump is None else jump.events


def _short(phase: Phase, t_end: float) -> bool:
    """Return whether a phase is so short that its events count as simultaneous."""
    return phase.duration <= REST * t_end


def _stays_closed(phase: Phase, impact: Event) -> bool:
    """Whether a gap opens by round-off of its coordinates only, between two of its impacts."""
    g, rate, size = _function(phase, impact)
    # The height of a parabola with these rates at its ends, since steps may not show it.
    height = np.max(np.abs(rate)) * phase.duration / 4
    return bool(max(np.max(np.abs(g)), height) <= _RESTING * np.max(size))


def _is_held(phase: Phase, impact: Impact) -> bool:
    """Whether a gap stays closed in a phase, so that its rate at the end is round-off."""
    g, _, size = _function(phase, impact)
    return bool(np.all(np.abs(g) <= _HELD * size))


def _integrated(phase: Phase) -> Phase:
    """Return a phase with its run."""
    return replace(phase, run=phase.integrator.integrate(phase.system, phase.duration))


def _function(phase: Phase, event: Event) -> AlongRun:
    """Return the function of an event along a phase; refuse NaN."""
    g, rate, size = along_run(phase.mode.system, event.crossing[0], phase.t_0, phase.run)
    if not np.all(np.isfinite(g)):
        bad = phase.t_0 + float(phase.run.t[np.argmin(np.isfinite(g))])
        rule, repair = "must be finite along the run", "Check roots and divisions in it."
        got = f"NaN or infinity at t = {bad:.6g}"
        raise InvalidInputError(f"event {event.name!r}", rule, got, repair)
    return AlongRun(g, np.where(np.isfinite(rate), rate, 0.0), size)


def _ended_at(phase: Phase, steps: _StretchedSteps, crossing: Crossing, left: float) -> Phase:
    """Return the phase whose end is the zero of the function of its event.

    Zeros after `left`, the end of the run, do not count.
    """
    event, D = phase.event, min(crossing.time, left)
    assert event is not None
    last, before = math.inf, (0.0, 0.0)
    # Durations with the sign before the zero and with the other one.
    below, above = 0.0, math.inf
    for n in range(_HALVED):
        phase = _integrated(replace(phase, duration=D, integrator=steps.of(D)))
        if not phase.run.outcome.success:
            return phase
        values, rates, _ = _function(phase, event)
        g, rate, t = float(values[-1]), float(rates[-1]), phase.t_0 + D
        if last < math.inf and before[1] != D and g != before[0]:
            # The change from run to run; the rate before belongs to the motion in one run.
            rate = (g - before[0]) / (D - before[1])
        change = -g / rate if rate else math.copysign(math.inf, g * crossing.side)
        stuck = abs(change) >= 0.5 * last and abs(change) <= _ACCEPTED * D
        is_zero = _is_zero(values, rates, t)
        if is_zero and (stuck or abs(change) <= _ROUND_OFF * t):
            if _simple(phase, rates, max(abs(change), _DOUBLE * D)):
                return phase
            if crossing.after == math.inf:
                break
        below, above = (D, above) if g * crossing.side > 0 else (below, min(D, above))
        if above == math.inf and left <= D and crossing.after < math.inf:
            return replace(phase, event=None)
        if above - below <= _TOGETHER * t and is_zero and crossing.after < math.inf:
            return phase
        if above - below <= _ROUND_OFF * t or (above == math.inf and n >= _CORRECTIONS):
            break
        before, new = (g, D), min(max(D + change, 0.5 * D), 2.0 * D)
        if above < math.inf and not (below < new < above and abs(change) < 0.5 * last):
            last, D = above - below, 0.5 * (below + above)
            continue
        if above == math.inf and (change <= 0 or n == _SLOW) and D < crossing.after < math.inf:
            new = crossing.after
        last, D = abs(change), min(new, left)
    advice = f"The function of {event.name!r} touches zero, or jumps or has a pole there."
    done = replace(phase.run.outcome, verdict=Verdict.EVENT_NOT_LOCATED, advice=advice)
    return replace(phase, run=replace(phase.run, outcome=done))


def _simple(phase: Phase, rates: Array, near: float) -> bool:
    """Whether a time changes the rate at the end of a phase by less than a tenth: a simple zero."""
    t = phase.run.t
    bend = (rates[-1] - rates[-2]) / (t[-1] - t[-2])
    return bool(abs(rates[-1]) > 10 * abs(bend) * near)


def _is_zero(values: Array, rates: Array, t: float) -> bool:
    """Whether the last of the values of a phase is small beside those before, or round-off."""
    before, speeds = np.abs(values[:-1]), np.abs(rates[:-1])
    largest = np.max(before) + speeds[0] * t
    noise = 8 * _ROUND_OFF * np.max(speeds) * t
    return bool(abs(values[-1]) <= _ACCEPTED * largest + noise)


def _in_steps(integrator: Integrator, window: float, least: int) -> Integrator:
    """Return the integrator, with a fixed step so short that it takes some steps at least."""
    if isinstance(integrator, SteppedIntegrator) and isinstance(integrator.steps, FixedSteps):
        step = min(integrator.steps.step, window / least)
        return integrator.with_steps(FixedSteps(step))
    return integrator


@final
class _StretchedSteps:
    """The steps of a phase up to an event, stretched to any duration near it."""

    def __init__(self, integrator: Integrator, run: Solution, D: float) -> None:
        self._integrator, self._D = integrator, D
        self._shares: Array | None = None
        self._count = 0
        if isinstance(integrator, SteppedIntegrator):
            if isinstance(integrator.steps, FixedSteps):
                self._count = integrator.steps.count(D)
                return
            t = run.t[:: run.degree]
            before = t[t < D]
            # A last step that is a small part of the one before joins it.
            if len(before) > 1 and D - before[-1] < 0.3 * (before[-1] - before[-2]):
                before = before[:-1]
            self._shares = np.append(before, D) / D

    def of(self, D: float) -> Integrator:
        """Return the integrator whose steps end at D."""
        integrator = self._integrator
        if not isinstance(integrator, SteppedIntegrator):
            return integrator
        if self._shares is None:
            return integrator.with_steps(FixedSteps(D / self._count))
        times = self._shares * D
        times[-1] = D
        return integrator.with_steps(PrescribedSteps(tuple(times.tolist())))
