"""Report on published beam problems: statics, modes and motion, with derivatives."""

from validation.literature.arch import arch
from validation.literature.bend import bend
from validation.literature.buckling import buckling
from validation.literature.cable import cable
from validation.literature.cantilever import cantilever
from validation.literature.elastica import elastica
from validation.literature.princeton import princeton
from validation.literature.rotating import rotating
from validation.literature.spin_up import spin_up
from validation.literature.stability import stability
from validation.literature.supported import supported
from validation.report import Report

_CASES = (
    elastica,
    cantilever,
    bend,
    princeton,
    arch,
    cable,
    supported,
    buckling,
    stability,
    rotating,
    spin_up,
)


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `literature`; add its text, tables and figures."""
    report.say("method")
    for case in _CASES:
        case(report, quick)
    report.heading("Verdict")
    report.say("yes" if report.verdict(quick) else "no")
    report.say("limits")
