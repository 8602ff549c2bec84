"""Complex step of whole runs: derivatives of the discrete solution to round-off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.integrators import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.objectives import Objective
from ancfdae.observables import states_of
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution
from ancfdae.sensitivity.method import Gradient, Method, finished, repeated, with_columns

# Relative imaginary perturbation: its square vanishes against one, and it stays far above
# the smallest normal number after division by beta h^2 or multiplication with small lengths.
_STEP = 1e-40


@final
@dataclass(frozen=True)
class ComplexStep(Method):
    """Run the whole simulation at b (1 + i eps), once per design variable.

    The imaginary part over eps is the derivative, free of subtraction; the independent check
    of direct differentiation. Needs a system that computes in complex numbers, as every ANCF
    scene does.
    """

    def differentiate(
        self, system: MechanicalSystem, t_end: float, integrator: Integrator, progress: bool
    ) -> Solution:
        """Run once in real numbers and once in complex ones per design variable.

        Raises
        ------
        InvalidInput
            If the integrator computes in real numbers only (IDA, IDAS, Explicit).
        """
        _refuse_real(integrator)
        solution = integrator.integrate(system, t_end, progress=progress)
        integrator, t_end = repeated(integrator, solution, t_end)
        columns, outcomes = [], [solution.outcome]
        for i in range(system.n_b):
            b, size = _moved(system, i)
            run = integrator.integrate(system.with_values(b), t_end, progress=progress)
            outcomes.append(run.outcome)
            columns.append(
                (run.q.imag / size, run.v.imag / size, run.a.imag / size, run.lam.imag / size)
            )
        return with_columns(system, solution, columns, outcomes)

    def gradients(
        self,
        system: MechanicalSystem,
        objectives: Sequence[Objective],
        t_end: float,
        integrator: Integrator,
        progress: bool,
    ) -> list[Gradient]:
        """Imaginary parts of the objectives of complex runs.

        Raises
        ------
        InvalidInput
            As `differentiate`.
        """
        _refuse_real(integrator)
        solution = finished(integrator.integrate(system, t_end, progress=progress))
        integrator, t_end = repeated(integrator, solution, t_end)
        slopes = np.zeros((len(objectives), system.n_b))
        for i in range(system.n_b):
            b, size = _moved(system, i)
            moved = system.with_values(b)
            states = states_of(finished(integrator.integrate(moved, t_end, progress=progress)))
            slopes[:, i] = [
                np.imag(objective.value(moved, states)) / size for objective in objectives
            ]
        return [
            Gradient(
                objective.value(system, states_of(solution)),
                slope,
                system.design_names,
                self,
                solution,
            )
            for objective, slope in zip(objectives, slopes, strict=True)
        ]


def _refuse_real(integrator: Integrator) -> None:
    """Refuse before the first run, which would be wasted."""
    if integrator.real_only:
        raise InvalidInput(
            "ComplexStep",
            "needs an integrator that computes in complex numbers",
            repr(integrator),
            "Use HHT, or FiniteDifference().",
        )


def _moved(system: MechanicalSystem, index: int) -> tuple[Array, float]:
    """Complex design values and the size of the imaginary step."""
    b = system.b.astype(complex)
    size = _STEP * (abs(float(system.b[index])) or 1.0)
    b[index] += 1j * size
    return b, size
