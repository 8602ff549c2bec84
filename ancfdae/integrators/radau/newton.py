"""Newton's method for the stages of a step, by a kernel: its rules, and how it ends.

`kernels/stages.h` iterates.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from ancfdae.equations.prepared import Prepared
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.stages import Begin, stage_matrices
from ancfdae.integrators.radau.tableau import TABLEAU
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.kernels import RULES, STAGES_NOT_FINITE, STAGES_SINGULAR, STAGES_SOLVED
from ancfdae.numerics.arrays import Array

# The iteration matrix is recomputed if more than _MORE further iterations are predicted.
_MORE = 4
# Forces above _JUMP times those at the start of the step come from wrong strains of the guess: a
# matrix made there is used once.
_JUMP = 10.0
# Corrections are measured against forces of the iterate, at most _MOST times those at the start of
# the step: a diverging iterate has huge forces.
_MOST = 100.0
# Corrections stop shrinking where they shrink by less than this factor.
_SLOW = 0.5
# Corrections that stop shrinking are round-off if they are this small against the motion, or that
# many times the round-off of positions.
_ROUND_OFF, _POSITIONS = 1e-6, 1e4
_TINY = float(np.finfo(float).tiny)


class SolvedStages(NamedTuple):
    """Scaled displacements and multipliers of the stages."""

    x: Array
    lam: Array


@final
class StageSolver:
    """Newton's method for one step after another, which the recorder counts."""

    def __init__(
        self,
        problem: InitialValueProblem,
        tolerance: float,
        max_iterations: int,
        recorder: SolutionRecorder,
    ) -> None:
        system, matrices = problem.system, problem.matrices
        least = max(10 * system.traits.force_round_off, _TINY)
        rules = tolerance, max_iterations, least, _MORE, _JUMP, _MOST, _SLOW, _ROUND_OFF
        self._rules, self._recorder = np.array([0.0, *rules, _POSITIONS]), recorder
        self._kernel = Prepared(system, matrices, np.zeros(RULES), recorder.dtype)
        self._coupled = stage_matrices(problem)

    def solve(self, begin: Begin, guess: tuple[Array, Array]) -> SolvedStages | Failure:
        """Solve the equations of a step from a guess of x and of the multipliers."""
        plan, dtype = self._kernel.plan, self._kernel.dtype
        x, lam = (np.array(each, dtype=dtype) for each in guess)
        instants = np.append(begin.times, begin.t)
        joints, still = plan.joint_factors, np.ones((1, 1))
        factors = still if joints is None else joints(instants, 1)[0]
        tables = factors, plan.load_factors(instants), TABLEAU, self._rules
        self._rules[0] = begin.h
        ends, size, (iterations, factorisations, stuck) = self._kernel.model.solve_stages(
            self._coupled, begin.state, x, lam, *tables
        )
        self._recorder.residuals += 3 * iterations
        self._recorder.iterations += iterations
        self._recorder.factorisations += factorisations
        self._recorder.round_off_steps += stuck
        if ends == STAGES_SINGULAR:
            raise SingularMatrix("the matrix of the stages is singular")
        if ends == STAGES_SOLVED:
            return SolvedStages(x, lam)
        why = Verdict.NOT_FINITE if ends == STAGES_NOT_FINITE else Verdict.NO_CONVERGENCE
        return Failure(why, size)
