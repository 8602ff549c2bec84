"""What the paper does not show: the time step."""

import itertools
from collections.abc import Sequence

import numpy as np

from ancfdae import HHT, differentiate
from ancfdae.plotting import Panel, Series
from validation.pendulum.case import DESIGN, STEP, SYMBOLS, Array, Curves, Extent, relative, scaled
from validation.report import Agreement, Report
from validation.scenes import pendulum

__all__ = ["step_halving"]

# At t = 1 s, E = 1e7: deflection and its derivatives E d/dE, h d/dh of the equations of motion
# themselves, by IDA (stabilised index-2 form, several tolerances) with an independent
# plain-quadrature code; project design notes, section 3.
_CONTINUOUS = {"deflection": -0.5794907, "E": 0.3337, "h": 0.7634}


def step_halving(report: Report, coarse: Curves, extent: Extent) -> None:
    """Add what halving the step changes."""
    report.heading("What the paper does not show: the time step")
    runs = {STEP: coarse}
    for k in range(extent.halvings):
        step = STEP / 2 ** (k + 1)
        runs[step] = scaled(differentiate(pendulum(), extent.t_end, HHT(step), design=DESIGN))
    steps = list(runs)
    _table_at_one_second(report, runs)
    changes = np.array([_changes(runs[a], runs[b]) for a, b in itertools.pairwise(steps)])
    names = ("deflection", *(f"{symbol}-sensitivity" for symbol in SYMBOLS))
    for row_changes, step in zip(changes, steps[:-1], strict=True):
        for name, value in zip(names, row_changes, strict=True):
            report.figure(f"halving.2{int(np.log2(step))}.{name}", value)
    _plot_halving(report, runs, changes, names)
    last = changes[-1]
    report.text(
        f"From step {steps[-2]:.3g} s to {steps[-1]:.3g} s the deflection still changes by "
        f"{last[0]:.1g}, its sensitivities by "
        + ", ".join(f"{last[i + 1]:.1g} ({s})" for i, s in enumerate(SYMBOLS))
        + " (relative, norm over time). Gravity sets in suddenly and excites axial and thickness "
        "waves that none of these steps resolves; a wave of amplitude A and frequency omega adds "
        "A omega t/2 to a sensitivity, so waves too small to be seen in the motion dominate it."
    )
    report.claim(
        "The curves of Figs. 4 to 6 are the sensitivities of the pendulum",
        "implied; one step (2^-7 s) is shown",
        f"one halving of that step changes the E-sensitivity by {changes[0][3]:.2g} of its norm",
        Agreement.DISAGREES if changes[0][3] > 0.2 else Agreement.PARTLY,
    )


def _table_at_one_second(report: Report, runs: dict[float, Curves]) -> None:
    """Add a table of values at t = 1 s, a row a step."""
    rows: list[list[object]] = []
    for step, curves in runs.items():
        name = f"2^{int(np.log2(step))}"
        row: list[object] = [name]
        at = _at_one_second(curves, step)
        if at is not None:
            report.figure(f"step.{name.replace('^', '')}.deflection_1s", at[0])
            report.figure(f"step.{name.replace('^', '')}.h_1s", at[1])
            report.figure(f"step.{name.replace('^', '')}.E_1s", at[2])
            row += list(at)
        else:
            row += ["-"] * 3
        rows.append(row)
    rows.append(["continuous", *(_CONTINUOUS[k] for k in ("deflection", "h", "E"))])
    report.text(
        "Values at t = 1 s. The last row solves the equations of motion themselves (IDA on an "
        "index-reduced form, an independent code)."
    )
    report.table(["step [s]", "deflection [m]", "h · d/dh [m]", "E · d/dE [m]"], rows)


def _plot_halving(
    report: Report, runs: dict[float, Curves], changes: Array, names: Sequence[str]
) -> None:
    """Plot the curves of the first and last step, and the changes by halving."""
    steps = list(runs)
    report.plot(
        "step-halving",
        [
            Panel(
                "Sensitivity to E over time",
                "time t [s]",
                "E · d(deflection)/dE [m]",
                [
                    Series(f"step 2^{int(np.log2(step))} s", runs[step].t, runs[step].y_b[:, 2])
                    for step in (steps[0], steps[-1])
                ],
            ),
            Panel(
                "Change when the step is halved",
                "step [s]",
                "relative change, norm over time [-]",
                [
                    Series(name, steps[:-1], changes[:, i], marker=True)
                    for i, name in enumerate(names)
                ],
                x_scale="log",
                y_scale="log",
            ),
        ],
        columns=2,
        title="Planar pendulum, E = 1e7 N/m²: what halving the step changes",
        caption="Left: the printed step against the smallest one. Right: relative change of the "
        "whole curve from one step to half of it.",
    )


def _at_one_second(curves: Curves, step: float) -> tuple[float, float, float] | None:
    row = round(1.0 / step)
    if row >= len(curves.t):
        return None
    return float(curves.y[row]), float(curves.y_b[row, 0]), float(curves.y_b[row, 2])


def _changes(coarse: Curves, fine: Curves) -> list[float]:
    """Relative change of the deflection and of its three sensitivities, on the coarse grid."""
    stride = (len(fine.t) - 1) // (len(coarse.t) - 1)
    changes = [relative(coarse.y, fine.y[::stride])]
    changes += [relative(coarse.y_b[:, i], fine.y_b[::stride, i]) for i in range(3)]
    return changes
