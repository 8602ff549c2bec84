"""Linear passes over a computed HHT-I3 run: direct differentiation and its transpose.

Both read the discrete equations of `equations` linearised at the converged
states. With c the coefficients, one step of the derivative recurrence is

    q~_b, v~_b = predictors of q_b and v_b                                        (2), (3)
    A~_b = alpha/(1+alpha) A_b,n
    J [a_b; lam_b] = -[ M A~_b + f_b + f_q q~_b + f_v v~_b ;
                        (Phi_q q~_b + Phi_b)/(beta h^2) ]                         (22), (23)
    q_b = q~_b + beta h^2 a_b,  v_b = v~_b + gamma h a_b,  A_b = A~_b + a_b/(1+alpha)

where f = M A + Phi_q^T lam - Q with A and lam held. The pass back reads the same matrices of
coefficients, transposed, and the transpose of the solution, in reverse order.

At small steps the second row takes Phi_q,{n+1} dq~_b + G q_b,n + g for Phi_q q~_b + Phi_b
(`small_steps`).

Design partials of many steps are formed at once. Kernels linearise, factorise and run the
recurrence step by step (`compiled`); what they do not take is linearised many steps at once here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias, final

import numpy as np

from ancfdae.equations import Linearisation, MechanicalSystem
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht.compiled import CompiledPasses, Packet
from ancfdae.integrators.hht.equations import (
    Coefficients,
    Defects,
    Node,
    NodeSensitivity,
    Steps,
    increment_from_velocities,
    iteration_terms,
    predict,
    step_matrices,
)
from ancfdae.integrators.hht.small_steps import ConstraintRow, Nodes
from ancfdae.integrators.integrator import Seeds
from ancfdae.kernels import recombine
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.progress import progress_bar

# Numbers held at once by a chunk of steps: small enough for the cache (crank-slider, measured:
# chunks of 16 to 32 steps are 1.4 times faster than 64).
_CHUNK_NUMBERS = 200_000
# q, v, A and lam, instants as rows.
States: TypeAlias = tuple[Array, Array, Array, Array]


@final
@dataclass(frozen=True)
class LinearSteps:
    """A chunk of k steps with their converged states (q, v, A, lam); h has the shape (k, 1).

    One step takes z = (q~_b, v~_b, A~_b) to a_b and lam_b (`solve`); a matrix of coefficients takes
    (z, a_b) to (q_b, v_b, A_b) and the next z (`step_matrices`). The backward pass applies the
    transposes of these two maps.
    """

    system: MechanicalSystem
    c: Coefficients
    t: Array
    states: States

    @cached_property
    def local(self) -> Linearisation:
        """f_q, f_v and Phi_q of the steps of the chunk, at their states."""
        return self.system.linearise(self.t, *self.states)

    @cached_property
    def constraints_q(self) -> Array:
        """Phi_q / (beta h^2) of the steps of the chunk, values on the pattern."""
        return np.asarray(self.local.Phi_q / (self.c.beta * self.c.h**2))

    def packet(self, compiled: CompiledPasses, part: slice, matrices: Array) -> Packet:
        """Return the kernel's data for a part of the steps."""
        q, v, _, lam = (x[part] for x in self.states)
        h = np.array(self.c.h[part, 0])
        return compiled.packet(h, self.t[part], (q, v, lam), matrices)

    def factorised(self, matrices: SaddlePoint, order: range) -> Iterator[Factorization]:
        """Factorise eq. (6) step by step, forward or backward."""
        c = Coefficients(0.0, self.c.alpha)
        for k in order:
            h = float(self.c.h[k, 0])
            c = c if c.h == h else Coefficients(h, c.alpha)
            yield matrices.factor_sum(iteration_terms(c, self.local, k), self.local.Phi_q[k])

    def given(self) -> Array:
        """Return the part of the right sides that is known before the pass, (k, n_b, n)."""
        partials = self.system.design_partials(self.t, *self.states)
        k, n_q, n_b = partials.f_b.shape
        given = np.empty((k, n_b, n_q + partials.Phi_b.shape[1]))  # each step in one piece
        np.negative(partials.f_b.transpose(0, 2, 1), out=given[:, :, :n_q])
        scale = -self.c.beta * self.c.h[:, None] ** 2
        np.divide(partials.Phi_b.transpose(0, 2, 1), scale, out=given[:, :, n_q:])
        return given

    def solve(
        self,
        k: int,
        jacobian: Factorization,
        right: Array,
        z: Array,
        side: Array | None,
    ) -> tuple[Array, Array]:
        """Return a_b and lam_b of step k, design variables as rows; `right` is overwritten.

        The side is that of the constraints over a small step.
        """
        system, n_q = self.system, self.system.n_q
        system.pattern.subtract_dot(self.local.f_q[k], z[0], right)
        system.constraint_pattern.subtract_dot(self.constraints_q[k], z[0], right, n_q)
        right[:, :n_q] -= system.mass_times(self.states[0][k], z[2].T).T
        if self.local.f_v is not None:
            system.pattern.subtract_dot(self.local.f_v[k], z[1], right)
        if side is not None:
            right[:, n_q:] = side
        x = jacobian.solve(right.T).T
        return x[:, :n_q], x[:, n_q:]

    def solve_transposed(
        self, k: int, jacobian: Factorization, on: Array, on_lam: Array, small: bool
    ) -> tuple[Array, Array]:
        """Transpose of `solve`: from covectors on (q~, v~, A~, a) and lam to those on (q~, v~, A~).

        They are left in the first rows of `on`. Returns mu and zeta, which
        `MechanicalSystem.pull_back` takes to the design. What the constraints add to q~ is left
        out where the step is small: they then have their side.
        """
        system, local, n_q = self.system, self.local, self.system.n_q
        solved = jacobian.solve_transposed(np.concatenate([on[3], on_lam]))
        mu, zeta = solved[:n_q], solved[n_q:]
        system.pattern.subtract_dot(local.f_q[k], mu, on[0], transposed=True)
        if not small:
            pattern, values = system.constraint_pattern, self.constraints_q[k]
            pattern.subtract_dot(values, zeta, on[0], transposed=True)
        if local.f_v is not None:
            system.pattern.subtract_dot(local.f_v[k], mu, on[1], transposed=True)
        on[2] -= system.mass_times(self.states[0][k], mu)
        return mu, zeta / (self.c.beta * float(self.c.h[k, 0]) ** 2)


