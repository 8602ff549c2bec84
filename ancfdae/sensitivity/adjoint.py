"""The discrete equations differentiated: directly (eqs. 21-25), and by their transpose."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import AdjointIntegrator, Seeds
from ancfdae.numerics.threads import in_one_thread
from ancfdae.sensitivity import checkpointed
from ancfdae.sensitivity.checkpointed import size_of
from ancfdae.sensitivity.method import Gradient, GradientMethod, Method, Run, keeping
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.states import states_of


@final
@dataclass(frozen=True)
class DirectDifferentiation(Method):
    """Differentiate the discrete equations step by step.

    The result is the exact derivative of the discrete solution; all design variables are
    right-hand sides of one factorisation per step.
    """

    def differentiate(self, run: Run) -> Solution:
        """Return the motion with its design derivatives."""
        return run.solution(sensitivities=True)

    @in_one_thread
    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """Differentiate all objectives by one run and one forward pass over it (eq. 21)."""
        solution, totals = run.integrals(objectives, differentiated=True, sensitivities=True)
        states, s = states_of(solution), solution.sensitivities
        assert s is not None
        results = []
        for objective in objectives:
            p = objective.partials(run.system, states, totals)
            total = p.b
            for rows, x_b in ((p.q, s.q_b), (p.v, s.v_b), (p.lam, s.lam_b)):
                if rows is not None:
                    total = total + np.tensordot(rows, x_b, axes=2)
            results.append(Gradient(p.value, total, run.system.design_names, self, solution))
        return results


@final
@dataclass(frozen=True)
class Adjoint(GradientMethod):
    """Run forward once, then backward once per objective.

    The backward pass is the transpose of the recurrence that direct differentiation runs, so
    the two agree to round-off at any step size. Its cost grows little with the number of design
    variables: report `performance` measures it with six variables and with a thousand.

    Parameters
    ----------
    memory : str or float, optional
        Memory limit for stored states, for example ``"200 MB"``, or a number of bytes. If the run
        needs more, as few parts of it as possible are integrated again during the backward pass
        (docs/theory/08-adjoint.md). For `HHT` at steps that are known before.
    """

    memory: str | float | None = None

    def __post_init__(self) -> None:
        if self.memory is not None:
            size_of(self.memory)

    def __repr__(self) -> str:
        return f"Adjoint(memory={self.memory!r})" if self.memory is not None else "Adjoint()"

    @property
    def takes_runs(self) -> bool:
        """Whether an existing run can be reused: False with `memory`, where parts run again."""
        return self.memory is None

    @in_one_thread
    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """Differentiate all objectives by one run, and one backward pass over it for each."""
        system, integrator = run.system, run.integrator
        if not isinstance(integrator, AdjointIntegrator):
            rule, repair = (
                "needs an integrator with an adjoint",
                "Use HHT, Radau or IDAS, or DirectDifferentiation().",
            )
            raise InvalidInputError("Adjoint", rule, repr(integrator), repair)
        if self.memory is not None:
            return checkpointed.gradients(run, objectives, self, size_of(self.memory))
        solution, totals = run.integrals(objectives, differentiated=True)
        results = []
        factorised = integrator.back_factorisations(solution)
        for objective in objectives:
            started = time.perf_counter()
            partials = objective.partials(system, states_of(solution), totals)
            seeds = Seeds(partials.q, partials.v, partials.lam, partials.densities)
            with keeping(solution):
                total = partials.b + integrator.pull_back(system, solution, seeds, run.progress)
            seconds = time.perf_counter() - started
            done = solution.with_pass(factorised, seconds)
            results.append(Gradient(partials.value, total, system.design_names, self, done))
        return results
