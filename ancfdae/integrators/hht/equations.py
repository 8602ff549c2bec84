"""The discrete equations of HHT-I3 (eqs. 2-6), the defects of its steps, and small steps.

Forward run, direct differentiation and complex step all use the equations from here. With f = M A +
Phi_q^T lam - Q, unknowns (a, lam) at t_{n+1}, and

    q = q~ + beta h^2 a,   q~ = q_n + h v_n + h^2 (1/2 - beta) a_n      (2)
    v = v~ + gamma h a,    v~ = v_n + h (1 - gamma) a_n                 (3)
    A = (a + alpha A_n)/(1 + alpha)

the residual is

    R_1 = f = M(q) A + Phi_q^T lam - Q                                  (4)
    R_2 = Phi / (beta h^2)                                              (5)

and its Jacobian

    J = [ M/(1 + alpha) + beta h^2 f_q + gamma h f_v    Phi_q^T ]               (6)
        [ Phi_q                                         0       ].

A is the acceleration at t_{n+1}; the algorithm's a stands for t_{n+1} + alpha h. For a constant
mass (Phi_q^T lam - Q)_n = -M A_n turns R_1 into the paper's (4). Where the mass depends on q, the
paper's form would multiply M at one time with an acceleration at another and drop to first order;
this one stays second order.

**Defects** are the residuals of the smooth motion, for adjoint-weighted error estimates. Inserted
in eqs. (2)-(4), with a_n standing for q'' at t_n + alpha h, the smooth solution leaves

    q: C h^3 q''',  C = -(1 + 3 alpha^2)/12         from (2), see docs/theory/13-errors.md
    v: h^3 (alpha^2/2 - 1/12) q''''                 from (3)
    A: -alpha h^2/2 q''''                           from A = (a + alpha A_n)/(1 + alpha)

per step, and the shift of v_0 at the start. The defect alpha^2 h^2/2 q'''' of a_0 changes a run by
O(h^3) and is left out, as is alpha^2/2 h' (h' - h) q'''' of a change of the step. Time derivatives
are differences of the accelerations A of the run.

**Small steps** take Phi from its increment (docs/theory/05-hht-i3.md). R_2 = Phi/(beta h^2) of
eq. (5) has the round-off eps |q|/(beta h^2). Where that disturbs the motion the equations and their
derivatives use

    R_2 = (chi Phi_n + I)/(beta h^2),    I = Phi_{n+1} - Phi_n = integral of Phi_q dq - h nu

over s from 0 to 1 at q_n + s dq, t_n + s h, with the round-off eps h |v|, and a fraction chi of the
round-off left in Phi_n. The derivative in the design, dq_b along with dq, is

    Phi_q,{n+1} dq_b + G q_b,n + g,
    G = chi Phi_q,n + integral of (Phi_q dq)_q - h nu_q,
    g = chi Phi_b,n + integral of (Phi_q dq)_b - h nu_b.

In exact arithmetic G = Phi_q,{n+1} and g = Phi_b,{n+1} at chi = 1, and Phi_n and its derivative are
zero: the equations are those of eqs. (5) and (23).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import require_finite
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Coefficients:
    """Step size, or an array of them, and Newmark coefficients (below eq. 6)."""

    h: Any
    alpha: float
    beta: float = field(init=False)
    gamma: float = field(init=False)
    in_q: Any = field(init=False)
    in_v: Any = field(init=False)
    in_A: float = field(init=False)

    def __post_init__(self) -> None:
        """Derive beta and gamma, and the factors of a in q, v and A."""
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
    """Raise InvalidInputError unless `alpha` lies in [-1/3, 0], where HHT-I3 is stable."""
    require_finite(where, alpha)
    if not -1 / 3 <= alpha <= 0:
        repair = "Use -0.05 for little numerical damping, -0.3 to damp high frequencies strongly."
        raise InvalidInputError(where, "must lie in [-1/3, 0]", alpha, repair)


@final
@dataclass(frozen=True)
class Steps:
    """Step sizes h of a run, shape (n,), s, and its numerical damping alpha."""

    h: Array
    alpha: float

    def of(self, n: int) -> Coefficients:
        """Return the coefficients of the step that ends at time point n."""
        return Coefficients(float(self.h[n - 1]), self.alpha)

    def ratio(self, n: int) -> float:
        """Return the size of the step after time point n relative to the step before it."""
        return float(self.h[n] / self.h[n - 1])


class Node(NamedTuple):
    """State of the recurrence of HHT-I3 after a step.

    a is the acceleration of the algorithm, q'' at t + alpha h, and A is q'' at t. `motion` is the
    norm of the forces in the step, to which corrections are relative; infinite if no step led here.
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
    """Return the predictors q~ and v~ of eqs. (2) and (3); also for arrays of derivatives."""
    dq_p, v_p = predict_increment(c, v, a)
    return q + dq_p, v_p


