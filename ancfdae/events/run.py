"""Runs with events: one phase after the other, each of which ends exactly where an event happens.

A phase is integrated over a window of time until a function of an event crosses zero in it. Then
its duration is found to round-off (`locating`), and the jump at its end is computed (`jumps`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution_parts import ContactRecord, MissedContact
from ancfdae.errors.kinds import InvalidInputError, ManyStepsWarning
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.events.jumps import Jumps
from ancfdae.events.kinds import Event, Impact, ModeSystem
from ancfdae.events.locating import ROUND_OFF, first_event, located
from ancfdae.events.phases import (
    Beginning,
    Jump,
    Phase,
    PhasedRun,
    function_along,
    integrated,
)
from ancfdae.integrators.high_order import INTERVALS, HighOrder
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.step_control import FixedSteps
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import progress_bar

#: Impacts that follow each other within this fraction of the run count as rest.
REST = 1e-8
# Most events of a run.
_MOST = 100_000
# A gap that opens by less than the first number, relative to its coordinates, in more phases in a
# row than the second is at rest. Bodies that move together have single impacts of round-off size.
_RESTING, _CLOSED_PHASES = 1e-15, 20
# An event closer to the end of the run than this fraction of the run counts as one after the end.
_AT_END = 1e-15
# Length of the first window as a fraction of the run; ratio of the next to the last phase.
_FIRST, _GROWTH = 1 / 8, 2.0
# Least number of intervals that an integrator of high order reports in a phase.
_INTERVALS = 4
# Most steps into which a window is divided because no event was found in longer ones.
_FINEST = 512
# Most phases in a row, by any events, that are shorter than the fraction REST of the run.
_SHORT = 200
# Phases, in two halves, after which the number of all events is foreseen, if durations of
# the second half are not shorter by this factor than in the first half.
_FORESEEN, _STEADY = 400, 0.9
# Number of foreseen events from which on a run warns. An event takes some ten milliseconds.
_SLOW = 5_000
# Number of foreseen steps under error control from which on a run warns, and least number of steps
# that predict it. A step of a run with events takes up to 2 ms.
_SLOW_STEPS, _TELLING = 10_000, 2_000
_MANY = (
    f"At the rate of the last {_FORESEEN} events there would be more than {_MOST} until the end. "
    "Give impacts a lower restitution, and rest=..., the name of a mode with a joint that keeps "
    "the gap closed."
)


@final
class PhaseMarch:
    """Integrates the phases of one run at a real design.

    `thin` is called once for each phase, in order, after the jump at its end. The run stores the
    phase that it returns, with at least the first and the last state.
    """

    def __init__(
        self,
        modes: Mapping[str, ModeSystem],
        t_end: float,
        integrator: Integrator,
        thin: Callable[[Phase], Phase] | None = None,
    ) -> None:
        self._modes, self._t_end, self._integrator = modes, t_end, integrator
        self._jumps, self._thin, self._left = Jumps(modes, t_end), thin, 0
        self._told = self._steps_told = False
        self._chooses_steps = isinstance(integrator, HighOrder) or (
            isinstance(integrator, SteppedIntegrator) and integrator.steps.kind == "controlled"
        )
        self._steps = 0
        self._window, self._size = t_end * _FIRST, 0.0
        self._contacts = _Contacts()

    def run(self, mode: ModeSystem, progress: bool, begins: Beginning | None = None) -> PhasedRun:
        """Integrate from the start of a mode to the end; after a failure return the phases so far.

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
        before = self._jumps.at_start(mode, q, v)
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
        """Integrate all phases from a mode, its state, and the events that have just happened."""
        mode, state, happened = begins
        phases: list[Phase] = []
        short = closed = 0
        while len(phases) < _MOST:
            phase = self._phase(mode, state, first, happened)
            if not phase.run.outcome.success:
                if closed > 0 and len(phase.times) == 1 and phases[-1].event is not None:
                    # No step is short enough for a gap that stays closed.
                    return self._accumulated(before, phases, phase, phases[-1].event)
                return self._ended(before, [*phases, phase], phase.run.outcome)
            event, system = phase.event, mode.system
            sizes = (norm(system.centred(x), system.weights) for x in phase.run.q[[0, -1]])
            self._size = max(self._size, *sizes)
            if event is None:
                return self._ended(before, [*phases, phase], None)
            short = short + 1 if _short(phase, self._t_end) else 0
            at_once = phase.duration <= ROUND_OFF * self._t_end
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
            jump = self._jumps.at_end(phase, event, rests, self._size)
            if not jump.ends and self._t_end - phase.t_end <= _AT_END * self._t_end:
                # The run ends before the event.
                return self._ended(before, [*phases, replace(phase, event=None)], None)
            phase = replace(phase, jump=jump)
            phases.append(phase)
            self._steps += phase.run.statistics.steps
            self._leave(phases, len(phases) - 1)
            bar.update(phase.duration)
            if jump.ends:
                return self._ended(before, phases, None)
            state = phase.t_end, phase.run.q[-1], jump.velocities(phase.run.v[-1])
            mode, first, happened = jump.mode, False, jump.events
        return self._ended(before, phases, self._outcome(Verdict.EVENT_LIMIT, phases, ""))

    def _too_many(self, phases: Sequence[Phase]) -> bool:
        """Return whether events follow steadily, too fast to reach the end of the run.

        Warn once if the run may reach its end, but only after very many events.
        """
        if len(phases) < _FORESEEN:
            return False
        durations = np.array([phase.duration for phase in phases[-_FORESEEN:]])
        before, after = np.split(durations, 2)
        t, mean = phases[-1].t_end, np.mean(after)
        left = (self._t_end - t) / mean if np.sum(after) > _STEADY * np.sum(before) else 0.0
        if len(phases) + left > _MOST:
            return True
        if left > _SLOW and not self._told:
            self._told = True
            message = (
                f"about {left:.2g} events are to come: the last ones, before t = {t:.6g}, are "
                f"{mean:.2g} s apart. Take a shorter t_end, or joints in place of gaps that stay "
                "closed. Ctrl-C ends the run and keeps what is done."
            )
            warnings.warn(message, ManyStepsWarning, stacklevel=2)
        return False

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
            phase = integrated(Phase.planned(mode, state, first, window, integrator))
            self._warn_of_steps(phase)
            found = first_event(phase, happened, self._t_end)
            if found is not None:
                done = located(phase, found, happened, self._t_end)
                lost = done.run.outcome.verdict is Verdict.EVENT_NOT_LOCATED
                if not lost or finer >= _FINEST:
                    self._window = max(_GROWTH * done.duration, REST * self._t_end)
                    return done
                # Steps as long as the phase do not show the motion in it.
                window, finer = min(window, _GROWTH * found[1].time), 8 * finer
            elif window >= left or not phase.run.outcome.success:
                return replace(phase, integrator=integrator.frozen(phase.run))
            else:
                window = min(left, _GROWTH * window)

    def _warn_of_steps(self, phase: Phase) -> None:
        """Warn once if all steps up to the end of a phase predict very many until the run's end."""
        t, steps = phase.t_0 + float(phase.run.t[-1]), self._steps + phase.run.statistics.steps
        silent = self._steps_told or not (self._chooses_steps and phase.run.outcome.success)
        if silent or steps < _TELLING or (self._t_end - t) * steps <= _SLOW_STEPS * t:
            return
        self._steps_told = True
        message = (
            f"about {(self._t_end - t) / t * steps:.2g} steps are to come if all are as short as "
            f"those up to t = {t:.6g}, {t / steps:.2g} s: error control follows every vibration "
            "and every contact. HHT(step) steps over those that do not matter "
            "(docs/howto/integrator.md), and contacts with less stiffness allow longer steps. "
            "Ctrl-C ends the run and keeps what is done."
        )
        warnings.warn(message, ManyStepsWarning, stacklevel=2)

    def _for_phase(self, t: float, window: float) -> Integrator:
        """Return the integrator of a phase of length `window`, s, that begins at t."""
        integrator = self._integrator
        if not isinstance(integrator, HighOrder):
            return integrator
        count = (integrator.intervals or INTERVALS) * window / self._t_end
        stops = tuple(x - t for x in integrator.stops if x > t)
        return replace(integrator, intervals=max(_INTERVALS, math.ceil(count)), stops=stops)

    # -- how it ends -------------------------------------------------------------------------------

    def _outcome(self, verdict: Verdict, phases: Sequence[Phase], advice: str) -> RunOutcome:
        steps = sum(x.run.statistics.steps for x in phases)
        return RunOutcome(verdict, phases[-1].t_end, steps, 0.0, advice=advice)

    def _accumulated(
        self, before: Jump | None, phases: list[Phase], phase: Phase, event: Event
    ) -> PhasedRun:
        """Return the run up to the time at which events follow each other without time between."""
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
        self._leave(phases, len(phases))
        return PhasedRun(before, tuple(phases), outcome)

    def _leave(self, phases: list[Phase], count: int) -> None:
        """Record contacts of the first `count` phases, and thin these phases, if not yet done."""
        for k in range(self._left, count):
            if isinstance(self._integrator, SteppedIntegrator):
                self._contacts.follow(phases[k])
            if self._thin is not None:
                phases[k] = self._thin(phases[k])
        self._left = max(self._left, count)

    def _ended(
        self, before: Jump | None, phases: list[Phase], outcome: RunOutcome | None
    ) -> PhasedRun:
        ended, alone = self._outcome(Verdict.FINISHED, phases, ""), len(phases) == 1
        if outcome is not None:
            time = phases[-1].t_0 + phases[-1].run.outcome.time
            ended = replace(outcome, time=time, step=ended.step)
        self._leave(phases, len(phases))
        # The contacts of a single phase were judged by its own run.
        missed = None if alone or outcome is not None else self._contacts.missed()
        if missed is not None:
            ended = self._outcome(Verdict.MISSED_CONTACT, phases, missed.advice)
            ended = replace(ended, time=missed.time)
        return PhasedRun(before, tuple(phases), ended)


