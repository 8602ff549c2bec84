"""Report on the paper's flexible pendulum, section by section."""

import numpy as np

from ancfdae import HHT, assemble, differentiate, simulate
from ancfdae.results import Solution
from validation.pendulum.case import DESIGN, FULL, QUICK, STEP, Extent, scaled
from validation.pendulum.exactness import against_complex_step, order, valley
from validation.pendulum.figures import (
    against_finite_differences,
    effect_of_modulus,
    planar_and_spatial,
)
from validation.pendulum.time_step import step_halving
from validation.report import Report
from validation.scenes import pendulum


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `pendulum`; add its text, tables and figures."""
    extent = QUICK if quick else FULL
    report.say("method")
    soft = scaled(
        differentiate(pendulum(youngs_modulus=5e6), extent.t_end, HHT(STEP), design=DESIGN)
    )
    hard_run = differentiate(pendulum(), extent.t_end, HHT(STEP), design=DESIGN)
    hard = scaled(hard_run)
    effect_of_modulus(report, hard, soft)
    against_finite_differences(report, hard, extent)
    planar_and_spatial(report, hard, extent)
    against_complex_step(report, hard_run, extent)
    order(report, extent)
    step_halving(report, hard, extent)
    valley(report, hard, extent)
    _cost(report, extent)
    report.say("limits")


def _cost(report: Report, extent: Extent) -> None:
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
