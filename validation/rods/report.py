"""Report on slender rods and contact: experiments of cosseratbench, and penalty against event."""

from validation.report import Report
from validation.rods.experiments import experiments
from validation.rods.penalty import penalty


def run(report: Report, quick: bool) -> None:
    """Fill the report."""
    penalty(report, quick)
    experiments(report, quick)
