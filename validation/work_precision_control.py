"""What error control of HHT-I3 gains, and how far its tolerance may be trusted."""

from collections.abc import Sequence

from ancfdae.results import MeasuredSetting, WorkPrecision
from validation.report import Agreement, Report
from validation.work_precision_findings import (
    Gain,
    ModelChoice,
    alpha,
    best_gain,
    control,
    controlled,
    controlled_both,
    largest_ratio,
    short_name,
)
from validation.work_precision_scenes import OBJECTIVES, Measured, newton_tolerances

__all__ = ["gains", "newton", "trust"]

# Errors of a gradient below this are as large as those of some references.
_FLOOR = 1e-6
_ALLOWED = 10.0


def gains(report: Report, found: Sequence[Measured]) -> None:
    """Compare the controlled step with fixed ones."""
    rows: list[list[object]] = []
    best: dict[bool, tuple[Gain, str]] = {}
    for each in found:
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            row: list[object] = [each.case.title, kind]
            for same in (False, True):
                gain = best_gain(table, _FLOOR, same, controlled)
                if gain is None:
                    row += ["-"] * 4
                    continue
                name = "same_alpha" if same else "any_alpha"
                report.figure(f"gain.{each.case.name}.{kind}.{name}", gain.ratio)
                row += [short_name(gain.row), f"{gain.row.error('gradient'):.2g}"]
                row += [f"{gain.row.seconds:.2g} / {gain.fixed_seconds:.2g}", f"{gain.ratio:.2f}"]
                if same not in best or gain.ratio < best[same][0].ratio:
                    best[same] = gain, f"{each.case.title}, {kind}"
            both = best_gain(table, _FLOOR, False, controlled_both)
            row.append("-" if both is None else f"{both.ratio:.2f}")
            rows.append(row)
    report.text(_GAIN_TEXT)
    header = ["scene", "gradient"]
    for which in ("any alpha", "same alpha"):
        header += [f"controlled ({which})", "error", "CPU [s] / fixed", "ratio"]
    report.table([*header, "ratio of both"], rows)
    ratios = {same: gain.ratio for same, (gain, _) in best.items()}
    verdict = Agreement.PARTLY if ratios.get(True, 1.0) <= 0.5 else Agreement.DISAGREES
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
        Agreement.AGREES if ratios.get(False, 1.0) <= 0.5 else verdict,
    )
    report.text(_GAIN_NOTES)


def trust(report: Report, found: Sequence[Measured]) -> None:
    """Compare errors with tolerances."""
    report.text(_TRUST_TEXT)
    motion = _ratios(report, found, controlled, "trust")
    report.text(_TRUST_BOTH)
    both = _ratios(report, found, controlled_both, "trust.both")
    listed = ", ".join(f"{name} {ratio:.2g}" for name, ratio in both.items())
    promised = [motion["states"], *both.values()]
    report.claim(
        "The controlled step is never wrong by more than 10 times its tolerance",
        "asked for",
        "largest error over rtol on any scene, at any hht_alpha: control of the motion, states "
        f"{motion['states']:.2g}; control of motion and derivatives, {listed}",
        Agreement.AGREES if max(promised) <= _ALLOWED else Agreement.DISAGREES,
    )
    report.text(_TRUST_NOTES)


def _ratios(
    report: Report, found: Sequence[Measured], choice: ModelChoice, prefix: str
) -> dict[str, float]:
    """Tell the largest errors over tolerances per scene; return those over all."""
    rows: list[list[object]] = []
    worst: dict[str, float] = {}
    for each in found:
        cells: list[object] = [each.case.title]
        looks: list[tuple[str, str, Sequence[WorkPrecision]]] = [
            ("states", "states", each.tables[:1])
        ]
        for kind, table in zip(OBJECTIVES, each.tables, strict=True):
            looks += [(f"objective {kind}", "objective", [table])]
            looks += [(f"gradient {kind}", "gradient", [table])]
        for name, of, tables in looks:
            ratio, row = largest_ratio(tables, of, choice)
            report.figure(f"{prefix}.{each.case.name}.{name.replace(' ', '.')}", ratio)
            worst[name] = max(worst.get(name, 0.0), ratio)
            cells.append(f"{ratio:.2g}" + ("" if row is None else f" ({_place(row)})"))
        measured = [row for row in each.tables[0].rows if choice(row)]
        cells.append(f"{sum(row.finished for row in measured)} of {len(measured)}")
        rows.append(cells)
    report.table(["scene", *worst, "finished"], rows)
    return worst


