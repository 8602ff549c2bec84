"""Report on the paper's flexible pendulum, section by section."""

from ancfdae import HHT, differentiate
from validation.pendulum.case import DESIGN, FULL, QUICK, STEP, scaled
from validation.pendulum.cost import cost
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
    cost(report, extent)
    report.say("limits")
