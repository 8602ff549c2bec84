"""What every method of differentiating a run offers."""

from __future__ import annotations

import abc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.errors import AncfdaeError, Outcome, PassFailed, SingularMatrix, Verdict
from ancfdae.integrators import Integrator, QuadratureIntegrator
from ancfdae.numerics.arrays import Array
from ancfdae.objectives import Objective
from ancfdae.objectives.objective import NO_TOTALS, Totals
from ancfdae.objectives.totals import totals_of
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution
from ancfdae.protocol.solution_parts import Sensitivities
from ancfdae.text import columns


@final
class UnfinishedRun(AncfdaeError):
    """A gradient was asked of a run that did not reach its end time.

    Attributes
    ----------
    solution : Solution
        What was computed, with its outcome.
    """

    def __init__(self, solution: Solution) -> None:
        super().__init__(f"no gradient: {solution.outcome}")
        self.solution = solution


@final
@dataclass(frozen=True)
class Gradient:
    """Value and gradient of an objective.

    Attributes
    ----------
    value : float
    gradient : array, shape (n_b,)
        Total derivatives in the design variables.
    names : tuple of str
        Names of the design variables.
    method : GradientMethod
        How it was computed.
    solution : Solution
        The run at the design.
    """

    value: float
    gradient: Array
    names: tuple[str, ...]
    method: GradientMethod
    solution: Solution

    @property
    def pair(self) -> tuple[float, Array]:
        """Value and gradient, as ``scipy.optimize.minimize(jac=True)`` wants them."""
        return self.value, self.gradient

    def __repr__(self) -> str:
        """Return value, method, derivatives by name and outcome."""
        slopes = [f"{slope:.6g}" for slope in self.gradient]
        rows = [("design variable", "derivative"), *zip(self.names, slopes, strict=True)]
        head = f"objective {self.value:.9g}, gradient by {self.method}"
        return f"{head}\n{columns(rows)}\n{self.solution.outcome}"


class GradientMethod(abc.ABC):
    """Frozen settings of a method that differentiates objectives of a run."""

    @abc.abstractmethod
    def gradients(
        self,
        system: MechanicalSystem,
        objectives: Sequence[Objective],
        t_end: float,
        integrator: Integrator,
        progress: bool,
    ) -> list[Gradient]:
        """Return value and gradient of every objective from as few runs as possible.

        Raises
        ------
        UnfinishedRun
            If a run ends before `t_end`.
        NonFiniteObjective
            If an objective is not finite.
        """


class Method(GradientMethod):
    """A method that differentiates the whole trajectory, and so any objective."""

    @abc.abstractmethod
    def differentiate(
        self, system: MechanicalSystem, t_end: float, integrator: Integrator, progress: bool
    ) -> Solution:
        """Return the solution with the design derivatives of its trajectory.

        A run that ends early yields derivatives up to the last instant that all runs reached.
        """


@contextmanager
def keeping(solution: Solution) -> Iterator[None]:
    """Raise an error with the run and the reason where a pass back breaks off.

    Raises
    ------
    UnfinishedRun
    """
    try:
        yield
    except KeyboardInterrupt as error:
        raise _without_gradient(solution, Verdict.INTERRUPTED) from error
    except SingularMatrix as error:
        raise _without_gradient(solution, Verdict.SINGULAR) from error
    except PassFailed as error:
        raise _without_gradient(solution, error.verdict) from error


def _without_gradient(solution: Solution, verdict: Verdict) -> UnfinishedRun:
    return UnfinishedRun(replace(solution, outcome=replace(solution.outcome, verdict=verdict)))


def finished(solution: Solution) -> Solution:
    """Return a solution that reached its end time.

    Raises
    ------
    UnfinishedRun
    """
    if not solution.outcome.success:
        raise UnfinishedRun(solution)
    return solution


def run_for(
    system: MechanicalSystem,
    objectives: Sequence[Objective],
    t_end: float,
    integrator: Integrator,
    progress: bool,
    *,
    differentiated: bool,
    sensitivities: bool = False,
) -> tuple[Solution, Totals]:
    """Return a finished run and the integrals that the integrator took beside the motion.

    Raises
    ------
    UnfinishedRun
    """
    if not isinstance(integrator, QuadratureIntegrator):
        run = integrator.integrate(system, t_end, sensitivities=sensitivities, progress=progress)
        return finished(run), NO_TOTALS
    totals = totals_of(system, objectives, differentiated)
    run = integrator.integrate_with(
        system, t_end, list(totals.values()), sensitivities=sensitivities, progress=progress
    )
    return finished(run), totals


def with_columns(
    system: MechanicalSystem,
    solution: Solution,
    columns: Sequence[tuple[Array, Array, Array, Array]],
    outcomes: Sequence[Outcome],
) -> Solution:
    """Attach derivatives given as columns (q_b, v_b, a_b, lam_b), one per design variable.

    Everything is cut to the shortest column; the outcome is that of the run that ended first.
    """
    rows = min([len(solution.t), *(len(column[0]) for column in columns)])
    first = min([solution.outcome, *outcomes], key=lambda outcome: outcome.step)
    parts = [
        np.stack([column[k][:rows] for column in columns], axis=-1)
        if columns
        else np.zeros((rows, n, 0))
        for k, n in enumerate((system.n_q, system.n_q, system.n_q, system.n_lam))
    ]
    own = Sensitivities(system.design_names, system.b, parts[0], parts[1], parts[2], parts[3])
    return replace(
        solution,
        t=solution.t[:rows],
        q=solution.q[:rows],
        v=solution.v[:rows],
        a=solution.a[:rows],
        lam=solution.lam[:rows],
        outcome=first,
        sensitivities=own,
    )


def repeated(integrator: Integrator, solution: Solution, t_end: float) -> tuple[Integrator, float]:
    """Return the integrator at the steps of a run, and the time to which it can repeat them."""
    done = solution.outcome.success or len(solution.t) < 2
    return integrator.frozen(solution), t_end if done else float(solution.t[-1])