def differentiate(
    nodes: Nodes, start: NodeSensitivity, progress: bool = False
) -> tuple[list[Array], Verdict]:
    """Run the derivative recurrence forward from the start.

    Returns q_b, v_b, A_b, lam_b, shapes (n_t, n_q, n_b) and (n_t, n_lam, n_b), cut to the steps
    done, and how the pass ended.
    """
    system, n_t = nodes.problem.system, len(nodes.run.t)
    n_b, n_q = system.n_b, system.n_q
    states, lam_b = np.zeros((n_t, 3, n_b, n_q)), np.zeros((n_t, n_b, system.n_lam))
    states[0], lam_b[0] = (start.q_b.T, start.v_b.T, start.A_b.T), start.lam_b.T
    done, verdict = 1, Verdict.FINISHED
    try:
        steps = _advance(nodes, start, states, lam_b)
        with progress_bar(progress, total=n_t - 1, desc="derivatives", unit="step") as bar:
            for taken in steps:
                done += taken
                bar.update(taken)
    except SingularMatrix:
        verdict = Verdict.SINGULAR
    except KeyboardInterrupt:
        verdict = Verdict.INTERRUPTED
    arrays = (states[:done, 0], states[:done, 1], states[:done, 2], lam_b[:done])
    return [array.transpose(0, 2, 1) for array in arrays], verdict


