"""Runs of external problems: the result and its cost, or why there is none."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ancfdae import (
    DOP853,
    IDA,
    IDAS,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    FiniteDifference,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.errors import (
    InvalidInputError,
    ManyStepsWarning,
    MissingPackageError,
    StabilityWarning,
    UnfinishedRunError,
)
from ancfdae.extend import MechanicalSystem
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch
from ancfdae.results import Solution
from ancfdae.sensitivity.method import GradientMethod
from ancfdae.sensitivity.objectives import Objective
from validation.integrator_runs import MANY, step_of
from validation.report import Report

FINISHED: Final = "finished"
_REFUSED: Final = "refused"

_METHODS: Final[Mapping[str, GradientMethod]] = {
    "direct": DirectDifferentiation(),
    "adjoint": Adjoint(),
    "continuous adjoint": ContinuousAdjoint(),
    "central difference": FiniteDifference(1e-3, central=True),
    "complex step": ComplexStep(),
}


@dataclass(frozen=True)
class Attempt:
    """A run or a gradient, and its processor time.

    The note is `FINISHED`, or why there is no result. The solution is kept if the run ended early;
    the value is the objective with its gradient, where one was asked for and computed.
    """

    note: str
    seconds: float
    solution: Solution | None = None
    value: Array | None = None

    @property
    def finished(self) -> bool:
        """Whether the end time was reached."""
        return self.note == FINISHED

    @property
    def refused(self) -> bool:
        """Whether the package does not offer the combination."""
        return self.note.startswith(_REFUSED)


@dataclass(frozen=True)
class Problem:
    """A system with an objective whose value and gradient are known.

    The name is for keys of figures; `exact` holds the objective and its gradient, shape (1 + n_b,).
    """

    name: str
    system: MechanicalSystem
    objective: Objective
    t_end: float
    exact: Array


def controlled(
    rtols: Sequence[float], intervals: int, max_steps: int = MANY
) -> list[IDA | IDAS | DOP853]:
    """Return every integrator with error control at every tolerance."""
    kinds = (IDA, IDAS, DOP853)
    return [k(rtol=r, intervals=intervals, max_steps=max_steps) for k in kinds for r in rtols]


def setting(integrator: Integrator) -> str:
    """Return the step or the tolerance in words."""
    if isinstance(integrator, SteppedIntegrator):
        return f"h = {step_of(integrator):g}"
    assert isinstance(integrator, IDA | IDAS | DOP853)
    return f"rtol = {integrator.rtol:.0e}"


def key(*parts: object) -> str:
    """Return the key of a figure."""
    words = [
        f"{type(x).__name__}.{setting(x)}" if isinstance(x, Integrator) else str(x) for x in parts
    ]
    return ".".join(words).replace(" = ", "").replace(" ", "_")


def run(
    system: MechanicalSystem, t_end: float, integrator: Integrator, sensitivities: bool = True
) -> Attempt:
    """Integrate, with direct differentiation if sensitivities are asked for."""

    def call() -> Attempt:
        if sensitivities:
            solution = differentiate(system, t_end, integrator)
        else:
            solution = simulate(system, t_end, integrator)
        note = FINISHED if solution.outcome.success else solution.outcome.verdict.value
        return Attempt(note, 0.0, solution)

    return _timed(call)


def differentiated(problem: Problem, integrator: Integrator, method: GradientMethod) -> Attempt:
    """Return the objective and its gradient."""

    def call() -> Attempt:
        answer = gradient(
            problem.system, problem.objective, problem.t_end, integrator, method=method
        )
        return Attempt(FINISHED, 0.0, answer.solution, np.array([answer.value, *answer.gradient]))

    return _timed(call)


def _timed(call: Callable[[], Attempt]) -> Attempt:
    clock = stopwatch()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", ManyStepsWarning)
            # The double four-bar passes one; the report says so.
            warnings.filterwarnings("ignore", "The run passes a singular", StabilityWarning)
            attempt = call()
    except ManyStepsWarning as warning:
        attempt = Attempt(f"given up: {str(warning).split(':')[0]}", 0.0)
    except MissingPackageError:
        attempt = Attempt("sundials4py is not installed", 0.0)
    except UnfinishedRunError as error:
        note = error.solution.outcome.verdict.value
        attempt = Attempt(note, 0.0, error.solution)
    except InvalidInputError as error:
        attempt = Attempt(f"{_REFUSED}: {error.where} {error.rule}", 0.0)
    return Attempt(attempt.note, clock(), attempt.solution, attempt.value)


def rows_at(solution: Solution, times: Array) -> list[int]:
    """Return the rows of the solution at the given times, which must be among its times."""
    rows = [int(np.argmin(np.abs(solution.t - time))) for time in times]
    assert np.allclose(solution.t[rows], times, rtol=0, atol=1e-9)
    return rows


def compare_methods(report: Report, problem: Problem, integrators: Sequence[Integrator]) -> None:
    """Add the table of all integrators by all methods; name the refused combinations below."""
    table: list[list[object]] = []
    refused: dict[str, list[str]] = {}
    for integrator in integrators:
        family = type(integrator).__name__
        direct: Array | None = None
        for name, method in _METHODS.items():
            attempt = differentiated(problem, integrator, method)
            if attempt.refused:
                refused.setdefault(name, []).append(family)
                continue
            row: list[object] = [family, setting(integrator), name]
            if attempt.value is None:
                table.append([*row, "-", "-", f"{attempt.seconds:.2f}", attempt.note])
                continue
            error = float(np.max(np.abs(attempt.value - problem.exact)[1:]))
            report.figure(key(problem.name, "methods", integrator, name, "error"), error)
            direct = attempt.value if name == "direct" else direct
            apart = None if direct is None else np.max(np.abs(attempt.value - direct)[1:])
            cells = [f"{error:.1e}", "-" if apart is None else f"{apart:.1e}"]
            table.append([*row, *cells, f"{attempt.seconds:.2f}", attempt.note])
    report.table(
        ["integrator", "setting", "method", "error", "from direct", "CPU [s]", "outcome"], table
    )
    which = (f"{name} ({', '.join(families)})" for name, families in refused.items())
    report.text(f"Refused by the package: {'; '.join(which)}.")
