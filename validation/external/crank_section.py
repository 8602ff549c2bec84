"""Part of the report on external problems: the slider-crank of SUNDIALS."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ancfdae import HHT, IDA, IDAS, Adjoint, DirectDifferentiation
from ancfdae.integrators.integrator import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.drawing import dots, error_over_work
from validation.external import published
from validation.external.runs import (
    Attempt,
    Problem,
    compare_methods,
    controlled,
    differentiated,
    key,
    rows_at,
    setting,
)
from validation.external.slider_crank import SliderCrank, kinetic_energy_integral
from validation.report import Report

_T_END: Final = 10.0
# The times of the table of the trajectory are the ends of the intervals.
_INTERVALS: Final = 25
_PROBLEM: Final = Problem(
    "crank", SliderCrank(), kinetic_energy_integral(), _T_END, published.CRANK_G
)
_NAMES: Final = ("G", "dG/dk", "dG/dc")


@dataclass(frozen=True)
class _Run:
    """One integrator with one method."""

    integrator: Integrator
    method: str
    attempt: Attempt

    @property
    def errors(self) -> Array | None:
        """Of G, dG/dk and dG/dc, signed."""
        value = self.attempt.value
        return None if value is None else value - published.CRANK_G


def slider_crank(report: Report, quick: bool) -> None:
    """Fill the section of the slider-crank."""
    rtols = (1e-3, 1e-4) if quick else (1e-6, 1e-8, 1e-10)
    steps = (0.2, 0.1) if quick else (0.02, 0.01, 0.005, 0.0025)
    report.say("crank")
    runs = _ladder(rtols, steps)
    _table(report, runs)
    orders, extrapolated = _extrapolation(report, runs)
    _plots(report, runs)
    report.say("crank.methods")
    rtol = rtols[0] if quick else rtols[-1]
    compare_methods(report, _PROBLEM, [HHT(steps[1]), *controlled((rtol,), _INTERVALS)])
    _published(report, runs)
    _require(report, runs, rtols[-1])
    report.require("crank.order", max(abs(order - 2) for order in orders))
    report.require("crank.extrapolated", extrapolated)


def _ladder(rtols: Sequence[float], steps: Sequence[float]) -> list[_Run]:
    integrators: list[Integrator] = [HHT(step) for step in steps]
    integrators += controlled(rtols, _INTERVALS)
    runs = []
    for integrator in integrators:
        runs.append(
            _Run(
                integrator, "direct", differentiated(_PROBLEM, integrator, DirectDifferentiation())
            )
        )
        if isinstance(integrator, IDAS):
            back = differentiated(_PROBLEM, integrator, Adjoint())
            runs.append(_Run(integrator, "adjoint", back))
    return runs


def _table(report: Report, runs: Sequence[_Run]) -> None:
    rows: list[list[object]] = []
    for run in runs:
        row: list[object] = [type(run.integrator).__name__, setting(run.integrator), run.method]
        errors, solution = run.errors, run.attempt.solution
        if errors is None or solution is None:
            rows.append([*row, *["-"] * 6, run.attempt.note])
            continue
        path = _path_error(solution)
        end = _end_error(solution)
        name = key("crank", run.integrator, run.method)
        report.figures(f"{name}.{{}}", ("G", "G_k", "G_c"), errors)
        report.figure(f"{name}.path", path)
        if end is not None:
            report.figure(f"{name}.end", end)
        report.figure(f"{name}.seconds", run.attempt.seconds)
        cells = [f"{abs(error):.1e}" for error in errors]
        last = "-" if end is None else f"{end:.1e}"
        rows.append(
            [*row, *cells, last, f"{path:.1e}", f"{run.attempt.seconds:.2f}", run.attempt.note]
        )
    header = ["integrator", "setting", "method", *_NAMES, "end", "path", "CPU [s]", "outcome"]
    report.table(header, rows)
    report.say("crank.table")


def _path_error(solution: Solution) -> float:
    table = published.CRANK_TRAJECTORY
    return float(np.max(np.abs(solution.q[rows_at(solution, table[:, 0])] - table[:, 1:])))


def _end_error(solution: Solution) -> float | None:
    if solution.sensitivities is None:
        return None
    end = [solution.q[-1, 0], solution.v[-1, 0], *solution.sensitivities.q_b[-1, 0]]
    return float(np.max(np.abs(end - published.CRANK_END)))


def _extrapolation(report: Report, runs: Sequence[_Run]) -> tuple[list[float], float]:
    """Orders between the last two steps of HHT, and the error after Richardson's step."""
    values = [run.errors for run in runs if run.integrator.order is not None]
    coarse, fine = values[-2], values[-1]
    assert coarse is not None
    assert fine is not None
    orders = [float(x) for x in np.log2(coarse / fine)]
    left = fine + (fine - coarse) / 3
    rows = []
    for name, symbol, order, error in zip(_NAMES, ("G", "G_k", "G_c"), orders, left, strict=True):
        report.figure(f"crank.HHT.order.{symbol}", order)
        report.figure(f"crank.HHT.extrapolated.{symbol}", error)
        rows.append([name, order, f"{abs(error):.1e}"])
    report.say("crank.extrapolation")
    report.table(["", "observed order", "error after extrapolation"], rows)
    return orders, float(np.max(np.abs(left)))


