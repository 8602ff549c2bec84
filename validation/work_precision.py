"""Report on work and precision: which integrator for which scene, by the library's `tradeoff`."""

from collections.abc import Sequence

from ancfdae import HHT, Explicit, Setting, Tradeoff
from ancfdae.plotting import Panel, Series
from validation.report import Report, Verdict
from validation.work_precision_findings import (
    Gain,
    best_gain,
    cheapest_of,
    controlled,
    fixed,
    largest_ratio,
    short_name,
)
from validation.work_precision_scenes import (
    ALPHAS,
    OBJECTIVES,
    Measured,
    cases,
    measured,
    newton_tolerances,
)

__all__ = ["run"]

# Lines that a plot shows; the others are in the tables.
_SHOWN = (-0.05, -0.3)
_TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6)
# Errors of a gradient below this are as large as those of some references.
_FLOOR = 1e-6
_ALLOWED = 10.0
_GROUPS = {
    "HHT fixed": fixed,
    "HHT controlled": controlled,
    "high order": lambda row: not isinstance(row.integrator, HHT),
}


def run(report: Report, quick: bool) -> None:
    """Fill the report."""
    report.heading("Method")
    report.text(_METHOD)
    found = [measured(case, quick) for case in cases(quick)]
    report.heading("Which to choose")
    _choice(report, found)
    _pointwise(report, found)
    _stiff(report, found)
    report.heading("What the controlled step gains")
    _gains(report, found)
    report.heading("How far the controlled step may be trusted")
    _trust(report, found)
    _newton(report, quick)
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
            for choice in _GROUPS.values():
                for target in (1e-2, 1e-4):
                    best = cheapest_of(table, target, choice)
                    cells.append("-" if best is None else f"{best.seconds:.2g}")
            rows.append([each.case.title, kind, *cells])
    report.text("Processor time in seconds of the cheapest setting of each kind:")
    names = [f"{name}, {target}" for name in _GROUPS for target in ("1e-2", "1e-4")]
    report.table(["scene", "gradient", *names], rows)
    report.text(_ANSWER)


def _named(found: Sequence[Measured], name: str) -> Measured | None:
    return next((each for each in found if each.case.name == name), None)


def _within(table: Tradeoff, seconds: float) -> Setting | None:
    """Return the HHT setting with the least error of the gradient in some processor time."""
    rows = [
        row
        for row in table.rows
        if isinstance(row.integrator, HHT) and row.finished and row.seconds <= seconds
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
            row for row in table.rows if isinstance(row.integrator, Explicit) and row.finished
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
        Verdict.AGREES if factors and factors[-1] > 100 else Verdict.DISAGREES,
    )


def _stiff(report: Report, found: Sequence[Measured]) -> None:
    """Compare second and high order on the stiff pendulums."""
    texts, wins = [], []
    for each in found:
        if not each.case.name.startswith("stiff"):
            continue
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            ours = cheapest_of(table, 1e-2, lambda row: isinstance(row.integrator, HHT))
            other = cheapest_of(table, 1e-2, _GROUPS["high order"])
            own, theirs = (x.seconds if x else float("inf") for x in (ours, other))
            wins.append(own < theirs)
            who = "none" if ours is None else f"{short_name(ours)} {own:.2g} s"
            whom = "none" if other is None else f"{short_name(other)} {theirs:.2g} s"
            texts.append(f"{each.case.name}, {kind}: {who}, high order {whom}")
    if texts:
        verdict = Verdict.AGREES if all(wins) else Verdict.PARTLY
        report.claim(
            "On stiff scenes second order wins",
            "expected",
            "cheapest with a gradient right to 1e-2: " + "; ".join(texts),
            verdict if any(wins) else Verdict.DISAGREES,
        )


# ---------------------------------------------------------------- the controlled step