def newton(report: Report, quick: bool) -> None:
    """Show the influence of the tolerance of Newton's method."""
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


def _place(row: MeasuredSetting) -> str:
    steps = control(row)
    assert steps is not None
    return f"rtol {steps.rtol:.0e}, alpha {alpha(row):g}"


_GAIN_TEXT = f"""
For every scene the controlled setting that gains most, among those with an error of the gradient
between {_FLOOR:g} and 0.1, against the best fixed step for the same error: at any of the four
hht_alpha, which a user does not know beforehand, and at the same one. Its time is interpolated in
logarithms between measured steps, as if any step could be chosen. *ratio*: processor time of the
controlled step over that of the fixed one. Controlled settings that are accurate by chance, with
a larger error at a finer tolerance, are left out; fixed steps that are so are not.
"""


_TRUST_TEXT = """
The largest error divided by rtol over all tolerances and all hht_alpha, where it occurred, and
how many settings reached the end. First `HHT(rtol=...)`, whose tolerance bounds the rate at which
errors of the coordinates arise, and nothing else:
"""


_TRUST_BOTH = """
The same with `sensitivities=True`: the tolerance bounds the errors of the derivatives too.
"""


_GAIN_NOTES = """
A controlled step gains only where the time scale of a scene changes: on the damped
pendulums of larger modulus, where gravity sets in suddenly, waves decay, and a slow swing
remains. A fixed step has to be small enough for the start until the end; larger ones fail there
(Newton's method does not converge) or start a wrong motion. On undamped scenes and on the rigid
slider-crank, whose time scale stays the same, control costs as much as the best fixed step or more
(up to 1.6 times), and its advantage is that nobody has to find that step. On the undamped stiff
pendulum no tolerance of the motion resolves the waves that decide about the gradient: they are
smaller than any tried. *Ratio of both* is the least ratio, at any hht_alpha, of settings that
control motion and derivatives. They never beat a step chosen with the answer known; their advantage
is that the tolerance holds, see below.
"""


_TRUST_NOTES = """
Under control of the motion the errors of *states* stay below ten times the tolerance everywhere.
*Objectives* do so too where they are of the size of the coordinates; the height of the tip at the
end of the stiff scenes is some hundredths or thousandths of that, and its relative error that much
larger. *Gradients* do not: on the soft undamped pendulum they are wrong by up to 14 (integrated)
and 230 (pointwise) tolerances, on the stiff undamped one by a tenth to their own size at every
tolerance tried, because waves below the tolerance of the motion decide about them.
`estimated_errors` of such a run says so (report `error-bars`).

Under control of both all errors stay within a few tolerances, on every scene and at every
hht_alpha. What it costs is in the column *ratio of both* above: one to fifteen times the best fixed
step, which nobody knows beforehand. Integrated gradients of undamped scenes then are hundreds of
times better than asked, for the waves that the derivatives contain are resolved, and an integral
averages them out. A setting that did not finish ran at hht_alpha = 0, which is unstable and warned
about.
"""


_NEWTON_NOTES = """
Newton's method at rtol/1000 of the forces would be the usual choice. On the stiff damped beam
forces are large compared with the motion they cause, and the remaining imbalance moves it: states
would be wrong by tens of tolerances, gradients by any factor. That is why the default is no more
than 1e-9; the table shows what it costs.
"""
