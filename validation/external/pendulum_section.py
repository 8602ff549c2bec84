"""Part of the report on external problems: the Cartesian pendulum."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ancfdae import DOP853, HHT, IDA, IDAS, Integral
from ancfdae.integrators.integrator import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.observables import custom
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.drawing import dots, error_over_work
from validation.external import published
from validation.external.rods import cartesian_pendulum
from validation.external.runs import (
    Attempt,
    Problem,
    compare_methods,
    controlled,
    key,
    rows_at,
    run,
    setting,
)
from validation.integrator_runs import MANY
from validation.report import Report

_LIMIT: Final = 1e-8
# See `_NOTES`.
_TIGHTEST_IDA: Final = 5e-13
# Which columns of the table belong together.
_GROUPS: Final = {
    "position, velocity": slice(0, 4),
    "multiplier": slice(4, 5),
    "in L": slice(5, 8),
    "in g": slice(8, 11),
}


@dataclass(frozen=True)
class _Run:
    """One run; errors of the columns, relative to max(1, |value|), None if it did not finish."""

    integrator: Integrator
    attempt: Attempt
    errors: Array | None


def speed(t: Array, q: Array, v: Array, lam: Array, b: Array) -> Array:
    """Return the first velocity; its integral is a change of position."""
    return v[:, 0]


def pendulum(report: Report, quick: bool) -> None:
    """Fill the section."""
    table = published.PENDULUM[:3] if quick else published.PENDULUM
    rtols = (1e-3, 1e-4) if quick else (1e-8, 1e-10, 1.5e-12)
    tightest = 1e-5 if quick else _TIGHTEST_IDA
    steps = (0.01, 0.005) if quick else (0.01, 0.005, 0.0025, 0.00125)
    report.say("pendulum")
    runs = _ladder(table, rtols, tightest, steps)
    _table(report, runs)
    report.say("pendulum.notes")
    orders = _order(report, runs)
    _columns(report, runs)
    _plots(report, runs, table)
    report.say("pendulum.methods")
    row = dict(zip(published.PENDULUM_COLUMNS, published.PENDULUM[2, 1:], strict=True))
    exact = np.array([row["x"] + 1, row["dx/dL"] + 1, row["dx/dg"]])
    travel = Integral(custom(speed, "speed"))
    problem = Problem("pendulum", cartesian_pendulum(), travel, 1.0, exact)
    compare_methods(report, problem, [HHT(steps[-2]), *controlled((rtols[1],), 4)])
    _verdict(report, runs, orders)


def _ladder(
    table: Array, rtols: Sequence[float], tightest: float, steps: Sequence[float]
) -> list[_Run]:
    t_end = float(table[-1, 0])
    # Every time of the table is the end of an interval.
    n = round(4 * t_end)
    integrators: list[Integrator] = [HHT(step) for step in steps]
    integrators += controlled(rtols, n)
    last = max(k for k, x in enumerate(integrators) if isinstance(x, IDA))
    integrators.insert(last + 1, IDA(rtol=tightest, intervals=n, max_steps=MANY))
    runs = []
    for integrator in integrators:
        attempt = run(cartesian_pendulum(), t_end, integrator)
        errors = None
        if attempt.finished and attempt.solution is not None:
            errors = _errors(attempt.solution, table)
        runs.append(_Run(integrator, attempt, errors))
    return runs


def _errors(solution: Solution, table: Array) -> Array:
    b, rows = solution.sensitivities, rows_at(solution, table[:, 0])
    assert b is not None
    columns = [solution.q, solution.v, solution.lam]
    for i in range(2):
        columns += [b.q_b[..., i], b.lam_b[..., i]]
    exact = table[:, 1:]
    apart = np.abs(np.column_stack([x[rows] for x in columns]) - exact)
    return np.max(apart / np.maximum(1.0, np.abs(exact)), axis=0)


def _table(report: Report, runs: Sequence[_Run]) -> None:
    rows: list[list[object]] = []
    for each in runs:
        row: list[object] = [type(each.integrator).__name__, setting(each.integrator)]
        if each.errors is None or each.attempt.solution is None:
            rows.append([*row, *["-"] * 6, each.attempt.note])
            continue
        name = key("pendulum", each.integrator)
        report.figure(f"{name}.error", float(np.max(each.errors)))
        report.figure(f"{name}.seconds", each.attempt.seconds)
        cells = [f"{np.max(each.errors[part]):.1e}" for part in _GROUPS.values()]
        steps = each.attempt.solution.statistics.steps
        rows.append([*row, *cells, steps, f"{each.attempt.seconds:.2f}", each.attempt.note])
    header = ["integrator", "setting", *_GROUPS, "steps", "CPU [s]", "outcome"]
    report.table(header, rows)


def _order(report: Report, runs: Sequence[_Run]) -> Array:
    coarse, fine = [each.errors for each in runs if each.integrator.order is not None][-2:]
    assert coarse is not None
    assert fine is not None
    orders: Array = np.log2(coarse / fine)
    report.figure("pendulum.HHT.order.least", float(np.min(orders)))
    report.figure("pendulum.HHT.order.most", float(np.max(orders)))
    report.say("pendulum.order", least=np.min(orders), largest=np.max(orders))
    return orders


def _columns(report: Report, runs: Sequence[_Run]) -> None:
    """Every column at the tightest setting of every integrator."""
    last = {type(each.integrator).__name__: each for each in runs if each.errors is not None}
    rows: list[list[object]] = []
    for k, name in enumerate(published.PENDULUM_COLUMNS):
        cells = [f"{each.errors[k]:.1e}" for each in last.values() if each.errors is not None]
        rows.append([name, *cells])
    report.say("pendulum.columns")
    header = [f"{name}, {setting(each.integrator)}" for name, each in last.items()]
    report.table(["column", *header], rows)


def _plots(report: Report, runs: Sequence[_Run], table: Array) -> None:
    best = [each.attempt.solution for each in runs if each.errors is not None][-1]
    assert best is not None
    b = best.sensitivities
    assert b is not None
    curves, panels = (("dx/dL", 0), ("10 dx/dg", 1)), []
    series = []
    for (label, i), column, factor in zip(curves, (6, 9), (1.0, 10.0), strict=True):
        series.append(Series(label, best.t, factor * b.q_b[:, 0, i]))
        marks = factor * table[:, column]
        series.append(dots(f"recomputed {label}", table[:, 0], marks))
    panels.append(Panel("Sensitivity of x", "time t [s]", "dx/dL, 10 dx/dg [-]", series))
    points: dict[str, list[tuple[float, float]]] = {}
    for each in runs:
        if each.errors is not None:
            pair = (each.attempt.seconds, float(np.max(each.errors)))
            points.setdefault(type(each.integrator).__name__, []).append(pair)
    panels.append(error_over_work("Error against work", points, "largest error of the table [-]"))
    report.plot("cartesian-pendulum", panels, 2)


def _verdict(report: Report, runs: Sequence[_Run], orders: Array) -> None:
    tightest = {type(each.integrator): each for each in runs}
    for kind in (IDA, IDAS, DOP853):
        each = tightest[kind]
        missing = "not installed" in each.attempt.note
        worst = float("inf") if each.errors is None else float(np.max(each.errors))
        found, words = None if missing else worst, setting(each.integrator)
        report.require("pendulum", found, kind=kind.__name__, setting=words)
        if kind is IDA:
            report.judge("pendulum.verdict", worst <= _LIMIT, first=worst, setting=words)
    report.require("pendulum.order", float(np.max(np.abs(orders - 2))))
