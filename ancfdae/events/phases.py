"""Phases of a run with events, and the jumps between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast, final

import numpy as np

from ancfdae.equations import Solution
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import RunOutcome
from ancfdae.events.functions import AlongRun, along_run
from ancfdae.events.kinds import Event, ModeSystem
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.events.strikes import Strike
from ancfdae.integrators.integrator import Integrator
from ancfdae.numerics.arrays import Array


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
    """All phases of a run, impacts before the first phase, and how the run ended."""

    before: Jump | None
    phases: tuple[Phase, ...]
    outcome: RunOutcome


@final
@dataclass(frozen=True)
class Beginning:
    """Where a run continues: mode, state (t, q, v), latest events, and last phase's duration, s."""

    mode: str
    state: tuple[float, Array, Array]
    happened: tuple[Event, ...]
    duration: float


def integrated(phase: Phase) -> Phase:
    """Return a phase with its run."""
    return replace(phase, run=phase.integrator.integrate(phase.system, phase.duration))


def function_along(phase: Phase, event: Event) -> AlongRun:
    """Return the function of an event along a phase; InvalidInputError if it is not finite."""
    g, rate, size = along_run(phase.mode.system, event.crossing[0], phase.t_0, phase.run)
    if not np.all(np.isfinite(g)):
        bad = phase.t_0 + float(phase.run.t[np.argmin(np.isfinite(g))])
        rule, repair = "must be finite along the run", "Check roots and divisions in it."
        got = f"NaN or infinity at t = {bad:.6g}"
        raise InvalidInputError(f"event {event.name!r}", rule, got, repair)
    return AlongRun(g, np.where(np.isfinite(rate), rate, 0.0), size)
