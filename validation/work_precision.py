"""Report on work and precision: which integrator for which scene, by `work_precision`."""

import itertools
from collections.abc import Sequence

from ancfdae import DOP853
from ancfdae.plotting import Panel, Series
from ancfdae.results import MeasuredSetting, WorkPrecision
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
from validation.work_precision_scenes import (
    ALPHAS,
    OBJECTIVES,
    Measured,
    cases,
    measured,
)

__all__ = ["run"]

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
    report.heading("Method")
    report.text(_METHOD)
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
    report.heading("Limits")
    report.text(_LIMITS)


# ---------------------------------------------------------------- which to choose


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
    report.text(_CHOICE)
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
    report.text("Processor time in seconds of the cheapest setting of each kind:")
    names = [f"{name}, {target:.0e}" for name in _GROUPS for target in _GROUP_TARGETS]
    report.table(["scene", "gradient", *names], rows)
    report.text(_ANSWER)


def _named(found: Sequence[Measured], name: str) -> Measured | None:
    return next((each for each in found if each.case.name == name), None)


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
    soft = _named(found, "soft")
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
    report.claim(
        "On soft undamped scenes second order loses by orders of magnitude for pointwise "
        "sensitivities",
        "expected",
        "error of the gradient for the same time, " + "; ".join(texts),
        Agreement.AGREES if factors and factors[-1] > 100 else Agreement.DISAGREES,
    )


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
        report.claim(
            "On stiff scenes second order wins",
            "expected",
            "cheapest with a gradient right to 1e-2: " + "; ".join(texts),
            verdict if any(wins) else Agreement.DISAGREES,
        )


# ---------------------------------------------------------------- hht_alpha


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
    report.text(_ALPHA_TEXT)
    report.table(["scene", "gradient", *(f"{x:g}" for x in ALPHAS)], rows)
    report.text(_ALPHA_NOTES)


# ---------------------------------------------------------------- scenes


def _scene(report: Report, each: Measured) -> None:
    report.heading(each.case.title, level=3)
    panels = []
    first = each.tables[0]
    panels.append(_panel("Error of the states", first, "states"))
    for kind, table in zip(OBJECTIVES, each.tables, strict=True):
        panels.append(_panel(f"Error of the {kind} gradient", table, "gradient"))
    report.plot(
        each.case.name,
        panels,
        columns=3,
        title=f"Error against processor time: {each.case.title}",
        caption="From left to right smaller steps or tolerances. Errors relative to the reference; "
        "what is above 10 is cut off.",
    )
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
    series = [
        Series(name, [x for x, _ in points], [y for _, y in points], marker=True)
        for name, points in lines.items()
    ]
    return Panel(title, "processor time [s]", "relative error [-]", series, "log", "log")


def _line(row: MeasuredSetting) -> str:
    if alpha(row) is None:
        return type(row.integrator).__name__
    kind = "both controlled" if controlled_both(row) else "fixed"
    kind = "controlled" if controlled(row) else kind
    return f"HHT {kind}, alpha = {alpha(row):g}"


_METHOD = """
Every number comes from `ancfdae.work_precision`, with which users measure their own scenes.
Each setting runs with two design variables along (direct differentiation) for two objectives: the
gradient of a time integral (*integrated*) and of a value at the end time (*pointwise*). Errors
are relative to a reference, the last row of each table: states and multipliers the largest over
201 common times over the largest of the reference, gradients in the Euclidean norm after
multiplication by the design values. Processor time is that of motion and gradient, the smaller of
two runs where one takes less than a second; on a shared machine read ratios, to a third.

*HHT fixed* and *HHT controlled* are HHT-I3 with `step` or with `rtol`, each at four values of
hht_alpha; *both* stands for `sensitivities=True`, where the tolerance bounds the errors
of the derivatives as well as those of the motion. *IDA*, *IDAS* (needs Python 3.12; a row says so
where it is missing) and *DOP853* are of high order. End times are short where the beam is
stiff: at E = 2e11 N/m² the fastest wave has 6e5 rad/s, so high order takes half a million steps
for a second; 2⁻⁶ s hold two and a half periods of the first bending mode (1.1e3 rad/s). With
damping the waves die out, but their decay, up to 1e8 1/s, is out of reach of an explicit step, so
that the reference is HHT itself at a small step; seconds of motion are affordable there.
"""

_CHOICE = """
The cheapest measured setting whose gradient has at most the relative error on top, as
`recommend(error)` returns it:
"""

_ALPHA_TEXT = """
Error of the gradient / of the multipliers at the smallest fixed step of each scene:
"""

_ANSWER = """
In words:

- **Soft, undamped.** Up to an error of 1 % of either gradient, HHT-I3 at a fixed step, 30 times
  cheaper than high order. For a pointwise gradient better than 1e-3: DOP853. In the same time its
  errors are a thousand times smaller, because each halving of the step gains HHT a factor of four
  at best and the undamped waves, whose phases a pointwise sensitivity counts, need a step far below
  their periods first. An integral averages waves out, so HHT remains the cheaper one down to
  1e-4.
- **Soft, damped.** HHT-I3 to 1e-4, then IDAS, for both gradients: the waves that made the
  difference are gone.
- **Stiff, undamped.** HHT-I3 for a few per cent, 40 times cheaper; IDA from 1e-3 on. The
  states are misleading here: they are right to 6e-6 at a step at which the pointwise gradient is
  wrong by its own size.
- **Stiff or medium, damped.** HHT-I3, with error control at rtol of 3e-4 or less. An explicit
  step is out of the question, and IDA at 1e-5 stops at its limit of steps below (run to the end
  it took 50 s, 200 times as long, for an error of 0.2).
- **Rigid (slider-crank).** HHT-I3 to 1e-3, DOP853 for more: 18 steps give five digits.
- **Paper's crank-slider.** Soft and undamped: HHT-I3 for a per cent, DOP853 beyond.
- **Any scene, and a gradient that has to keep a tolerance without a reference at hand.** HHT-I3
  with `sensitivities=True` (up to fifteen times the time of the best fixed step), or
  DOP853 where it finishes.

A coarse setting in the column 1e-01 may be right by chance: on undamped scenes errors do not fall
steadily before waves are resolved. Look at the tables below, or ask for two settings in a row.
"""

_ALPHA_NOTES = """
At equal small steps -0.05 is as accurate as 0 and up to twice as accurate as -0.3. Damping helps
where fast motion should die out: multipliers of the stiff damped pendulum are right to 7e-6 at
-0.3, to 4e-3 at -0.05, and at 0 they are 7e-3 off, oscillating, as the warning of that setting
says; the gradient is not affected in these short runs. Coarse steps show the reverse: at -0.3 a
start that is not resolved excites the beam more strongly (damped stiff pendulum at 2⁻⁹ s: gradient
wrong by 4, at -0.05 by 3e-4). With error control hht_alpha matters little, but 0 takes up to five
times the steps. So: -0.05 for gradients at fixed steps, -0.3 where multipliers of stiff scenes are
wanted, 0 never.
"""

_LIMITS = """
- Seven scenes, one objective of each kind, two variables: `work_precision` is for others.
- An error below that of the reference means nothing. References of high order are good to 1e-7 or
  better, those of the damped pendulums of larger modulus are HHT at 2⁻¹⁴ of the end time, good to
  about 1e-6.
- Processor times are of NumPy code with small matrices, on a shared machine.
- Derivatives with error control are those at frozen steps. What the choice of steps itself would
  contribute is below the tolerance.
"""
