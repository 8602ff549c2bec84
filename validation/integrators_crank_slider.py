"""Crank-slider's part of the report on the integrators."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae import (
    HHT,
    IDA,
    IDAS,
    Explicit,
    Integral,
    Integrator,
    Solution,
    assemble,
    gradient,
    position,
)
from ancfdae.plotting import Panel, Series
from ancfdae.system import AncfSystem
from validation.integrator_runs import Array, balance, common_rows, family, label, timed
from validation.report import Report
from validation.scenes import crank_slider

__all__ = ["run"]

_SYMBOLS = ("E_1", "h_1", "rho_1", "E_2", "h_2", "rho_2")
_DESIGN = tuple(
    f"{beam}.{name}"
    for beam in ("crank", "rod")
    for name in ("youngs_modulus", "height", "density")
)
_LENGTH = 2.7
# Panels of the quadrature over 2 s; the sensitivity of Psi to E_1 needs more than the states do.
_INTERVALS = 256
# Integrator, processor time in s, Psi and b dPsi/db in the order of `_SYMBOLS`.
_RECORDED: Sequence[tuple[str, str, tuple[float, ...]]] = ()


@dataclass(frozen=True)
class _Extent:
    """How much of the crank-slider's part is run.

    The early part of the motion, up to `t_short`, is run by all integrators.
    """

    t_end: float
    exponents: Sequence[int]
    reference: float
    t_short: float
    short_exponents: Sequence[int]
    short_rtol: float


_FULL = _Extent(2.0, range(6, 14), 1e-6, 2.0**-4, range(9, 14), 1e-6)
_QUICK = _Extent(2.0**-4, (7, 8, 9), 1e-4, 2.0**-8, (10, 11), 1e-4)


def run(report: Report, quick: bool) -> None:
    """Fill the crank-slider's part."""
    extent = _QUICK if quick else _FULL
    system = assemble(crank_slider(), _DESIGN)
    report.heading("Crank-slider: the first instants by all integrators")
    _early(report, system, extent)
    report.heading("Crank-slider: dΨ/db over the whole run")
    _objective(report, system, extent)


# ---------------------------------------------------------------- early motion


def _early(report: Report, system: AncfSystem, extent: _Extent) -> None:
    """States and sensitivities of the slider's position by all integrators."""
    n, rtol = 4, extent.short_rtol
    spacing = extent.t_short / n
    settings: list[Integrator] = [HHT(2.0**-k) for k in extent.short_exponents]
    settings += [IDA(rtol, intervals=n), IDAS(rtol, intervals=n), Explicit(rtol, n)]
    reference = timed(system, extent.t_short, Explicit(1e-2 * rtol, n))
    assert reference is not None
    x_0, x_b0 = _slider(reference.solution, system, spacing)
    rows: list[list[object]] = []
    for integrator in settings:
        done = timed(system, extent.t_short, integrator)
        names = [family(integrator), label(integrator)]
        if done is None:
            rows.append([*names, "not installed: sundials4py (Python 3.12)", *["-"] * 7])
            continue
        x, x_b = _slider(done.solution, system, spacing)
        own = np.max(np.abs(x_b - x_b0), axis=0) / np.max(np.abs(x_b0), axis=0)
        drift, energy = balance(system, done.solution, _LENGTH)
        apart = float(np.max(np.abs(x - x_0)))
        cells = [done.seconds, apart, float(np.max(own[3:])), float(np.max(own[:3])), drift, energy]
        for name, value in zip(_COLUMNS, cells, strict=True):
            report.figure(f"early.{_key(integrator)}.{name}", value)
        rows.append([*names, done.solution.statistics.steps, *(f"{c:.2g}" for c in cells)])
    report.text(
        f"Six design variables along, up to t = {extent.t_short:g} s; against Explicit at rtol "
        f"{1e-2 * rtol:.0e}. Position of the slider in metres; sensitivities relative to the "
        "largest value of each so far, the worst of three."
    )
    report.table(
        ["integrator", "setting", "steps", *_TITLES],
        rows,
    )


_TITLES = ("CPU [s]", "slider [m]", "rod's", "crank's", "drift [-]", "energy [-]")
_COLUMNS = ("seconds", "slider", "rod", "crank", "drift", "energy")


def _key(integrator: Integrator) -> str:
    place = f"{family(integrator)}.{label(integrator)}".replace(" ", "_")
    return place.replace("step_", "").replace("rtol_", "").replace("^", "").replace("_s", "")


def _slider(solution: Solution, system: AncfSystem, spacing: float) -> tuple[Array, Array]:
    """Position of the slider and its derivatives times the variables, at common instants."""

    def read(s: Solution) -> Array:
        x: Array = s.position("rod", 1.0)[:, 0]
        return x

    rows = common_rows(solution, spacing)
    x_b = solution.derivative(read)[rows] * system.b
    return read(solution).real[rows], x_b


