"""Linear passes over a computed Radau IIA run: direct differentiation and its transpose.

With x_b and lam_b of the stages, and (i) for matrices linearised at stage i,

    Q_b = q_b + h c v_b + h^2 x_b,    V_b = v_b + h A^-1 x_b
    (M A^-2 x_b + f_v V_b + f_q Q_b + Phi_q^T lam_b + f_b)(i) = 0,
    (Phi_q Q_b + Phi_b)(i) / h^2 = 0,

solved with the exact matrix of the stages, which are then completed. The backward pass uses the
same matrices, transposed, in reverse order. Velocities, accelerations and multipliers of the stages
before completion are not part of a solution; they follow from the positions. V is the completed v
less v - V, which differences of positions give: their round-off over h, far from the origin more
than the speeds at which friction sticks, then acts across the constraints only.

**Stages completed.** From positions q on the constraints and velocities V that may violate theirs,

    M (v - V) + Phi_q^T sigma = 0,   Phi_q v = nu(q),
    M a + Phi_q^T lam = Q(q, v),     Phi_q a = gamma(q, v).

With Phi' = Phi_q v - nu, Phi'' = Phi_q a - gamma, f for M a + Phi_q^T lam - Q, f_0 for M (v - V) +
Phi_q^T sigma with v - V and sigma fixed, and (Phi')_q = Phi_q', (Phi'')_v = 2 Phi_q',

    M v_b + Phi_q^T sigma_b = M V_b - f_0,q q_b - f_0,b,         Phi_q v_b = -(Phi'_q q_b + Phi'_b)
    M a_b + Phi_q^T lam_b = -(f_q q_b + f_v v_b + f_b),
    Phi_q a_b = -(Phi''_q q_b + 2 Phi'_q v_b + Phi''_b).

Stages of many steps are linearised at once here. The kernel (`stage_passes.h`) factorises and runs
the recurrence step by step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations import Linearisation, ListedSystem, MechanicalSystem
from ancfdae.equations.saddle_points import Prepared
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.integrator import OnStates, Seeds
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau.stages import (
    INVERSE,
    PLACES,
    SQUARED,
    TABLEAU,
    Stages,
    stage_matrices,
)
from ancfdae.integrators.start import Covectors, pull_back_start
from ancfdae.kernels import RULES, March, Model
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import progress_bar

# q, v, a and lam at k time points, as rows.
States: TypeAlias = tuple[Array, Array, Array, Array]
# Most numbers in the arrays of a chunk of steps.
_CHUNK_NUMBERS = 200_000


class Packet(NamedTuple):
    """Steps for the kernel: see `differentiate_stages` in `kernels.cpp`."""

    h: Array
    M: Array
    Phi_q: Array
    f_q: Array
    f_v: Array | None
    end_q: Array
    end_v: Array | None
    held_q: Array | None
    rates: tuple[Array, Array] | None
    tableau: Array


@final
class StageKernel:
    """The kernel's derivative passes over the stages of computed steps of one system."""

    def __init__(self, problem: InitialValueProblem) -> None:
        self.system, self.size = problem.system, problem.matrices.size
        rules, dtype = np.zeros(RULES), np.dtype(float)
        self._prepared = Prepared(problem.system, problem.matrices, rules, dtype)
        self._coupled = stage_matrices(problem)

    def found(self, t: Array, q: Array, V: Array, A: Array) -> tuple[Stages, tuple[Array, Array]]:
        """Return the stages at times t, and v - V and sigma, from rough accelerations A.

        Raises SingularMatrix.
        """
        plan, k, n = self._prepared.plan, len(t), self.system.n_q
        joints = plan.joint_factors(t, 2) if plan.joint_factors else np.ones((1, 1, 1))
        tables = np.ascontiguousarray(joints), np.ascontiguousarray(plan.load_factors(t))
        out = np.zeros((k, 2, self.size))
        if self._prepared.go(lambda x, at: x.find_stages(tables, (q, V, A), out, at), 0) < k:
            raise SingularMatrix("the mass matrix of a stage is singular")
        (a, lam), moved = (np.split(np.ascontiguousarray(out[:, i]), [n], 1) for i in range(2))
        return Stages(q, V, a, lam), (moved[0], moved[1])

    def forward(
        self,
        steps: Packet,
        known: tuple[Array, Array, Array],
        states: Array,
        lam_b: Array,
        x_b: Array,
    ) -> int:
        """Take steps of direct differentiation; return the number with regular matrices."""
        given = states, lam_b, x_b
        return self._prepared.go(
            lambda x, at: x.differentiate_stages(self._coupled, steps, known, *given, at), 0
        )

    def embedded_errors(
        self, h: float, t: float, state: tuple[Array, ...], rows: tuple[Array, Array, Array]
    ) -> Array:
        """Return errors dq and dv of derivatives in a step of size h, shape (2, n_b, n_q).

        The state (q, v, a, lam) at t is the middle stage. Rows are v_b at the start and the stages,
        a_b at the start, and x_b at the stages. Raises SingularMatrix.
        """
        plan, instant = self._prepared.plan, np.array([t])
        joints = np.ones(1) if plan.joint_factors is None else plan.joint_factors(instant, 1)[0, 0]
        errors, loads = np.empty((2, *rows[1].shape)), plan.load_factors(instant)[0]

        def passed(model: Model, _: int) -> tuple[int, int]:
            end = model.embedded_errors(h, state, (joints, loads), rows, errors, TABLEAU)
            return int(end == March.ALL_TAKEN), end

        if not self._prepared.go(passed, 0):
            raise SingularMatrix("the matrix of the embedded formula is singular")
        return errors

    def backward(self, steps: Packet, seeds: OnStates, on: Array, to: tuple[Array, ...]) -> None:
        """Take transposed steps back from the last; raises SingularMatrix."""
        left = self._prepared.go(
            lambda x, at: x.pull_back_stages(self._coupled, steps, seeds, on, to, at),
            len(steps.h),
        )
        if left:
            raise SingularMatrix("a matrix of the pass back is singular")


