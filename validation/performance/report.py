"""Report on speed: steps, derivatives, scale, memory, start and many runs."""

import re
from collections.abc import Callable

from ancfdae.plotting import Series
from validation.drawing import log_log
from validation.performance import (
    explicit_path,
    long_run,
    mechanisms,
    memory,
    scale,
    start,
    steps,
    sweep,
    unit,
)
from validation.performance.row import Row
from validation.report import Report

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_ELEMENTS = re.compile(r"step of (\d+) elements")


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `performance`; add its text, tables and figures."""
    report.say("method")
    (one,) = unit.measure(3 if quick else 9)
    for title, rows in _subjects(quick):
        _subject(report, title, [one, *rows] if title == _STEPS else rows, one)
    report.say("limits")


_STEPS = "A step and its derivatives"


def _subjects(quick: bool) -> list[tuple[str, list[Row]]]:
    """Measure the subjects one after the other."""
    few = {"repeats": 1} if quick else {}
    subjects: list[tuple[str, Callable[[], list[Row]]]] = [
        (_STEPS, lambda: steps.measure(**({"steps": 8} | few if quick else few))),
        ("Small mechanisms", lambda: mechanisms.measure(**({"steps": 8} | few if quick else few))),
        ("Start", lambda: start.measure(**few)),
    ]
    if not quick:
        subjects += [
            ("The explicit path", explicit_path.measure),
            ("From ten to ten thousand elements", scale.measure),
            ("A thousand variables", memory.measure),
            ("A long run", long_run.measure),
            ("Sweeps", sweep.measure),
        ]
    return [(title, measure()) for title, measure in subjects]


def _subject(report: Report, title: str, rows: list[Row], one: Row) -> None:
    report.heading(title)
    table = []
    for row in rows:
        report.figure(_name(f"{title}.{row.what}"), row.value)
        banded = (
            row.value * _SECONDS[row.unit] / (one.value * 1e-6) if row.unit in _SECONDS else None
        )
        found = f"{row.value:.3g} {row.unit}".removesuffix(" -")
        if banded is not None:
            report.figure(_name(f"{title}.{row.what}.banded_lu"), banded)
        told = "-" if row.asked == "-" else "yes" if reached(row) else "no"
        table.append((row.what, found, "-" if banded is None else f"{banded:.3g}", row.asked, told))
        if row.asked != "-":
            report.claim(row.what, row.asked, found, reached(row))
    report.table(("figure", "found", "banded LUs", "asked", "reached"), table)
    _plot(report, rows)


def _plot(report: Report, rows: list[Row]) -> None:
    """Show the time of a step against the number of elements where rows tell it."""
    found = [(m, row) for row in rows if (m := _ELEMENTS.fullmatch(row.what))]
    if not found:
        return
    n = [float(m[1]) for m, _ in found]
    ms = [row.value * _SECONDS[row.unit] * 1e3 for _, row in found]
    line = [ms[0] * x / n[0] for x in n]
    series = [Series("measured", n, ms, marker=True), Series("proportional", n, line, dashed=True)]
    panel = log_log("Time of a step", "spatial elements [-]", "time [ms]", series)
    report.plot("scale", [panel])


def reached(row: Row) -> bool:
    """Tell whether a figure is what is asked of it: a bound below or above, or a size."""
    bound = float(re.findall(r"[\d.]+", row.asked)[0])
    return row.value >= bound if row.asked.startswith("at least") else row.value <= bound


def _name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "_", text).strip("_").lower()
