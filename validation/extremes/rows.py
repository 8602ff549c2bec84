"""One row of the report `extremes`: run a case, and say how it ended and how right it is."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ancfdae import HHT, Scene, assemble, simulate
from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors import AncfdaeError, StabilityWarning
from ancfdae.extend import MaterialPoint
from ancfdae.integrators.hht.equations import Coefficients
from ancfdae.numerics.arrays import Array
from ancfdae.results import Solution
from validation.report import Report

HEADER = (
    "case",
    "outcome",
    "error",
    "estimated",
    "equations",
    "constraints",
    "condition",
    "iterations",
)
_NUMBERS = HEADER[2:]
# A motion with a larger relative error must show it: its estimated error may not be much less.
_WRONG_MOTION, _SHARE = 0.02, 0.2
# An accepted step whose equations are violated by more is an undetected error; the
# stopping rule lets round-off pass up to 1e-6 of the motion (docs/theory/05-hht-i3.md).
_WRONG_EQUATIONS = 1e-5
_WRONG_CONSTRAINTS = 1e-8
# The error counts as detected if this part of the steps were counted as ended by round-off.
_SIGN = 0.5
_DENSE = 500
_CHECKED_INSTANTS = 40
_NOT_MEASURED = "-"
# What a defect of the package would look like.
_CRASHES = (ArithmeticError, AttributeError, LookupError, MemoryError, RuntimeError, TypeError)


@dataclass(frozen=True)
class Case:
    """A run that becomes a row of a table.

    `make` returns the scene or the system and may be refused. `error` of the finished run against
    a reference is free of units. `in_time` says that it is the error of the steps, which the run
    must then show in its estimate.
    """

    label: str
    make: Callable[[], Scene | MechanicalSystem]
    step: float
    steps: int
    alpha: float = -0.3
    error: Callable[[Solution], float] | None = None
    in_time: bool = False


@dataclass(frozen=True)
class Row:
    """The findings of a case; a number is None where there is nothing to measure.

    The message says how the run ended or why it was refused; `clean` is whether the package
    promises such an end.
    """

    case: Case
    message: str
    clean: bool
    solution: Solution | None = None
    error: float | None = None
    estimated: float | None = None
    equations: float | None = None
    constraints: float | None = None
    condition: float | None = None
    iterations: float | None = None

    @property
    def survived(self) -> bool:
        """Whether the run reached its end."""
        return self.solution is not None and self.solution.outcome.success

    def cells(self) -> list[object]:
        """Return the row of the table."""
        numbers = [getattr(self, name) for name in _NUMBERS]
        formats = (".1e", ".0e", ".0e", ".0e", ".0e", ".1f")
        shown = [
            _NOT_MEASURED if value is None else format(value, style)
            for value, style in zip(numbers, formats, strict=True)
        ]
        return [self.case.label, self.message, *shown]


def measure(case: Case) -> Row:
    """Run a case."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            row = _run(case)
        except AncfdaeError as error:
            row = Row(case, f"refused: {error}", True)
        except _CRASHES as error:
            row = Row(case, f"CRASH: {type(error).__name__}: {error}", False)
    noise = {f"{w.category.__name__}: {w.message}" for w in caught if not _expected(w)}
    for said in sorted({str(w.message) for w in caught if _expected(w)}):
        row = replace(row, message=f"{row.message}; warned: {said}")
    if not noise:
        return row
    message = f"{row.message} WARNING: {'; '.join(sorted(noise))}"
    return replace(row, message=message, clean=False)


def add_table(report: Report, name: str, rows: list[Row]) -> None:
    """Add the rows of one group and keep their figures."""
    report.table(HEADER, [row.cells() for row in rows])
    for number, row in enumerate(rows):
        for what in _NUMBERS:
            value = getattr(row, what)
            if value is not None:
                report.figure(f"{name}.{number}.{what}", value)
        report.figure(f"{name}.{number}.survived", row.survived)


def _expected(warning: warnings.WarningMessage) -> bool:
    return issubclass(warning.category, StabilityWarning)