@final
@dataclass(frozen=True)
class Completion:
    """k states, completed as stages are, and linearised.

    `moved` holds v - V and sigma. `rates` are Phi'_q and Phi''_q, `held_q` is f_0,q; both are None
    where they vanish.
    """

    system: MechanicalSystem
    t: Array
    states: States
    moved: tuple[Array, Array]
    local: Linearisation
    held_q: Array | None
    rates: tuple[Array, Array] | None

    @staticmethod
    def of(
        system: MechanicalSystem, t: Array, states: States, moved: tuple[Array, Array]
    ) -> Completion:
        """Return completed states with their linearisation."""
        traits, held_q, rates = system.traits, None, None
        if not (traits.constant_mass and traits.linear_constraints):
            held_q = system.linearise(t, states[0], None, *moved).f_q
        if not traits.constant_constraints:
            q, v, a, _ = states
            rates = system.constraints_q(t, q, v), system.constraints_q(t, q, v, a)
        local = system.linearise(t, *states)
        return Completion(system, t, states, moved, local, held_q, rates)

    @cached_property
    def partials(self) -> tuple[Array, Array, Array]:
        """Return design partials of f_0 and f, (k, n_q, n_b), and of Phi' and Phi''."""
        system, t, (q, v, a, lam) = self.system, self.t, self.states
        held = system.design_partials(t, q, None, *self.moved).f_b
        sides = np.zeros((2, len(t), system.n_lam, system.n_b))
        if self.rates is not None:
            sides[:] = (
                _constraint_partials(system, t, q, v),
                _constraint_partials(system, t, q, v, a),
            )
        return held, system.design_partials(t, q, v, a, lam).f_b, sides

    def pull_back(self, m: Array, z: Array, w: Array, y: Array) -> Array:
        """Return the direct part of the gradient, (n_b,), from adjoint vectors, (k, n)."""
        system, t, (q, v, a, _) = self.system, self.t, self.states
        none = np.zeros_like(z)
        total = system.pull_back(t, (q, None, *self.moved), (m, none))
        if w.any():
            total = total + system.pull_back(t, self.states, (w, none))
        if self.rates is not None:
            total = total + np.einsum("ki,kib", z, _constraint_partials(system, t, q, v))
            some = y.any(axis=1)
            at = t[some], q[some], v[some], a[some]
            total = total + np.einsum("ki,kib", y[some], _constraint_partials(system, *at))
        return -total


