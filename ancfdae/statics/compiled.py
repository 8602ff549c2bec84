"""Newton's method for equilibria by the kernel (`rest.h`)."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.prepared import Prepared
from ancfdae.kernels import RULES, Plan, Rest
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
    """End of a search in the kernel: state, reason, and for a solution its path in s.

    Where corrections have stopped shrinking the last one stands in place of the path.
    """

    why: Rest
    q: Array
    lam: Array
    path: tuple[Array, Array]
    iterations: int
    correction: float
    definite: bool


@final
class CompiledRest:
    """The kernel of one system at one time; `follows` says whether loads turn with the motion."""

    def __init__(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        t: float,
        known: RestStart,
        follows: bool,
    ) -> None:
        dtype = np.result_type(known.q_0, system.b, float)
        self._kernel = Prepared(system, matrices, np.zeros(RULES), dtype)
        self._known, instant, plan = known, np.array([t]), self._kernel.plan
        of = plan.joint_factors
        self._of_joints = np.ones(1) if of is None else np.array(of(instant, 1)[0, 0])
        self._of_loads = plan.load_factors(instant)[0]
        turning = self._of_loads * plan.turning if isinstance(plan, Plan) else np.ones(1)
        self._turning = turning * float(follows)

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
        known, acting = self._known, self._of_loads
        if isinstance(self._kernel.plan, Plan):
            acting = acting - (1.0 - s) * self._turning
        dtype = self._kernel.dtype
        state = tuple(np.array(x, dtype=dtype) for x in (q, lam, q, lam))
        rules = np.array([s, mu, *gaps, *known[3:], iterations, _CLEAR])
        given = known.q_0, anchor, known.r_0, known.Phi_0
        with np.errstate(all="ignore"):
            why, count, size, definite = self._kernel.model.rest(
                state, given, (self._of_joints, acting, self._turning), rules
            )
        if why == Rest.INDEFINITE:
            self._kernel.add_band()
            return self.solve(s, q, lam, gaps, mu, anchor, iterations)
        q, lam, *path = state
        return RestEnd(Rest(why), q, lam, (path[0], path[1]), count, size, bool(definite))
