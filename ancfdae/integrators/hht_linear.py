"""Linear passes over a computed HHT-I3 run: direct differentiation and its transpose.

Both read the discrete equations of `hht_equations` linearised at the converged
states. With c the coefficients, one step of the derivative recurrence is

    x~ = P x_n                    predictors of q_b and v_b                         (2), (3)
    J [a_b; lam_b] = -[ alpha/(1+alpha) M A_b,n + f_b + f_q q~_b + f_v v~_b ;
                        (Phi_q q~_b + Phi_b)/(beta h^2) ]                         (22), (23)
    q_b = q~_b + beta h^2 a_b,  v_b = v~_b + gamma h a_b
    A_b = (a_b + alpha A_b,n)/(1+alpha)

where f = M A + Phi_q^T lam - Q with A and lam held. The pass back is the transpose of exactly
these lines, in reverse order.

Jacobians and design partials of many steps are formed at once; only the
factorisation and the recurrence run step by step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ancfdae.errors import SingularMatrix, Verdict
from ancfdae.integrators.hht_equations import (
    Coefficients,
    NodeSensitivity,
    acceleration,
    correct,
    iteration_matrices,
    predict,
)
from ancfdae.integrators.seeds import Seeds
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.patterns import Stack
from ancfdae.solution import Solution
from ancfdae.system import Linearisation, MechanicalSystem

# Numbers held at once by a chunk of steps: small enough for the cache (crank-slider, measured:
# chunks of 16 to 32 steps are 1.4 times faster than 64).
_CHUNK_NUMBERS = 350_000


def differentiate(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    run: Solution,
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
    n_t, n_q, n_b, n_lam = len(run.t), system.n_q, system.n_b, system.n_lam
    arrays = [np.zeros((n_t, n, n_b)) for n in (n_q, n_q, n_q, n_lam)]
    first = (start.q_b, start.v_b, start.A_b, start.lam_b)
    for array, value in zip(arrays, first, strict=True):
        array[0] = value
    done, verdict = 1, Verdict.FINISHED
    try:
        for _ in _advance(system, matrices, c, run, arrays, start.a_b):
            done += 1
    except SingularMatrix:
        verdict = Verdict.SINGULAR
    except KeyboardInterrupt:
        verdict = Verdict.INTERRUPTED
    return [array[:done] for array in arrays], verdict


def _advance(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    run: Solution,
    arrays: list[Array],
    a_b: Array,
) -> Iterator[None]:
    """Fill the rows of the arrays one by one and yield after each."""
    q_b, v_b, A_b, lam_b = arrays
    n_t, n_q, n_b, n_lam = len(q_b), system.n_q, system.n_b, system.n_lam
    # f_q and Phi_q / (beta h^2) above each other: one product with the predictors.
    stacked = Stack(system.pattern, system.constraint_pattern)
    for steps in _chunks(system, n_t, n_b * (n_q + n_lam)):
        t, q, v, A, lam = (x[steps] for x in (run.t, run.q, run.v, run.a, run.lam))
        local = system.linearise(t, q, v, A, lam)
        partials = system.design_partials(t, q, v, A, lam)
        constraints_b = partials.Phi_b / (c.beta * c.h**2)
        given = -np.concatenate([partials.f_b, constraints_b], axis=1)
        jacobians = _factorised(matrices, c, local, range(len(t)))
        for k, jacobian in enumerate(jacobians):
            n = steps.start + k
            q_p, v_p = predict(c, q_b[n - 1], v_b[n - 1], a_b)
            right = given[k]
            right -= stacked.dot(local.f_q[k], local.Phi_q[k] / (c.beta * c.h**2), q_p)
            right[:n_q] -= system.mass_times(q[k], (c.alpha / (1 + c.alpha)) * A_b[n - 1])
            if local.f_v is not None:
                right[:n_q] -= system.pattern.dot(local.f_v[k], v_p)
            x = jacobian.solve(right)
            a_b, lam_b[n] = x[:n_q], x[n_q:]
            q_b[n], v_b[n] = correct(c, q_p, v_p, a_b)
            A_b[n] = acceleration(c, a_b, A_b[n - 1])
            yield


def pull_back(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    run: Solution,
    seeds: Seeds,
) -> tuple[Array, NodeSensitivity]:
    """Run the transposed recurrence backward (discrete adjoint).

    Returns
    -------
    gradient : array, shape (n_b,)
        Everything but what goes through the start.
    start : NodeSensitivity
        Covectors on the start: the derivative through it is the sum of their products with the
        start's derivatives. Its arrays have no design axis.
    """
    n_t, n_q, share = len(run.t), system.n_q, c.alpha / (1 + c.alpha)
    gradient = np.zeros(system.n_b)
    back = NodeSensitivity(*(np.zeros(n) for n in (n_q, n_q, n_q, system.n_lam, n_q)))
    for steps in reversed(_chunks(system, n_t, 0)):
        t, q, v, A, lam = (x[steps] for x in (run.t, run.q, run.v, run.a, run.lam))
        local = system.linearise(t, q, v, A, lam)
        mu, zeta = np.zeros_like(q), np.zeros_like(lam)
        order = range(len(t) - 1, -1, -1)
        for k, jacobian in zip(order, _factorised(matrices, c, local, order), strict=True):
            n = steps.start + k
            q_bar = _seeded(back.q_b, seeds.q, n)
            v_bar = _seeded(back.v_b, seeds.v, n)
            a_bar = back.a_b + back.A_b / (1 + c.alpha)
            a_bar += (c.gamma * c.h) * v_bar + (c.beta * c.h**2) * q_bar
            right = np.concatenate([a_bar, _seeded(back.lam_b, seeds.lam, n)])
            solved = jacobian.solve_transposed(right)
            mu[k], zeta[k] = solved[:n_q], solved[n_q:] / (c.beta * c.h**2)
            q_bar = q_bar - system.pattern.dot_transposed(local.f_q[k], mu[k])
            q_bar -= system.constraint_pattern.dot_transposed(local.Phi_q[k], zeta[k])
            if local.f_v is not None:
                v_bar = v_bar - system.pattern.dot_transposed(local.f_v[k], mu[k])
            back = NodeSensitivity(
                q_b=q_bar,
                v_b=v_bar + c.h * q_bar,
                a_b=(c.h**2 * (0.5 - c.beta)) * q_bar + (c.h * (1 - c.gamma)) * v_bar,
                lam_b=np.zeros(system.n_lam),
                A_b=share * (back.A_b - system.mass_times(q[k], mu[k])),
            )
        gradient -= system.pull_back(t, (q, v, A, lam), (mu, zeta))
    return gradient, back


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
