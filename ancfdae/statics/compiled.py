"""Newton's method for equilibria by the kernel, for a system that is a plan of arrays (`rest.h`).

It solves the equations of `balance.py` by the same rules.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem, PlannedSystem
from ancfdae.kernels import RULES, Model, Plan, Rest
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint

# K is positive definite for certain if its factorisation succeeds with the diagonal reduced by this
# fraction of itself.
_CLEAR = 1e-13


class RestStart(NamedTuple):
    """Constants of a search: its start, the unbalanced forces there, scales, and rules."""

    q_0: Array
    r_0: Array
    Phi_0: Array
    position: float
    load: float
    tolerance: float
    far: float
    growths: int


class RestEnd(NamedTuple):
    """End of a search in the kernel: state, reason, and for a solution its path in s."""

    why: Rest
    q: Array
    lam: Array
    path: tuple[Array, Array]
    iterations: int
    correction: float
    definite: bool


@final
class CompiledRest:
    """The kernel of one system at one instant."""

    def __init__(self, plan: Plan, matrices: SaddlePoint, t: float, known: RestStart) -> None:
        self._plan, self._matrices, self._known = plan, matrices, known
        self._model = self._prepared(band=False)
        instant, of = np.array([t]), plan.joint_factors
        self._of_joints = np.ones(1) if of is None else np.array(of(instant, 1)[0, 0])
        self._of_loads = plan.load_factors(instant)[0]

    @classmethod
    def of(
        cls, system: MechanicalSystem, matrices: SaddlePoint, t: float, known: RestStart
    ) -> CompiledRest | None:
        """Return None for a system that is no plan, or whose matrices need another solver."""
        plan = system.plan if isinstance(system, PlannedSystem) else None
        if plan is None or np.iscomplexobj(known.q_0) or matrices.layout(band=False) is None:
            return None
        return cls(plan, matrices, t, known)

    def solve(
        self,
        s: float,
        q: Array,
        lam: Array,
        gaps: tuple[float, float],
        mu: float,
        anchor: Array | None,
        iterations: int,
    ) -> RestEnd:
        """Solve from a guess; with no iterations the state is taken as it is.

        `gaps` are the part of Phi_0 that is left, and the part that it loses per s.
        """
        known, turning = self._known, self._of_loads * self._plan.turning
        factors = self._of_joints, self._of_loads - (1.0 - s) * turning, turning
        state = q.copy(), lam.copy(), np.empty_like(q), np.empty_like(lam)
        rules = np.array([s, mu, *gaps, *known[3:], iterations, _CLEAR])
        given = known.q_0, anchor, known.r_0, known.Phi_0
        why, count, size, definite = self._model.rest(state, given, factors, rules)
        if why == Rest.INDEFINITE:
            self._model = self._prepared(band=True)
            return self.solve(s, q, lam, gaps, mu, anchor, iterations)
        return RestEnd(Rest(why), state[0], state[1], state[2:], count, size, bool(definite))

    def _prepared(self, band: bool) -> Model:
        layout = self._matrices.layout(band)
        assert layout is not None
        return Model(self._plan, layout, np.zeros(RULES))
