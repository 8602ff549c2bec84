"""Report on where the numerics end: each row of its tables is measured."""

from collections.abc import Callable, Sequence

from validation.extremes import damped_cases, mechanism_cases, pendulum_cases, stall_cases
from validation.extremes.floor import round_off
from validation.extremes.long import Long, long_runs
from validation.extremes.rows import Case, Row, add_table, measure
from validation.extremes.scaling import scaling
from validation.report import Agreement, Report

# Cases of each section, as functions of `quick`.
_GROUPS: dict[str, Callable[[bool], Sequence[Case]]] = {
    "modulus": pendulum_cases.moduli,
    "slenderness": pendulum_cases.slenderness,
    "step": pendulum_cases.step_sizes,
    "first-step": damped_cases.first_steps,
    "damped-start": damped_cases.damped_starts,
    "stall": stall_cases.stalls,
    "alpha": pendulum_cases.alphas,
    "elements": pendulum_cases.elements,
    "ratio": mechanism_cases.ratios,
    "dead-centre": mechanism_cases.dead_centres,
    "redundant": mechanism_cases.redundant,
    "far": pendulum_cases.far,
    "length": pendulum_cases.lengths,
}


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `extremes`; add its text, tables and figures."""
    report.say("method")
    rows: list[Row] = []
    for name, cases in _GROUPS.items():
        report.say(name)
        measured = [measure(case) for case in cases(quick)]
        add_table(report, name, measured)
        rows += measured
    _judge(report, rows)
    largest = scaling(report, quick)
    report.judge("units", largest < 1e-10, largest=largest)
    floor = round_off(report, quick)
    report.judge("floor", floor < 1e-3, floor=floor)
    _judge_long(report, long_runs(report, quick), quick)
    report.say("limits")


def _judge(report: Report, rows: list[Row]) -> None:
    survived, clean = sum(row.survived for row in rows), sum(row.clean for row in rows)
    counts = {"cases": len(rows), "survived": survived, "clean": clean}
    report.figures("rows.{}", counts, counts.values())
    failed = [row.case.label for row in rows if not row.clean]
    report.judge(
        "rows",
        not failed,
        rows=len(rows),
        survived=survived,
        stopped=len(rows) - survived,
        others=f"; not clean: {', '.join(failed)}" if failed else "; none else",
    )


def _judge_long(report: Report, runs: list[Long], quick: bool) -> None:
    damped = [long for long in runs if long.alpha < 0]
    worst = max(long.size for long in damped)
    drift = max(long.drift for long in damped)
    held = all(long.run.outcome.success for long in damped) and worst < 0.05
    report.judge("long.damped", held, worst=worst, drift=drift)
    rigid = next(long for long in runs if long.alpha == 0.0 and long.label == "rigid")
    shown = not rigid.run.outcome.success or rigid.size > 1.0
    report.judge(
        "long.undamped",
        Agreement.NOT_CHECKABLE if quick else shown and bool(rigid.warning),
        rigid=rigid,
        multipliers=float(max(rigid.multipliers())),
        warned="yes" if rigid.warning else "no",
    )
