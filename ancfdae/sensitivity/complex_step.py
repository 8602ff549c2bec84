"""Complex step of whole runs: derivatives of the discrete solution to round-off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.integrators import Integrator
from ancfdae.sensitivity.contract import Method, with_sensitivities
from ancfdae.solution import Solution
from ancfdae.system import MechanicalSystem

# Relative imaginary perturbation: its square vanishes against one, and itself stays far from
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
        """Run once in real numbers and once in complex ones per design variable."""
        solution = integrator.integrate(system, t_end, progress=progress)
        columns = []
        for i in range(system.n_b):
            b = system.b.astype(complex)
            size = _STEP * (abs(float(system.b[i])) or 1.0)
            b[i] += 1j * size
            run = integrator.integrate(system.with_values(b), t_end, progress=progress)
            columns.append(
                (run.q.imag / size, run.v.imag / size, run.a.imag / size, run.lam.imag / size)
            )
        return with_sensitivities(system, solution, columns)
