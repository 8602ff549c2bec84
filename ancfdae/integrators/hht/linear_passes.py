"""Linear passes over a computed HHT-I3 run: direct differentiation and its transpose.

Both use the discrete equations of `equations` linearised at the converged states. With c the
coefficients, one step of the derivative recurrence is

    q~_b, v~_b = predictors of q_b and v_b                                        (2), (3)
    A~_b = alpha/(1+alpha) A_b,n
    J [a_b; lam_b] = -[ M A~_b + f_b + f_q q~_b + f_v v~_b ;
                        (Phi_q q~_b + Phi_b)/(beta h^2) ]                         (22), (23)
    q_b = q~_b + beta h^2 a_b,  v_b = v~_b + gamma h a_b,  A_b = A~_b + a_b/(1+alpha)

where f = M A + Phi_q^T lam - Q with A and lam fixed. The backward pass uses the same matrices of
coefficients, transposed, and the transpose of the solution, in reverse order.

At small steps the second row has Phi_q,{n+1} dq~_b + G q_b,n + g in place of Phi_q q~_b + Phi_b
(`equations`).

Design partials of many steps are computed at once here. The kernel (`passes.h`) linearises,
factorises and runs the recurrence step by step; user-defined systems are linearised many steps at
once for it.
"""

from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.plans import Plan
from ancfdae.equations.saddle_points import Prepared
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht.equations import (
    Coefficients,
    ConstraintRow,
    Defects,
    Node,
    Nodes,
    NodeSensitivity,
    Steps,
    predict,
    small_rows,
    step_matrices,
)
from ancfdae.integrators.integrator import OnStates, Seeds
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.kernels import RULES
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.numerics.timing import progress_bar

# Most numbers in the arrays of a chunk of steps, small enough for the cache (crank-slider,
# measured: chunks of 16 to 32 steps are 1.4 times faster than 64).
_CHUNK_NUMBERS = 200_000


class Packet(NamedTuple):
    """Steps for the kernel: see `differentiate_steps` in `kernels.cpp`."""

    h: Array
    q: Array
    v: Array
    lam: Array
    of_joints: Array
    of_loads: Array
    matrices: Array
    local: tuple[Array, Array, Array | None, Array] | None
    small: tuple[Array, Array, Array] | None


@final
class CompiledPasses:
    """The kernel's passes over linearised steps of a run, for derivatives and adjoints."""

    def __init__(self, system: MechanicalSystem, matrices: SaddlePoint, alpha: float) -> None:
        rules = np.zeros(RULES)
        rules[0] = alpha
        self._system = system
        self._kernel = Prepared(system, matrices, rules, np.dtype(float))
        # Whether the kernel linearises steps; otherwise Python does, many steps at once.
        self.linearises = isinstance(self._kernel.plan, Plan)

    def packet(
        self,
        h: Array,
        t: Array,
        states: tuple[Array, Array, Array, Array],
        matrices: Array,
        small: tuple[Array, Array, Array] | None,
    ) -> Packet:
        """Return the arguments for steps of sizes h with states q, v, A and lam at their ends."""
        plan, (q, v, _, lam), local = self._kernel.plan, states, None
        of_joints = plan.joint_factors(t, 1)[0] if plan.joint_factors else np.ones((1, 1))
        if not self.linearises:
            at = self._system.linearise(t, *states)
            local = at.M, at.f_q, at.f_v, at.Phi_q
        rows = map(np.ascontiguousarray, (h, q, v, lam, of_joints, plan.load_factors(t), matrices))
        return Packet._make((*rows, local, small))

    def forward(self, steps: Packet, right: Array, z: Array, states: Array, lam_b: Array) -> int:
        """Take steps of direct differentiation; return the number of steps with regular matrix."""
        given = steps, right, z, states, lam_b
        return self._kernel.go(lambda model, at: model.differentiate_steps(*given, at), 0)

    def backward(
        self,
        steps: Packet,
        seeds: OnStates,
        on: Array,
        covectors: tuple[Array, Array, Array | None],
    ) -> None:
        """Take transposed steps back from the last, with rows of mu, zeta and defects' adjoints.

        Raises SingularMatrix.
        """
        given, count = (steps, seeds, (on, *covectors)), len(steps.h)
        if self._kernel.go(lambda model, at: model.pull_back_steps(*given, at), count):
            raise SingularMatrix("a matrix of the pass back is singular")


