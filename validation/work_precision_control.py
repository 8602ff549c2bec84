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
    report.say("gain", floor=_FLOOR)
    header = ["scene", "gradient"]
    for which in ("any alpha", "same alpha"):
        header += [f"controlled ({which})", "error", "CPU [s] / fixed", "ratio"]
    report.table([*header, "ratio of both"], rows)
    ratios = {same: gain.ratio for same, (gain, _) in best.items()}
    verdict = Agreement.PARTLY if ratios.get(True, 1.0) <= 0.5 else Agreement.DISAGREES
    report.judge(
        "gains",
        Agreement.AGREES if ratios.get(False, 1.0) <= 0.5 else verdict,
        gains="; ".join(
            f"fixed step at {'the same' if same else 'the best'} hht_alpha: ratio {gain.ratio:.2f} "
            f"({where}: {short_name(gain.row)}, error {gain.row.error('gradient'):.1g}, "
            f"{gain.row.seconds:.2g} s against {gain.fixed_seconds:.2g} s)"
            for same, (gain, where) in best.items()
        )
        or "no pair to compare",
    )
    report.say("gain.notes")


def trust(report: Report, found: Sequence[Measured]) -> None:
    """Compare errors with tolerances."""
    report.say("trust")
    motion = _ratios(report, found, controlled, "trust")
    report.say("trust.both")
    both = _ratios(report, found, controlled_both, "trust.both")
    listed = ", ".join(f"{name} {ratio:.2g}" for name, ratio in both.items())
    promised = [motion["states"], *both.values()]
    report.judge("trust", max(promised) <= _ALLOWED, states=motion["states"], listed=listed)
    report.say("trust.notes")


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
    report.say("newton", title=title)
    header = [
        f"{what}, {x}" for x in ("loose", "default") for what in ("states", "gradient", "CPU")
    ]
    report.table(["rtol", *header], rows)
    report.say("newton.notes")


def _place(row: MeasuredSetting) -> str:
    steps = control(row)
    assert steps is not None
    return f"rtol {steps.rtol:.0e}, alpha {alpha(row):g}"
