"""Report on published DAE benchmarks that users bring as mechanical systems of their own."""

from validation.external.crank_section import slider_crank
from validation.external.four_bar_section import four_bar
from validation.external.pendulum_section import pendulum
from validation.report import Report


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `external-dae`; add its text, tables and figures."""
    report.say("method")
    for section in (slider_crank, pendulum, four_bar):
        section(report, quick)
    report.heading("Agreement")
    measured = sum(found is not None for _, _, found in report.requirements)
    report.figure("verdict.measured", measured)
    report.say("yes" if report.verdict(quick) else "no")
    report.say("answer")
    report.say("limits")
