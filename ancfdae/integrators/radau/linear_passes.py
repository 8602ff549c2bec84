"""Linear passes over a computed run: direct differentiation and its transpose.

With q_b and v_b before the step and x_b, lam_b of the stages, (i) for what is taken there,

    Q_b = q_b + h c v_b + h^2 x_b,    V_b = v_b + h A^-1 x_b
    (M A^-2 x_b + f_v V_b + f_q Q_b + Phi_q^T lam_b + f_b)(i) = 0
    (Phi_q Q_b + Phi_b)(i) / h^2 = 0,

solved with the exact matrix of the stages. At every stage, f at rest for M dv + Phi_q^T sigma,

    M v_b + Phi_q^T sigma_b = M V_b - f_q Q_b - f_b,                Phi_q v_b = -(Phi'_q Q_b + Phi'_b)
    M a_b + Phi_q^T lam_b   = -(f_q Q_b + f_v v_b + f_b),
    Phi_q a_b = -(Phi''_q Q_b + 2 Phi'_q v_b + Phi''_b).

The pass back reads the same matrices, transposed, in reverse order. What a solution does not keep,
velocities, accelerations and multipliers of the stages before they were completed, follows from
its positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from ancfdae.equations import DesignPartials, Linearisation, MechanicalSystem
from ancfdae.equations.saddle_points import solve, solve_transposed
from ancfdae.equations.solution import Solution
from ancfdae.errors import SingularMatrix, Verdict
from ancfdae.integrators.integrator import Seeds
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.radau.stages import Begin, ExactMatrix, StageMatrices, Stages
from ancfdae.integrators.radau.tableau import INVERSE, PLACES, at_stages
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

# Numbers held at once by a chunk of steps.
_CHUNK_NUMBERS = 200_000


@final
@dataclass(frozen=True)
class LinearSteps:
    """k steps linearised: at their stages, and where these are completed.

    Arrays have 3 k rows but h, (k,). `moved` holds dv and sigma, `held_q` is the derivative of
    M dv + Phi_q^T sigma in q, and `rates` are Phi'_q and Phi''_q; both None where they vanish.
    """

    problem: Problem
    h: Array
    t: Array
    stages: Stages
    ends: Stages
    moved: tuple[Array, Array]
    factors: list[Factorization]
    local: Linearisation
    completed: Linearisation
    held_q: Array | None
    rates: tuple[Array, Array] | None

    @staticmethod
    def of(problem: Problem, h: Array, t: Array, states: tuple[Array, ...]) -> LinearSteps:
        """Linearise steps whose start, stages and end are rows, (k, 4, ...)."""
        system, traits = problem.system, problem.system.traits
        ends = Stages(*(x[:, 1:].reshape(-1, x.shape[2]) for x in states))
        times = t[:, 1:].ravel()
        begins = [Begin(*x) for x in zip(t[:, 0].tolist(), states[0][:, 0], states[1][:, 0], h)]
        rough = [
            begin.stages(begin.displacements(q[1:]), lam[1:])
            for begin, q, lam in zip(begins, states[0], states[3], strict=True)
        ]
        V, A = (np.concatenate([getattr(x, name) for x in rough]) for name in ("v", "a"))
        found = [_before(problem, *x) for x in zip(times.tolist(), ends.q, V, A, strict=True)]
        factors = [x[0] for x in found]
        a, lam, dv, sigma = (np.array([x[k] for x in found]) for k in range(1, 5))
        stages, moved, rates, held_q = Stages(ends.q, V, a, lam), (dv, sigma), None, None
        if not (traits.constant_mass and traits.linear_constraints):
            held_q = system.linearise(times, ends.q, None, *moved).f_q
        if not traits.constant_constraints:
            motion = list(zip(times.tolist(), *ends[:3], strict=True))
            first = np.array([system.constraint_q(s, q, v) for s, q, v, _ in motion])
            rates = first, np.array([system.constraint_q(*x) for x in motion])
        local, completed = (system.linearise(times, *x) for x in (stages, ends))
        return LinearSteps(
            problem, h, times, stages, ends, moved, factors, local, completed, held_q, rates
        )

    @cached_property
    def _partials(self) -> tuple[DesignPartials, Array, Array, Array, Array]:
        """Design partials at the stages, and of M dv + Phi_q^T sigma, f, Phi' and Phi''."""
        system, t, (q, v, a, _) = self.problem.system, self.t, self.ends
        stages = system.design_partials(t, *self.stages)
        held = system.design_partials(t, q, None, *self.moved).f_b
        f_b, rates = system.design_partials(t, *self.ends).f_b, np.zeros((2, *stages.Phi_b.shape))
        if self.rates is not None:
            for k, s in enumerate(t.tolist()):
                rates[0, k] = system.constraint_total(s, (q[k], v[k]))
                rates[1, k] = system.constraint_total(s, (q[k], v[k], a[k]))
        return stages, held, f_b, *rates

    def factor(self, matrices: StageMatrices, s: int) -> ExactMatrix:
        """Factorise the exact matrix of step s."""
        at, local = slice(3 * s, 3 * s + 3), self.local
        M = local.M if len(local.M) == 1 else local.M[at]
        f_v = None if local.f_v is None else local.f_v[at]
        return matrices.factor(self.h[s], Linearisation(M, local.f_q[at], f_v, local.Phi_q[at]))

    def advance(
        self, s: int, matrices: StageMatrices, q_b: Array, v_b: Array
    ) -> tuple[list[Array], Array]:
        """Take q_b and v_b over step s; return q_b, v_b, a_b, lam_b of its stages, and x_b."""
        system, h, n = self.problem.system, self.h[s], self.problem.system.n_q
        partials, K, B = self._partials[0], system.pattern.dot, system.constraint_pattern.dot
        straight = q_b + h * PLACES[:, :, None] * v_b
        right = np.empty((3, n + system.n_lam, system.n_b))
        for i, x in enumerate(straight):
            k = 3 * s + i
            right[i, :n] = partials.f_b[k] + K(self.local.f_q[k], x)
            right[i, n:] = (partials.Phi_b[k] + B(self.local.Phi_q[k], x)) / h**2
            if self.local.f_v is not None:
                right[i, :n] += K(self.local.f_v[k], v_b)
        x_b = -self.factor(matrices, s).solve(right)[:, :n]
        q_b, v_b = straight + h**2 * x_b, v_b + h * at_stages(INVERSE, x_b)
        ends = [self._end(3 * s + i, q_b[i], v_b[i]) for i in range(3)]
        return [np.array(x) for x in zip(*ends, strict=True)], x_b

    def _end(self, k: int, q_b: Array, v_b: Array) -> tuple[Array, Array, Array, Array]:
        """Complete q_b and v_b of a stage."""
        system, local = self.problem.system, self.completed
        K, B = system.pattern.dot, system.constraint_pattern.dot
        _, held_b, f_b, side, side_a = (x[k] for x in (self.t, *self._partials[1:]))
        right = system.mass_times(self.ends.q[k], v_b) - held_b
        if self.held_q is not None:
            right = right - K(self.held_q[k], q_b)
        if self.rates is not None:
            side = side + B(self.rates[0][k], q_b)
        v_b = solve(self.factors[k], right, -side)[0]
        right = f_b + K(local.f_q[k], q_b)
        if local.f_v is not None:
            right = right + K(local.f_v[k], v_b)
        if self.rates is not None:
            side_a = side_a + B(self.rates[1][k], q_b) + 2 * B(self.rates[0][k], v_b)
        return q_b, v_b, *solve(self.factors[k], -right, -side_a)

    def back(
        self, s: int, matrices: StageMatrices, on: tuple[Array, Array, Array | None]
    ) -> tuple[Array, Array, list[Array]]:
        """Transpose of `advance`: from covectors on q, v and lam of the stages, (3, n).

        Returns those on q and v before the step, and those that `pull_back` takes to the design.
        """
        system, h, n = self.problem.system, self.h[s], self.problem.system.n_q
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        on_lam = (None,) * 3 if on[2] is None else on[2]
        ends = [self._end_back(3 * s + i, on[0][i], on[1][i], on_lam[i]) for i in range(3)]
        on_q, on_v, *covectors = (np.array(x) for x in zip(*ends, strict=True))
        on_x = h**2 * on_q + h * at_stages(INVERSE.T, on_v)
        right = np.concatenate([on_x, np.zeros((3, system.n_lam))], axis=1)
        solved = self.factor(matrices, s).solve_transposed(right)
        mu, zeta = solved[:, :n], solved[:, n:] / h**2
        for i in range(3):
            k = 3 * s + i
            on_q[i] -= K(self.local.f_q[k], mu[i]) + B(self.local.Phi_q[k], zeta[i])
            if self.local.f_v is not None:
                on_v[i] -= K(self.local.f_v[k], mu[i])
        on_v = (on_v + h * PLACES * on_q).sum(axis=0)
        return on_q.sum(axis=0), on_v, [mu, zeta, *covectors]

    def _end_back(self, k: int, on_q: Array, on_v: Array, on_lam: Array | None) -> list[Array]:
        """Transpose of `_end`."""
        system, local, factors = self.problem.system, self.completed, self.factors[k]
        K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
        still, none = np.zeros(system.n_q), np.zeros(system.n_lam)
        w, y = still, none
        if on_lam is not None:
            w, y = solve_transposed(factors, still, on_lam)
            on_q = on_q - K(local.f_q[k], w)
            if local.f_v is not None:
                on_v = on_v - K(local.f_v[k], w)
            if self.rates is not None:
                on_q = on_q - B(self.rates[1][k], y)
                on_v = on_v - 2 * B(self.rates[0][k], y)
        m, z = solve_transposed(factors, on_v, none)
        if self.held_q is not None:
            on_q = on_q - K(self.held_q[k], m)
        if self.rates is not None:
            on_q = on_q - B(self.rates[0][k], z)
        return [on_q, system.mass_times(self.ends.q[k], m), m, z, w, y]

    def pull_back(self, covectors: list[Array]) -> Array:
        """Return what goes to the design directly, (n_b,); covectors of `back` for all steps."""
        system, t, (q, v, a, _) = self.problem.system, self.t, self.ends
        mu, zeta, m, z, w, y = covectors
        none = np.zeros_like(z)
        total = system.pull_back(t, self.stages, (mu, zeta))
        total = total + system.pull_back(t, (q, None, *self.moved), (m, none))
        if w.any():
            total = total + system.pull_back(t, self.ends, (w, none))
        if self.rates is not None:
            for k, s in enumerate(t.tolist()):
                total = total + z[k] @ system.constraint_total(s, (q[k], v[k]))
                if y.any():
                    total = total + y[k] @ system.constraint_total(s, (q[k], v[k], a[k]))
        return -total