def _advance(nodes: Nodes, start: NodeSensitivity, states: Array, lam_b: Array) -> Iterator[int]:
    """Fill the rows of the arrays and yield how many were filled at once.

    States are q_b, v_b, A_b with design variables as rows, (n_t, 3, n_b, n_q), and so is lam_b:
    right-hand sides then stand in memory as LAPACK wants them.
    """
    n_t, _, n_b, n_q = states.shape
    system, all_steps, maybe_small = nodes.problem.system, nodes.steps, nodes.maybe_small()
    matrices = nodes.problem.matrices
    compiled = CompiledPasses.of(system, matrices, all_steps.alpha)
    z = np.zeros((4, n_b, n_q))  # q~_b, v~_b, A~_b, a_b of a step
    z[:3] = _predicted(all_steps.of(1), start)
    matrix = step_matrices(all_steps)
    known = 2 * n_b * (n_q + system.n_lam)
    for steps in _chunks(system, n_t, known, linearised=not compiled or bool(maybe_small.any())):
        linear = _computed(nodes, steps)
        given, k = linear.given(), 0
        while k < len(given):
            n = steps.start + k
            part = slice(k, k + _until(maybe_small[n : steps.stop]))
            if compiled and part.stop > k:
                at = slice(n, steps.start + part.stop)
                packet = linear.packet(compiled, part, matrix[n - 1 : at.stop - 1])
                taken = compiled.forward(packet, given[part], z, states[at], lam_b[at])
                k += taken
                yield taken
                if k == part.stop:
                    continue
                n = steps.start + k
            (jacobian,) = linear.factorised(matrices, range(k, k + 1))
            row = nodes.row(n) if maybe_small[n] else None
            side = None
            if row is not None:
                Phi_q, before = linear.local.Phi_q[k], states[n - 1]
                side = _small_side(system, all_steps.of(n), Phi_q, row, before, z[1])
            z[3], lam_b[n] = linear.solve(k, jacobian, given[k], z, side)
            recombine(matrix[n - 1], z, states[n], z[:3])
            k += 1
            yield 1


def _until(small: Array) -> int:
    """Return the number of steps before the first small one."""
    return int(np.argmax(small)) if np.any(small) else len(small)


def advance(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    before: NodeSensitivity,
    after: Node,
    row: ConstraintRow | None,
) -> NodeSensitivity:
    """Take one step of the derivative recurrence to a computed node; the row is of a small step."""
    t = np.array([after.t])
    states = (after.q[None], after.v[None], after.A[None], after.lam[None])
    columns = Coefficients(np.array([[c.h]]), c.alpha)
    linear, z = LinearSteps(system, columns, t, states), _predicted(c, before)
    (right,) = linear.given()
    side = None
    if row is not None:
        known = np.array([before.q_b.T, before.v_b.T])
        side = _small_side(system, c, linear.local.Phi_q[0], row, known, z[1])
    (jacobian,) = linear.factorised(matrices, range(1))
    a_b, lam_b = linear.solve(0, jacobian, right, z, side)
    one = step_matrices(Steps(np.array([c.h]), c.alpha))[0, :3]
    q_b, v_b, A_b = np.tensordot(one, np.array([*z, a_b]), axes=1)
    return NodeSensitivity(q_b.T, v_b.T, a_b.T, lam_b.T, A_b.T)