def _gains(report: Report, found: Sequence[Measured]) -> None:
    rows: list[list[object]] = []
    best: dict[bool, tuple[Gain, str]] = {}
    for each in found:
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            row: list[object] = [each.case.title, kind]
            for same in (False, True):
                gain = best_gain(table, _FLOOR, same)
                if gain is None:
                    row += ["-"] * 4
                    continue
                name = "same_alpha" if same else "any_alpha"
                report.figure(f"gain.{each.case.name}.{kind}.{name}", gain.ratio)
                row += [short_name(gain.row), f"{gain.row.error('gradient'):.2g}"]
                row += [f"{gain.row.seconds:.2g} / {gain.fixed_seconds:.2g}", f"{gain.ratio:.2f}"]
                if same not in best or gain.ratio < best[same][0].ratio:
                    best[same] = gain, f"{each.case.title}, {kind}"
            rows.append(row)
    report.text(_GAIN_TEXT)
    header = ["scene", "gradient"]
    for which in ("any alpha", "same alpha"):
        header += [f"controlled ({which})", "error", "CPU [s] / fixed", "ratio"]
    report.table(header, rows)
    ratios = {same: gain.ratio for same, (gain, _) in best.items()}
    verdict = Verdict.PARTLY if ratios.get(True, 1.0) <= 0.5 else Verdict.DISAGREES
    report.claim(
        "The controlled step needs at most half the CPU time of the best fixed step for the same "
        "gradient error on at least one scene",
        "asked for",
        "; ".join(
            f"fixed step at {'the same' if same else 'the best'} hht_alpha: ratio {gain.ratio:.2f} "
            f"({where}: {short_name(gain.row)}, error {gain.row.error('gradient'):.1g}, "
            f"{gain.row.seconds:.2g} s against {gain.fixed_seconds:.2g} s)"
            for same, (gain, where) in best.items()
        )
        or "no pair to compare",
        Verdict.AGREES if ratios.get(False, 1.0) <= 0.5 else verdict,
    )
    report.text(_GAIN_NOTES)


def _trust(report: Report, found: Sequence[Measured]) -> None:
    rows: list[list[object]] = []
    worst: dict[str, float] = {}
    for each in found:
        cells: list[object] = [each.case.title]
        looks: list[tuple[str, str, Sequence[Tradeoff]]] = [("states", "states", each.tables[:1])]
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            looks += [(f"objective {kind}", "objective", [table])]
            looks += [(f"gradient {kind}", "gradient", [table])]
        for name, of, tables in looks:
            ratio, row = largest_ratio(tables, of)
            report.figure(f"trust.{each.case.name}.{name.replace(' ', '.')}", ratio)
            worst[name] = max(worst.get(name, 0.0), ratio)
            cells.append(f"{ratio:.2g}" + ("" if row is None else f" ({_place(row)})"))
        rows.append(cells)
    report.text(_TRUST_TEXT)
    report.table(["scene", *worst], rows)
    listed = ", ".join(f"{name} {ratio:.2g}" for name, ratio in worst.items())
    if worst["states"] > _ALLOWED:
        verdict = Verdict.DISAGREES
    else:
        verdict = Verdict.AGREES if max(worst.values()) <= _ALLOWED else Verdict.PARTLY
    report.claim(
        "The controlled step is never wrong by more than 10 times its tolerance",
        "asked for",
        f"largest error over rtol on any scene, at any hht_alpha: {listed}",
        verdict,
    )
    report.text(_TRUST_NOTES)


def _newton(report: Report, quick: bool) -> None:
    """Show what the tolerance of Newton's method has to do with it."""
    rtols = (1e-2, 1e-3) if quick else (1e-2, 1e-3, 1e-4)
    title, tables = newton_tolerances(rtols, quick)
    rows: list[list[object]] = []
    for k, rtol in enumerate(rtols):
        row: list[object] = [f"{rtol:.0e}"]
        for name, table in zip(("loose", "default"), tables, strict=True):
            one = table.rows[k]
            row += [f"{one.error('states'):.1g}", f"{one.error('gradient'):.1g}", one.seconds]
            for of in ("states", "gradient"):
                report.figure(f"newton.{name}.{rtol:.0e}.{of}", getattr(one, of))
        rows.append(row)
    report.text(f"{title}, hht_alpha = -0.3, integrated:")
    report.text("*Loose* is newton_tolerance = rtol/1000, *default* no more than 1e-9.")
    header = [
        f"{what}, {x}" for x in ("loose", "default") for what in ("states", "gradient", "CPU")
    ]
    report.table(["rtol", *header], rows)
    report.text(_NEWTON_NOTES)


def _place(row: Setting) -> str:
    assert isinstance(row.integrator, HHT)
    return f"rtol {row.integrator.rtol:.0e}, alpha {row.integrator.hht_alpha:g}"


# ---------------------------------------------------------------- hht_alpha


def _alphas(report: Report, found: Sequence[Measured]) -> None:
    rows: list[list[object]] = []
    for each in found:
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            cells = []
            for alpha in ALPHAS:
                last = [r for r in table.rows if fixed(r) and _alpha(r) == alpha][-1]
                cells.append(f"{last.error('gradient'):.1g} / {last.error('multipliers'):.1g}")
                if last.finished:
                    key = f"alpha.{each.case.name}.{kind}.{abs(alpha):g}"
                    report.figure(f"{key}.gradient", last.error("gradient"))
            rows.append([each.case.title, kind, *cells])
    report.text(_ALPHA_TEXT)
    report.table(["scene", "gradient", *(f"{alpha:g}" for alpha in ALPHAS)], rows)
    report.text(_ALPHA_NOTES)


