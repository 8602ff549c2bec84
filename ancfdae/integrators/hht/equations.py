"""The discrete equations of HHT-I3, written once (eqs. 2-6).

Forward run, direct differentiation and complex step all read them from here.
With f = M A + Phi_q^T lam - Q, unknowns (a, lam) at t_{n+1}, and

    q = q~ + beta h^2 a,   q~ = q_n + h v_n + h^2 (1/2 - beta) a_n      (2)
    v = v~ + gamma h a,    v~ = v_n + h (1 - gamma) a_n                 (3)
    A = (a + alpha A_n)/(1 + alpha)

the residual is

    R_1 = f = M(q) A + Phi_q^T lam - Q                                  (4)
    R_2 = Phi / (beta h^2)                                              (5)

and its Jacobian

    J = [ M/(1 + alpha) + beta h^2 f_q + gamma h f_v    Phi_q^T ]               (6)
        [ Phi_q                                         0       ].

With small steps Phi is formed from its increment (`small_steps`).

A is the acceleration at t_{n+1}; the algorithm's a stands for t_{n+1} + alpha h. For a constant
mass (Phi_q^T lam - Q)_n = -M A_n turns R_1 into the paper's (4). Where the mass depends on q, the
paper's form would multiply M at one instant with an acceleration at another and drop to first
order; this one stays second order.

**What the motion itself misses**, for adjoint-weighted error estimates. Inserted in eqs. (2)-(4),
with a_n standing for q'' at t_n + alpha h, the smooth solution leaves

    q: C h^3 q''',  C = -(1 + 3 alpha^2)/12         from (2), see docs/theory/13-errors.md
    v: h^3 (alpha^2/2 - 1/12) q''''                 from (3)
    A: -alpha h^2/2 q''''                           from A = (a + alpha A_n)/(1 + alpha)

per step, and the shift of v_0 at the start. That a_0 misses alpha^2 h^2/2 q'''' changes a run by
O(h^3) and is left out, as is alpha^2/2 h' (h' - h) q'''' of a change of the step. Time derivatives
are differences of the accelerations A of the run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.errors.checks import require_finite
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Coefficients:
    """Step size, an array for many steps at once, and Newmark coefficients (below eq. 6)."""

    h: Any
    alpha: float
    beta: float = field(init=False)
    gamma: float = field(init=False)
    in_q: Any = field(init=False)
    in_v: Any = field(init=False)
    in_A: float = field(init=False)

    def __post_init__(self) -> None:
        """Derive the coefficients, and what a adds to q, v and A."""
        beta, gamma = (1 - self.alpha) ** 2 / 4, (1 - 2 * self.alpha) / 2
        for name, value in (
            ("beta", beta),
            ("gamma", gamma),
            ("in_q", beta * self.h**2),
            ("in_v", gamma * self.h),
            ("in_A", 1 / (1 + self.alpha)),
        ):
            object.__setattr__(self, name, value)


def require_alpha(where: str, alpha: float) -> None:
    """Refuse a numerical damping that makes HHT-I3 unstable."""
    require_finite(where, alpha)
    if not -1 / 3 <= alpha <= 0:
        repair = "Use -0.05 for little numerical damping, -0.3 to damp high frequencies strongly."
        raise InvalidInputError(where, "must lie in [-1/3, 0]", alpha, repair)


@final
@dataclass(frozen=True)
class Steps:
    """Step sizes of a run, shape (n,)."""

    h: Array
    alpha: float

    def of(self, n: int) -> Coefficients:
        """Coefficients of the step that ends at instant n."""
        return Coefficients(float(self.h[n - 1]), self.alpha)

    def ratio(self, n: int) -> float:
        """Size of the step from instant n relative to the one that ends there."""
        return float(self.h[n] / self.h[n - 1])

    def columns(self, steps: slice) -> Coefficients:
        """Coefficients of the steps that end at some instants; h has shape (k, 1)."""
        h = self.h[steps.start - 1 : steps.stop - 1]
        return Coefficients(h[:, None], self.alpha)


class Node(NamedTuple):
    """State of the recurrence after a step.

    a is the acceleration of the algorithm, q'' at t + alpha h, and A is q'' at t. The size of the
    motion is that of the forces in the step; infinite where no step led here.
    """

    t: float
    q: Array
    v: Array
    a: Array
    lam: Array
    A: Array
    motion: float = math.inf


class NodeSensitivity(NamedTuple):
    """Design derivatives of a `Node`; every array has a trailing axis n_b."""

    q_b: Array
    v_b: Array
    a_b: Array
    lam_b: Array
    A_b: Array


def predict(c: Coefficients, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """q~ and v~ of eqs. (2) and (3); arrays of derivatives go through unchanged."""
    dq_p, v_p = predict_increment(c, v, a)
    return q + dq_p, v_p


def predict_increment(c: Coefficients, v: Array, a: Array) -> tuple[Array, Array]:
    """Return q~ - q_n, without the round-off of q_n, and v~, shape (n_q,) each."""
    v_p = v + c.h * (1 - c.gamma) * a
    # h v + h^2 (1/2 - beta) a = h v~ + h^2 (gamma - 1/2 - beta) a
    dq_p = c.h * v_p + c.h**2 * (c.gamma - 0.5 - c.beta) * a
    return dq_p, v_p


def correct(c: Coefficients, q_p: Array, v_p: Array, a: Array) -> tuple[Array, Array]:
    """Coordinates and velocities of eqs. (2) and (3) from their predictors and a_{n+1}."""
    return q_p + c.in_q * a, v_p + c.in_v * a


def rescaled(node: Node, ratio: float) -> Node:
    """Return the node for a step whose size is `ratio` times that of the step before.

    a changes with h along the straight line through it and A, which keeps second order.
    """
    return node if ratio == 1.0 else node._replace(a=node.A + ratio * (node.a - node.A))


def rescaled_sensitivity(node: NodeSensitivity, ratio: float) -> NodeSensitivity:
    """Return the derivatives of `rescaled`, the state for another step size."""
    if ratio == 1.0:
        return node
    return node._replace(a_b=node.A_b + ratio * (node.a_b - node.A_b))


def acceleration(c: Coefficients, a: Array, A_n: Array) -> Array:
    """Return A at t_{n+1} from the algorithm's a and the A before, also for derivatives."""
    return (c.alpha * c.in_A) * A_n + c.in_A * a


