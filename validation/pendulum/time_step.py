"""What the paper does not show: the time step."""

import itertools
from collections.abc import Sequence

import numpy as np

from ancfdae import HHT, differentiate
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from validation.drawing import log_log
from validation.pendulum.case import DESIGN, STEP, SYMBOLS, Curves, Extent, relative, scaled
from validation.report import Agreement, Report
from validation.scenes import pendulum

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
        report.figures(f"halving.2{int(np.log2(step))}.{{}}", names, row_changes)
    _plot_halving(report, runs, changes, names)
    last = changes[-1]
    report.say(
        "halving",
        coarse=steps[-2],
        fine=steps[-1],
        last=last,
        sensitivities=", ".join(f"{last[i + 1]:.1g} ({s})" for i, s in enumerate(SYMBOLS)),
    )
    report.judge(
        "halving", Agreement.DISAGREES if changes[0][3] > 0.2 else Agreement.PARTLY, changes=changes
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
    report.say("one-second")
    report.table(["step [s]", "deflection [m]", "h · d/dh [m]", "E · d/dE [m]"], rows)


def _plot_halving(
    report: Report, runs: dict[float, Curves], changes: Array, names: Sequence[str]
) -> None:
    """Plot the curves of the first and last step, and the changes by halving."""
    steps = list(runs)
    ends = [
        Series(f"step 2^{int(np.log2(step))} s", runs[step].t, runs[step].y_b[:, 2])
        for step in (steps[0], steps[-1])
    ]
    lines = [Series(name, steps[:-1], changes[:, i], marker=True) for i, name in enumerate(names)]
    title, what = "Change when the step is halved", "relative change, norm over time [-]"
    panels = [
        Panel("Sensitivity to E over time", "time t [s]", "E · d(deflection)/dE [m]", ends),
        log_log(title, "step [s]", what, lines),
    ]
    report.plot("step-halving", panels, 2)


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
