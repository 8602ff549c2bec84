"""Newton's method for the stages of a step.

A kernel (`stages.h`) solves the same equations by the same rules for a system that is a plan of
arrays; the formulas here serve complex numbers and all other systems.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.equations import planned, reaction
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.stages import (
    Begin,
    Stages,
    factorised,
    linearised,
    residuals,
    stage_matrices,
)
from ancfdae.integrators.radau.tableau import INVERSE, PLACES, SQUARED, at_stages
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.kernels import (
    RULES,
    STAGES_NOT_FINITE,
    STAGES_SINGULAR,
    STAGES_SOLVED,
    ListPlan,
    Model,
    Plan,
    finite,
    norm,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.coupled import CoupledFactors

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
_EPS, _TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)
# An imaginary perturbation lags the real part by some iterations.
_LAG = 4
_TABLEAU = np.concatenate([x.ravel() for x in (PLACES, INVERSE, SQUARED)])


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
        self._problem, self._recorder = problem, recorder
        self._tolerance, self._most = tolerance, max_iterations
        self._weights = np.tile(problem.system.weights, 3)
        self._matrices = stage_matrices(problem)
        self._least = max(10 * problem.system.traits.force_round_off, _TINY)
        rules = tolerance, max_iterations, self._least, _MORE, _JUMP, _MOST, _SLOW, _ROUND_OFF
        self._rules = np.array([0.0, *rules, _POSITIONS])
        self._kernel = self._prepared()

    def _prepared(self) -> tuple[Plan | ListPlan, Model, Any] | None:
        """Return plan, plan as a kernel takes it, and the matrix; None where there are none."""
        system, layout = self._problem.system, self._problem.matrices.layout(band=False)
        plan = planned(system)
        coupled = self._matrices.arrays
        if plan is None or layout is None or coupled is None:
            return None
        return plan, Model(plan, layout, np.zeros(RULES)), coupled

    def solve(self, begin: Begin, guess: tuple[Array, Array]) -> SolvedStages | Failure:
        """Solve the equations of a step from a guess of x and of the multipliers."""
        if self._kernel is None or guess[0].dtype.kind == "c":
            return self._iterated(begin, guess)
        plan, model, coupled = self._kernel
        (x, lam), (q, v, a, lam_0) = (map(np.array, each) for each in (guess, begin.state))
        instants = np.append(begin.times, begin.t)
        joints, still = plan.joint_factors, np.ones((1, 1))
        factors = still if joints is None else joints(instants, 1)[0]
        tables = factors, plan.load_factors(instants), _TABLEAU, self._rules
        self._rules[0] = begin.h
        ends, size, (iterations, factorisations, stuck) = model.solve_stages(
            coupled, (q, v, a, lam_0), x, lam, *tables
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

    def _iterated(self, begin: Begin, guess: tuple[Array, Array]) -> SolvedStages | Failure:
        (x, lam), system, n_q = guess, self._problem.system, self._problem.system.n_q
        usual = self._usual(begin)
        most = _MOST * usual if usual > _TINY else math.inf
        matrix: CoupledFactors | None = None
        strained = False
        last = size = motion = math.inf
        settled, floor = 0, _POSITIONS * _EPS * norm(begin.q, system.weights) / begin.h**2
        lag = _LAG if x.dtype.kind == "c" or system.b.dtype.kind == "c" else 0
        for _ in range(self._most + lag):
            stages = begin.stages(x, lam)
            R, forces = residuals(system, begin, stages)
            self._recorder.residuals += 3
            self._recorder.iterations += 1
            if not finite(R):
                return Failure(Verdict.NOT_FINITE, size)
            now = self._motion(stages.a, *forces)
            motion = min(motion, most, now)
            fresh = matrix is None or strained
            if matrix is None or strained:
                matrix, strained = self._factorised(begin, stages), now > _JUMP * usual
            change = matrix.solve(R)
            x, lam = x - change[:, :n_q], lam - change[:, n_q:]
            correction = self._size(begin, stages, change)
            if last == math.inf and max(usual, now) < _EPS * correction:
                # Nothing acts at the start or in the guess: the correction is the motion.
                motion = usual = correction
                most = _MOST * usual
            size = correction / motion
            if not math.isfinite(size):
                break
            rate = min(size / last, 1.0) if 0 < last < math.inf else float(size > 0)
            stuck = last < math.inf and rate > _SLOW and size <= _ROUND_OFF + floor / motion
            left = size * (rate**2 if fresh else min(rate / (1.001 - rate), 1.0))
            if stuck or settled or left <= self._tolerance:
                settled += 1
                if settled == 1:
                    self._recorder.round_off_steps += stuck
                if settled > lag:
                    return SolvedStages(x, lam)
            elif last < math.inf and size * rate**_MORE > self._tolerance:
                matrix = None
            last = size
        return Failure(Verdict.NO_CONVERGENCE, size)

    def _factorised(self, begin: Begin, stages: Stages) -> CoupledFactors:
        self._recorder.factorisations += 1
        local = linearised(self._problem.system, begin.times, *stages)
        return factorised(self._matrices, begin.h, local)

    def _size(self, begin: Begin, stages: Stages, change: Array) -> float:
        """Size of a correction: of the accelerations and of the reactions, in units of force."""
        system, n_q = self._problem.system, self._problem.system.n_q
        a = at_stages(SQUARED, change[:, :n_q]).ravel()
        rows = zip(begin.times.tolist(), stages.q, change[:, n_q:], strict=True)
        force = np.concatenate([reaction(system, *row) for row in rows])
        return norm(a, self._weights, force, 1 / self._weights)

    def _usual(self, begin: Begin) -> float:
        """Size of the motion at three stages like the start."""
        system, (q, v, a, lam) = self._problem.system, begin.state
        forces = reaction(system, begin.t, q, lam), system.force(begin.t, q, v)
        return self._motion(*(np.tile(x, 3) for x in (a, *forces)))

    def _motion(self, a: Array, *forces: Array) -> float:
        """Size of accelerations, reactions and forces of all stages together."""
        sizes = (norm(x.ravel(), 1 / self._weights) for x in forces)
        return max(norm(a.ravel(), self._weights) + sum(sizes), self._least)
