"""Location of an event: the duration D of its phase, to round-off.

Newton's method finds the zero of the event's function at the end of runs of length D. In these all
steps of the phase are stretched by the same factor, so that no step is short and the integrator
keeps its order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.equations import Solution
from ancfdae.errors.outcomes import Verdict
from ancfdae.events.crossing import Crossing, first_crossing
from ancfdae.events.kinds import Event, Impact
from ancfdae.events.phases import Phase, function_along, integrated
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.step_control import FixedSteps, PrescribedSteps
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.numerics.arrays import Array

#: Gaps that close within this fraction of the run after the first one close with it.
TOGETHER = 1e-12
#: Corrections of D below this fraction of the time are round-off.
ROUND_OFF = 4e-16
#: Round-off of an event function, relative to the size of its terms.
NOISE = 1e-14
# Most corrections of D by Newton's method, and most if a bracket is halved, too.
_CORRECTIONS, _HALVED = 30, 100
# Number of corrections, few because zeros of higher order converge slowly, after which a time with
# the other sign is tried.
_SLOW = 10
# Largest correction, relative to D, that may have stopped shrinking, and largest value at a zero,
# relative to the values before it.
_ACCEPTED = 1e-6
# A zero is double if a correction, or this fraction of D, changes the rate by a tenth of it.
_DOUBLE = 1e-9
# Most repetitions because another event happens before the located one.
_ANEW = 8


def first_event(
    phase: Phase, happened: Sequence[Event], t_end: float
) -> tuple[Event, Crossing] | None:
    """Return the first event in a phase and its crossing, or None."""
    found: tuple[Event, Crossing] | None = None
    if len(phase.run.t) < 2:
        return None
    for event in phase.mode.events:
        g, rate, size = function_along(phase, event)
        # A gap is open at the start of a phase, or it opens, or it closes at once.
        side, gap = None, isinstance(event, Impact)
        if gap:
            side = 1.0
        elif event in happened and abs(g[0]) <= _ACCEPTED * np.max(np.abs(g)):
            side = float(np.sign(rate[0])) or None
        noise = NOISE * size + ROUND_OFF * t_end * np.abs(rate)
        at = first_crossing(phase.run.t, g, rate, event.crossing[1], side, noise, gap)
        if at is not None and (found is None or at.time < found[1].time):
            found = event, at
    return found


def located(
    phase: Phase, found: tuple[Event, Crossing], happened: Sequence[Event], t_end: float
) -> Phase:
    """Return a phase ended, to round-off, at the event that its run has passed."""
    for _ in range(_ANEW):
        event, crossing = found
        if ROUND_OFF * t_end >= crossing.time:
            return replace(phase, event=event, duration=0.0)
        steps = _StretchedSteps(phase.integrator, phase.run, crossing.time)
        left = t_end - phase.t_0
        done = _ended_at(replace(phase, event=event), steps, crossing, left)
        earlier = first_event(done, happened, t_end) if done.run.outcome.success else None
        least = TOGETHER * t_end
        if earlier is None or earlier[1].time >= done.duration - least:
            return done
        found = earlier
    return done


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
        phase = integrated(replace(phase, duration=D, integrator=steps.of(D)))
        if not phase.run.outcome.success:
            return phase
        values, rates, _ = function_along(phase, event)
        g, rate, t = float(values[-1]), float(rates[-1]), phase.t_0 + D
        if last < math.inf and before[1] != D and g != before[0]:
            # The change from run to run; the rate before belongs to the motion in one run.
            rate = (g - before[0]) / (D - before[1])
        change = -g / rate if rate else math.copysign(math.inf, g * crossing.side)
        stuck = abs(change) >= 0.5 * last and abs(change) <= _ACCEPTED * D
        is_zero = _is_zero(values, rates, t)
        if is_zero and (stuck or abs(change) <= ROUND_OFF * t):
            if _simple(phase, rates, max(abs(change), _DOUBLE * D)):
                return phase
            if crossing.after == math.inf:
                break
        below, above = (D, above) if g * crossing.side > 0 else (below, min(D, above))
        if above == math.inf and left <= D and crossing.after < math.inf:
            return replace(phase, event=None)
        if above - below <= TOGETHER * t and is_zero and crossing.after < math.inf:
            return phase
        if above - below <= ROUND_OFF * t or (above == math.inf and n >= _CORRECTIONS):
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
    """Return whether a zero is simple: its rate changes by less than a tenth within `near`, s."""
    t = phase.run.t
    bend = (rates[-1] - rates[-2]) / (t[-1] - t[-2])
    return bool(abs(rates[-1]) > 10 * abs(bend) * near)


def _is_zero(values: Array, rates: Array, t: float) -> bool:
    """Return whether the last value of a phase is small beside the values before, or round-off."""
    before, speeds = np.abs(values[:-1]), np.abs(rates[:-1])
    largest = np.max(before) + speeds[0] * t
    noise = 8 * ROUND_OFF * np.max(speeds) * t
    return bool(abs(values[-1]) <= _ACCEPTED * largest + noise)


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