def step_matrices(steps: Steps) -> Array:
    """Return the maps from (q~, v~, A~, a) to (q, v, A) and the next (q~, v~, A~), (n, 6, 4).

    The coefficients of all steps come at once from unit vectors; after the last step the same size
    is taken once more.
    """
    h = steps.h[:, None]
    following = np.append(steps.h[1:], steps.h[-1])[:, None]
    alpha = steps.alpha
    c, ahead = Coefficients(h, alpha), Coefficients(following, alpha)
    q_p, v_p, A_p, a = np.eye(4)
    q, v = correct(c, q_p, v_p, a)
    A = A_p + a / (1 + alpha)
    q_next, v_next = predict(ahead, q, v, A + following / h * (a - A))
    rows = [np.broadcast_to(x, q.shape) for x in (q, v, A, q_next, v_next)]
    return np.stack([*rows, np.broadcast_to(alpha / (1 + alpha) * A, q.shape)], axis=1)


def constraint_error(c: Coefficients) -> float:
    """Return C h^2 of the module description."""
    return -(1 + 3 * c.alpha**2) / 12 * float(c.h) ** 2


@final
@dataclass(frozen=True)
class Defects:
    """Defects of the steps that end at each instant, shape (n_t, n_q); row 0 is zero."""

    q: Array
    v: Array
    A: Array

    @staticmethod
    def of(t: Array, A: Array, steps: Steps) -> Defects:
        """Estimate the defects of a run from its instants, three at least, and accelerations."""
        h, alpha = steps.h[:, None], steps.alpha
        snap = np.gradient(np.gradient(A, t, axis=0, edge_order=2), t, axis=0, edge_order=2)
        q, v, on_a = np.zeros_like(A), np.zeros_like(A), np.zeros_like(A)
        q[1:] = -(1 + 3 * alpha**2) / 12 * h**2 * np.diff(A, axis=0)
        v[1:] = (alpha**2 / 2 - 1 / 12) * h**3 * 0.5 * (snap[1:] + snap[:-1])
        on_a[1:] = -alpha / 2 * h**2 * snap[1:]
        return Defects(q, v, on_a)