def _run(case: Case) -> Row:
    model = case.make()
    system = assemble(model) if isinstance(model, Scene) else model
    run = simulate(system, case.step * case.steps, HHT(case.step, hht_alpha=case.alpha))
    equations, constraints = _defects(system, run)
    statistics, outcome = run.statistics, run.outcome
    signed = statistics.round_off_steps > _SIGN * statistics.steps
    right = (equations < _WRONG_EQUATIONS or signed) and constraints < _WRONG_CONSTRAINTS
    if outcome.success:
        message = f"survived {statistics.steps} steps"
        if statistics.round_off_steps:
            message += f", {statistics.round_off_steps} to round-off"
        if statistics.continued:
            message += f", {statistics.continued} by way of shorter ones"
    else:
        message = f"stopped: {outcome}"
    error = None if case.error is None or not outcome.success else case.error(run)
    if error is not None and not math.isfinite(error):
        error, message = None, f"{message}; the run to compare with stopped"
    if not right:
        message += " WRONG: accepted steps violate the equations."
    assert run.estimated_errors is not None
    estimated = run.estimated_errors.motion
    if case.in_time and error is not None and estimated < _SHARE * error > _SHARE * _WRONG_MOTION:
        right, message = False, f"{message} WRONG: without a sign."
    return Row(
        case,
        message,
        right,
        run,
        error,
        estimated,
        equations,
        constraints,
        _condition(system, case),
        statistics.iterations / max(statistics.steps, 1),
    )


def _defects(system: MechanicalSystem, run: Solution) -> tuple[float, float]:
    """Largest violation of the equations of motion and of the constraints, both free of units.

    Recomputed from the solution: |M A + Phi_q^T lam - Q| against its terms, and |Phi_k|/|Phi_qk|
    against |q|, in the norm of the weights.
    """
    weights, pattern = system.weights, system.constraint_pattern
    chosen = np.unique(np.linspace(0, len(run.t) - 1, _CHECKED_INSTANTS).astype(int))
    worst = [0.0, 0.0]

    def norm(x: Array) -> float:
        return float(np.sqrt(np.sum(x * x / weights)))

    for t, q, v, a, lam in zip(
        *(x[chosen] for x in (run.t, run.q, run.v, run.a, run.lam)), strict=True
    ):
        parts = (system.mass_times(q, a), reaction(system, t, q, lam))
        Q = system.force(t, q, v)
        size = sum(norm(x) for x in (*parts, Q))
        floor = system.traits.force_round_off * 1e6
        worst[0] = max(worst[0], norm(parts[0] + parts[1] - Q) / max(size, floor, 1e-300))
        if system.n_lam:
            values = system.constraint_q(t, q) / np.sqrt(weights[pattern.columns])
            rows = np.sqrt(np.bincount(pattern.rows, values**2, minlength=system.n_lam))
            distance = np.abs(system.constraint(t, q)) / np.where(rows > 0, rows, 1.0)
            length = float(np.sqrt(np.sum(weights * q * q)))
            worst[1] = max(worst[1], float(np.max(distance)) / max(length, 1e-300))
    return worst[0], worst[1]


def _condition(system: MechanicalSystem, case: Case) -> float | None:
    """Condition number of the scaled iteration matrix at the start, for small systems."""
    n, m = system.n_q, system.n_lam
    if n + m > _DENSE:
        return None
    q, v = system.start()
    t, zero = np.zeros(1), np.zeros((1, n))
    local = system.linearise(t, q[None], v[None], zero, np.zeros((1, m)))
    c = Coefficients(case.step, case.alpha)
    K = c.in_A * local.M[0] + c.in_q * local.f_q[0]
    if local.f_v is not None:
        K = K + c.in_v * local.f_v[0]
    B = system.constraint_pattern.dense(local.Phi_q[0])
    scale = saddle_point(system, 0.0).scale
    matrix = np.block([[system.pattern.dense(K), B.T], [B, np.zeros((m, m))]]) * np.outer(
        scale, scale
    )
    return float(np.linalg.cond(matrix))


def against_sixteenth(
    label: str, scene: Scene, beam: str, step: float, steps: int, at: float = 1.0
) -> Case:
    """Case whose error is that of a point, relative to its travel, to sixteen times the steps."""

    def error(run: Solution) -> float:
        fine = simulate(scene, step * steps, HHT(step / 16))
        if not fine.outcome.success:
            return np.inf
        place, exact = (x.position(MaterialPoint(beam, at)) for x in (run, fine))
        return float(np.max(np.abs(place - exact[::16])) / np.max(np.abs(exact - exact[0])))

    return Case(label, lambda: scene, step, steps, error=error)
