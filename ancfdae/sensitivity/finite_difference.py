"""Finite differences of whole runs: the check that the paper uses, and where it fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput, require_positive
from ancfdae.integrators import Integrator
from ancfdae.sensitivity.contract import Method, with_sensitivities
from ancfdae.solution import Solution
from ancfdae.system import MechanicalSystem


@final
@dataclass(frozen=True)
class FiniteDifference(Method):
    """Forward or central differences of whole runs.

    Parameters
    ----------
    relative_step : float
        Perturbation of each design variable relative to its value; the paper uses 0.01.
    central : bool
        Whether two runs per variable, at plus and minus, replace one.

    Raises
    ------
    InvalidInput
        If the perturbation is not positive, or not below one.
    """

    relative_step: float = 0.01
    central: bool = False

    def __post_init__(self) -> None:
        """Validate."""
        require_positive("FiniteDifference.relative_step", self.relative_step)
        if self.relative_step >= 1:
            raise InvalidInput(
                "FiniteDifference.relative_step",
                "must be below 1",
                self.relative_step,
                "0.01 perturbs by one per cent.",
            )

    def differentiate(
        self, system: MechanicalSystem, t_end: float, integrator: Integrator, progress: bool
    ) -> Solution:
        """Run once at the design and once or twice per design variable.

        Raises
        ------
        InvalidInput
            If a design variable is zero, so that a relative perturbation does nothing.
        """
        for name, value in zip(system.design_names, system.b, strict=True):
            if value == 0:
                raise InvalidInput(
                    f"design variable {name!r}",
                    "must not be zero for a relative perturbation",
                    value,
                    "Use direct differentiation or the complex step.",
                )
        solution = integrator.integrate(system, t_end, progress=progress)
        columns = []
        for i in range(system.n_b):
            ahead = self._perturbed(system, i, 1.0, t_end, integrator, progress)
            behind = solution
            if self.central:
                behind = self._perturbed(system, i, -1.0, t_end, integrator, progress)
            rows = min(len(ahead.t), len(behind.t))
            difference = float(system.b[i]) * self.relative_step * (2.0 if self.central else 1.0)
            columns.append(
                (
                    (ahead.q[:rows] - behind.q[:rows]) / difference,
                    (ahead.v[:rows] - behind.v[:rows]) / difference,
                    (ahead.a[:rows] - behind.a[:rows]) / difference,
                    (ahead.lam[:rows] - behind.lam[:rows]) / difference,
                )
            )
        return with_sensitivities(system, solution, columns)

    def _perturbed(
        self,
        system: MechanicalSystem,
        index: int,
        sign: float,
        t_end: float,
        integrator: Integrator,
        progress: bool,
    ) -> Solution:
        b = np.array(system.b, dtype=float)
        b[index] *= 1 + sign * self.relative_step
        return integrator.integrate(system.with_values(b), t_end, progress=progress)
