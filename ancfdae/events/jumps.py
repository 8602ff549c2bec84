"""Jumps between phases: impacts, one group after the other, and the mode that follows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from ancfdae.errors.kinds import InconsistentStartError, InvalidInputError
from ancfdae.events.functions import along_run, gap_at
from ancfdae.events.impact import uncoupled
from ancfdae.events.kinds import EndEvent, Event, Impact, ModeSystem, Switch
from ancfdae.events.locating import NOISE, TOGETHER
from ancfdae.events.phases import Jump, Phase, function_along
from ancfdae.events.strikes import Strike, allowed, is_pressed
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array

# A gap below minus this fraction of its coordinates at the start of a mode raises an error.
_NEGATIVE = 1e-9
# A rate after an impact counts as zero below this fraction of the rates before it.
_STANDS = 1e-12
# A gap below this fraction of its coordinates in a whole phase is kept closed by a joint.
_HELD = 1e-11
# Most impacts one after the other at one time.
_CHAIN = 1000
# Largest change of coordinates that closes the joints of a new mode, relative to the mechanism.
_CLOSED = 1e-6


@final
class Jumps:
    """Computes the jumps of one run from states at the ends of its phases."""

    def __init__(self, modes: Mapping[str, ModeSystem], t_end: float) -> None:
        self._modes, self._t_end = modes, t_end

    def at_start(self, mode: ModeSystem, q: Array, v: Array) -> Jump | None:
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
        have times of their own at neighbouring designs.
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
        """Return impacts with the closed gaps that their impulses move, in uncoupled groups."""
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

        The first of `v` are velocities at that time; further ones are velocities before impacts.
        Raises InvalidInputError for gaps clearly negative where a run or a mode `begins`.
        """
        closing = []
        for event in mode.events:
            if isinstance(event, Impact):
                g, u, size, speed = gap_at(mode.system, event.gap, t, q, *v)
                near = abs(u) * TOGETHER * self._t_end + NOISE * size
                if begins and -g > (near if t == 0 else _NEGATIVE * size):
                    begin = f"where mode {mode.name!r} begins, t = {t:.6g}" if t else "at the start"
                    where = f"gap of {event.name!r} {begin}"
                    repair = "Begin with bodies apart, or change the sign of the gap."
                    raise InvalidInputError(where, "must not be negative", f"{g:.6g}", repair)
                if u < -NOISE * speed and g <= near:
                    closing.append(event)
        return closing

    def at_end(self, phase: Phase, event: Event, rests: bool, size: float) -> Jump:
        """Return the jump at the end of a phase, by an event and all others of the same time.

        `size` is the largest weighted norm of the coordinates so far.
        """
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
            mode, on_joints = self._mode(targets[0], phase, on_joints, size)
            # Gaps that only the new mode has, or that its joints close.
            closing = self._closing(mode, t, q, on_joints, begins=True)
            closing = [x for x in closing if x not in events and not _is_held(phase, x)]
            state = t, q, strikes[-1].velocities if strikes else v
            strikes += self._struck(mode, closing, False, state)
            events += closing
        return Jump(tuple(events), strikes, mode, ends)

    def _pressed(self, strikes: Sequence[Strike]) -> Impact | None:
        """Return an impact whose gap has no rate after it and accelerates to close, or None."""
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
                near = abs(g) <= abs(rate) * TOGETHER * self._t_end
                if near and rate and direction in (0, np.sign(rate)):
                    found.append(event)
        return found

    def _mode(self, name: str, phase: Phase, v: Array, size: float) -> tuple[ModeSystem, Array]:
        """Return the mode that follows a phase, and velocities v projected onto its joints.

        InvalidInputError if its joints are not closed there.
        """
        mode, (t, q, _) = self._modes[name], phase.last
        system = mode.system
        try:
            state = allowed(system, t, q, v)
            moved, v = norm(state.q - q, system.weights), state.v
        except InconsistentStartError:
            moved = math.inf
        if moved > _CLOSED * size:
            rule = f"its joints must be closed where it begins, at t = {t:.6g}"
            repair = "Let the function of the event be zero where they are closed."
            got = f"coordinates that must move by {moved / (size or 1.0):.1e} of the mechanism"
            raise InvalidInputError(f"mode {name!r}", rule, got, repair)
        return mode, v


def _is_held(phase: Phase, impact: Impact) -> bool:
    """Return whether a gap stays closed in a phase, so that its rate at the end is round-off."""
    g, _, size = function_along(phase, impact)
    return bool(np.all(np.abs(g) <= _HELD * size))
