"""Solution of a run with events: its phases, and a record of each event between them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import Sensitivities, pandas
from ancfdae.errors.checks import require_array, require_path
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import RunOutcome
from ancfdae.errors.text import PrintedTable, TableText
from ancfdae.numerics.arrays import Array, Numbers

#: Name of the mode in which every run with events begins.
START = "start"


@final
@dataclass(frozen=True)
class EventRecord:
    """One event of a run.

    Attributes
    ----------
    name : str
        Name of the event.
    time : float
        Time at which it happened; s.
    mode : str
        Name of the mode that followed; ``"start"`` is the model that the run began with.
    impulse : float or None
        Impulse P of an impact, in N s for a gap in m. None for other events, and for a gap that
        another impact at the same time opened.
    time_b, impulse_b : array, shape (n_b,), or None
        Their design derivatives, where the run was differentiated; s or N s per unit of the
        variable.
    sliding_impulse : float or array, shape (2,), or None
        Impulse T of friction in the direction of the sliding velocity, or of both sliding
        velocities of a cone of friction; N s. None without friction.
    sliding_impulse_b : array, shape (n_b,) or (2, n_b), or None
        Its design derivatives, where the run was differentiated; N s per unit of the variable.
    """

    name: str
    time: float
    mode: str
    impulse: float | None = None
    time_b: Array | None = None
    impulse_b: Array | None = None
    sliding_impulse: float | Array | None = None
    sliding_impulse_b: Array | None = None


@final
@dataclass(frozen=True, repr=False)
class EventSolution(PrintedTable):
    """Trajectory of a run with events.

    Attributes
    ----------
    phases : tuple of Solution
        The motion between events. The last time point of a phase and the first one of the next are
        the same time, before and after the event. Design derivatives are taken at fixed times; a_b
        and lam_b have the error of differences in time.
    events : tuple of EventRecord
        Events in the order of time.
    outcome : RunOutcome
        How the run ended.
    """

    phases: tuple[Solution, ...]
    events: tuple[EventRecord, ...]
    outcome: RunOutcome

    @property
    def modes(self) -> tuple[str, ...]:
        """Name of the mode of each phase; ``"start"`` is the model that the run began with."""
        names = []
        for phase in self.phases:
            before = [each.mode for each in self.events if each.time <= phase.t[0]]
            names.append(before[-1] if before else START)
        return tuple(names)

    @property
    def t(self) -> Array:
        """Times of all phases between events, shape (n_t,), s; each event time appears twice."""
        return np.concatenate([phase.t for phase in self.phases])

    @property
    def q(self) -> Array:
        """Coordinates of all phases between events, shape (n_t, n_q)."""
        return np.concatenate([phase.q for phase in self.phases])

    @property
    def v(self) -> Array:
        """Velocities of all phases between events, shape (n_t, n_q)."""
        return np.concatenate([phase.v for phase in self.phases])

    @property
    def a(self) -> Array:
        """Accelerations of all phases between events, shape (n_t, n_q)."""
        return np.concatenate([phase.a for phase in self.phases])

    def position(self, point: Any) -> Array:
        """Return the position of a point such as ``rod.at(0.3)``, shape (n_t, d); m."""
        return np.concatenate([phase.position(point) for phase in self.phases])

    def velocity(self, point: Any) -> Array:
        """Return the velocity of a material point, shape (n_t, d); m/s."""
        return np.concatenate([phase.velocity(point) for phase in self.phases])

    def at(self, times: Numbers) -> tuple[Array, Array]:
        """Return q and v interpolated at increasing times, shape (k, n_q) each.

        Within a phase the interpolation is that of `Solution.at`; at the time of an event the state
        before it is returned.
        """
        asked = np.atleast_1d(require_array("times", times))
        ends = np.array([phase.t[-1] for phase in self.phases])
        good = asked.ndim == 1 and bool(np.all(np.diff(asked) > 0))
        if not good or not (asked[0] >= 0 and asked[-1] <= ends[-1]):
            rule = f"must increase and lie in [0, {ends[-1]:.6g}]"
            raise InvalidInputError("times", rule, repr(times))
        which = np.searchsorted(ends, asked)
        parts = [self.phases[k].at(asked[which == k]) for k in np.unique(which).tolist()]
        return np.concatenate([x.q for x in parts]), np.concatenate([x.v for x in parts])

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each event: its name, time and impulse."""
        rows = [(each.name, each.time, each.impulse) for each in self.events]
        return pandas().DataFrame(rows, columns=["event", "time", "impulse"])

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write all phases and events to one file, complete or not at all; return its path.

        The file name is chosen as in `Solution.save`; `load_event_solution` reads the file.
        """
        from ancfdae.equations import solution_file

        fields = [vars(phase) for phase in self.phases]
        file = require_path("path of a solution", path)
        return solution_file.write_phases(file, fields, self.events, self.outcome)

    def _printed(self) -> TableText:
        rows = [("event", "time", "impulse")]
        for each in self.events:
            impulse = "" if each.impulse is None else f"{each.impulse:.6g}"
            rows.append((each.name, f"{each.time:.9g}", impulse))
        return f"EventSolution: {len(self.phases)} phases", rows, str(self.outcome)


def at_held_times(run: Solution, times: Array, states: Sensitivities, t_b: Array) -> Solution:
    """Return the solution of a phase at its times in the whole run.

    Its derivatives are taken at fixed times. `states` are derivatives at the time points of the
    phase, which move with the design by t_b.
    """

    def rate(x: Array) -> Array:
        return np.gradient(x, run.t, axis=0)

    moved = t_b[:, None, :]
    q_b = states.q_b - run.v[..., None] * moved
    v_b = states.v_b - run.a[..., None] * moved
    a_b = states.a_b - rate(run.a)[..., None] * moved
    lam_b = states.lam_b - rate(run.lam)[..., None] * moved
    held = replace(states, q_b=q_b, v_b=v_b, a_b=a_b, lam_b=lam_b)
    return replace(run, t=times, sensitivities=held, control=())
