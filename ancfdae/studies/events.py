"""The calls `simulate`, `differentiate` and `gradients`, fits and sweeps of runs with events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ancfdae.equations.event_solution import EventSolution
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.events.calls import EventRun, solution, states_of
from ancfdae.events.objectives import along_phases, require_reductions, value_of
from ancfdae.events.run import PhasedRun
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.sensitivity.method import Gradient, GradientMethod, UnfinishedRunError
from ancfdae.sensitivity.objectives import AtTimes, Objective
from ancfdae.sensitivity.observables.observable import Observable


def simulated(run: EventRun) -> EventSolution:
    """Return the motion with its events."""
    return uninterrupted(solution(run.phased()))


def differentiated(run: EventRun, method: object) -> EventSolution:
    """Return the motion with its events, and the design derivatives of both if it reached the end.

    The method is `DirectDifferentiation`.
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
    """Return a finished run with events and the values of objectives, without derivatives."""
    require_reductions(objectives)
    phased = run.phased()
    found = _reached(phased)
    phases = states_of(phased)
    return found, np.array([value_of(objective, phases).real for objective in objectives])


def observed(run: EventRun, observable: Observable) -> tuple[EventSolution, Array]:
    """Return a finished run with events and an observable along all its phases, shape (n_t,)."""
    phased = run.phased()
    found = _reached(phased)
    nodes = along_phases(observable, states_of(phased))
    return found, np.concatenate([list(each.values())[-1] for each in nodes])


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


def _reached(phased: PhasedRun) -> EventSolution:
    """Return the solution of a run; UnfinishedRunError if it did not reach its end."""
    found = uninterrupted(solution(phased))
    if not phased.outcome.success:
        raise UnfinishedRunError(replace(found.phases[-1], outcome=found.outcome))
    return found


def gradients(
    run: EventRun, objectives: Sequence[Objective], method: GradientMethod | None
) -> list[Gradient]:
    """Return value and gradient of each objective of a run with events."""
    if method is None:
        # The adjoint takes two passes over each phase for every objective.
        few = len(run.b) <= 4 * len(objectives)
        adjoint = isinstance(run.integrator, SteppedIntegrator) and not few
        method = Adjoint() if adjoint else DirectDifferentiation()
    phased = run.phased()
    found = _reached(phased)
    last = replace(found.phases[-1], outcome=found.outcome)
    names = run.design_names
    return [
        Gradient(value, slope, names, method, last, event_solution=found)
        for value, slope in run.gradients(phased, objectives, method)
    ]
