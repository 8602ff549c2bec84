"""Report on work and precision: which integrator for which scene, by `work_precision`."""

import itertools
from collections.abc import Sequence

from ancfdae import DOP853
from ancfdae.plotting import Panel
from ancfdae.results import MeasuredSetting, WorkPrecision
from validation.drawing import error_over_work
from validation.report import Agreement, Report
from validation.work_precision_control import gains, newton, trust
from validation.work_precision_findings import (
    alpha,
    cheapest_of,
    controlled,
    controlled_both,
    fixed,
    short_name,
)
from validation.work_precision_scenes import ALPHAS, OBJECTIVES, Measured, cases, measured

# Lines that a plot shows; the others are in the tables.
_SHOWN = (-0.05, -0.3)
_TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6)
_GROUP_TARGETS = (1e-2, 1e-4, 1e-6)
# Results with larger errors are not counted.
_ALLOWED = 10.0
_GROUPS = {
    "HHT fixed": fixed,
    "HHT controlled": controlled,
    "both controlled": controlled_both,
    "high order": lambda row: row.integrator.order != 2,
}


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `work-precision`; add its text, tables and figures."""
    report.say("method")
    found = [measured(case, quick) for case in cases(quick)]
    report.heading("Which to choose")
    _choice(report, found)
    _pointwise(report, found)
    _stiff(report, found)
    report.heading("What the controlled step gains")
    gains(report, found)
    report.heading("How far the controlled step may be trusted")
    trust(report, found)
    newton(report, quick)
    report.heading("The numerical damping hht_alpha")
    _alphas(report, found)
    report.heading("Scene by scene")
    for each in found:
        _scene(report, each)
    report.say("limits")


def _choice(report: Report, found: Sequence[Measured]) -> None:
    rows: list[list[object]] = []
    for each in found:
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            cells = []
            for target in _TARGETS:
                best = cheapest_of(table, target, lambda row: True)
                if best is None:
                    cells.append("not reached")
                    continue
                cells.append(f"{short_name(best)} ({best.seconds:.2g} s)")
                report.figure(f"choice.{each.case.name}.{kind}.{target:.0e}", best.seconds)
            rows.append([each.case.title, kind, *cells])
    report.say("choice")
    report.table(["scene", "gradient", *(f"{target:.0e}" for target in _TARGETS)], rows)
    rows = []
    for each in found:
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            cells = []
            for name, target in itertools.product(_GROUPS, _GROUP_TARGETS):
                best = cheapest_of(table, target, _GROUPS[name])
                cells.append("-" if best is None else f"{best.seconds:.2g}")
                if best is not None:
                    key = f"cheapest.{each.case.name}.{kind}.{name.replace(' ', '_')}.{target:.0e}"
                    report.figure(key, best.seconds)
            rows.append([each.case.title, kind, *cells])
    report.say("choice.kinds")
    names = [f"{name}, {target:.0e}" for name in _GROUPS for target in _GROUP_TARGETS]
    report.table(["scene", "gradient", *names], rows)
    report.say("answer")


def _within(table: WorkPrecision, seconds: float) -> MeasuredSetting | None:
    """Return the HHT setting with the least error of the gradient in some processor time."""
    rows = [
        row
        for row in table.rows
        if row.integrator.order == 2 and row.finished and row.seconds <= seconds
    ]
    return min(rows, key=lambda row: row.error("gradient"), default=None)


def _pointwise(report: Report, found: Sequence[Measured]) -> None:
    """Compare second and high order on the soft, undamped pendulum."""
    soft = next((each for each in found if each.case.name == "soft"), None)
    if soft is None:
        return
    texts, factors = [], []
    for kind, table in zip(OBJECTIVES, soft.tables, strict=True):
        explicit = next(
            row for row in table.rows if isinstance(row.integrator, DOP853) and row.finished
        )
        best = _within(table, explicit.seconds)
        if best is None:
            continue
        factors.append(best.error("gradient") / explicit.error("gradient"))
        report.figure(f"soft.{kind}.hht_over_explicit", factors[-1])
        texts.append(
            f"{kind}: {explicit.error('gradient'):.1g} by {short_name(explicit)} in "
            f"{explicit.seconds:.2g} s, {best.error('gradient'):.1g} by {short_name(best)} in "
            f"{best.seconds:.2g} s"
        )
    report.judge("pointwise", bool(factors) and factors[-1] > 100, texts="; ".join(texts))


def _stiff(report: Report, found: Sequence[Measured]) -> None:
    """Compare second and high order on the stiff pendulums."""
    texts, wins = [], []
    for each in found:
        if not each.case.name.startswith("stiff"):
            continue
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            ours = cheapest_of(table, 1e-2, lambda row: row.integrator.order == 2)
            other = cheapest_of(table, 1e-2, _GROUPS["high order"])
            own, theirs = (x.seconds if x else float("inf") for x in (ours, other))
            wins.append(own < theirs)
            who = "none" if ours is None else f"{short_name(ours)} {own:.2g} s"
            whom = "none" if other is None else f"{short_name(other)} {theirs:.2g} s"
            texts.append(f"{each.case.name}, {kind}: {who}, high order {whom}")
    if texts:
        verdict = Agreement.AGREES if all(wins) else Agreement.PARTLY
        report.judge("stiff", verdict if any(wins) else Agreement.DISAGREES, texts="; ".join(texts))


def _alphas(report: Report, found: Sequence[Measured]) -> None:
    rows: list[list[object]] = []
    for each in found:
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            cells = []
            for damping in ALPHAS:
                last = [r for r in table.rows if fixed(r) and alpha(r) == damping][-1]
                cells.append(f"{last.error('gradient'):.1g} / {last.error('multipliers'):.1g}")
                if last.finished:
                    key = f"alpha.{each.case.name}.{kind}.{abs(damping):g}"
                    report.figure(f"{key}.gradient", last.error("gradient"))
            rows.append([each.case.title, kind, *cells])
    report.say("alpha")
    report.table(["scene", "gradient", *(f"{x:g}" for x in ALPHAS)], rows)
    report.say("alpha.notes")


def _scene(report: Report, each: Measured) -> None:
    report.heading(each.case.title, level=3)
    panels = []
    first = each.tables[0]
    panels.append(_panel("Error of the states", first, "states"))
    for kind, table in zip(OBJECTIVES, each.tables, strict=True):
        panels.append(_panel(f"Error of the {kind} gradient", table, "gradient"))
    report.plot("{case.name}", panels, 3, case=each.case)
    header = ["integrator", "setting", "CPU [s]", "states", "multipliers", "drift", "energy"]
    header += [f"{what} {kind}" for kind in OBJECTIVES for what in ("objective", "gradient")]
    rows: list[list[object]] = []
    for k, row in enumerate((*first.rows, first.reference)):
        other = (*each.tables[1].rows, each.tables[1].reference)[k]
        if alpha(row) not in (None, *_SHOWN):
            continue
        rows.append(_cells(row, other, reference=row is first.reference))
        if row.finished and row is not first.reference:
            key = f"{each.case.name}.{row.family}.{row.label}".replace("hht_alpha = -", "alpha")
            key = key.replace(" ", "_").replace(",", "").replace("=", "").replace("+", "")
            report.figure(f"{key}.seconds", row.seconds)
            report.figure(f"{key}.gradient", row.error("gradient"))
            if other.finished:
                report.figure(f"{key}.pointwise", other.error("gradient"))
    report.table([*header, "steps or outcome"], rows)


def _cells(row: MeasuredSetting, other: MeasuredSetting, reference: bool) -> list[object]:
    name = row.family + (" (reference)" if reference else "")
    own = (row.states, row.multipliers, row.drift, row.energy)
    numbers = (*own, row.objective, row.gradient, other.objective, other.gradient)
    shown = ["-" if x is None else f"{x:.1g}" for x in numbers]
    end = row.outcome if not row.finished else row.outcome.split(", ")[-1].rstrip(").")
    return [name, row.label, f"{row.seconds:.2g}", *shown, end]


def _panel(title: str, table: WorkPrecision, of: str) -> Panel:
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in table.rows:
        error = getattr(row, of)
        if error is None or not 0 < error < _ALLOWED:
            continue
        if alpha(row) not in (None, *_SHOWN):
            continue
        lines.setdefault(_line(row), []).append((row.seconds, error))
    return error_over_work(title, lines, "relative error [-]")


def _line(row: MeasuredSetting) -> str:
    if alpha(row) is None:
        return type(row.integrator).__name__
    kind = "both controlled" if controlled_both(row) else "fixed"
    kind = "controlled" if controlled(row) else kind
    return f"HHT {kind}, alpha = {alpha(row):g}"
