"""The pendulum's design, the extent of a run, and curves of its deflection."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.results import Solution
from validation.scenes import pendulum_deflection

DESIGN = ("pendulum.height", "pendulum.density", "pendulum.youngs_modulus")
SYMBOLS = ("h", "rho", "E")
STEP = 2.0**-7


@dataclass(frozen=True)
class Extent:
    """How much of the report is run."""

    t_end: float
    halvings: int
    perturbations: Sequence[float]
    repeats: int


FULL = Extent(4.0, 4, [10.0**-k for k in range(1, 14)], 7)
QUICK = Extent(0.5, 1, [1e-2, 1e-5, 1e-8, 1e-11], 1)


@dataclass(frozen=True)
class Curves:
    """Deflection over time and its derivatives times the value of the variable; m."""

    t: Array
    y: Array
    y_b: Array


def scaled(solution: Solution) -> Curves:
    """Deflection of a run with its scaled sensitivities."""
    sensitivities = solution.sensitivities
    assert sensitivities is not None
    y_b = solution.derivative(pendulum_deflection) * sensitivities.values
    return Curves(solution.t, pendulum_deflection(solution).real, y_b)


def relative(x: Array, reference: Array) -> float:
    """Norm over time of a difference, relative to the norm of the reference."""
    return float(np.linalg.norm(x - reference) / np.linalg.norm(reference))
