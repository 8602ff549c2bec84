"""Direct differentiation (eqs. 21-25): sensitivities of the whole motion, then the chain rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators import Integrator
from ancfdae.objectives import Objective, ObjectivePartials
from ancfdae.observables import states_of
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution
from ancfdae.sensitivity.method import Gradient, Method, run_for


@final
@dataclass(frozen=True)
class Direct(Method):
    """Differentiate the discrete equations step by step.

    The result is the exact derivative of the discrete solution; all design variables are
    right-hand sides of one factorisation per step.
    """

    def differentiate(
        self, system: MechanicalSystem, t_end: float, integrator: Integrator, progress: bool
    ) -> Solution:
        """Integrate motion and sensitivities."""
        return integrator.integrate(system, t_end, sensitivities=True, progress=progress)

    def gradients(
        self,
        system: MechanicalSystem,
        objectives: Sequence[Objective],
        t_end: float,
        integrator: Integrator,
        progress: bool,
    ) -> list[Gradient]:
        """One run for all objectives (eq. 21)."""
        solution, totals = run_for(
            system,
            objectives,
            t_end,
            integrator,
            progress,
            differentiated=True,
            sensitivities=True,
        )
        states = states_of(solution)
        return [
            self._chain(objective.partials(system, states, totals), system, solution)
            for objective in objectives
        ]

    def _chain(
        self, partials: ObjectivePartials, system: MechanicalSystem, solution: Solution
    ) -> Gradient:
        total, s = partials.b, solution.sensitivities
        assert s is not None
        for rows, x_b in ((partials.q, s.q_b), (partials.v, s.v_b), (partials.lam, s.lam_b)):
            if rows is not None:
                total = total + np.tensordot(rows, x_b, axes=2)
        return Gradient(partials.value, total, system.design_names, self, solution)