def _constraint_partials(system: MechanicalSystem, t: Array, *motion: Array) -> Array:
    """Return design derivatives of a rate of Phi at k fixed states, shape (k, n_lam, n_b)."""
    if isinstance(system, ListedSystem):
        return system.constraint_partials(t, *motion)
    states = zip(t.tolist(), zip(*motion, strict=True), strict=True)
    rows = [system.constraint_total(s, state) for s, state in states]
    return np.reshape(rows, (len(t), system.n_lam, system.n_b))


@final
@dataclass(frozen=True)
class LinearStages:
    """k steps linearised at their 3 k stages, which are rows."""

    kernel: StageKernel
    stages: Stages
    completion: Completion
    steps: Packet

    @staticmethod
    def of(kernel: StageKernel, h: Array, t: Array, states: Sequence[Array]) -> LinearStages:
        """Return linearised steps from their start, stages and end, (k, 4, ...)."""
        system, size = kernel.system, h[:, None, None]
        q, v, a, lam = (np.concatenate(x[:, 1:]) for x in states)
        times, (q_0, v_0) = t[:, 1:].ravel(), (x[:, :1] for x in states[:2])
        x = (states[0][:, 1:] - q_0 - size * PLACES * v_0) / size**2
        rough = np.concatenate(v_0 + size * (INVERSE @ x)), np.concatenate(SQUARED @ x)
        stages, moved = kernel.found(times, q, *rough)
        stages = stages._replace(v=v - moved[0])
        completion = Completion.of(system, times, (q, v, a, lam), moved)
        local, end = system.linearise(times, *stages), completion.local
        held_q, rates = completion.held_q, completion.rates
        own = local.M, local.Phi_q, local.f_q, local.f_v
        steps = Packet(h, *own, end.f_q, end.f_v, held_q, rates, TABLEAU)
        return LinearStages(kernel, stages, completion, steps)

    def forward(self, states: Array, lam_b: Array) -> tuple[int, Array]:
        """Integrate q_b and v_b over the steps; return the number of steps, and x_b of all stages.

        Rows of q_b, v_b and a_b, (3 k + 1, 3, n_b, n_q), and of lam_b, (3 k + 1, n_b, n_lam), are
        written except the first ones.
        """
        completion, system = self.completion, self.kernel.system
        at_stages = system.design_partials(completion.t, *self.stages)
        held_b, f_b, sides = completion.partials
        pairs = (at_stages.f_b, at_stages.Phi_b), (held_b, sides[0]), (f_b, sides[1])
        known = np.empty((3, len(f_b), system.n_b, self.kernel.size))
        for to, (of_f, of_Phi) in zip(known, pairs, strict=True):
            to[:, :, : system.n_q], to[:, :, system.n_q :] = of_f.mT, of_Phi.mT
        x_b = np.empty((len(f_b), *states.shape[2:]))
        taken = self.kernel.forward(self.steps, (known[0], known[1], known[2]), states, lam_b, x_b)
        return taken, x_b

    def backward(self, seeds: OnStates, on: Array) -> Array:
        """Return the direct part of the gradient, (n_b,), and pull `on` back over the steps.

        The seeds are adjoint vectors of q, v and lam at stages, `on`, shape (2, n_q), those of q
        and v.
        """
        system, n = self.kernel.system, self.kernel.system.n_q
        rows = np.zeros((3, len(self.completion.t), self.kernel.size))
        self.kernel.backward(self.steps, seeds, on, (rows[0], rows[1], rows[2]))
        on_f, on_Phi = rows[:, :, :n], rows[:, :, n:]
        direct = system.pull_back(self.completion.t, self.stages, (on_f[0], on_Phi[0]))
        return self.completion.pull_back(on_f[1], on_Phi[1], on_f[2], on_Phi[2]) - direct


