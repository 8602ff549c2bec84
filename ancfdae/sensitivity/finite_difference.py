"""Finite differences of whole runs: the check that the paper uses, and where it fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput, require_positive
from ancfdae.integrators import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.objectives import Objective
from ancfdae.observables import states_of
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution
from ancfdae.sensitivity.method import Gradient, Method, repeated, run_for, with_columns


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
        self._refuse_zero(system)
        solution = integrator.integrate(system, t_end, progress=progress)
        integrator, t_end = repeated(integrator, solution, t_end)
        columns, outcomes = [], [solution.outcome]
        for i in range(system.n_b):
            ahead = self._perturbed(system, i, 1.0, t_end, integrator, progress)
            behind = solution
            if self.central:
                behind = self._perturbed(system, i, -1.0, t_end, integrator, progress)
            rows = min(len(ahead.t), len(behind.t))
            outcomes += [ahead.outcome, behind.outcome]
            difference = float(system.b[i]) * self.relative_step * (2.0 if self.central else 1.0)
            columns.append(
                (
                    (ahead.q[:rows] - behind.q[:rows]) / difference,
                    (ahead.v[:rows] - behind.v[:rows]) / difference,
                    (ahead.a[:rows] - behind.a[:rows]) / difference,
                    (ahead.lam[:rows] - behind.lam[:rows]) / difference,
                )
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
        """Differences of the objectives of whole runs."""
        self._refuse_zero(system)
        solution, base = self._values(system, objectives, t_end, integrator, progress)
        integrator, t_end = repeated(integrator, solution, t_end)
        slopes = np.zeros((len(objectives), system.n_b))
        for i in range(system.n_b):
            values = [base]
            for sign in (1.0, -1.0) if self.central else (1.0,):
                moved = system.with_values(self._moved(system, i, sign))
                values.append(self._values(moved, objectives, t_end, integrator, progress)[1])
            ahead, behind = values[1], values[-1] if self.central else base
            difference = float(system.b[i]) * self.relative_step * (2.0 if self.central else 1.0)
            slopes[:, i] = np.subtract(ahead, behind) / difference
        return [
            Gradient(value, slope, system.design_names, self, solution)
            for value, slope in zip(base, slopes, strict=True)
        ]

    def _values(
        self,
        system: MechanicalSystem,
        objectives: Sequence[Objective],
        t_end: float,
        integrator: Integrator,
        progress: bool,
    ) -> tuple[Solution, list[float]]:
        solution, totals = run_for(
            system, objectives, t_end, integrator, progress, differentiated=False
        )
        states = states_of(solution)
        return solution, [objective.value(system, states, totals) for objective in objectives]

    def _refuse_zero(self, system: MechanicalSystem) -> None:
        for name, value in zip(system.design_names, system.b, strict=True):
            if value == 0:
                raise InvalidInput(
                    f"design variable {name!r}",
                    "must not be zero for a relative perturbation",
                    value,
                    "Use direct differentiation or the complex step.",
                )

    def _moved(self, system: MechanicalSystem, index: int, sign: float) -> Array:
        b = np.array(system.b, dtype=float)
        b[index] *= 1 + sign * self.relative_step
        return b

    def _perturbed(
        self,
        system: MechanicalSystem,
        index: int,
        sign: float,
        t_end: float,
        integrator: Integrator,
        progress: bool,
    ) -> Solution:
        moved = system.with_values(self._moved(system, index, sign))
        return integrator.integrate(moved, t_end, progress=progress)
