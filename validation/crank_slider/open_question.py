"""Why direct differentiation and finite differences disagree for two variables."""

import numpy as np

from ancfdae import HHT, Adjoint, FiniteDifference, assemble, gradient
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Series
from validation.crank_slider.case import STEP, SYMBOLS, Extent, paper_objective, scaled_gradient
from validation.drawing import log_log
from validation.report import Report
from validation.scenes import crank_slider


def open_question(report: Report, extent: Extent) -> None:
    """Separate finite differences, step, solver and section."""
    report.heading("The open question: why E_1 and h_2 disagree")
    table = _halved_steps(report, extent)
    exact = scaled_gradient(extent.t_end, HHT(STEP), Adjoint())
    _attribute(report, exact, _one_percent(report, exact, extent), table)
    _solver_tolerance(report, extent)
    _square_section(report, extent)
    report.say("open-question.answer")


def _halved_steps(report: Report, extent: Extent) -> Array:
    """Return the exact gradient of the discrete run at every step, one a row."""
    table = np.array(
        [scaled_gradient(extent.t_end, HHT(2.0**-k), Adjoint()) for k in extent.exponents]
    )
    rows: list[list[object]] = []
    for exponent, values in zip(extent.exponents, table, strict=True):
        rows.append([f"2^-{exponent}", *values.tolist()])
        report.figures(f"step.2-{exponent}.{{}}", SYMBOLS, values)
    report.say("open-question.halved-steps")
    report.table(["step [s]", *SYMBOLS], rows)
    return table


def _one_percent(report: Report, exact: Array, extent: Extent) -> Array:
    """Return 1 % forward differences, and plot the errors of all perturbations."""
    errors = {
        kind: np.array(
            [
                scaled_gradient(extent.t_end, HHT(STEP), FiniteDifference(size, central=central))
                for size in extent.perturbations
            ]
        )
        for kind, central in (("forward difference", False), ("central difference", True))
    }
    panels, axes = [], ("relative perturbation [-]", "relative error [-]")
    for i, symbol in enumerate(SYMBOLS):
        series = [
            Series(kind, extent.perturbations, np.abs(v[:, i] / exact[i] - 1), marker=True)
            for kind, v in errors.items()
        ]
        panels.append(log_log(f"Finite differences of Ψ in {symbol}", *axes, series))
    report.plot("open-question", panels, 3)
    return errors["forward difference"][list(extent.perturbations).index(1e-2)]


def _attribute(report: Report, exact: Array, one_percent: Array, table: Array) -> None:
    """Separate the parts of finite differences and of time discretisation in the disagreement."""
    spread = np.abs(table[-2] - table[-1])
    rows = []
    for i, symbol in enumerate(SYMBOLS):
        error = abs(one_percent[i] - exact[i])
        by_difference = report.figure(f"open.{symbol}.finite_difference", error)
        by_step = report.figure(f"open.{symbol}.step", abs(exact[i] - table[-1, i]))
        rows.append([symbol, exact[i], by_difference, by_step, float(spread[i])])
    report.say("open-question.attribute")
    report.table(["variable", "exact at 2⁻⁸ s", "finite differences", "step", "last halving"], rows)


def _solver_tolerance(report: Report, extent: Extent) -> None:
    """Show how a solver that stops early changes finite differences."""
    rows = []
    for tolerance in (1e-14, 1e-8, 1e-4):
        integrator = HHT(STEP, newton_tolerance=tolerance)
        values = scaled_gradient(extent.t_end, integrator, FiniteDifference(0.01))
        rows.append([f"{tolerance:.0e}", *values.tolist()])
        report.figures(f"tolerance.{tolerance:.0e}.{{}}", SYMBOLS, values)
    report.say("open-question.solver-tolerance")
    report.table(["tolerance", *SYMBOLS], rows)


def _square_section(report: Report, extent: Extent) -> None:
    """Show what a change of both sides of the square section would give."""
    system = assemble(crank_slider(), ["crank.height", "crank.width", "rod.height", "rod.width"])
    computed = gradient(system, paper_objective(), extent.t_end, HHT(STEP), method=Adjoint())
    h_1, w_1, h_2, w_2 = (computed.gradient * system.b).tolist()
    report.figure("square.w_1", w_1)
    report.figure("square.w_2", w_2)
    report.say("open-question.square-section", h_2=h_2, both_2=h_2 + w_2, h_1=h_1, both_1=h_1 + w_1)
