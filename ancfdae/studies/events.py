"""The calls `simulate`, `differentiate` and `gradients` for runs with events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ancfdae.equations.event_solution import EventSolution
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.events.calls import EventRun, solution
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.sensitivity.adjoint import Adjoint, DirectDifferentiation
from ancfdae.sensitivity.method import Gradient, GradientMethod, UnfinishedRunError
from ancfdae.sensitivity.objectives import Objective


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


def gradients(
    run: EventRun, objectives: Sequence[Objective], method: GradientMethod | None
) -> list[Gradient]:
    """Return value and gradient of each objective of a run with events."""
    if method is None:
        # The adjoint takes two passes over each phase for every objective.
        few = run.system.n_b <= 4 * len(objectives)
        adjoint = isinstance(run.integrator, SteppedIntegrator) and not few
        method = Adjoint() if adjoint else DirectDifferentiation()
    phased = run.phased()
    found = uninterrupted(solution(phased))
    last = replace(found.phases[-1], outcome=found.outcome)
    if not phased.outcome.success:
        raise UnfinishedRunError(last)
    names = run.system.design_names
    return [
        Gradient(value, slope, names, method, last, event_solution=found)
        for value, slope in run.gradients(phased, objectives, method)
    ]