# ---------------------------------------------------------------- the objective


def _objective(report: Report, system: AncfSystem, extent: _Extent) -> None:
    """Convergence of HHT-I3 to the explicit path in Psi and its gradient."""
    slider = position(crank_slider().beams[1].at_end, 0)
    psi = Integral((slider - 1.8) ** 2)

    def values(integrator: Integrator) -> tuple[Array, float]:
        started = time.process_time()
        found = gradient(system, psi, (), extent.t_end, integrator)
        seconds = time.process_time() - started
        return np.array([found.value, *(found.gradient * system.b)]), seconds

    reference = Explicit(extent.reference, _INTERVALS)
    exact, paid = values(reference)
    runs = [(HHT(2.0**-k), *values(HHT(2.0**-k))) for k in extent.exponents]
    table = np.abs(np.array([found for _, found, _ in runs]) / exact - 1)
    names = ("Psi", *_SYMBOLS)
    for name, value in zip(names, exact, strict=True):
        report.figure(f"objective.explicit.{name}", value)
    for (integrator, _, seconds), errors in zip(runs, table, strict=True):
        report.figure(f"objective.{_key(integrator)}.seconds", seconds)
        for name, error in zip(names, errors, strict=True):
            report.figure(f"objective.{_key(integrator)}.{name}", error)
    report.figure("objective.explicit.seconds", paid)
    _show(report, [i.step for i, _, _ in runs], [s for _, _, s in runs], table)
    _recorded(report, label(reference), exact, paid)


def _show(report: Report, steps: Sequence[float], seconds: Sequence[float], table: Array) -> None:
    """Table and plot of the errors of HHT-I3."""
    names = ("Ψ", *_SYMBOLS)
    rows: list[list[object]] = []
    for k, step in enumerate(steps):
        order = np.log2(table[k - 1] / table[k]) if k else np.full(len(names), np.nan)
        cells = [
            f"{e:.2g}" + (f" ({o:.2f})" if k else "") for e, o in zip(table[k], order, strict=True)
        ]
        rows.append([f"2^{int(np.log2(step))}", f"{seconds[k]:.2g}", *cells])
    report.text(
        "Relative errors of HHT-I3 (gradient by the discrete adjoint), in brackets the order from "
        "the step above:"
    )
    report.table(["step [s]", "CPU [s]", *names], rows)
    # Over three halvings: single ones are irregular while waves are not resolved.
    orders = [
        report.figure(f"objective.order.{name}", _mean_order(column))
        for name, column in zip(("Psi", *_SYMBOLS), table.T, strict=True)
    ]
    report.text(
        "Mean order over the last three halvings: "
        + ", ".join(f"{name} {order:.2f}" for name, order in zip(names, orders, strict=True))
        + "."
    )
    series = [
        Series(name, steps, column, marker=True)
        for name, column in zip(names, table.T, strict=True)
    ]
    anchor = float(np.max(table[-1, 4:]))
    guide = Series("order 2", steps, anchor * (np.array(steps) / steps[-1]) ** 2, dashed=True)
    report.plot(
        "crank-slider-convergence",
        [
            Panel(
                "Ψ and its sensitivities: HHT-I3 against Explicit",
                "step [s]",
                "relative error [-]",
                [*series, guide],
                x_scale="log",
                y_scale="log",
            )
        ],
        title="Crank-slider, Ψ = ∫ (x - 1.8)² dt over the whole run",
    )


def _mean_order(column: Array) -> float:
    first = max(len(column) - 4, 0)
    return float(np.log2(column[first] / column[-1]) / (len(column) - 1 - first))


def _recorded(report: Report, setting: str, exact: Array, paid: float) -> None:
    """Values of the reference beside those of the runs that are too long for this report."""
    names = ("Psi", *_SYMBOLS)
    rows: list[list[object]] = [[f"Explicit, {setting}", f"{paid:.3g}", *_digits(exact)]]
    rows += [[name, seconds, *_digits(values)] for name, seconds, values in _RECORDED]
    report.text(
        f"Ψ(2 s) and b · dΨ/db, in m² s, by Gauss-Lobatto quadrature over {_INTERVALS} panels. The "
        "first row is made here, the others were run once and are kept in "
        "`validation/integrators_crank_slider.py`:"
    )
    report.table(["integrator", "CPU [s]", *names], rows)
    report.text(_OBJECTIVE_NOTES)


def _digits(values: Sequence[float] | Array) -> list[str]:
    return [f"{value:.9g}" for value in values]


_OBJECTIVE_NOTES = """
TODO
"""
