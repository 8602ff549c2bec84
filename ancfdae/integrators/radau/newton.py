"""Newton's method for the stages of a step: simplified, and exact where that does not converge."""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import Linearisation, reaction
from ancfdae.errors import Verdict
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.radau.stages import (
    Begin,
    SimplifiedMatrix,
    Stages,
    exact,
    residuals,
    stage_matrices,
)
from ancfdae.integrators.radau.tableau import SQUARED, at_stages
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.kernels import finite, norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.coupled import CoupledFactors, CoupledSaddlePoints

# Where more than so many iterations are to come the exact matrix takes over, or is formed anew.
_MORE = 4
# Forces that are so many times those before are those of strains that the guess has wrong: only the
# exact matrix brings them down.
_JUMP = 10.0
# Corrections are measured against so many times the forces before at most: a diverging iterate has
# huge ones.
_MOST = 100.0
# Corrections stop shrinking where they shrink by less than this factor.
_SLOW = 0.5
# Corrections that stop shrinking are round-off if they are this small against the motion, or that
# many times the round-off of positions.
_ROUND_OFF, _POSITIONS = 1e-6, 1e4
_EPS, _TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)
# An imaginary perturbation lags the real part by some iterations.
_LAG = 4


class SolvedStages(NamedTuple):
    """Scaled displacements and multipliers of the stages, and the matrix they were found with."""

    x: Array
    lam: Array
    matrix: SimplifiedMatrix


@final
class StageSolver:
    """Newton's method for one step after another, which the recorder counts."""

    def __init__(
        self, problem: Problem, tolerance: float, max_iterations: int, recorder: Recorder
    ) -> None:
        self._problem, self._recorder = problem, recorder
        self._tolerance, self._most = tolerance, max_iterations
        system = problem.system
        self._weights = np.tile(system.weights, 3)
        self._matrices: CoupledSaddlePoints | None = None
        self._least = max(10 * system.traits.force_round_off, _TINY)

    def solve(
        self, begin: Begin, guess: tuple[Array, Array], usual: float
    ) -> SolvedStages | Failure:
        """Solve the equations of a step from a guess of x and of the multipliers.

        `usual` is the size of the motion before.
        """
        most = _MOST * usual if usual > _TINY else math.inf
        (x, lam), system, n_q = guess, self._problem.system, self._problem.system.n_q
        matrix: SimplifiedMatrix | CoupledFactors | None = None
        simplified = None
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
            if simplified is None:
                simplified = self._simplified(begin, stages)
                matrix = simplified
            if matrix is None or now > _JUMP * usual:
                matrix = self._exact(begin, stages)
            change = matrix.solve(R)
            x, lam = x - change[:, :n_q], lam - change[:, n_q:]
            size = self._size(simplified, change) / motion
            if not math.isfinite(size):
                break
            rate = min(size / last, 1.0) if last < math.inf else float(size > 0)
            stuck = last < math.inf and rate > _SLOW and size <= _ROUND_OFF + floor / motion
            if stuck or settled or size * min(rate / (1.001 - rate), 1.0) <= self._tolerance:
                settled += 1
                if settled == 1:
                    self._recorder.round_off_steps += stuck
                if settled > lag:
                    return SolvedStages(x, lam, simplified)
            elif last < math.inf and size * rate**_MORE > self._tolerance:
                matrix, size = None, math.inf
            last = size
        return Failure(Verdict.NO_CONVERGENCE, size)

    def _simplified(self, begin: Begin, stages: Stages) -> SimplifiedMatrix:
        """Factorise at the middle one of the stages."""
        self._recorder.factorisations += 2
        return SimplifiedMatrix(
            self._problem, begin.h, self._linearised(begin, stages, slice(1, 2))
        )

    def _exact(self, begin: Begin, stages: Stages) -> CoupledFactors:
        """Factorise at every stage."""
        if self._matrices is None:
            self._matrices = stage_matrices(self._problem)
        self._recorder.factorisations += 1
        return exact(self._matrices, begin.h, self._linearised(begin, stages, slice(3)))

    def _linearised(self, begin: Begin, stages: Stages, rows: slice) -> Linearisation:
        """Linearise at some stages; an imaginary perturbation is left out."""
        states = (np.real(x[rows]) for x in stages)
        local = self._problem.system.linearise(begin.times[rows], *states)
        f_v = None if local.f_v is None else local.f_v.real
        return Linearisation(local.M.real, local.f_q.real, f_v, local.Phi_q.real)

    def _size(self, matrix: SimplifiedMatrix, change: Array) -> float:
        """Size of a correction: of the accelerations and of the reactions, in units of force."""
        system, n_q = self._problem.system, self._problem.system.n_q
        a = at_stages(SQUARED, change[:, :n_q]).ravel()
        Phi_q, dlam = matrix.local.Phi_q[0], change[:, n_q:]
        force = system.constraint_pattern.dot_transposed(Phi_q, dlam.T).T.ravel()
        return norm(a, self._weights, force, 1 / self._weights)

    def usual(self, t: float, q: Array, v: Array, a: Array, lam: Array) -> float:
        """Size of the motion at three stages like this state."""
        system = self._problem.system
        state = a, reaction(system, t, q, lam), system.force(t, q, v)
        return self._motion(*(np.tile(x, 3) for x in state))

    def _motion(self, a: Array, *forces: Array) -> float:
        """Size of accelerations, reactions and forces of all stages together."""
        sizes = (norm(x.ravel(), 1 / self._weights) for x in forces)
        return max(norm(a.ravel(), self._weights) + sum(sizes), self._least)