def _alpha(row: Setting) -> float:
    assert isinstance(row.integrator, HHT)
    return row.integrator.hht_alpha


# ---------------------------------------------------------------- scenes


def _scene(report: Report, each: Measured) -> None:
    report.heading(each.case.title, level=3)
    panels = []
    first = each.tables[0]
    panels.append(_panel("States", first, "states"))
    for kind, table in zip(OBJECTIVES, each.tables, strict=True):
        panels.append(_panel(f"Gradient, {kind}", table, "gradient"))
    report.plot(
        each.case.name,
        panels,
        columns=3,
        title=each.case.title,
        caption="From left to right smaller steps or tolerances. Errors relative to the reference; "
        "what is above 10 is cut off.",
    )
    header = ["integrator", "setting", "CPU [s]", "states", "multipliers", "drift", "energy"]
    header += [f"{what} {kind}" for kind in OBJECTIVES for what in ("objective", "gradient")]
    rows: list[list[object]] = []
    for k, row in enumerate((*first.rows, first.reference)):
        other = (*each.tables[1].rows, each.tables[1].reference)[k]
        if isinstance(row.integrator, HHT) and row.integrator.hht_alpha not in _SHOWN:
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


def _cells(row: Setting, other: Setting, reference: bool) -> list[object]:
    name = row.family + (" (reference)" if reference else "")
    own = (row.states, row.multipliers, row.drift, row.energy)
    numbers = (*own, row.objective, row.gradient, other.objective, other.gradient)
    shown = ["-" if x is None else f"{x:.1g}" for x in numbers]
    end = row.outcome if not row.finished else row.outcome.split(", ")[-1].rstrip(").")
    return [name, row.label, f"{row.seconds:.2g}", *shown, end]


def _panel(title: str, table: Tradeoff, of: str) -> Panel:
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in table.rows:
        error = getattr(row, of)
        if error is None or not 0 < error < _ALLOWED:
            continue
        if isinstance(row.integrator, HHT) and row.integrator.hht_alpha not in _SHOWN:
            continue
        lines.setdefault(_line(row), []).append((row.seconds, error))
    series = [
        Series(name, [x for x, _ in points], [y for _, y in points], marker=True)
        for name, points in lines.items()
    ]
    return Panel(title, "processor time [s]", "relative error [-]", series, "log", "log")


def _line(row: Setting) -> str:
    if not isinstance(row.integrator, HHT):
        return type(row.integrator).__name__
    kind = "controlled" if controlled(row) else "fixed"
    return f"HHT {kind}, alpha = {row.integrator.hht_alpha:g}"


_METHOD = """
Every number comes from `ancfdae.tradeoff`, the call with which users measure their own scenes.
Each setting runs with two design variables along (direct differentiation) for two objectives: the
gradient of a time integral (*integrated*) and of a value at the end time (*pointwise*). Errors
are relative to a reference, the last row of each table: states and multipliers the largest over
201 common times over the largest of the reference, gradients in the Euclidean norm after
multiplication by the design values. Processor time is that of motion and gradient, the smaller of
two runs where one takes less than a second; on a shared machine read ratios, to a third.

*HHT fixed* and *HHT controlled* are HHT-I3 with `step` or with `rtol`, each at four values of
hht_alpha. *IDA*, *IDAS* (needs Python 3.12; a row says so where it is missing) and *Explicit* are
of high order. End times are short where the beam is stiff: at E = 2e11 N/m² the fastest wave has
6e5 rad/s, so high order takes half a million steps for a second; 2⁻⁶ s hold two and a half
periods of the first bending mode (1.1e3 rad/s). With damping the waves die out, but their decay,
up to 1e8 1/s, is out of reach of an explicit step, so that the reference is HHT itself at a small
step; seconds of motion are affordable there.
"""

_CHOICE = """
The cheapest measured setting whose gradient has at most the relative error on top, as
`recommend(error)` returns it:
"""

_GAIN_TEXT = f"""
For every scene the controlled setting that gains most, among those with an error of the gradient
between {_FLOOR:g} and 0.1, against the best fixed step for the same error: at any of the four
hht_alpha, which a user does not know beforehand, and at the same one. Its time is interpolated in
logarithms between measured steps, as if any step could be chosen. *ratio*: processor time of the
controlled step over that of the fixed one. Controlled settings that are accurate by chance, with
a larger error at a finer tolerance, are left out; fixed steps that are so are not.
"""

_TRUST_TEXT = """
The largest error divided by rtol over all tolerances and all hht_alpha, and where it occurred.
The tolerance bounds the rate at which errors of the coordinates arise; nothing bounds those of
sensitivities.
"""

