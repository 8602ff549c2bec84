"""Equilibrium as a run with one time point, so that every gradient method differentiates it."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import AdjointIntegrator, Integrator, Seeds
from ancfdae.numerics.arrays import Array
from ancfdae.statics.equilibrium import MAX_STEPS, Tangent, find_equilibrium


@final
@dataclass(frozen=True)
class Static(AdjointIntegrator):
    """An integrator that finds the equilibrium, not a motion; its solution has one time point.

    Parameters
    ----------
    max_steps : int
        Largest number of attempted load steps.
    """

    max_steps: int = MAX_STEPS

    def refined(self, solution: Solution) -> Integrator:
        """Raise InvalidInputError: an equilibrium has no error of discretisation in time."""
        rule = "an equilibrium must have no error bar in time"
        raise InvalidInputError("Static", rule, repr(self), "Compare meshes: error_bars(meshes=2).")

    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Return the equilibrium at t = 0 as a solution; `t_end` and `progress` are ignored."""
        return find_equilibrium(
            system, max_steps=self.max_steps, sensitivities=sensitivities
        ).solution

    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient, shape (n_b,), by one transposed solve at the equilibrium."""
        q, lam, t = solution.q[0], solution.lam[0], float(solution.t[0])
        on_q = np.zeros_like(q) if seeds.q is None else seeds.q[0]
        on_lam = np.zeros_like(lam) if seeds.lam is None else seeds.lam[0]
        return Tangent(system, t, q, lam).pull_back(on_q, on_lam)