def predict_increment(c: Coefficients, v: Array, a: Array) -> tuple[Array, Array]:
    """Return q~ - q_n, without the round-off of q_n, and v~, shape (n_q,) each."""
    v_p = v + c.h * (1 - c.gamma) * a
    # h v + h^2 (1/2 - beta) a = h v~ + h^2 (gamma - 1/2 - beta) a
    dq_p = c.h * v_p + c.h**2 * (c.gamma - 0.5 - c.beta) * a
    return dq_p, v_p


def correct(c: Coefficients, q_p: Array, v_p: Array, a: Array) -> tuple[Array, Array]:
    """Return q and v at t_{n+1} by eqs. (2) and (3), from their predictors and a_{n+1}."""
    return q_p + c.in_q * a, v_p + c.in_v * a


def rescaled(node: Node, ratio: float) -> Node:
    """Return the node for a step of `ratio` times the size of the step before.

    a changes with h along the straight line through it and A, which keeps second order.
    """
    return node if ratio == 1.0 else node._replace(a=node.A + ratio * (node.a - node.A))


def rescaled_sensitivity(node: NodeSensitivity, ratio: float) -> NodeSensitivity:
    """Return the derivatives of `rescaled`, the node for another step size."""
    if ratio == 1.0:
        return node
    return node._replace(a_b=node.A_b + ratio * (node.a_b - node.A_b))


def acceleration(c: Coefficients, a: Array, A_n: Array) -> Array:
    """Return A at t_{n+1} from the algorithm's a and A_n, (n_q,); or derivatives from theirs."""
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
    """Return C h^2, the factor of a_{n+1} - a_n in the error of a step; s^2."""
    return -(1 + 3 * c.alpha**2) / 12 * float(c.h) ** 2


@final
@dataclass(frozen=True)
class Defects:
    """Defects of q, v and A in the step that ends at each time point, (n_t, n_q); row 0 is zero."""

    q: Array
    v: Array
    A: Array

    @staticmethod
    def of(t: Array, A: Array, steps: Steps) -> Defects:
        """Estimate the defects of a run from its times, at least three, and accelerations A."""
        h, alpha = steps.h[:, None], steps.alpha
        snap = np.gradient(np.gradient(A, t, axis=0, edge_order=2), t, axis=0, edge_order=2)
        q, v, on_a = np.zeros_like(A), np.zeros_like(A), np.zeros_like(A)
        q[1:] = -(1 + 3 * alpha**2) / 12 * h**2 * np.diff(A, axis=0)
        v[1:] = (alpha**2 / 2 - 1 / 12) * h**3 * 0.5 * (snap[1:] + snap[:-1])
        on_a[1:] = -alpha / 2 * h**2 * snap[1:]
        return Defects(q, v, on_a)


# Gauss points and weights on (0, 1), exact for polynomials of degree 5 in s.
PLACES = (0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15))
WEIGHTS = (5 / 18, 8 / 18, 5 / 18)
# Largest effect of the round-off of constraints, relative to the motion and to its derivatives.
QUIET, _QUIET_DERIVATIVES = 1e-9, 1e-8
_EPS = float(np.finfo(float).eps)
# Number of states of a run from which the norm of its coordinates is computed.
_SOME = 9


def motion_size(
    system: MechanicalSystem, inverse: Array, a: Array, reactions: Array, Q: Array
) -> float:
    """Return the norm of inertia, reactions and forces; a force per square root of a mass.

    `inverse` is one over the weights of the system.
    """
    return norm(a, system.weights, reactions, inverse, Q, inverse)