def pull_back(
    nodes: Nodes, seeds: Seeds, defects: Defects | None = None, progress: bool = False
) -> tuple[Array, NodeSensitivity, float]:
    """Run the transposed recurrence backward (discrete adjoint).

    Returns the gradient, (n_b,), but what goes through the start; covectors on the start, whose
    products with its derivatives are that; and what the defects of all steps change in the
    objective.
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
    """Run the transposed recurrence back over a run that is a part of another.

    `on`, (6, n_q), holds covectors on (q_b, v_b, A_b) of its last instant and on (q~_b, v~_b, A~_b)
    of the step from there; those of its first instant are returned. The matrices are those of
    `step_matrices` for its steps. Row 0 of the seeds is left out.
    """
    system, all_steps, maybe_small = nodes.problem.system, nodes.steps, nodes.maybe_small()
    n_t, n_q = len(nodes.run.t), system.n_q
    gradient, change = np.zeros(system.n_b), 0.0
    still, nothing = np.zeros((3, n_q)), np.zeros(system.n_lam)
    compiled = CompiledPasses.of(system, nodes.problem.matrices, all_steps.alpha)
    compiled, on = None if defects else compiled, on.copy()
    chunks = _chunks(system, n_t, 0, linearised=not compiled or bool(maybe_small.any()))
    for steps in progress_bar(progress, chunks[::-1], desc="adjoint", unit="chunk"):
        linear = _computed(nodes, steps)
        mu, zeta, k = *(np.zeros_like(linear.states[j]) for j in (0, 3)), len(linear.t)
        while k > 0:
            first = k - _until(maybe_small[steps.start : steps.start + k][::-1])
            if compiled and first < k:
                part, at = slice(first, k), slice(steps.start + first, steps.start + k)
                packet = linear.packet(compiled, part, matrix[at.start - 1 : at.stop - 1])
                k -= compiled.backward(packet, seeds.rows(at), on, mu[part], zeta[part])
                if k == first:
                    continue
            k -= 1
            n = steps.start + k
            (jacobian,) = linear.factorised(nodes.problem.matrices, range(k, k + 1))
            on = _with_seeds(on, seeds, n)
            on_lam = nothing if seeds.lam is None else seeds.lam[n]
            row = nodes.row(n) if maybe_small[n] else None
            on_step = matrix[n - 1].T @ on
            mu[k], zeta[k] = linear.solve_transposed(k, jacobian, on_step, on_lam, row is not None)
            on = np.concatenate([still, on_step[:3]])
            if defects is not None:
                change += on[3] @ defects.q[n] + on[4] @ defects.v[n] + on[5] @ defects.A[n]
            if row is not None:
                on_dq = _small_side_back(nodes, n, linear.local.Phi_q[k], row, zeta[k], on)
                gradient -= zeta[k] @ row.g
                zeta[k] = 0.0  # Phi_b has had its part.
                change += 0.0 if defects is None else on_dq @ defects.q[n]
        gradient -= system.pull_back(linear.t, linear.states, (mu, zeta))
    return gradient, on, float(change)


def _with_seeds(on: Array, seeds: Seeds, n: int) -> Array:
    """Add the partials of the objective in q and v at an instant."""
    on = on.copy()
    for row, seed in enumerate((seeds.q, seeds.v)):
        if seed is not None:
            on[row] += seed[n]
    return on


def _computed(nodes: Nodes, steps: slice) -> LinearSteps:
    """Return the steps that end at some instants."""
    run, c = nodes.run, nodes.steps.columns(steps)
    states = run.q[steps], run.v[steps], run.a[steps], run.lam[steps]
    return LinearSteps(nodes.problem.system, c, run.t[steps], states)


def _predicted(c: Coefficients, start: NodeSensitivity) -> Array:
    """Return q~_b, v~_b, A~_b of the step after a node, shape (3, n_b, n_q)."""
    q_p, v_p = predict(c, start.q_b, start.v_b, start.a_b)
    return np.array([q_p.T, v_p.T, c.alpha / (1 + c.alpha) * start.A_b.T])


def start_covectors(c: Coefficients, on: Array) -> NodeSensitivity:
    """Return adjoint vectors of the start: those of q_b and v_b plus `_predicted`^T of `on[3:]`."""
    units = NodeSensitivity(*(x[None].T for x in np.eye(4)[[0, 1, 2, 2, 3]]))
    q, v, a, A = _predicted(c, units)[:, 0].T @ on[3:]
    return NodeSensitivity(on[0] + q, on[1] + v, a, np.zeros(0), A)


def _small_side(
    system: MechanicalSystem,
    c: Coefficients,
    Phi_q: Array,
    row: ConstraintRow,
    before: Array,
    v_p: Array,
) -> Array:
    """Return the known part of the constraints over a small step, shape (n_b, n_lam).

    `before` holds q_b and v_b before the step, `v_p` is v~_b; design variables are rows.
    """
    pattern, dq_b = system.constraint_pattern, increment_from_velocities(c, before[1], v_p)
    lower = pattern.dot(Phi_q, dq_b.T) + pattern.dot(row.G, before[0].T) + row.g
    return np.asarray(-lower.T / (c.beta * c.h**2))


def _small_side_back(
    nodes: Nodes, n: int, Phi_q: Array, row: ConstraintRow, zeta: Array, on: Array
) -> Array:
    """Transpose of `_small_side`, added to covectors before the step; return that on dq_b."""
    pattern = nodes.problem.system.constraint_pattern
    on_dq = -pattern.dot_transposed(Phi_q, zeta)
    on[0] = -pattern.dot_transposed(row.G, zeta)
    # dq_b combines v_b before the step and v~_b: `increment_from_velocities`.
    by_v, by_predicted = increment_from_velocities(nodes.steps.of(n), *np.eye(2))
    on[1] = by_v * on_dq
    on[4] += by_predicted * on_dq
    return np.asarray(on_dq)


def _chunks(system: MechanicalSystem, n_t: int, extra: int, *, linearised: bool) -> Sequence[slice]:
    """Divide steps 1 to n_t - 1 so that what is held at once stays within memory."""
    per_step = 2 * system.n_q + extra
    if linearised:
        per_step += 4 * system.pattern.size + 6 * system.n_q
    size = max(1, min(64, _CHUNK_NUMBERS // per_step))
    return [slice(k, min(k + size, n_t)) for k in range(1, n_t, size)]
