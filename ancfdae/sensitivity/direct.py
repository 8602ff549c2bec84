"""Direct differentiation (eqs. 22-25): sensitivities integrated along with the motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.integrators import Integrator
from ancfdae.sensitivity.contract import Method
from ancfdae.solution import Solution
from ancfdae.system import MechanicalSystem


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
