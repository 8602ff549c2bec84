"""Timed runs of one scene by several integrators, and their errors against one of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ancfdae import DOP853, HHT, IDA, IDAS, FixedSteps, differentiate
from ancfdae.assembly.system import AncfSystem
from ancfdae.errors import MissingPackageError
from ancfdae.extend import Integrator
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.integrators.sundials.index_reduced import IndexReduction
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch
from ancfdae.results import Solution
from validation.scenes import pendulum_deflection

#: Steps; more than any run of a report takes.
MANY = 10_000_000

_FORMS = {IndexReduction.STABILISED_INDEX_2: "GGL", IndexReduction.INDEX_1: "index 1"}


@dataclass(frozen=True)
class Run:
    """A finished run with sensitivities, and its processor time."""

    integrator: Integrator
    solution: Solution
    seconds: float


@dataclass(frozen=True)
class Errors:
    """Largest differences to a reference at the common instants.

    The deflection is in m; states are positions in m and slopes without unit. Multipliers are
    relative to the largest one; sensitivities of the deflection, shape (n_b,), are multiplied by
    the variable; m.
    """

    deflection: float
    states: float
    multipliers: float
    sensitivities: Array


def differentiated_run(system: AncfSystem, t_end: float, integrator: Integrator) -> Run | None:
    """Run with sensitivities; None where the integrator's package is not installed."""
    clock = stopwatch()
    try:
        solution = differentiate(system, t_end, integrator)
    except MissingPackageError:
        return None
    return Run(integrator, solution, clock())


def family(integrator: Integrator) -> str:
    """Return the name of a line of work-precision plots."""
    if isinstance(integrator, IDA | IDAS):
        return f"{type(integrator).__name__} {_FORMS[integrator.form]}"
    return "HHT-I3" if isinstance(integrator, HHT) else type(integrator).__name__


def label(integrator: Integrator) -> str:
    """Return the setting that decides about accuracy."""
    if isinstance(integrator, SteppedIntegrator):
        return f"step 2^{int(np.log2(step_of(integrator)))} s"
    assert isinstance(integrator, IDA | IDAS | DOP853)
    return f"rtol {integrator.rtol:.0e}"


def step_of(integrator: Integrator) -> float:
    """Return the step of a run with a fixed one."""
    assert isinstance(integrator, SteppedIntegrator)
    assert isinstance(integrator.steps, FixedSteps)
    return integrator.steps.step


def common_rows(solution: Solution, spacing: float) -> npt.NDArray[np.int64]:
    """Return the rows of the instants that are multiples of a spacing."""
    count = round(float(solution.t[-1]) / spacing)
    times = spacing * np.arange(count + 1)
    rows = np.searchsorted(solution.t, times - 1e-9 * spacing)
    assert np.allclose(solution.t[rows], times, rtol=0, atol=1e-9 * spacing)
    return rows


def errors(run: Run, reference: Run, spacing: float) -> Errors:
    """Compare two runs of the pendulum at the common instants."""
    (y, y_b), (y_0, y_b0) = (_curves(r, spacing) for r in (run, reference))
    return Errors(
        float(np.max(np.abs(y - y_0))),
        *motion_errors(run.solution, reference.solution, spacing),
        np.max(np.abs(y_b - y_b0), axis=0),
    )


def motion_errors(solution: Solution, reference: Solution, spacing: float) -> tuple[float, float]:
    """Return largest differences at the common instants.

    The first is of any coordinate, the second of the multipliers relative to the largest one.
    """
    rows, rows_0 = (common_rows(s, spacing) for s in (solution, reference))
    lam, lam_0 = solution.lam[rows], reference.lam[rows_0]
    states = float(np.max(np.abs(solution.q[rows] - reference.q[rows_0])))
    return states, float(np.max(np.abs(lam - lam_0)) / np.max(np.abs(lam_0)))


def _curves(run: Run, spacing: float) -> tuple[Array, Array]:
    solution, sensitivities = run.solution, run.solution.sensitivities
    assert sensitivities is not None
    rows = common_rows(solution, spacing)
    y_b = solution.derivative(pendulum_deflection)[rows] * sensitivities.values
    return pendulum_deflection(solution).real[rows], y_b


def balance(system: AncfSystem, solution: Solution, length: float) -> tuple[float, float]:
    """Return drift and energy balance.

    The first is the largest violation of a constraint over a length, the second the largest change
    of the total energy over the largest kinetic energy.
    """
    drift = max(
        float(np.max(np.abs(system.constraint(t, q))))
        for q, t in zip(solution.q, solution.t, strict=True)
    )
    kinetic = system.energies.kinetic(solution.v)
    total = system.energies.total(solution.q, solution.v)
    return drift / length, float(np.max(np.abs(total - total[0])) / np.max(kinetic))


def cheapest(points: Sequence[tuple[float, float]], target: float) -> float:
    """Return the least processor time of (error, seconds) with the error reached, or infinity."""
    return min((seconds for error, seconds in points if error <= target), default=float("inf"))
