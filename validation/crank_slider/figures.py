"""Figures 8 and 9 of the paper: sensitivities of the slider's position and of the objective."""

import numpy as np
import numpy.typing as npt

from ancfdae import HHT, Adjoint, ContinuousAdjoint, FiniteDifference, differentiate, simulate
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.crank_slider.case import (
    DESIGN,
    STEP,
    SYMBOLS,
    Extent,
    relative,
    scaled,
    scaled_gradient,
    slider,
)
from validation.drawing import dots
from validation.report import Agreement, Report
from validation.scenes import crank_slider


def position_sensitivities(report: Report, solution: Solution, extent: Extent) -> None:
    """Add Fig. 8 of the paper, computed here."""
    report.heading("Slider position and its sensitivities (paper, Fig. 8)")
    check = differentiate(
        crank_slider(), extent.t_end, HHT(STEP), design=DESIGN, method=FiniteDifference(0.01)
    )
    position = [Series("slider", solution.t, slider(solution).real)]
    report.plot("slider", [Panel("Slider position", "time t [s]", "x [m]", position)])
    ours, theirs = scaled(solution), scaled(check)
    panels: list[Panel] = []
    difference: dict[str, float] = {}
    for i, symbol in enumerate(SYMBOLS):
        series = [
            Series("direct differentiation", solution.t, ours[:, i]),
            Series("forward difference, 1 %", check.t, theirs[:, i]),
        ]
        axes = "time t [s]", f"{symbol} · dx/d{symbol} [m]"
        panels.append(Panel(f"Sensitivity to {symbol}", *axes, series))
        error = relative(theirs[:, i], ours[:, i])
        difference[symbol] = report.figure(f"fig8.difference.{symbol}", error)
    report.plot("position-sensitivities", panels, 3)
    report.table(
        ["variable", "1 % difference against direct (norm over time)"], list(difference.items())
    )
    far = [symbol for symbol, value in difference.items() if value > 0.2]
    both = {"E_1", "h_2"}
    partly = Agreement.PARTLY if both & set(far) else Agreement.DISAGREES
    verdict = Agreement.AGREES if set(far) == both else partly
    report.judge("position-sensitivities", verdict, far=", ".join(far) or "none")


def objective_over_time(report: Report, solution: Solution, extent: Extent) -> None:
    """Add Fig. 9 of the paper, computed here."""
    report.heading("dΨ/db over time by all methods (paper, Fig. 9)")
    direct, difference = _over_time(solution, extent)
    times = np.linspace(0, extent.t_end, extent.adjoint_times + 1)[1:]
    discrete, continuous = (
        np.array([scaled_gradient(float(t), HHT(STEP), method) for t in times])
        for method in (Adjoint(), ContinuousAdjoint())
    )
    lines = {"direct differentiation": direct, "forward difference, 1 %": difference}
    markers = {"discrete adjoint": discrete, "continuous adjoint": continuous}
    _plot_objective(report, (solution.t, lines), (times, markers))
    rows = [
        [symbol, direct[-1, i], discrete[-1, i], continuous[-1, i], difference[-1, i]]
        for i, symbol in enumerate(SYMBOLS)
    ]
    report.say("objective-over-time", extent=extent)
    report.table(
        ["variable", "direct", "discrete adjoint", "continuous adjoint", "1 % difference"], rows
    )
    for i, symbol in enumerate(SYMBOLS):
        report.figure(f"fig9.direct.{symbol}", direct[-1, i])
        report.figure(f"fig9.finite_difference.{symbol}", difference[-1, i])
    agreement = report.figure("fig9.adjoint_direct", relative(discrete, direct[_rows(times)]))
    also = report.figure("fig9.continuous_direct", relative(continuous, direct[_rows(times)]))
    report.judge("objective-over-time", max(agreement, also) < 0.05, agreement=agreement, also=also)


def _over_time(solution: Solution, extent: Extent) -> tuple[Array, Array]:
    """Return b dPsi/db for every upper limit, directly and by 1 % differences."""
    sensitivities = solution.sensitivities
    assert sensitivities is not None
    b, x = sensitivities.values, slider(solution).real
    density = 2 * (x - 1.8)[:, None] * scaled(solution)
    runs = [
        slider(simulate(crank_slider().with_values({name: 1.01 * value}), extent.t_end, HHT(STEP)))
        for name, value in zip(DESIGN, b, strict=True)
    ]
    change = np.stack([((run.real - 1.8) ** 2 - (x - 1.8) ** 2) / 0.01 for run in runs], axis=1)
    return _cumulative(density, STEP), _cumulative(change, STEP)


def _plot_objective(
    report: Report, lines: tuple[Array, dict[str, Array]], markers: tuple[Array, dict[str, Array]]
) -> None:
    """Plot times and, by label, values of shape (n_t, 6)."""
    panels = []
    for i, symbol in enumerate(SYMBOLS):
        series = [Series(label, lines[0], y[:, i]) for label, y in lines[1].items()]
        series += [dots(label, markers[0], y[:, i]) for label, y in markers[1].items()]
        axes = "upper limit t [s]", f"{symbol} · dΨ/d{symbol} [m² s]"
        panels.append(Panel(f"Sensitivity to {symbol}", *axes, series))
    report.plot("objective-sensitivities", panels, 3)


def _rows(times: Array) -> npt.NDArray[np.int64]:
    return np.rint(times / STEP).astype(np.int64)


def _cumulative(values: Array, step: float) -> Array:
    """Return the running trapezoidal integral over time, starting at zero."""
    total = np.zeros_like(values)
    total[1:] = np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0)
    return total
