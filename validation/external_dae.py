"""Report on published DAE benchmarks that users bring as mechanical systems of their own."""

from validation.external.crank_section import slider_crank
from validation.external.four_bar_section import four_bar
from validation.external.pendulum_section import pendulum
from validation.external.runs import Requirement
from validation.report import Report

__all__ = ["run"]


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `external-dae`; add its text, tables and figures."""
    report.heading("Method")
    report.text(_METHOD)
    requirements = [*slider_crank(report, quick), *pendulum(report, quick)]
    requirements += four_bar(report, quick)
    _verdict(report, requirements, quick)
    report.heading("Limits")
    report.text(_LIMITS)


def _verdict(report: Report, requirements: list[Requirement], quick: bool) -> None:
    report.heading("Agreement")
    reached = [r for r in requirements if r.found is not None and r.found <= r.limit]
    measured = [r for r in requirements if r.found is not None]
    report.figure("verdict.required", len(requirements))
    report.figure("verdict.measured", len(measured))
    report.figure("verdict.reached", len(reached))
    settings = " (coarse settings: not results)" if quick else ""
    missing = len(requirements) - len(measured)
    report.text(
        f"{len(reached)} of {len(measured)} figures are reached{settings}"
        + (f"; {missing} could not be measured for want of a package." if missing else ".")
    )
    report.table(["figure", "limit", "found", "reached"], [r.row() for r in requirements])
    complete = len(reached) == len(measured)
    report.text((_YES if complete else _NO) + _ANSWER)


_METHOD = """
Three published problems, each written by hand as a `MechanicalSystem` (`validation/external/`)
with its partial derivatives; tests compare every one of them with a complex step. Each is run by
every integrator (HHT at a fixed step; IDA, IDAS and DOP853 with error control) and by every
method of differentiation. Numbers to compare with are *recomputed* by a way that shares nothing
with this package: minimal coordinates and an integrator of high order. *Published* values, where
there are any, are in the first table. Times are processor seconds of one call, sensitivities
included; none was repeated. Where sundials4py is not installed the rows of IDAS say so.

Every integrator is asked for every method; what the package does not offer it refuses with a
message, and the refusals stand below each table: an adjoint exists for HHT and IDAS, the
continuous adjoint for HHT, and the complex step needs an integrator that computes in complex
numbers, which only HHT does.
"""

_YES = """
To the question: yes, for the two regular problems by every integrator and by every method that the
package offers, each to its own accuracy. Through the singular positions of the double four-bar HHT
with newton_tolerance = 1e-5 passes at every step tried, the others at some tolerances; a run that
does not pass says so, and none passes with a wrong motion.
"""

_NO = """
To the question: not everywhere; see the rows with NO.
"""

_ANSWER = """
HHT is right to what its step gives at second order; IDA, IDAS and DOP853 are right to their
tolerance, times the growth of errors over the run (up to 1000 on the Cartesian pendulum).
Direct differentiation, discrete adjoint and complex step of HHT are the same number to round-off;
the adjoint of IDAS and its direct differentiation agree to ten times the tolerance; finite
differences of IDA and IDAS are the weakest, because they also differentiate the choice of steps.
"""

_LIMITS = """
- Three small systems with constant mass and constraints that do not name the time; prescribed
  motions and a mass that depends on q are covered by tests, not here.
- The recomputed values have 10 to 13 digits; errors below 1e-11 mean nothing.
- HHT meets the 1e-5 asked of the double four-bar with little to spare. What is left is truncation,
  largest at t = 5 s, where the point is fast; it falls by four with every halving of the step.
- IDA and IDAS repeat the same run only on the same build of their libraries: errors at a given
  tolerance vary by a factor of about three from build to build.
- Processor times are of single runs in Python callbacks and compare the methods, not the
  libraries.
"""
