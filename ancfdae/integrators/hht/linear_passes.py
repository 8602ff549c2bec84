"""Linear passes over a computed HHT-I3 run: direct differentiation and its transpose.

Both read the discrete equations of `equations` linearised at the converged
states. With c the coefficients, one step of the derivative recurrence is

    q~_b, v~_b = predictors of q_b and v_b                                        (2), (3)
    A~_b = alpha/(1+alpha) A_b,n
    J [a_b; lam_b] = -[ M A~_b + f_b + f_q q~_b + f_v v~_b ;
                        (Phi_q q~_b + Phi_b)/(beta h^2) ]                         (22), (23)
    q_b = q~_b + beta h^2 a_b,  v_b = v~_b + gamma h a_b,  A_b = A~_b + a_b/(1+alpha)

where f = M A + Phi_q^T lam - Q with A and lam held. The pass back is the transpose of exactly
these lines, in reverse order.

At small steps the second row takes Phi_q,{n+1} dq~_b + G q_b,n + g for Phi_q q~_b + Phi_b
(`small_steps`).

Jacobians and design partials of many steps are formed at once; only the
factorisation and the recurrence run step by step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ancfdae.errors import SingularMatrix, Verdict
from ancfdae.integrators.hht.defects import Defects
from ancfdae.integrators.hht.equations import (
    Coefficients,
    Node,
    NodeSensitivity,
    Steps,
    acceleration,
    correct,
    increment_from_velocities,
    iteration_matrices,
    newmark,
    predict,
)
from ancfdae.integrators.hht.small_steps import ConstraintRow, Nodes
from ancfdae.integrators.integrator import Seeds
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.patterns import Stack
from ancfdae.protocol import DesignPartials, Linearisation, MechanicalSystem

# Numbers held at once by a chunk of steps: small enough for the cache (crank-slider, measured:
# chunks of 16 to 32 steps are 1.4 times faster than 64).
_CHUNK_NUMBERS = 350_000


def differentiate(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    nodes: Nodes,
    start: NodeSensitivity,
) -> tuple[list[Array], Verdict]:
    """Run the derivative recurrence forward.

    Returns
    -------
    arrays : list of q_b, v_b, A_b, lam_b
        Shapes (n_t, n_q, n_b) and (n_t, n_lam, n_b), cut to the steps done; row 0 is the start.
    verdict : Verdict
        How the pass ended.
    """
    n_t, n_b, n_q = len(nodes.run.t), system.n_b, system.n_q
    states, lam_b = np.zeros((n_t, 3, n_b, n_q)), np.zeros((n_t, n_b, system.n_lam))
    states[0], lam_b[0] = (start.q_b.T, start.v_b.T, start.A_b.T), start.lam_b.T
    done, verdict = 1, Verdict.FINISHED
    try:
        for _ in _advance(system, matrices, nodes, start, states, lam_b):
            done += 1
    except SingularMatrix:
        verdict = Verdict.SINGULAR
    except KeyboardInterrupt:
        verdict = Verdict.INTERRUPTED
    arrays = (states[:done, 0], states[:done, 1], states[:done, 2], lam_b[:done])
    return [array.transpose(0, 2, 1) for array in arrays], verdict


def _advance(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    nodes: Nodes,
    start: NodeSensitivity,
    states: Array,
    lam_b: Array,
) -> Iterator[None]:
    """Fill the rows of the arrays one by one and yield after each.

    States are q_b, v_b, A_b with design variables as rows, (n_t, 3, n_b, n_q), and so is lam_b:
    right-hand sides then stand in memory as LAPACK wants them.
    """
    n_t, _, n_b, n_q = states.shape
    run, all_steps, maybe_small = nodes.run, nodes.steps, nodes.maybe_small(system)
    c = all_steps.first
    q_p, v_p = predict(c, start.q_b, start.v_b, start.a_b)
    predicted = np.array([q_p.T, v_p.T, c.alpha / (1 + c.alpha) * start.A_b.T])
    z = np.concatenate([predicted, np.zeros((1, n_b, n_q))])  # q~_b, v~_b, A~_b, a_b of a step
    step_matrices = _step_matrices(all_steps)
    # f_q and Phi_q / (beta h^2) above each other: one product with the predictors.
    stacked = Stack(system.pattern, system.constraint_pattern)
    for steps in _chunks(system, n_t, 2 * n_b * (n_q + system.n_lam)):
        t, q, v, A, lam = (x[steps] for x in (run.t, run.q, run.v, run.a, run.lam))
        c, local = all_steps.columns(steps), system.linearise(t, q, v, A, lam)
        given = _given(c, system.design_partials(t, q, v, A, lam))
        constraints_q = local.Phi_q / (c.beta * c.h**2)
        jacobians = _factorised(matrices, c, local, range(len(t)))
        for k, jacobian in enumerate(jacobians):
            n, right = steps.start + k, given[k]
            _subtract_predicted(right, system, stacked, local, constraints_q, k, q[k], z)
            row = nodes.row(system, n) if maybe_small[n] else None
            if row is not None:
                before, one = states[n - 1], all_steps.of(n)
                dq_b = increment_from_velocities(one, before[1], z[1]).T
                right[:, n_q:] = _small(system, one, local.Phi_q[k], row, before[0].T, dq_b)
            x = jacobian.solve(right.T).T
            z[3], lam_b[n] = x[:, :n_q], x[:, n_q:]
            after = (step_matrices[n - 1] @ z.reshape(4, -1)).reshape(6, n_b, n_q)
            states[n], z[:3] = after[:3], after[3:]
            yield


def advance(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    before: NodeSensitivity,
    after: Node,
    row: ConstraintRow | None,
) -> NodeSensitivity:
    """Take one step of the derivative recurrence, to a node that is computed.

    The row is that of a small step.

    Raises
    ------
    SingularMatrix
    """
    n_q, scale = system.n_q, c.beta * c.h**2
    q_p, v_p = predict(c, before.q_b, before.v_b, before.a_b)
    z = np.array([q_p.T, v_p.T, c.alpha / (1 + c.alpha) * before.A_b.T])
    t, q = np.array([after.t]), after.q[None]
    states = (q, after.v[None], after.A[None], after.lam[None])
    local = system.linearise(t, *states)
    columns = Coefficients(np.array([[c.h]]), c.alpha, c.beta, c.gamma)
    (right,) = _given(columns, system.design_partials(t, *states))
    stacked = Stack(system.pattern, system.constraint_pattern)
    _subtract_predicted(right, system, stacked, local, local.Phi_q / scale, 0, after.q, z)
    if row is not None:
        dq_b = increment_from_velocities(c, before.v_b, v_p)
        right[:, n_q:] = _small(system, c, local.Phi_q[0], row, before.q_b, dq_b)
    jacobian = matrices.factor(iteration_matrices(c, local)[0], local.Phi_q[0])
    x = jacobian.solve(right.T)
    a_b = x[:n_q]
    q_b, v_b = correct(c, q_p, v_p, a_b)
    A_b = acceleration(c, a_b, before.A_b)
    return NodeSensitivity(q_b, v_b, a_b, x[n_q:], A_b)


def _subtract_predicted(
    right: Array,
    system: MechanicalSystem,
    stacked: Stack,
    local: Linearisation,
    constraints_q: Array,
    k: int,
    q: Array,
    z: Array,
) -> None:
    """Subtract what the predictors z = (q~_b, v~_b, A~_b, ...) add to step k of a chunk."""
    n_q = system.n_q
    right -= stacked.dot_rows(local.f_q[k], constraints_q[k], z[0])
    right[:, :n_q] -= system.mass_times(q, z[2].T).T
    if local.f_v is not None:
        right[:, :n_q] -= system.pattern.dot(local.f_v[k], z[1].T).T


def _small(
    system: MechanicalSystem,
    c: Coefficients,
    Phi_q: Array,
    row: ConstraintRow,
    q_b: Array,
    dq_b: Array,
) -> Array:
    """Return the known part of the constraints over a small step, shape (n_b, n_lam)."""
    pattern = system.constraint_pattern
    lower = pattern.dot(Phi_q, dq_b) + pattern.dot(row.G, q_b) + row.g
    return np.asarray(-lower.T / (c.beta * c.h**2))


def _step_matrices(steps: Steps) -> Array:
    """Return the maps from (q~, v~, A~, a) to (q, v, A) and the next (q~, v~, A~), (n, 6, 4).

    All of a step but its solution in one small product; the coefficients come from all steps at
    once with unit vectors. After the last step the same size is taken once more.
    """
    h = steps.h[:, None]
    following = np.append(steps.h[1:], steps.h[-1])[:, None]
    alpha = steps.alpha
    c, ahead = (Coefficients(x, *newmark(alpha)) for x in (h, following))
    q_p, v_p, A_p, a = np.eye(4)
    q, v = correct(c, q_p, v_p, a)
    A = A_p + a / (1 + alpha)
    q_next, v_next = predict(ahead, q, v, A + following / h * (a - A))
    rows = [np.broadcast_to(x, q.shape) for x in (q, v, A, q_next, v_next)]
    return np.stack([*rows, np.broadcast_to(alpha / (1 + alpha) * A, q.shape)], axis=1)


def _given(c: Coefficients, partials: DesignPartials) -> Array:
    """Return the known part of the right sides, shape (k, n_b, n_q + n_lam)."""
    k, n_q, n_b = partials.f_b.shape
    given = np.empty((k, n_b, n_q + partials.Phi_b.shape[1]))  # each step in one piece
    np.negative(partials.f_b.transpose(0, 2, 1), out=given[:, :, :n_q])
    scale = -c.beta * c.h[:, None] ** 2
    np.divide(partials.Phi_b.transpose(0, 2, 1), scale, out=given[:, :, n_q:])
    return given


def pull_back(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    nodes: Nodes,
    seeds: Seeds,
    defects: Defects | None = None,
) -> tuple[Array, NodeSensitivity, float]:
    """Run the transposed recurrence backward (discrete adjoint).

    Returns
    -------
    gradient : array, shape (n_b,)
        Everything but what goes through the start.
    start : NodeSensitivity
        Covectors on the start: the derivative through it is the sum of their products with the
        start's derivatives. Its arrays have no design axis.
    change : float
        What the defects of all steps change in the objective; zero without them.
    """
    run, all_steps, maybe_small = nodes.run, nodes.steps, nodes.maybe_small(system)
    n_t, n_q, alpha = len(run.t), system.n_q, all_steps.alpha
    share = alpha / (1 + alpha)
    gradient, change = np.zeros(system.n_b), 0.0
    back = NodeSensitivity(*(np.zeros(n) for n in (n_q, n_q, n_q, system.n_lam, n_q)))
    for steps in reversed(_chunks(system, n_t, 0)):
        t, q, v, A, lam = (x[steps] for x in (run.t, run.q, run.v, run.a, run.lam))
        local = system.linearise(t, q, v, A, lam)
        mu, zeta = np.zeros_like(q), np.zeros_like(lam)
        order = range(len(t) - 1, -1, -1)
        jacobians = _factorised(matrices, all_steps.columns(steps), local, order)
        for k, jacobian in zip(order, jacobians, strict=True):
            n = steps.start + k
            c = all_steps.of(n)
            q_bar = _seeded(back.q_b, seeds.q, n)
            v_bar = _seeded(back.v_b, seeds.v, n)
            a_bar = back.a_b + back.A_b / (1 + c.alpha)
            a_bar += (c.gamma * c.h) * v_bar + (c.beta * c.h**2) * q_bar
            right = np.concatenate([a_bar, _seeded(back.lam_b, seeds.lam, n)])
            solved = jacobian.solve_transposed(right)
            mu[k], zeta[k] = solved[:n_q], solved[n_q:] / (c.beta * c.h**2)
            q_bar = q_bar - system.pattern.dot_transposed(local.f_q[k], mu[k])
            constraint = system.constraint_pattern
            on_dq = on_q = q_bar - constraint.dot_transposed(local.Phi_q[k], zeta[k])
            row = nodes.row(system, n) if maybe_small[n] else None
            if row is not None:
                on_q = q_bar - constraint.dot_transposed(row.G, zeta[k])
                gradient -= zeta[k] @ row.g
                zeta[k] = 0.0  # Phi_b has had its part.
            if local.f_v is not None:
                v_bar = v_bar - system.pattern.dot_transposed(local.f_v[k], mu[k])
            if defects is not None:
                on_A = back.A_b - system.mass_times(q[k], mu[k])
                change += on_dq @ defects.q[n] + v_bar @ defects.v[n] + on_A @ defects.A[n]
            back = NodeSensitivity(
                q_b=on_q,
                v_b=v_bar + c.h * on_dq,
                a_b=(c.h**2 * (0.5 - c.beta)) * on_dq + (c.h * (1 - c.gamma)) * v_bar,
                lam_b=np.zeros(system.n_lam),
                A_b=share * (back.A_b - system.mass_times(q[k], mu[k])),
            )
            if n > 1:
                back = _rescaled_transposed(back, all_steps.ratio(n - 1))
        gradient -= system.pull_back(t, (q, v, A, lam), (mu, zeta))
    return gradient, back, float(change)


def _rescaled_transposed(back: NodeSensitivity, ratio: float) -> NodeSensitivity:
    """Transpose of `rescaled`: from covectors on (a, A) after it to those before."""
    if ratio == 1.0:
        return back
    return replace(back, a_b=ratio * back.a_b, A_b=back.A_b + (1 - ratio) * back.a_b)


def _seeded(back: Array, seeds: Array | None, n: int) -> Array:
    return back if seeds is None else back + seeds[n]


def _chunks(system: MechanicalSystem, n_t: int, extra: int) -> Sequence[slice]:
    """Divide steps 1 to n_t - 1 so that what is held at once stays within memory."""
    per_step = 4 * system.pattern.size + 8 * system.n_q + extra
    size = max(1, min(64, _CHUNK_NUMBERS // per_step))
    return [slice(k, min(k + size, n_t)) for k in range(1, n_t, size)]


def _factorised(
    matrices: SaddlePoint,
    c: Coefficients,
    local: Linearisation,
    order: range,
) -> Iterator[Factorization]:
    """Factorise eq. (6) step by step, forward or backward."""
    forward = slice(None) if order.step > 0 else slice(None, None, -1)
    return matrices.factor_each(iteration_matrices(c, local)[forward], local.Phi_q[forward])
