"""Report on where the numerics end: each row of its tables is measured."""

from validation.extremes.floor import round_off
from validation.extremes.groups import GROUPS
from validation.extremes.long import Long, long_runs
from validation.extremes.rows import Row, add_table, measure
from validation.extremes.scaling import scaling
from validation.report import Agreement, Report

__all__ = ["run"]


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `extremes`; add its text, tables and figures."""
    report.heading("Method")
    report.text(_METHOD)
    rows: list[Row] = []
    for group in GROUPS:
        report.heading(group.title)
        report.text(group.text)
        measured = [measure(case) for case in group.cases(quick)]
        add_table(report, group.name, measured)
        rows += measured
    _judge(report, rows)
    largest = scaling(report, quick)
    report.claim(
        "Other units give the same dimensionless result",
        "to 1e-10 over 12 orders of magnitude of length, time and mass",
        f"to {largest:.0e} over 16, sensitivities included",
        _verdict(largest < 1e-10),
    )
    floor = round_off(report, quick)
    report.claim(
        "Accelerations and multipliers stay usable at a step of 1e-6 s",
        "relative error below 1e-3",
        f"{floor:.0e}",
        _verdict(floor < 1e-3),
    )
    _judge_long(report, long_runs(report, quick), quick)
    report.heading("Limits")
    report.text(_LIMITS)


def _judge(report: Report, rows: list[Row]) -> None:
    survived, clean = sum(row.survived for row in rows), sum(row.clean for row in rows)
    counts = {"cases": len(rows), "survived": survived, "clean": clean}
    for name, value in counts.items():
        report.figure(f"rows.{name}", value)
    failed = [row.case.label for row in rows if not row.clean]
    report.claim(
        "Every failure is a clean outcome",
        "no hang, no crash, no undetected wrong number",
        f"{len(rows)} rows: {survived} survived, {len(rows) - survived} stopped or refused in "
        "words" + (f"; not clean: {', '.join(failed)}" if failed else "; none else"),
        _verdict(not failed),
    )


def _judge_long(report: Report, runs: list[Long], quick: bool) -> None:
    damped = [long for long in runs if long.alpha < 0]
    worst = max(long.size for long in damped)
    drift = max(long.drift for long in damped)
    held = all(long.run.outcome.success for long in damped) and worst < 0.05
    report.claim(
        "The pendulum does not blow up within 100 s at hht_alpha = -0.05 and -0.3",
        "energy error bounded and printed",
        f"energy within {worst:.1g} of the fall, constraints within {drift:.0e} lengths",
        _verdict(held),
    )
    rigid = next(long for long in runs if long.alpha == 0.0 and long.label == "rigid")
    shown = not rigid.run.outcome.success or rigid.size > 1.0
    report.claim(
        "hht_alpha = 0 is unstable, and that is warned about",
        "shown",
        f"rigid pendulum: {rigid.run.outcome} Multipliers up to "
        f"{float(max(rigid.multipliers())):.0e}; StabilityWarning: "
        + ("yes" if rigid.warning else "no"),
        Agreement.NOT_CHECKABLE if quick else _verdict(shown and bool(rigid.warning)),
    )


def _verdict(good: bool) -> Agreement:
    return Agreement.AGREES if good else Agreement.DISAGREES


_METHOD = """
HHT-I3 at fixed steps with hht_alpha = -0.3 unless said. Scenes are the paper's pendulum (L = 1.2 m,
h = w = L/24, rho = 4000 kg/m³, E = 1e7 Pa, nu = 0.3, four planar elements, horizontal, turning at
2 rad/s under 9.81 m/s²) and a planar crank-slider (crank 0.9 m, rod 1.8 m, E = 1e8 Pa), with one
thing changed at a time. Columns:

- *outcome*: survived, with how many steps Newton's method ended at round-off above its tolerance,
  and how many it solved by way of shorter ones only (docs/theory/05-hht-i3.md); or *stopped*,
  with the sentence of the outcome; or *refused*, with the message of the error.
  CRASH, WARNING and WRONG would stand here for anything else.
- *error*: against the reference that the text above each table names.
- *estimated*: `estimated_errors.motion`, what the run says about the errors of its steps, relative
  to the coordinates.
- *equations*: largest |M A + Phi_qᵀ lambda - Q| of accepted steps, recomputed from the solution,
  relative to the three terms; above 1e-5 the row is WRONG, unless most steps are counted as ended
  by round-off. It is where a stiff scene shows its
  round-off, eps |K| |q|.
- *constraints*: largest distance from a constraint, relative to |q|, in the norm of the mass;
  above 1e-8 the row is WRONG.
- *condition*: of the scaled iteration matrix at the start (2-norm), up to 500 unknowns.
- *iterations*: of Newton's method for each step.
"""

_LIMITS = """
- *Survived* says that the discrete equations are solved, not that the step is small enough: the
  columns *error* of the step and of the crank turning at 10 rad/s show what truncation does.
- Beyond some size of a step the discrete equations have several solutions. Where Newton's method
  stalls, the one that belongs to the motion is found from shorter steps, or there is none and the
  outcome says so; but where it converges slowly by full steps, round-off may still decide which
  one it finds. A smaller step cures it.
- One integrator, HHT-I3; the others are compared in the reports `integrators` and `external-dae`.
"""