def _plots(report: Report, runs: Sequence[_Run]) -> None:
    best = next(r.attempt.solution for r in reversed(runs) if r.method == "direct")
    assert best is not None
    assert best.sensitivities is not None
    table, t, q_b = published.CRANK_TRAJECTORY, best.t, best.sensitivities.q_b
    motion = []
    for i, name in enumerate(("crank angle q [rad]", "slider x [m]", "rod angle p [rad]")):
        motion.append(Series(name, t, best.q[:, i]))
    for i in range(3):
        label = f"recomputed {'qxp'[i]}"
        motion.append(dots(label, table[:, 0], table[:, 1 + i]))
    slopes = [Series(f"dq/d{name}", t, q_b[:, 0, i]) for i, name in enumerate("kc")]
    points: dict[str, list[tuple[float, float]]] = {}
    for run in runs:
        if run.errors is not None:
            name = f"{type(run.integrator).__name__}, {run.method}"
            error = float(np.max(np.abs(run.errors)))
            points.setdefault(name, []).append((run.attempt.seconds, error))
    axes = "time t [s]", "derivative of q [rad per unit]"
    panels = [
        Panel("Motion", "time t [s]", "coordinate [rad or m]", motion),
        Panel("Sensitivity of the crank angle", *axes, slopes),
    ]
    report.plot("slider-crank", panels, 2)
    title, what = "Slider-crank: error against work", "largest error of G, dG/dk, dG/dc [-]"
    report.plot("slider-crank-work", [error_over_work(title, points, what)])


def _published(report: Report, runs: Sequence[_Run]) -> None:
    """Compare with the printed values; the run of IDA at its tightest tolerance."""
    run = [r for r in runs if isinstance(r.integrator, IDA)][-1]
    value = run.attempt.value
    assert value is not None
    for name, printed, ours in zip(_NAMES, published.CRANK_G_PUBLISHED, value, strict=True):
        difference = float(abs(ours - printed))
        report.judge(
            "crank.published",
            difference <= 1e-4,
            name=name,
            printed=printed,
            ours=ours,
            difference=difference,
            setting=setting(run.integrator),
        )


def _require(report: Report, runs: Sequence[_Run], rtol: float) -> None:
    for run in runs:
        if not isinstance(run.integrator, IDA | IDAS) or run.integrator.rtol != rtol:
            continue
        who = f"{type(run.integrator).__name__} {run.method}, rtol {rtol:.0e}"
        error = None if run.errors is None else float(np.max(np.abs(run.errors)))
        report.require("crank", error, who=who)
        solution = run.attempt.solution
        end = None if solution is None else _end_error(solution)
        if end is not None and solution is not None:
            report.require("crank.path", max(end, _path_error(solution)), who=who)
