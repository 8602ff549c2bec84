"""What derivatives cost beside the dynamics."""

import numpy as np

from ancfdae import HHT, assemble, differentiate, simulate
from ancfdae.results import Solution
from validation.pendulum.case import DESIGN, STEP, Extent
from validation.report import Report
from validation.scenes import pendulum


def cost(report: Report, extent: Extent) -> None:
    """Fill the section on the cost of derivatives relative to that of the motion."""
    report.heading("Cost")
    rows = []
    for dimension, name in ((2, "planar"), (3, "spatial")):
        plain, full = assemble(pendulum(dimension)), assemble(pendulum(dimension), DESIGN)
        alone, along = [], []
        for _ in range(extent.repeats):
            alone.append(_microseconds(simulate(plain, extent.t_end, HHT(STEP))))
            along.append(_microseconds(differentiate(full, extent.t_end, HHT(STEP))))
        base = report.figure(f"cost.{name}.microseconds_per_step", float(np.median(alone)))
        ratio = float(np.median(np.divide(along, alone)))
        report.figure(f"cost.{name}.ratio_three_variables", ratio)
        rows.append([name, plain.n_q, base, float(np.median(along)), ratio])
    report.say("cost")
    report.table(
        ["element", "coordinates", "dynamics [µs]", "with three variables [µs]", "ratio"], rows
    )


def _microseconds(solution: Solution) -> float:
    return 1e6 * solution.statistics.wall_seconds / solution.statistics.steps
