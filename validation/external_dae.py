"""Report on published DAE benchmarks that users bring as mechanical systems of their own."""

from validation.external.crank_section import slider_crank
from validation.external.four_bar_section import four_bar
from validation.external.pendulum_section import pendulum
from validation.external.runs import Requirement
from validation.report import Report

__all__ = ["run"]


def run(report: Report, quick: bool) -> None:
    """Fill the report."""
    report.heading("Method")
    report.text(_METHOD)
    requirements = [*slider_crank(report, quick), *pendulum(report, quick)]
    requirements += four_bar(report, quick)
    _verdict(report, requirements, quick)
    report.heading("Limits")
    report.text(_LIMITS)


def _verdict(report: Report, requirements: list[Requirement], quick: bool) -> None:
    report.heading("Verdict")
    reached = [r for r in requirements if r.found is not None and r.found <= r.limit]
    measured = [r for r in requirements if r.found is not None]
    report.figure("verdict.required", len(requirements))
    report.figure("verdict.measured", len(measured))
    report.figure("verdict.reached", len(reached))
    settings = " (coarse settings: not results)" if quick else ""
    report.text(
        f"{len(reached)} of {len(measured)} figures are reached{settings}; "
        f"{len(requirements) - len(measured)} could not be measured for want of a package."
    )
    report.table(["figure", "limit", "found", "reached"], [r.row() for r in requirements])


_METHOD = """
Three problems of others, each written by hand as a `MechanicalSystem` (`validation/external/`)
with its partial derivatives; tests compare every one of them with a complex step. Each is run by
every integrator (HHT at a fixed step; IDA, IDAS and Explicit with error control) and by every
method of differentiation. Numbers to compare with are *recomputed* by a way that shares nothing
with this package: minimal coordinates and an integrator of high order. *Published* values, where
there are any, are in the first table. Times are processor seconds of one call, sensitivities
included; none was repeated. Where sundials4py is not installed the rows of IDAS say so.

`refused` in a table of methods is the answer of the package to a combination that it does not
offer: an adjoint exists for HHT and IDAS, the continuous adjoint for HHT, and the complex step
needs an integrator that computes in complex numbers, which only HHT does.
"""

_LIMITS = """
- Three small systems with constant mass and constraints that do not name the time; prescribed
  motions and a mass that depends on q are covered by tests, not here.
- The recomputed values have 10 to 13 digits; errors below 1e-11 say nothing.
- IDA and IDAS repeat the same run only on the same build of their libraries: errors at a given
  tolerance vary by a factor of about three from build to build.
- Processor times are of single runs in Python callbacks and compare the methods, not the
  libraries.
"""
