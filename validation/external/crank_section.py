"""Part of the report on external problems: the slider-crank of SUNDIALS."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ancfdae import HHT, IDA, IDAS, Adjoint, DirectDifferentiation
from ancfdae.integrators.integrator import Integrator
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.external import published
from validation.external.runs import (
    Attempt,
    Problem,
    Requirement,
    compare_methods,
    controlled,
    differentiated,
    key,
    rows_at,
    setting,
    work_precision,
)
from validation.external.scleronomic import Array
from validation.external.slider_crank import SliderCrank, kinetic_energy_integral
from validation.report import Agreement, Report

__all__ = ["slider_crank"]

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


def slider_crank(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section of the slider-crank; return the requirements and whether they are met."""
    rtols = (1e-3, 1e-4) if quick else (1e-6, 1e-8, 1e-10)
    steps = (0.2, 0.1) if quick else (0.02, 0.01, 0.005, 0.0025)
    report.heading("Slider-crank (SUNDIALS, idasSlCrank_FSA_dns)")
    report.text(_TEXT)
    runs = _ladder(rtols, steps)
    _table(report, runs)
    orders, extrapolated = _extrapolation(report, runs)
    _plots(report, runs)
    report.heading("Every method", level=3)
    report.text(_METHODS)
    rtol = rtols[0] if quick else rtols[-1]
    compare_methods(report, _PROBLEM, [HHT(steps[1]), *controlled((rtol,), _INTERVALS)])
    _published(report, runs)
    return [*_required(runs, rtols[-1]), *_required_of_hht(orders, extrapolated)]


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
        for symbol, error in zip(("G", "G_k", "G_c"), errors, strict=True):
            report.figure(f"{name}.{symbol}", error)
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
    report.text(
        "Absolute errors against the recomputed values. *End*: the largest of q, q', dq/dk and "
        "dq/dc of the crank at t = 10 (an adjoint yields none); *path*: the largest of q, x and p "
        "over the 26 times of the table."
    )


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
    report.text(
        "HHT between its two smallest steps: the observed order, and the error left when the two "
        "are extrapolated as a second-order method (Richardson):"
    )
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
        motion.append(Series(label, table[:, 0], table[:, 1 + i], line=False, marker=True))
    slopes = [Series(f"dq/d{name}", t, q_b[:, 0, i]) for i, name in enumerate("kc")]
    points: dict[str, list[tuple[float, float]]] = {}
    for run in runs:
        if run.errors is not None:
            name = f"{type(run.integrator).__name__}, {run.method}"
            error = float(np.max(np.abs(run.errors)))
            points.setdefault(name, []).append((run.attempt.seconds, error))
    report.plot(
        "slider-crank",
        [
            Panel("Motion", "time t [s]", "coordinate [rad or m]", motion),
            Panel(
                "Sensitivity of the crank angle",
                "time t [s]",
                "derivative of q [rad per unit]",
                slopes,
            ),
        ],
        columns=2,
        title="Slider-crank: DOP853 at its tightest tolerance",
        caption="Marks: the recomputed table.",
    )
    report.plot(
        "slider-crank-work",
        [
            work_precision(
                "Slider-crank: error against work", points, "largest error of G, dG/dk, dG/dc [-]"
            )
        ],
        caption="Every mark is one setting of the table above; from left to right smaller steps or "
        "tolerances.",
    )


def _published(report: Report, runs: Sequence[_Run]) -> None:
    """Compare with the printed values; the run of IDA at its tightest tolerance."""
    run = [r for r in runs if isinstance(r.integrator, IDA)][-1]
    value = run.attempt.value
    assert value is not None
    for name, printed, ours in zip(_NAMES, published.CRANK_G_PUBLISHED, value, strict=True):
        difference = float(abs(ours - printed))
        report.claim(
            f"Slider-crank, {name}",
            f"{printed:.8g} (SUNDIALS example, 5 digits)",
            f"{ours:.9g}: {difference:.1e} apart, 1e-4 allowed (IDA, {setting(run.integrator)})",
            Agreement.AGREES if difference <= 1e-4 else Agreement.DISAGREES,
        )


def _required(runs: Sequence[_Run], rtol: float) -> list[Requirement]:
    requirements = []
    for run in runs:
        if not isinstance(run.integrator, IDA | IDAS) or run.integrator.rtol != rtol:
            continue
        what = f"slider-crank, {type(run.integrator).__name__} {run.method}, rtol {rtol:.0e}"
        error = None if run.errors is None else float(np.max(np.abs(run.errors)))
        requirements.append(Requirement(f"{what}: G, dG/dk, dG/dc", 1e-6, error))
        solution = run.attempt.solution
        end = None if solution is None else _end_error(solution)
        if end is not None and solution is not None:
            worst = max(end, _path_error(solution))
            requirements.append(Requirement(f"{what}: crank at t = 10, path", 1e-4, worst))
    return requirements


def _required_of_hht(orders: Sequence[float], extrapolated: float) -> list[Requirement]:
    distance = max(abs(order - 2) for order in orders)
    return [
        Requirement("slider-crank, HHT: distance of the observed order from 2", 0.1, distance),
        Requirement("slider-crank, HHT extrapolated: G, dG/dk, dG/dc", 1e-6, extrapolated),
    ]


_TEXT = """
Crank (0.5 m), rod (1 m) and slider with a damped spring between the middles of crank and rod:
three coordinates, two constraints, constant mass, forces that depend on position and velocity.
Design variables are stiffness k and damping c of the spring; G is the integral of the kinetic
energy over 10 s.
"""

_METHODS = """
Largest error of dG/dk and dG/dc against the recomputed values, and the distance from direct
differentiation with the same integrator. Central differences perturb by 0.1 %; with error control
they also differentiate the choice of steps, which limits their accuracy. The continuous
adjoint discretises its own equations, so it differs from the others by O(h²).
"""
