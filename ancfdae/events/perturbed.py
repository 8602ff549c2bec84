"""A run with events at a complex design: the phases of a real run with imaginary parts.

The complex step differentiates whole runs, events included. With an imaginary step in the design
the function g of the event that ends a phase has the value i Im g there. A phase of the real system
whose duration D has an imaginary step gives g_D, and D changes by -i Im g / g_D. Derivatives of the
motion with respect to the design are not used.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.complex_steps import at_values
from ancfdae.events.derivatives import require_closed_start
from ancfdae.events.functions import in_time
from ancfdae.events.kinds import ModeSystem
from ancfdae.events.objectives import PhaseStates
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.events.phases import Jump, Phase, PhasedRun
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.sensitivity.method import finished
from ancfdae.sensitivity.observables.observable import Observable, States

State = tuple[complex, Array, Array]


def at_complex(run: PhasedRun, b: Array, late: float = 0.0) -> list[PhaseStates]:
    """Return the states of all phases of a run at a complex design b near its own.

    The end time of the run has the imaginary part `late`.
    """
    systems: dict[str, MechanicalSystem] = {}

    def moved(mode: ModeSystem) -> MechanicalSystem:
        if mode.name not in systems:
            systems[mode.name] = at_values(mode.system, b)
        return systems[mode.name]

    system = moved(run.phases[0].mode)
    state: State = (0.0, *system.start())
    if run.before is not None:
        require_closed_start(run.phases[0].mode.system, run.before)
        state = _jumped(moved, run.before, state)
    found = []
    for phase in run.phases:
        system = moved(phase.mode)
        D = _duration(phase, system, state, late)
        complete, last = _states(phase, system, state, D)
        found.append(complete)
        state = last if phase.jump is None else _jumped(moved, phase.jump, last)
    return found


def _duration(phase: Phase, system: MechanicalSystem, state: State, late: float) -> complex:
    """Return the duration of a phase at a complex design, s; its event moves with the design."""
    if phase.event is None:
        return phase.t_end + 1j * late - state[0]
    D, function = phase.duration, phase.event.crossing[0]
    off = _at_end(phase, system, function, state, D)
    stretched = _at_end(phase, phase.mode.system, function, phase.state, D * (1 + 1j * STEP))
    rate = np.imag(stretched) / (STEP * D)
    return D - 1j * np.imag(off) / rate


def _at_end(
    phase: Phase, system: MechanicalSystem, function: Observable, state: State, D: complex
) -> complex:
    """Return the function of an event at the end of a phase of duration D from a state."""
    complete, (t, *_) = _states(phase, system, state, D)
    states = complete.states
    last = States(states.t[-1:], states.q[-1:], states.v[-1:], states.lam[-1:])
    value = complex(function.value(system, last)[0])
    real = States(last.t, last.q.real, last.v.real, last.lam.real)
    return value + 1j * np.imag(t) * in_time(phase.mode.system, function, real)[0]


def _states(
    phase: Phase, system: MechanicalSystem, state: State, D: complex
) -> tuple[PhaseStates, State]:
    """Integrate a phase from a state for the duration D; return its states, and the last one."""
    t, q, v = state
    start = PhaseStart.held(t, q, v, system.n_b)
    local = PhaseSystem(system, start, D, phase.first)
    run = finished(phase.integrator.integrate(local, float(np.real(D))))
    rates = run.v * (np.real(D) / D)
    states = States(phase.t_0 + run.t, run.q, rates, run.lam, run.degree)
    return PhaseStates(system, states, t, D), (t + D, run.q[-1], rates[-1])


def _jumped(moved: Callable[[ModeSystem], MechanicalSystem], jump: Jump, state: State) -> State:
    """Return the state after a jump whose modes are at a complex design."""
    for strike in jump.strikes:
        state = strike.at_complex(moved(strike.mode), state)
    return state
