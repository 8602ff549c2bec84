"""Linear passes over a computed HHT-I3 run: direct differentiation and its transpose.

Both read the discrete equations of `hht_equations` linearised at the converged
states. With c the coefficients, one step of the derivative recurrence is

    x~ = P x_n                    predictors of q_b and v_b             (2), (3)
    J [a_b; lam_b] = -[ d + f_q q~_b + f_v v~_b - alpha/(1+alpha) F_n ;
                        (Phi_q q~_b + Phi_b)/(beta h^2) ]               (22), (23)
    q_b = q~_b + beta h^2 a_b,  v_b = v~_b + gamma h a_b
    F_{n+1} = alpha/(1+alpha) F_n - (M a_b + M_b a)/(1+alpha)

with d = M_b a/(1+alpha) + (Phi_q^T lam)_b - Q_b and F = df/db. The pass back
is the transpose of exactly these lines, in reverse order.

Jacobians and design partials of many steps are formed at once; only the
factorisation and the recurrence run step by step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import SingularMatrix, Verdict
from ancfdae.integrators.hht_equations import Coefficients, NodeSensitivity, correct, predict
from ancfdae.integrators.seeds import Seeds
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.patterns import Stack
from ancfdae.system import Linearisation, MechanicalSystem

# Numbers held at once by a chunk of steps: small enough for the cache (crank-slider, measured:
# chunks of 16 to 32 steps are 1.4 times faster than 64).
_CHUNK_NUMBERS = 350_000


@final
@dataclass(frozen=True)
class Trajectory:
    """Converged states of a run, row 0 the start.

    Attributes
    ----------
    t : array, shape (n_t,)
    q, v : array, shape (n_t, n_q)
    a : array, shape (n_t, n_q)
        The algorithm's accelerations a_n.
    lam : array, shape (n_t, n_lam)
    """

    t: Array
    q: Array
    v: Array
    a: Array
    lam: Array


def differentiate(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    path: Trajectory,
    start: NodeSensitivity,
) -> tuple[list[Array], Verdict]:
    """Run the derivative recurrence forward.

    Returns
    -------
    arrays : list of q_b, v_b, a_b, lam_b
        Shapes (n_t, n_q, n_b) and (n_t, n_lam, n_b), cut to the steps done; a_b is the
        derivative of the algorithm's accelerations; row 0 is the start.
    verdict : Verdict
        How the pass ended.
    """
    n_t, n_q, n_b, n_lam = len(path.t), system.n_q, system.n_b, system.n_lam
    q_b, v_b, a_b = (np.zeros((n_t, n_q, n_b)) for _ in range(3))
    lam_b = np.zeros((n_t, n_lam, n_b))
    q_b[0], v_b[0], a_b[0], lam_b[0] = start.q_b, start.v_b, start.a_b, start.lam_b
    arrays, done, verdict = [q_b, v_b, a_b, lam_b], 1, Verdict.FINISHED
    try:
        for _ in _advance(system, matrices, c, path, arrays, start.f_b.copy()):
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
    path: Trajectory,
    arrays: list[Array],
    F: Array,
) -> Iterator[None]:
    """Fill the rows of the arrays one by one and yield after each."""
    q_b, v_b, a_b, lam_b = arrays
    n_t, n_q, n_b, n_lam, scale = len(q_b), system.n_q, system.n_b, system.n_lam, 1 + c.alpha
    # f_q and Phi_q / (beta h^2) above each other: one product with the predictors.
    stacked = Stack(system.pattern, system.constraint_pattern)
    for steps in _chunks(system, n_t, n_b * (n_q + n_lam)):
        t, q, v, a, lam = (x[steps] for x in (path.t, path.q, path.v, path.a, path.lam))
        local = system.linearise(t, q, v, lam)
        partials = system.design_partials(t, q, v, a, lam)
        inertia_b = partials.inertia_b / scale
        constraints_b = partials.Phi_b / (c.beta * c.h**2)
        given = -np.concatenate([inertia_b + partials.f_b, constraints_b], axis=1)
        jacobians = _factorised(system, matrices, c, local, range(len(t)))
        for k, jacobian in enumerate(jacobians):
            n = steps.start + k
            q_p, v_p = predict(c, q_b[n - 1], v_b[n - 1], a_b[n - 1])
            F *= c.alpha / scale
            right = given[k]
            right -= stacked.dot(local.f_q[k], local.Phi_q[k] / (c.beta * c.h**2), q_p)
            right[:n_q] += F
            if local.f_v is not None:
                right[:n_q] -= system.pattern.dot(local.f_v[k], v_p)
            x = jacobian.solve(right)
            a_b[n], lam_b[n] = x[:n_q], x[n_q:]
            q_b[n], v_b[n] = correct(c, q_p, v_p, a_b[n])
            F -= system.mass_times(a_b[n] / scale)
            F -= inertia_b[k]
            yield


def pull_back(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    path: Trajectory,
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
    n_t, n_q, scale = len(path.t), system.n_q, 1 + c.alpha
    gradient = np.zeros(system.n_b)
    back = NodeSensitivity(*(np.zeros(n) for n in (n_q, n_q, n_q, system.n_lam, n_q)))
    for steps in reversed(_chunks(system, n_t, 0)):
        t, q, v, a, lam = (x[steps] for x in (path.t, path.q, path.v, path.a, path.lam))
        local = system.linearise(t, q, v, lam)
        x, mu = np.zeros_like(q), np.zeros_like(q)
        zeta = np.zeros_like(lam)
        order = range(len(t) - 1, -1, -1)
        for k, jacobian in zip(order, _factorised(system, matrices, c, local, order), strict=True):
            n = steps.start + k
            q_bar = _seeded(back.q_b, seeds.q, n)
            v_bar = _seeded(back.v_b, seeds.v, n)
            inertia = back.f_b / scale
            a_bar = back.a_b - system.mass_times(inertia)
            a_bar += (c.gamma * c.h) * v_bar + (c.beta * c.h**2) * q_bar
            right = np.concatenate([a_bar, _seeded(back.lam_b, seeds.lam, n)])
            solved = jacobian.solve_transposed(right)
            mu[k], zeta[k] = solved[:n_q], solved[n_q:] / (c.beta * c.h**2)
            x[k] = inertia + mu[k] / scale
            q_bar = q_bar - system.pattern.dot_transposed(local.f_q[k], mu[k])
            q_bar -= system.constraint_pattern.dot_transposed(local.Phi_q[k], zeta[k])
            if local.f_v is not None:
                v_bar = v_bar - system.pattern.dot_transposed(local.f_v[k], mu[k])
            back = NodeSensitivity(
                q_b=q_bar,
                v_b=v_bar + c.h * q_bar,
                a_b=(c.h**2 * (0.5 - c.beta)) * q_bar + (c.h * (1 - c.gamma)) * v_bar,
                lam_b=np.zeros(system.n_lam),
                f_b=c.alpha * x[k],
            )
        gradient -= system.pull_back(t, (q, v, a, lam), (x, mu, zeta))
    return gradient, back


def _seeded(back: Array, seeds: Array | None, n: int) -> Array:
    return back if seeds is None else back + seeds[n]


def _chunks(system: MechanicalSystem, n_t: int, extra: int) -> Sequence[slice]:
    """Divide steps 1 to n_t - 1 so that what is held at once stays within memory."""
    per_step = 4 * system.pattern.size + 8 * system.n_q + extra
    size = max(1, min(64, _CHUNK_NUMBERS // per_step))
    return [slice(k, min(k + size, n_t)) for k in range(1, n_t, size)]


def _factorised(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    c: Coefficients,
    local: Linearisation,
    order: range,
) -> Iterator[Factorization]:
    """Factorise eq. (6) step by step, forward or backward."""
    K = system.mass() / (1 + c.alpha) + (c.beta * c.h**2) * local.f_q
    if local.f_v is not None:
        K = K + (c.gamma * c.h) * local.f_v
    forward = slice(None) if order.step > 0 else slice(None, None, -1)
    return matrices.factor_each(K[forward], local.Phi_q[forward])