def _before(problem: Problem, t: float, q: Array, v: Array, a: Array) -> tuple[Any, ...]:
    """Return the matrix at q, and what the equations of the stage and its completion found there.

    Accelerations and multipliers of the stage, dv and sigma, from rough accelerations.
    """
    system, factors = problem.system, problem.accelerations.factors(t, q)
    side = system.constraint_pattern.dot(system.constraint_q(t, q), a)
    stage = solve(factors, system.force(t, q, v), side)
    return factors, *stage, *solve(factors, np.zeros_like(v), -system.constraint(t, q, v))


def differentiate(
    problem: Problem, run: Solution, h: Array, progress: bool = False
) -> tuple[list[Array], Verdict]:
    """Run the derivative recurrence forward over steps of the sizes h.

    Returns q_b, v_b, a_b and lam_b of all instants, cut to the steps done, and how the pass ended.
    """
    from tqdm import tqdm

    assert problem.derivative is not None
    first, matrices = problem.derivative, StageMatrices(problem)
    arrays = [np.empty((len(run.t), *x.shape)) for x in first]
    for array, x in zip(arrays, first, strict=True):
        array[0] = x
    done, verdict = 1, Verdict.FINISHED
    try:
        with tqdm(total=len(h), desc="derivatives", disable=not progress, unit="step") as bar:
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
    problem: Problem, run: Solution, h: Array, seeds: Seeds, on: Array, progress: bool = False
) -> tuple[Array, Array]:
    """Run the transposed recurrence back over steps of the sizes h (discrete adjoint).

    `on`, (2, n_q), holds covectors on q and v at the last instant, from what follows. Returns the
    gradient but for what goes through the first instant, and covectors on q and v there, where
    seeds are left out.
    """
    from tqdm import tqdm

    system, matrices = problem.system, StageMatrices(problem)
    gradient, still = np.zeros(system.n_b), np.zeros((3, system.n_q))
    chunks = _chunks(system, len(h), 0)
    for steps in tqdm(chunks[::-1], "adjoint", disable=not progress, unit="chunk"):
        linear, covectors = _linearised(problem, run, h, steps), list[list[Array]]()
        for s in range(len(linear.h) - 1, -1, -1):
            n = 3 * (steps.start + s) + 1
            q, v, lam = (None if x is None else x[n : n + 3] for x in (seeds.q, seeds.v, seeds.lam))
            on_q, on_v = (still.copy() if x is None else x.copy() for x in (q, v))
            on_q[2] += on[0]
            on_v[2] += on[1]
            *before, own = linear.back(s, matrices, (on_q, on_v, lam))
            on = np.array(before)
            covectors.insert(0, own)
        gradient += linear.pull_back([np.concatenate(x) for x in zip(*covectors, strict=True)])
    return gradient, on


def _linearised(problem: Problem, run: Solution, h: Array, steps: slice) -> LinearSteps:
    """Linearise some steps of a run."""
    rows = 3 * np.arange(steps.start, steps.stop)[:, None] + np.arange(4)
    return LinearSteps.of(
        problem, h[steps], run.t[rows], tuple(x[rows] for x in (run.q, run.v, run.a, run.lam))
    )


def _chunks(system: MechanicalSystem, n: int, columns: int) -> Sequence[slice]:
    """Divide n steps so that what is held at once stays within memory."""
    per_step = 3 * (8 * system.pattern.size + (8 + 3 * columns) * system.n_q)
    size = max(1, min(32, _CHUNK_NUMBERS // per_step))
    return [slice(k, min(k + size, n)) for k in range(0, n, size)]