def differentiate(
    nodes: Nodes, start: NodeSensitivity, progress: bool = False
) -> tuple[list[Array], Verdict]:
    """Run the derivative recurrence forward from the start.

    Return q_b, v_b, A_b, lam_b, shapes (n_t, n_q, n_b) and (n_t, n_lam, n_b), cut to the completed
    steps, and how the pass ended.
    """
    system, n_t, alpha = nodes.problem.system, len(nodes.run.t), nodes.steps.alpha
    n_b, n_q = system.n_b, system.n_q
    states, lam_b = np.zeros((n_t, 3, n_b, n_q)), np.zeros((n_t, n_b, system.n_lam))
    states[0], lam_b[0] = (start.q_b.T, start.v_b.T, start.A_b.T), start.lam_b.T
    done, verdict = 1, Verdict.FINISHED
    chunks = _Chunks(nodes)
    z = np.zeros((4, n_b, n_q))  # q~_b, v~_b, A~_b, a_b of a step
    z[:3] = _predicted(nodes.steps.of(1), start)
    try:
        with progress_bar(progress, total=n_t - 1, desc="derivatives", unit="step") as bar:
            for steps in chunks.slices(2 * n_b * (n_q + system.n_lam)):
                rows, (packet, t, x) = slice(steps.start - 1, steps.stop), chunks.packet(steps)
                sizes = Coefficients(nodes.steps.h[steps.start - 1 : steps.stop - 1], alpha)
                given = _given(system, sizes.in_q, t, x)
                taken = chunks.passes.forward(packet, given, z, states[rows], lam_b[steps])
                done += taken
                bar.update(taken)
                if done < steps.stop:
                    verdict = Verdict.SINGULAR
                    break
    except KeyboardInterrupt:
        verdict = Verdict.INTERRUPTED
    arrays = (states[:done, 0], states[:done, 1], states[:done, 2], lam_b[:done])
    return [array.transpose(0, 2, 1) for array in arrays], verdict