@final
class _Contacts:
    """Detects contacts by penalty that steps do not resolve, across the phases of one mode.

    The run of each phase checks its own contacts, without those in which it begins or ends.
    """

    def __init__(self) -> None:
        self._system: MechanicalSystem | None = None
        self._record: ContactRecord | None = None
        self._missed: MissedContact | None = None

    def follow(self, phase: Phase) -> None:
        """Record the contacts of the next phase."""
        system = phase.mode.system
        if system is not self._system:
            self._missed = self.missed()
            self._system, self._record = system, system.contacts()
        if self._record is not None:
            self._record.follow(phase.times, phase.run.q, phase.run.v)

    def missed(self) -> MissedContact | None:
        """Return the first contact that steps do not resolve, if there is one."""
        if self._missed is not None or self._record is None:
            return self._missed
        return self._record.missed()


def _impacts(jump: Jump | None) -> tuple[Event, ...]:
    return () if jump is None else jump.events


def _short(phase: Phase, t_end: float) -> bool:
    """Return whether a phase is so short that its events count as simultaneous."""
    return phase.duration <= REST * t_end


def _stays_closed(phase: Phase, impact: Event) -> bool:
    """Return whether a gap opens by round-off only between two of its impacts."""
    g, rate, size = function_along(phase, impact)
    # The height of a parabola with these rates at its ends; steps may be too long to show it.
    height = np.max(np.abs(rate)) * phase.duration / 4
    return bool(max(np.max(np.abs(g)), height) <= _RESTING * np.max(size))


def _in_steps(integrator: Integrator, window: float, least: int) -> Integrator:
    """Return the integrator, with a fixed step of at most 1/`least` of the window."""
    if isinstance(integrator, SteppedIntegrator) and isinstance(integrator.steps, FixedSteps):
        step = min(integrator.steps.step, window / least)
        return integrator.with_steps(FixedSteps(step))
    return integrator
