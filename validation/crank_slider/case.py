"""What is run of the paper's crank-slider: design variables, objective, extent."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ancfdae import HHT, Integral, assemble, gradient
from ancfdae.extend import MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.observables import position
from ancfdae.results import Solution
from ancfdae.sensitivity.method import GradientMethod
from validation.scenes import crank_slider

SYMBOLS = ("h_1", "rho_1", "E_1", "h_2", "rho_2", "E_2")
DESIGN = tuple(
    f"{beam}.{name}"
    for beam in ("crank", "rod")
    for name in ("height", "density", "youngs_modulus")
)
STEP = 2.0**-8


@dataclass(frozen=True)
class Extent:
    """How much of the report is run."""

    t_end: float
    exponents: Sequence[int]
    perturbations: Sequence[float]
    repeats: int
    adjoint_times: int


def paper_objective() -> Integral:
    """Return the objective of eq. (43) of the paper; m^2 s."""
    return Integral((position(crank_slider().beams[1].at_end, 0) - 1.8) ** 2)


def slider(solution: Solution) -> npt.NDArray[np.number]:
    """Return the position of the slider along its line, shape (n_t,); m."""
    return solution.position(MaterialPoint("rod", 1.0))[:, 0]


def scaled(solution: Solution) -> Array:
    """Sensitivities of the slider's position times the variable, shape (n_t, 6); m."""
    sensitivities = solution.sensitivities
    assert sensitivities is not None
    return solution.derivative(slider) * sensitivities.values


def relative(x: Array, reference: Array) -> float:
    """Return the difference to a reference in its norm."""
    return float(np.linalg.norm(x - reference) / np.linalg.norm(reference))


def scaled_gradient(t_end: float, integrator: HHT, method: GradientMethod) -> Array:
    """Return b dPsi/db, shape (6,)."""
    system = assemble(crank_slider(), DESIGN)
    return gradient(system, paper_objective(), t_end, integrator, method=method).gradient * system.b
