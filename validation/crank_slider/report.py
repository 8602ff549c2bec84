"""Report on the paper's crank-slider (section 4.2, Figs. 8 and 9, CPU times) and its question."""

from ancfdae import (
    HHT,
    differentiate,
)
from validation.crank_slider.case import DESIGN, STEP, Extent
from validation.crank_slider.cost import cost
from validation.crank_slider.exactness import balance, continuous, exactness
from validation.crank_slider.figures import objective_over_time, position_sensitivities
from validation.crank_slider.open_question import open_question
from validation.report import Report
from validation.scenes import crank_slider

__all__ = ["run"]

_FULL = Extent(2.0, range(6, 12), [10.0**-k for k in range(1, 13)], 9, 8)
_QUICK = Extent(0.125, (6, 7), [1e-2, 1e-5, 1e-8], 1, 2)


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `crank-slider`; add its text, tables and figures."""
    extent = _QUICK if quick else _FULL
    report.heading("Method")
    report.text(_METHOD)
    solution = differentiate(crank_slider(), extent.t_end, HHT(STEP), design=DESIGN)
    position_sensitivities(report, solution, extent)
    objective_over_time(report, solution, extent)
    open_question(report, extent)
    exactness(report, solution, extent)
    continuous(report, extent)
    balance(report, solution)
    cost(report, extent)
    report.heading("Limits")
    report.text(_LIMITS)


_METHOD = """
Data of the paper's Table 1: crank 0.9 m, E = 1e9 N/m², two elements; rod 1.8 m, E = 1e8 N/m², four
elements; both 0.05 m x 0.05 m, 2770 kg/m³, nu = 0.3; spatial elements of 24 coordinates, massless
slider. The paper's Fig. 7 is not legible in our copy. Taken here: the in-plane mechanism, crank and
rod stretched out along +x at the start (slider at 2.7 m, so that 1.8 m is the middle of its
travel), heights in the plane of motion, gravity -y, start from rest. HHT-I3, hht_alpha = -0.3,
step 2⁻⁸ s (the paper does not give one). Objective: eq. (43). Sensitivities are multiplied by the
variable: a hundred times what one per cent changes.
"""

_LIMITS = """
- The geometry is our reading of section 4.2; the paper's curves carry no printed values.
- The motion starts stretched out, a dead-centre position; gravity decides which way it goes.
- Six elements are the paper's mesh, not a converged one, and nu = 0.3 shows Poisson locking.
"""
