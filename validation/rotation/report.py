"""Report on steady rotation: blades, whirling shafts, derivatives, a simulation."""

from validation.report import Report
from validation.rotation.blade import blades
from validation.rotation.derivatives import derivatives
from validation.rotation.shaft import shafts
from validation.rotation.simulated import simulated


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `rotation`; add its text, tables and figures."""
    report.say("method")
    for case in (blades, shafts, derivatives, simulated):
        case(report, quick)
    report.heading("Verdict")
    report.say("yes" if report.verdict(quick) else "no")
    report.say("limits")
