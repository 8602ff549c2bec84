"""Direct differentiation (eqs. 21-25): sensitivities of the whole motion, then the chain rule."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.sensitivity.method import Gradient, Method, Run
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables import states_of


@final
@dataclass(frozen=True)
class Direct(Method):
    """Differentiate the discrete equations step by step.

    The result is the exact derivative of the discrete solution; all design variables are
    right-hand sides of one factorisation per step.
    """

    def differentiate(self, run: Run) -> Solution:
        """Integrate motion and sensitivities."""
        return run.solution(sensitivities=True)

    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """One run for all objectives (eq. 21)."""
        solution, totals = run.integrals(objectives, differentiated=True, sensitivities=True)
        states, s = states_of(solution), solution.sensitivities
        assert s is not None
        results = []
        for objective in objectives:
            p = objective.partials(run.system, states, totals)
            total = p.b
            for rows, x_b in ((p.q, s.q_b), (p.v, s.v_b), (p.lam, s.lam_b)):
                if rows is not None:
                    total = total + np.tensordot(rows, x_b, axes=2)
            results.append(Gradient(p.value, total, run.system.design_names, self, solution))
        return results