_ALPHA_TEXT = """
Error of the gradient / of the multipliers at the smallest fixed step of each scene:
"""

_ANSWER = """
In words:

- **Soft, undamped.** Up to an error of 1 % of either gradient, HHT-I3 at a fixed step, 30 times
  cheaper than high order. For a pointwise gradient better than 1e-3: Explicit. In its time it has
  a thousand times smaller errors, because each halving of the step buys HHT a factor of four at
  best and the undamped waves, whose phases a pointwise sensitivity counts, need a step far below
  their periods first. An integral averages waves out, so HHT remains the cheaper one down to
  1e-4.
- **Soft, damped.** HHT-I3 to 1e-4, then IDAS, for both gradients: the waves that made the
  difference are gone.
- **Stiff, undamped.** HHT-I3 for a few per cent, 40 times cheaper; IDA from 1e-3 on. States
  mislead here: 6e-6 right at a step that has the pointwise gradient wrong by its own size.
- **Stiff or medium, damped.** HHT-I3, with error control at rtol of 3e-4 or less. An explicit
  step is out of the question, and IDA at 1e-5 stops at its limit of steps below (run to the end
  it took 50 s, 200 times as long, for an error of 0.2).
- **Rigid (slider-crank).** HHT-I3 to 1e-3, Explicit for more: 18 steps give five digits.
- **Paper's crank-slider.** Soft and undamped: HHT-I3 for a per cent, Explicit beyond.

A coarse setting in the column 1e-01 may be right by chance: on undamped scenes errors do not fall
steadily before waves are resolved. Look at the tables below, or ask for two settings in a row.
"""

_GAIN_NOTES = """
A controlled step gains where the pace of a scene changes and nowhere else: on the damped
pendulums of larger modulus, where gravity sets in suddenly, waves decay, and a slow swing
remains. A fixed step has to be small enough for the start until the end; larger ones fail there
(Newton's method does not converge) or leave a wrong kick. On undamped scenes and on the rigid
slider-crank, whose pace is even, control is as good as the best fixed step or dearer (up to 1.6
times), and its advantage is that nobody has to find that step. On the undamped stiff pendulum no
tolerance tried resolves the waves that decide about the gradient: they are smaller than any of
these tolerances of the coordinates.
"""

_TRUST_NOTES = """
*States* keep to ten times the tolerance everywhere. *Objectives* do so too where they are of the
size of the coordinates; the height of the tip at the end of the stiff scenes is some hundredths or
thousandths of that, and its relative error that much larger. *Gradients* do not, nor does the
tolerance speak of them: on the soft undamped pendulum they are wrong by up to 14 (integrated) and
230 (pointwise) tolerances, on the stiff undamped one by a tenth to their own size at every
tolerance tried. Only on the slider-crank is a gradient as right as the motion (3.7 tolerances). To
know a gradient, ask `error_bars`.
"""

_NEWTON_NOTES = """
Newton's method at rtol/1000 of the forces would be the usual choice. On the stiff damped beam
forces are large for the motion they make, and what is left of them moves it: states would be
wrong by tens of tolerances, gradients by any factor. That is why the default is no more than
1e-9; the table has what it costs.
"""

_ALPHA_NOTES = """
At equal small steps -0.05 is as accurate as 0 and up to twice as accurate as -0.3. Damping pays
where fast motion is to vanish: multipliers of the stiff damped pendulum are right to 7e-6 at
-0.3, to 4e-3 at -0.05, and at 0 they are 7e-3 off, oscillating, as the warning of that setting
says; the gradient does not feel it in these short runs. Coarse steps show the reverse: at -0.3 a
start that is not resolved kicks the beam harder (damped stiff pendulum at 2⁻⁹ s: gradient wrong
by 4, at -0.05 by 3e-4). With error control hht_alpha hardly matters, but 0 takes up to five times
the steps. So: -0.05 for gradients at fixed steps, -0.3 where multipliers of stiff scenes are
wanted, 0 never.
"""

_LIMITS = """
- Seven scenes, one objective of each kind, two variables: `tradeoff` is there to measure others.
- An error below that of the reference says nothing. References of high order are good to 1e-7 or
  better, those of the damped pendulums of larger modulus are HHT at 2⁻¹⁴ of the end time, good to
  about 1e-6.
- IDA and IDAS report Gauss-Lobatto instants in 64 intervals; where waves are faster than an
  interval their integrals are limited by the quadrature, not by their tolerance.
- Processor times are of NumPy code with small matrices, on a shared machine.
- Derivatives with error control are those at frozen steps. What the choice of steps itself would
  contribute is below the tolerance.
"""
