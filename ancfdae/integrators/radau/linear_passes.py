"""Linear passes over a computed run: direct differentiation and its transpose.

With x_b and lam_b of the stages, and (i) for matrices linearised at stage i,

    Q_b = q_b + h c v_b + h^2 x_b,    V_b = v_b + h A^-1 x_b
    (M A^-2 x_b + f_v V_b + f_q Q_b + Phi_q^T lam_b + f_b)(i) = 0,
    (Phi_q Q_b + Phi_b)(i) / h^2 = 0,

solved with the exact matrix of the stages, which are then completed (`Completion`). The pass back
reads the same matrices, transposed, in reverse order. What a solution does not keep of the stages,
velocities, accelerations and multipliers before they were completed, follows from the positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from ancfdae.equations import DesignPartials, Linearisation, MechanicalSystem
from ancfdae.equations.saddle_points import solve
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.completion import Completion
from ancfdae.integrators.integrator import Seeds
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.stages import Begin, Stages, factorised, stage_matrices
from ancfdae.integrators.radau.tableau import INVERSE, PLACES, at_stages
from ancfdae.integrators.start import Covectors, pull_back_start
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.coupled import CoupledFactors, CoupledSaddlePoints
from ancfdae.numerics.progress import progress_bar

# Numbers held at once by a chunk of steps.
_CHUNK_NUMBERS = 200_000


@final
@dataclass(frozen=True)
class LinearStages:
    """k steps of sizes h, (k,), linearised at their stages, which are rows, 3 k."""

    system: MechanicalSystem
    h: Array
    stages: Stages
    local: Linearisation
    completion: Completion

    @staticmethod
    def of(
        problem: InitialValueProblem, h: Array, t: Array, states: Sequence[Array]
    ) -> LinearStages:
        """Linearise steps of which start, stages and end are given, (k, 4, ...)."""
        q, v, a, lam = (np.concatenate(x[:, 1:]) for x in states)
        rough, times = list[Stages](), t[:, 1:].ravel()
        for s, size in enumerate(h):
            begin = Begin(float(size), float(t[s, 0]), *(x[s, 0] for x in states))
            x = begin.displacements(states[0][s, 1:])
            rough.append(begin.stages(x, states[3][s, 1:]))
        V, A = (np.concatenate(x) for x in zip(*((x.v, x.a) for x in rough), strict=True))
        factored = [_before(problem, *x) for x in zip(times.tolist(), q, V, A, strict=True)]
        factors, *columns = zip(*factored, strict=True)
        stage_a, stage_lam, dv, sigma = map(np.array, columns)
        stages = Stages(q, V, stage_a, stage_lam)
        completion = Completion.of(problem.system, factors, times, (q, v, a, lam), (dv, sigma))
        local = problem.system.linearise(times, *stages)
        return LinearStages(problem.system, h, stages, local, completion)

    @cached_property
    def _partials(self) -> DesignPartials:
        return self.system.design_partials(self.completion.t, *self.stages)

    def _factor(self, matrices: CoupledSaddlePoints, s: int) -> CoupledFactors:
        at, local = slice(3 * s, 3 * s + 3), self.local
        M = local.M if len(local.M) == 1 else local.M[at]
        f_v = None if local.f_v is None else local.f_v[at]
        jacobians = Linearisation(M, local.f_q[at], f_v, local.Phi_q[at])
        return factorised(matrices, float(self.h[s]), jacobians)

    def advance(
        self, s: int, matrices: CoupledSaddlePoints, q_b: Array, v_b: Array
    ) -> tuple[list[Array], Array]:
        """Take q_b and v_b over step s; return q_b, v_b, a_b, lam_b of its stages, and x_b."""
        system, h, n, local = self.system, self.h[s], self.system.n_q, self.local
        K, B = system.pattern.dot, system.constraint_pattern.dot
        straight = q_b + h * PLACES[:, :, None] * v_b
        right = np.empty((3, n + system.n_lam, system.n_b))
        for i, x in enumerate(straight):
            k = 3 * s + i
            right[i, :n] = self._partials.f_b[k] + K(local.f_q[k], x)
            right[i, n:] = (self._partials.Phi_b[k] + B(local.Phi_q[k], x)) / h**2
            if local.f_v is not None:
                right[i, :n] += K(local.f_v[k], v_b)
        x_b = -self._factor(matrices, s).solve(right)[:, :n]
        Q_b, V_b = straight + h**2 * x_b, v_b + h * at_stages(INVERSE, x_b)
        ends = [self.completion.total(3 * s + i, Q_b[i], V_b[i]) for i in range(3)]
        return [Q_b, *map(np.array, zip(*ends, strict=True))], x_b

    def back(
        self, s: int, matrices: CoupledSaddlePoints, on: tuple[Array, Array, Array | None]
    ) -> tuple[Array, list[Array]]:
        """Transpose of `advance`: from covectors on q, v and lam of the stages, (3, n).

        Returns those on q and v before the step, and those that `pull_back` takes to the design.
        """
        system, h, n, local = self.system, self.h[s], self.system.n_q, self.local
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        ends = []
        for i in range(3):
            on_lam = None if on[2] is None else on[2][i]
            ends.append(self.completion.back(3 * s + i, on[0][i], on[1][i], None, on_lam))
        on_q, on_v, *covectors = (np.array(x) for x in zip(*ends, strict=True))
        on_x = h**2 * on_q + h * at_stages(INVERSE.T, on_v)
        right = np.concatenate([on_x, np.zeros((3, system.n_lam))], axis=1)
        solved = self._factor(matrices, s).solve_transposed(right)
        mu, zeta = solved[:, :n], solved[:, n:] / h**2
        for i in range(3):
            k = 3 * s + i
            on_q[i] -= K(local.f_q[k], mu[i]) + B(local.Phi_q[k], zeta[i])
            if local.f_v is not None:
                on_v[i] -= K(local.f_v[k], mu[i])
        on_v += h * PLACES * on_q
        return np.array([on_q.sum(axis=0), on_v.sum(axis=0)]), [mu, zeta, *covectors]

    def pull_back(self, mu: Array, zeta: Array, *covectors: Array) -> Array:
        """Return the direct part of the gradient from the adjoint vectors of all steps, (n_b,)."""
        direct = self.system.pull_back(self.completion.t, self.stages, (mu, zeta))
        return self.completion.pull_back(*covectors) - direct


def _before(
    problem: InitialValueProblem, t: float, q: Array, v: Array, a: Array
) -> tuple[Any, ...]:
    """Return the matrix at q, and a, lam, v - V and sigma of a stage from rough accelerations."""
    system, factors = problem.system, problem.accelerations.factors(t, q)
    side = system.constraint_pattern.dot(system.constraint_q(t, q), a)
    stage = solve(factors, system.force(t, q, v), side)
    return factors, *stage, *solve(factors, np.zeros_like(v), -system.constraint(t, q, v))


def differentiate(
    problem: InitialValueProblem, run: Solution, h: Array, progress: bool = False
) -> tuple[list[Array], Verdict]:
    """Run the derivative recurrence forward over steps of the sizes h.

    Returns q_b, v_b, a_b and lam_b of all instants, cut to the steps done, and how the pass ended.
    """
    assert problem.derivative is not None
    matrices, arrays = stage_matrices(problem), list[Array]()
    for x in problem.derivative:
        arrays.append(np.concatenate([x[None], np.empty((len(run.t) - 1, *x.shape))]))
    done, verdict = 1, Verdict.FINISHED
    try:
        with progress_bar(progress, total=len(h), desc="derivatives", unit="step") as bar:
            for steps in _chunks(problem.system, len(h), problem.system.n_b):
                linear = _linearised(problem, run, h, steps)
                for s in range(len(linear.h)):
                    q_b, v_b = arrays[0][done - 1], arrays[1][done - 1]
                    rows, _ = linear.advance(s, matrices, q_b, v_b)
                    for array, x in zip(arrays, rows, strict=True):
                        array[done : done + 3] = x
                    done += 3
                    bar.update()
    except SingularMatrix:
        verdict = Verdict.SINGULAR
    except KeyboardInterrupt:
        verdict = Verdict.INTERRUPTED
    return [array[:done] for array in arrays], verdict


def pull_back(
    problem: InitialValueProblem,
    run: Solution,
    h: Array,
    seeds: Seeds,
    on: Array,
    progress: bool = False,
) -> tuple[Array, Array]:
    """Run the transposed recurrence back over steps of the sizes h (discrete adjoint).

    `on`, shape (2, n_q), holds the adjoint vectors of q and v at the last time, from later steps.
    Returns the gradient without the part through the first state, and the adjoint vectors of q and
    v there, without the seeds of that state.
    """
    system, matrices = problem.system, stage_matrices(problem)
    gradient, still = np.zeros(system.n_b), np.zeros((len(run.t), system.n_q))
    on_q, on_v = (still if x is None else x for x in (seeds.q, seeds.v))
    chunks = _chunks(system, len(h), 0)
    for steps in progress_bar(progress, chunks[::-1], desc="adjoint", unit="chunk"):
        linear, covectors = _linearised(problem, run, h, steps), list[list[Array]]()
        for s in range(len(linear.h) - 1, -1, -1):
            n = 3 * (steps.start + s) + 1
            at = slice(n, n + 3)
            on_states = np.array([on_q[at], on_v[at]])
            on_states[:, 2] += on
            lam = None if seeds.lam is None else seeds.lam[at]
            on, covector = linear.back(s, matrices, (on_states[0], on_states[1], lam))
            covectors.insert(0, covector)
        gradient += linear.pull_back(*map(np.concatenate, zip(*covectors, strict=True)))
    return gradient, on


def through_start(problem: InitialValueProblem, on: Array, seeds: Seeds, gradient: Array) -> Array:
    """Add to a gradient what goes through the first instant, with its seeds."""
    none = np.zeros(problem.system.n_q), np.zeros(problem.system.n_lam)
    q, v, lam = (
        x if seed is None else x + seed[0]
        for x, seed in ((on[0], seeds.q), (on[1], seeds.v), (none[1], seeds.lam))
    )
    on_start = Covectors(q, v, none[0], lam, gradient)
    return pull_back_start(problem.system, problem.matrices, problem.initial, on_start)


def _linearised(
    problem: InitialValueProblem, run: Solution, h: Array, steps: slice
) -> LinearStages:
    rows = 3 * np.arange(steps.start, steps.stop)[:, None] + np.arange(4)
    states = [x[rows] for x in (run.q, run.v, run.a, run.lam)]
    return LinearStages.of(problem, h[steps], run.t[rows], states)


def _chunks(system: MechanicalSystem, n: int, columns: int) -> Sequence[slice]:
    """Divide n steps so that what is held at once stays within memory."""
    per_step = 3 * (8 * system.pattern.size + (8 + 3 * columns) * system.n_q)
    size = max(1, min(32, _CHUNK_NUMBERS // per_step))
    return [slice(k, min(k + size, n)) for k in range(0, n, size)]
