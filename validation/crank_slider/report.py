"""Report on the paper's crank-slider (section 4.2, Figs. 8 and 9, CPU times) and its question."""

from ancfdae import HHT, differentiate
from validation.crank_slider.case import DESIGN, STEP, Extent
from validation.crank_slider.cost import cost
from validation.crank_slider.exactness import balance, continuous, exactness
from validation.crank_slider.figures import objective_over_time, position_sensitivities
from validation.crank_slider.open_question import open_question
from validation.report import Report
from validation.scenes import crank_slider

_FULL = Extent(2.0, range(6, 12), [10.0**-k for k in range(1, 13)], 9, 8)
_QUICK = Extent(0.125, (6, 7), [1e-2, 1e-5, 1e-8], 1, 2)


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `crank-slider`; add its text, tables and figures."""
    extent = _QUICK if quick else _FULL
    report.say("method")
    solution = differentiate(crank_slider(), extent.t_end, HHT(STEP), design=DESIGN)
    position_sensitivities(report, solution, extent)
    objective_over_time(report, solution, extent)
    open_question(report, extent)
    exactness(report, solution, extent)
    continuous(report, extent)
    balance(report, solution)
    cost(report, extent)
    report.say("limits")
