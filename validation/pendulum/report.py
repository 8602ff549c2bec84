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

__all__ = ["run"]


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `pendulum`; add its text, tables and figures."""
    extent = QUICK if quick else FULL
    report.heading("Method")
    report.text(_METHOD)
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
    report.heading("Limits")
    report.text(_LIMITS)


_METHOD = """
Straight beam, L = 1.2 m, h = w = 0.05 m, rho = 4000 kg/m³, nu = 0.3, five elements, pinned at its
left end, horizontal and at rest at t = 0, then free under 9.81 m/s². HHT-I3 at the paper's step
2⁻⁷ s with hht_alpha = -0.3 (the paper does not say which value it uses) and exact Jacobian.
*Deflection* is the y component of the free end in the frame that sits at the pin with its x axis
along the tangent there. Sensitivities come by direct differentiation and are shown as
b · d(deflection)/db, in metres: a hundred times what one per cent of b changes.
The paper's figures are curves without printed values; *agrees* below refers to what its text says
of them.
"""

_LIMITS = """
- Five elements are a demonstration, not a converged mesh, and both elements show Poisson locking.
- Undamped material: unresolved waves never die out physically; only HHT-I3 damps them.
- Curves are compared as wholes (norm over time); single instants can differ by more.
"""