def small_from(system: MechanicalSystem, run: Solution, alpha: float) -> float:
    """Return the number of equal steps of a run above which half of the steps would be small.

    It does not depend on where the system stands, so that the same runs are predicted everywhere.
    """
    root = np.sqrt(system.weights)
    some = np.linspace(0, len(run.t) - 1, _SOME).round().astype(int)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        # The system about its centre, or a point on its way.
        shapes = np.array([system.centred(x) for x in run.q[some].real])
        moved = run.q[some].real - run.q[0].real
        sizes = [np.linalg.norm(root * x, axis=1) for x in (shapes, moved)]
        q = np.median(np.maximum(*sizes))
        A = np.linalg.norm(root * run.a.real, axis=1)
        longest = np.sqrt(_EPS * q / (_QUIET_DERIVATIVES * Coefficients(1.0, alpha).beta * A))
        return float(run.t[-1] / np.median(longest))


@final
@dataclass(frozen=True)
class ConstraintRow:
    """Derivative of the constraints over a small step: entries of G on their pattern, and g."""

    G: Array
    g: Array

    @staticmethod
    def of(
        system: MechanicalSystem, c: Coefficients, before: Node, after: Node
    ) -> ConstraintRow | None:
        """Return G and g of a step; None where it is not small, so that eq. (23) is accurate."""
        floor = _EPS * norm(before.q, system.weights)
        unit = _QUIET_DERIVATIVES * c.beta * c.h**2
        # The inertia alone decides in most steps; at both ends, since it may pass through zero.
        if floor <= unit * max(norm(x.A, system.weights) for x in (before, after)):
            return None
        q, t = before.q, before.t
        forces = reaction(system, t, q, before.lam), system.force(t, q, before.v)
        motion = motion_size(system, 1 / system.weights, before.A, *forces)
        if floor <= unit * motion:
            return None
        # chi: 1, or less where Phi_n is round-off that would disturb the step.
        noise, allowed = floor, QUIET * motion * c.beta * c.h**2
        chi = 1.0 if noise <= allowed else allowed / noise
        dq = predict_increment(c, before.v, before.a)[0] + (c.beta * c.h**2) * after.a
        G, g = chi * system.constraint_q(t, q), chi * system.constraint_total(t, (q,))
        for place, weight in zip(PLACES, WEIGHTS, strict=True):
            q, t = before.q + place * dq, before.t + place * c.h
            G = G + (weight * c.h) * system.constraint_q(t, q, dq / c.h)
            g = g + (weight * c.h) * system.constraint_total(t, (q, dq / c.h))
        return ConstraintRow(G, g)


def small_rows(rows: Sequence[ConstraintRow | None]) -> tuple[Array, Array, Array]:
    """Return which of k steps are small, (k,), with rows of G and g, zero for the other steps."""
    some = [row for row in rows if row is not None]
    small = np.array([row is not None for row in rows], dtype=np.int32)
    G, g = (np.zeros((len(rows), *x.shape)) for x in (some[0].G, some[0].g))
    G[small == 1], g[small == 1] = [row.G for row in some], [row.g for row in some]
    return small, G, g


def node_after(run: Solution, n: int, alpha: float) -> Node:
    """Return the node after the step that ends at time point n of a run.

    The accelerations of the run are A; a_{n+1} = (1 + alpha) A_{n+1} - alpha A_n.
    """
    a = (1 + alpha) * run.a[n] - alpha * run.a[n - 1]
    return Node(float(run.t[n]), run.q[n], run.v[n], a, run.lam[n], run.a[n])


@final
@dataclass(frozen=True)
class Nodes:
    """Nodes of the recurrence at the time points of a finished run; `first` is its start."""

    problem: InitialValueProblem
    run: Solution
    steps: Steps
    first: Node

    def after(self, n: int) -> Node:
        """Return the node after the step that ends at time point n."""
        return node_after(self.run, n, self.steps.alpha)

    def maybe_small(self) -> Array:
        """Return for every time point whether the step that ends there may be small, (n_t,)."""
        weights = self.problem.system.weights
        h, beta = self.steps.h, self.steps.of(1).beta
        # A run that diverged overflows; its motion is not small.
        with np.errstate(over="ignore"):
            q, A = (np.sqrt(x.real**2 @ weights) for x in (self.run.q, self.run.a))
        # As in `ConstraintRow.of`, for all steps at once.
        allowed = _QUIET_DERIVATIVES * beta * h**2 * np.maximum(A[1:], A[:-1])
        return np.append(False, _EPS * q[:-1] > allowed)

    def row(self, n: int) -> ConstraintRow | None:
        """Return G and g of the step that ends at time point n; None if it is not small."""
        before = self.first
        if n > 1:
            before = rescaled(self.after(n - 1), self.steps.ratio(n - 1))
        return ConstraintRow.of(self.problem.system, self.steps.of(n), before, self.after(n))