def differentiate(
    problem: InitialValueProblem, run: Solution, h: Array, progress: bool = False
) -> tuple[list[Array], Verdict]:
    """Run the derivative recurrence forward over steps of the sizes h.

    Return q_b, v_b, a_b, lam_b at all time points, cut to the completed steps, and how the pass
    ended.
    """
    assert problem.derivative is not None
    *motion, lam = (x.T for x in problem.derivative)
    states, lam_b = (np.zeros((len(run.t), *x.shape)) for x in (np.array(motion), lam))
    states[0], lam_b[0] = motion, lam
    done, verdict, kernel = 0, Verdict.FINISHED, StageKernel(problem)
    try:
        with progress_bar(progress, total=len(h), desc="derivatives", unit="step") as bar:
            for steps in _chunks(problem.system, len(h), problem.system.n_b):
                rows = slice(3 * steps.start, 3 * steps.stop + 1)
                taken, _ = _linearised(kernel, run, h, steps).forward(states[rows], lam_b[rows])
                done += taken
                bar.update(taken)
                if done < steps.stop:
                    verdict = Verdict.SINGULAR
                    break
    except SingularMatrix:
        verdict = Verdict.SINGULAR
    except KeyboardInterrupt:
        verdict = Verdict.INTERRUPTED
    arrays = (*states[: 3 * done + 1].transpose(1, 0, 2, 3), lam_b[: 3 * done + 1])
    return [array.transpose(0, 2, 1) for array in arrays], verdict


def pull_back(
    problem: InitialValueProblem,
    run: Solution,
    h: Array,
    seeds: Seeds,
    on: Array,
    progress: bool = False,
) -> tuple[Array, Array]:
    """Run the transposed recurrence backward over steps of the sizes h (discrete adjoint).

    `on`, shape (2, n_q), holds the adjoint vectors of q and v at the last time, from later steps.
    Returns the gradient without the part through the first state, and the adjoint vectors of q and
    v there, without the seeds of that state.
    """
    system, kernel = problem.system, StageKernel(problem)
    gradient, on = np.zeros(system.n_b), on.copy()
    chunks = _chunks(system, len(h), 0)
    for steps in progress_bar(progress, chunks[::-1], desc="adjoint", unit="chunk"):
        rows = slice(3 * steps.start + 1, 3 * steps.stop + 1)
        gradient += _linearised(kernel, run, h, steps).backward(seeds.rows(rows), on)
    return gradient, on


def through_start(problem: InitialValueProblem, on: Array, seeds: Seeds, gradient: Array) -> Array:
    """Return the gradient with the part through the first state, including its seeds."""
    none = np.zeros(problem.system.n_q), np.zeros(problem.system.n_lam)
    q, v, lam = (
        x if seed is None else x + seed[0]
        for x, seed in ((on[0], seeds.q), (on[1], seeds.v), (none[1], seeds.lam))
    )
    on_start = Covectors(q, v, none[0], lam, gradient)
    return pull_back_start(problem.system, problem.matrices, problem.initial, on_start)


def _linearised(kernel: StageKernel, run: Solution, h: Array, steps: slice) -> LinearStages:
    rows = 3 * np.arange(steps.start, steps.stop)[:, None] + np.arange(4)
    states = [x[rows] for x in (run.q, run.v, run.a, run.lam)]
    return LinearStages.of(kernel, h[steps], run.t[rows], states)


def _chunks(system: MechanicalSystem, n: int, columns: int) -> Sequence[slice]:
    """Divide n steps into chunks whose arrays stay within memory."""
    per_step = 3 * (8 * system.pattern.size + (8 + 6 * columns) * system.n_q)
    size = max(1, min(32, _CHUNK_NUMBERS // per_step))
    return [slice(k, min(k + size, n)) for k in range(0, n, size)]
