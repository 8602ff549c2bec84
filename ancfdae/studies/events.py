"""Runs with events behind `simulate`, `differentiate`, `gradients`, fits and sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.event_solution import START, EventSolution
from ancfdae.errors.checks import require_count, require_kind
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.events.calls import EventRun, assembled, solution, states_of
from ancfdae.events.kinds import Mode
from ancfdae.events.objectives import PhaseStates, require_reductions, value_of
from ancfdae.events.phases import Beginning, PhasedRun
from ancfdae.events.thinning import thinned
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.model.design import DesignVariable
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.sensitivity.method import Gradient, GradientMethod, UnfinishedRunError
from ancfdae.sensitivity.objectives import AtTimes, Objective
from ancfdae.sensitivity.observables.observable import Observable, observe, require_same_sizes
from ancfdae.sensitivity.observables.observable import states_of as state_rows
from ancfdae.studies.parts import Keep, instants


def simulated(run: EventRun, after: object = None, keep: Keep | None = None) -> EventSolution:
    """Return the run with events, continued from `after` if given.

    The last phase of `after`, which no event ended, is integrated again, so that its steps
    equal the steps of a run in one go. Phases hold all states, or their ends and
    the states that `keep` names.
    """
    thin = None if keep is None else thinned(kept_states(keep, run.t_end))
    if after is None:
        return uninterrupted(solution(run.phased(thin=thin)))
    require_kind("after", after, (EventSolution,), "Pass what simulate returned with events.")
    assert isinstance(after, EventSolution)
    begins = _beginning(run, after)
    if begins is None:
        return uninterrupted(solution(run.phased(thin=thin)))
    found, t_0 = solution(run.phased(begins, thin)), begins.state[0]
    records = tuple(x for x in after.events if x.time <= t_0)
    return uninterrupted(
        replace(found, phases=after.phases[:-1] + found.phases, events=records + found.events)
    )


def kept_states(keep: Keep, t_end: float) -> int | Array:
    """Return the number or times of the states to store; InvalidInputError for invalid ones."""
    if isinstance(keep, int):
        require_count("keep", keep, "keep=100 keeps one step of 100, and the ends of phases.")
        return keep
    return instants("keep", keep, t_end)


def _beginning(run: EventRun, after: EventSolution) -> Beginning | None:
    """Return the state in which the last phase of `after` began; None if it is the start.

    InvalidInputError for a run of another model, or one that has passed the end time.
    """
    last, n_q = after.phases[-1], run.system.n_q
    if last.q.shape[1] != n_q:
        got = f"{last.q.shape[1]} coordinates in place of {n_q}"
        raise InvalidInputError("after", "must be a run of this model", got)
    if run.t_end < last.t[-1]:
        rule, got = "must not have passed t_end", f"{last.t[-1]:.6g} s and {run.t_end:.6g} s"
        raise InvalidInputError("after", rule, got, "Take Solution.at, or run again.")
    if len(after.phases) == 1:
        return None
    t_0 = float(last.t[0])
    name, just = after.modes[-1], {x.name for x in after.events if x.time == t_0}
    if name not in run.modes:
        raise UnknownNameError("mode in which `after` ends", name, list(run.modes))
    happened = tuple(x for x in run.modes[name].events if x.name in just)
    before = after.phases[-2]
    duration = float(before.t[-1] - before.t[0])
    return Beginning(name, (t_0, last.q[0], last.v[0]), happened, duration)


def differentiated(run: EventRun, method: object) -> EventSolution:
    """Return the run with events, with design derivatives if it reached its end.

    InvalidInputError unless the method is `DirectDifferentiation`.
    """
    if not isinstance(method, DirectDifferentiation):
        rule = "must be DirectDifferentiation() in a run with events"
        repair = "Call gradient, which takes other methods, too."
        raise InvalidInputError("method", rule, repr(method), repair)
    phased = run.phased()
    if not phased.outcome.success:
        return uninterrupted(solution(phased))
    return run.differentiated(phased)


def values(run: EventRun, objectives: Sequence[Objective]) -> tuple[EventSolution, Array]:
    """Return a finished run with events, and the values of objectives, shape (n,)."""
    require_reductions(objectives)
    phased = run.phased()
    found = reached(phased)
    phases = states_of(phased)
    return found, np.array([value_of(objective, phases).real for objective in objectives])


def evaluated(
    objective: Objective,
    found: EventSolution,
    system: MechanicalSystem,
    modes: Mapping[str, Mode] | None,
    design: Sequence[str | DesignVariable] | None,
) -> float:
    """Return the value of an objective on the solution of a run that began with `system`."""
    require_reductions([objective])
    if not found.outcome.success:
        raise _unfinished(found)
    systems = {START: system}
    for name, mode in (modes or {}).items():
        require_kind(f"modes[{name!r}]", mode, (Mode,), "For example Mode(scene, events).")
        systems[name] = assembled(mode.model, design)
    phases = []
    for name, phase in zip(found.modes, found.phases, strict=True):
        if name not in systems:
            raise UnknownNameError("mode of the run", name, list(systems))
        require_same_sizes("model", systems[name], phase)
        span = float(phase.t[0]), float(phase.t[-1] - phase.t[0])
        phases.append(PhaseStates(systems[name], state_rows(phase), *span))
    return float(value_of(objective, phases).real)


def observed(run: EventRun, observable: Observable) -> tuple[EventSolution, Array]:
    """Return a finished run with events and an observable along all its phases, shape (n_t,)."""
    phased = run.phased()
    found = reached(phased)
    systems = {phase.mode.name: phase.mode.system for phase in phased.phases}
    return found, observe(observable, found, systems)


def measured(
    run: EventRun, observables: Sequence[Observable], times: Numbers
) -> tuple[EventSolution, Array, Array]:
    """Return a finished run, observables at times, (n, m), and their derivatives, (n, m, n_b)."""
    read = [AtTimes(observable, [time]) for observable in observables for time in times]
    found = gradients(run, read, DirectDifferentiation())
    solution, shape = found[0].event_solution, (len(observables), len(times))
    assert solution is not None  # of a run with events
    slopes = np.reshape([each.gradient for each in found], (*shape, -1))
    return solution, np.reshape([each.value for each in found], shape), slopes


def reached(phased: PhasedRun) -> EventSolution:
    """Return the solution of a run; UnfinishedRunError if it did not reach its end."""
    found = uninterrupted(solution(phased))
    if not phased.outcome.success:
        raise _unfinished(found)
    return found


def _unfinished(found: EventSolution) -> UnfinishedRunError:
    """Return the error of a run with events that did not reach its end."""
    return UnfinishedRunError(replace(found.phases[-1], outcome=found.outcome))


def gradients(
    run: EventRun, objectives: Sequence[Objective], method: GradientMethod | None
) -> list[Gradient]:
    """Return value and gradient of each objective of a run with events."""
    if method is None:
        # The adjoint takes two passes over each phase for every objective.
        few = len(run.b) <= 4 * len(objectives)
        adjoint = isinstance(run.integrator, SteppedIntegrator) and not few
        method = Adjoint() if adjoint else DirectDifferentiation()
    phased, pairs = run.gradients(objectives, method)
    found = reached(phased)
    last = replace(found.phases[-1], outcome=found.outcome)
    names = run.design_names
    return [
        Gradient(value, slope, names, method, last, event_solution=found) for value, slope in pairs
    ]
