"""Impacts one after the other at one time, and derivatives of the times between them.

Impacts of bodies that do not act on each other may coincide at one design only. Each then has a
time of its own. Between two such impacts no time passes at this design, but the time has a
derivative. With the gap g of the second impact, its rate u = g_q v + g_t, and the state (q, v)
after the first,

    D_b = -(g_q q_b + g_t t_b + g_b) / u,   q_b + v D_b,   v_b + a D_b,   t_b + D_b,

where a are the accelerations from the equations of motion in this state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.events.contact_rows import gap_partials
from ancfdae.events.functions import Partials, gap_rows, rows_along
from ancfdae.events.impact import Directions, Struck, struck
from ancfdae.events.kinds import Impact, ModeSystem
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.start import InitialState
from ancfdae.numerics.arrays import Array

State = tuple[complex, Array, Array]

# Derivatives depend on the order of impacts if it changes them by more than this fraction.
_ORDER = 1e-6
# A second derivative of a gap counts as zero below this fraction of its terms.
_PRESSED = 1e-9


@final
@dataclass(frozen=True)
class Wait:
    """A time before an impact that is zero at this design: the gap, its rate, velocities and a."""

    gap: Partials
    rate: float
    v: Array
    a: Array

    @staticmethod
    def until(impact: Impact, system: MechanicalSystem, state: State) -> Wait:
        """Return the time from a state until an impact, with the data for its derivative."""
        t, q, v = float(np.real(state[0])), state[1], state[2]
        p = gap_partials(system, impact, (t, q, v))
        return Wait(p, float(p.q @ v + p.t), v, allowed(system, t, q, v).a)

    def change(self, moved: Directions) -> Array:
        """Return the derivatives of the time before an impact along directions, (k,)."""
        p = self.gap
        return -(p.t * moved.t + p.q @ moved.q + p.b @ moved.b) / self.rate

    def along(self, moved: Directions) -> Directions:
        """Return the directions in which the state moves at the end of this time."""
        D = self.change(moved)
        q, v = moved.q + np.outer(self.v, D), moved.v + np.outer(self.a, D)
        return Directions(moved.t + D, q, v, moved.b)


@final
@dataclass(frozen=True)
class Strike:
    """Impacts solved together in a mode, and the time before them at neighbouring designs."""

    mode: ModeSystem
    struck: Struck
    wait: Wait | None = None

    @staticmethod
    def of(
        mode: ModeSystem, impacts: Sequence[Impact], plastic: bool, state: State, *, apart: bool
    ) -> Strike:
        """Solve impacts at a state; if `apart` from earlier ones they have a time of their own."""
        wait = Wait.until(impacts[0], mode.system, state) if apart else None
        return Strike(mode, struck(mode.system, impacts, plastic, state), wait)

    @property
    def velocities(self) -> Array:
        """The velocities after the impacts, shape (n_q,)."""
        return self.struck.after.value

    def arrived(self, moved: Directions) -> Directions:
        """Return the directions in which the state moves just before the impacts."""
        return moved if self.wait is None else self.wait.along(moved)

    def along(self, moved: Directions) -> tuple[Directions, Array]:
        """Return the directions after the impacts, and derivatives of the impulses, (m, k)."""
        moved = self.arrived(moved)
        v_b, impulses_b = self.struck.along(moved)
        return moved._replace(v=v_b), impulses_b

    def at_complex(self, system: MechanicalSystem, state: State) -> State:
        """Return the state after the impacts from a state with small imaginary parts."""
        self.struck.require_branch()
        if self.wait is not None:
            parts = (np.imag(x)[..., None] for x in (np.asarray(state[0]), *state[1:], system.b))
            t, q, v, _ = self.wait.along(Directions(*parts))
            late = complex(np.real(state[0]), t[0])
            state = late, state[1].real + 1j * q[:, 0], state[2].real + 1j * v[:, 0]
        again = struck(system, self.struck.impacts, self.struck.plastic, state)
        return state[0], state[1], again.after.value


def allowed(system: MechanicalSystem, t: float, q: Array, v: Array) -> InitialState:
    """Return the consistent state of a system that is nearest to q, v at time t."""
    start = PhaseStart.held(t, q, v, system.n_b)
    return InitialValueProblem.of(PhaseSystem(system, start, 1.0, first=False), 1.0).initial


def is_pressed(system: MechanicalSystem, impact: Impact, state: tuple[float, Array, Array]) -> bool:
    """Return whether accelerations close a gap: g'' = g_q a + (g_q)' v + (g_t)' < 0."""
    t, q, v = state
    a = allowed(system, t, q, v).a
    g_q, _ = gap_rows(system, impact.gap, np.array([t]), q[None])
    motion = np.ones(1), v[:, None], np.zeros((system.n_b, 1))

    def rows_of(own: MechanicalSystem, times: Array, places: Array) -> tuple[Array, Array]:
        return gap_rows(own, impact.gap, times, places)

    turned, late = rows_along(system, rows_of, t, q, motion)
    terms = np.concatenate([g_q[0] * a, turned[:, 0] * v, late])
    return bool(np.sum(terms) < -_PRESSED * np.sum(np.abs(terms)))


def order_matters(strikes: Sequence[Strike], moved: Directions) -> bool:
    """Return whether derivatives change if impacts with times of their own swap their order."""
    turned, (t, q, v) = list[Strike](), strikes[0].struck.state
    for strike in reversed(strikes):
        same = strike.struck.impacts, strike.struck.plastic
        turned.append(Strike.of(strike.mode, *same, (t, q, v), apart=True))
        v = turned[-1].velocities
    one, other = (_at_held_time(each, moved) for each in (strikes, turned))
    sizes = [np.max(np.abs(x)) for x in one]
    changes = [np.max(np.abs(x - y)) for x, y in zip(one, other, strict=True)]
    return any(change > _ORDER * size for change, size in zip(changes, sizes, strict=True))


def _at_held_time(strikes: Sequence[Strike], moved: Directions) -> tuple[Array, Array]:
    """Return derivatives of q and v after impacts at a time that does not depend on the design."""
    for strike in strikes:
        moved, _ = strike.along(moved)
    last = strikes[-1].struck
    t, q, _ = last.state
    after = allowed(last.system, float(np.real(t)), q, last.after.value)
    return moved.q - np.outer(after.v, moved.t), moved.v - np.outer(after.a, moved.t)