@final
class _Chunks:
    """The steps of a run in chunks of several steps, in the form that the kernel takes.

    The matrices of the recurrence are those of `step_matrices` unless they are given.
    """

    def __init__(self, nodes: Nodes, matrices: Array | None = None) -> None:
        self._nodes, self._maybe_small = nodes, nodes.maybe_small()
        self._system, alpha = nodes.problem.system, nodes.steps.alpha
        self._matrices = step_matrices(nodes.steps) if matrices is None else matrices
        self.passes = CompiledPasses(self._system, nodes.problem.matrices, alpha)

    def slices(self, extra: int) -> Sequence[slice]:
        """Divide steps 1 to n_t - 1 into slices whose arrays stay within memory."""
        n_t, per_step = len(self._nodes.run.t), 2 * self._system.n_q + extra
        if not self.passes.linearises:
            per_step += 4 * self._system.pattern.size + 6 * self._system.n_q
        size = max(1, min(64, _CHUNK_NUMBERS // per_step))
        return [slice(k, min(k + size, n_t)) for k in range(1, n_t, size)]

    def packet(self, steps: slice) -> tuple[Packet, Array, tuple[Array, Array, Array, Array]]:
        """Return steps for the kernel, their end times, (k,), and their states there.

        The steps include derivatives of constraints over small steps.
        """
        before, nodes, run = slice(steps.start - 1, steps.stop - 1), self._nodes, self._nodes.run
        states = run.q[steps], run.v[steps], run.a[steps], run.lam[steps]
        ends = range(steps.start, steps.stop)
        rows = [nodes.row(n) if self._maybe_small[n] else None for n in ends]
        small = small_rows(rows) if any(rows) else None
        h, matrices = nodes.steps.h[before], self._matrices[before]
        packet = self.passes.packet(h, run.t[steps], states, matrices, small)
        return packet, run.t[steps], states


def _given(system: MechanicalSystem, in_q: Array, t: Array, states: tuple[Array, ...]) -> Array:
    """Return -f_b and -Phi_b/(beta h^2), the explicit design terms of k steps, (k, n_b, n).

    `in_q` is beta h^2, shape (k,).
    """
    q, v, A, lam = states
    partials = system.design_partials(t, q, v, A, lam)
    k, n_q, n_b = partials.f_b.shape
    given = np.empty((k, n_b, n_q + partials.Phi_b.shape[1]))  # each step in one piece
    np.negative(partials.f_b.transpose(0, 2, 1), out=given[:, :, :n_q])
    np.divide(partials.Phi_b.transpose(0, 2, 1), -in_q[:, None, None], out=given[:, :, n_q:])
    return given


def advance(
    problem: InitialValueProblem,
    passes: CompiledPasses,
    c: Coefficients,
    before: NodeSensitivity,
    after: Node,
    row: ConstraintRow | None,
) -> NodeSensitivity | None:
    """Return the derivatives after one step, from those before, to the computed node `after`.

    `row` is the constraint row of a small step, else None. None if the matrix there is singular.
    """
    system, h, t = problem.system, np.array([c.h]), np.array([after.t])
    states = (after.q[None], after.v[None], after.A[None], after.lam[None])
    right = _given(system, np.array([c.in_q]), t, states)
    matrices = step_matrices(Steps(h, c.alpha))
    packet = passes.packet(h, t, states, matrices, small_rows([row]) if row else None)
    rows = np.zeros((2, 3, system.n_b, system.n_q))
    rows[0] = before.q_b.T, before.v_b.T, before.A_b.T
    z, lam_b = np.zeros((4, *rows.shape[2:])), np.zeros((1, system.n_b, system.n_lam))
    z[:3] = _predicted(c, before)
    if not passes.forward(packet, right, z, rows, lam_b):
        return None
    (q_b, v_b, A_b), a_b = rows[1], z[3]
    return NodeSensitivity(q_b.T, v_b.T, a_b.T, lam_b[0].T, A_b.T)


def pull_back(
    nodes: Nodes, seeds: Seeds, defects: Defects | None = None, progress: bool = False
) -> tuple[Array, NodeSensitivity, float]:
    """Run the transposed recurrence backward (discrete adjoint).

    Return the gradient, (n_b,), without the part through the start; the adjoint vectors of the
    start, whose products with its derivatives are that part; and the change of the objective by the
    defects of all steps.
    """
    on, matrix = np.zeros((6, nodes.problem.system.n_q)), step_matrices(nodes.steps)
    gradient, on, change = pull_back_part(nodes, seeds, on, matrix, defects, progress)
    return gradient, start_covectors(nodes.steps.of(1), on), change


def pull_back_part(
    nodes: Nodes,
    seeds: Seeds,
    on: Array,
    matrix: Array,
    defects: Defects | None = None,
    progress: bool = False,
) -> tuple[Array, Array, float]:
    """Run the transposed recurrence backward over a run that is a part of another one.

    `on`, (6, n_q), holds adjoint vectors of (q_b, v_b, A_b) at its last time point and of (q~_b,
    v~_b, A~_b) of the step from there. Return the gradient, the same at its first time point, and
    the change by defects. The matrices are those of `step_matrices` for its steps. Row 0 of the
    seeds is left out.
    """
    system, chunks, on = nodes.problem.system, _Chunks(nodes, matrix), on.copy()
    gradient, change = np.zeros(system.n_b), 0.0
    for steps in progress_bar(progress, chunks.slices(0)[::-1], desc="adjoint", unit="chunk"):
        packet, t, states = chunks.packet(steps)
        mu, zeta = np.zeros_like(states[0]), np.zeros_like(states[3])
        on_defects = None if defects is None else np.zeros((len(mu), 3, system.n_q))
        chunks.passes.backward(packet, seeds.rows(steps), on, (mu, zeta, on_defects))
        if defects is not None:
            missed = np.stack([x[steps] for x in (defects.q, defects.v, defects.A)], axis=1)
            change += np.sum(on_defects * missed)
        if packet.small is not None:
            small, _, g = packet.small
            gradient -= np.einsum("km,kmb->b", zeta, g)  # g vanishes where a step is not small.
            zeta[small == 1] = 0.0  # Phi_b has had its part.
        gradient -= system.pull_back(t, states, (mu, zeta))
    return gradient, on, float(change)


def _predicted(c: Coefficients, start: NodeSensitivity) -> Array:
    """Return q~_b, v~_b, A~_b of the step after a node, shape (3, n_b, n_q)."""
    q_p, v_p = predict(c, start.q_b, start.v_b, start.a_b)
    return np.array([q_p.T, v_p.T, c.alpha / (1 + c.alpha) * start.A_b.T])


def start_covectors(c: Coefficients, on: Array) -> NodeSensitivity:
    """Return adjoint vectors of the start: of q_b and v_b, plus `_predicted`^T of `on[3:]`."""
    units = NodeSensitivity(*(x[None].T for x in np.eye(4)[[0, 1, 2, 2, 3]]))
    q, v, a, A = _predicted(c, units)[:, 0].T @ on[3:]
    return NodeSensitivity(on[0] + q, on[1] + v, a, np.zeros(0), A)
