"""Report on steady rotation: blades, whirling shafts, derivatives, a simulation."""

from validation.external.runs import add_verdict
from validation.report import Report
from validation.rotation.blade import blades
from validation.rotation.derivatives import derivatives
from validation.rotation.shaft import shafts
from validation.rotation.simulated import simulated

__all__ = ["run"]


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `rotation`; add its text, tables and figures."""
    report.heading("Method")
    report.text(_METHOD)
    cases = (blades, shafts, derivatives, simulated)
    requirements = [each for case in cases for each in case(report, quick)]
    report.heading("Verdict")
    report.text(_YES if add_verdict(report, requirements, quick) else _NO)
    report.heading("Limits")
    report.text(_LIMITS)


_METHOD = """
Scenes are declared in a `RotatingFrame` ([theory](../../theory/15-steady-rotation.md)); `campbell`
finds the equilibrium and the modes at every rate. References share nothing with the elements:
Ritz's method with polynomials, roots of a determinant, differences of the calls themselves, and
a simulation of the same blade in a frame at rest, where neither centrifugal nor gyroscopic terms
are written down.
"""

_YES = "To the question: yes. All figures asked for are met."
_NO = "To the question: not everywhere; see the rows with NO."

_LIMITS = """
- References leave rotary inertia and shear of blade and shaft out, which is 1e-5 to 1e-4 here, and
  the stretch of the blade.
- The ground turns with the frame: bearings with damping at rest are not described.
"""
