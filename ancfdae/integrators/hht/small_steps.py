"""Constraints of HHT-I3 at small steps, from their increments (docs/theory/05-hht-i3.md).

R_2 = Phi/(beta h^2) of eq. (5) has the round-off eps |q|/(beta h^2). Where that disturbs the motion
the equations and their derivatives take

    R_2 = (chi Phi_n + I)/(beta h^2),    I = Phi_{n+1} - Phi_n = integral of Phi_q dq - h nu

over s from 0 to 1 at q_n + s dq, t_n + s h, with the round-off eps h |v|, and a part chi of what
round-off has left in Phi_n. The derivative in the design, dq_b along with dq, is

    Phi_q,{n+1} dq_b + G q_b,n + g,
    G = chi Phi_q,n + integral of (Phi_q dq)_q - h nu_q,
    g = chi Phi_b,n + integral of (Phi_q dq)_b - h nu_b.

In exact arithmetic G = Phi_q,{n+1} and g = Phi_b,{n+1} at chi = 1, and Phi_n and its derivative are
zero: the equations are those of eqs. (5) and (23).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.equations.solution import Solution
from ancfdae.integrators.hht.equations import Coefficients, Node, Steps, predict_increment, rescaled
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array

# Gauss points on (0, 1), exact for polynomials of degree 5 in s.
PLACES = (0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15))
WEIGHTS = (5 / 18, 8 / 18, 5 / 18)
# Part of the motion that round-off of the constraints may disturb, and of its derivatives.
QUIET, _QUIET_DERIVATIVES = 1e-9, 1e-8
_EPS = float(np.finfo(float).eps)
# States of a run from which the size of its coordinates is taken.
_SOME = 9


def motion_size(
    system: MechanicalSystem, inverse: Array, a: Array, reactions: Array, Q: Array
) -> float:
    """Size of inertia, reactions and forces in one norm, a force per square root of a mass.

    `inverse` is one over the weights of the system.
    """
    return norm(a, system.weights, reactions, inverse, Q, inverse)


def share_of_defect(system: MechanicalSystem, c: Coefficients, q: Array, motion: float) -> float:
    """Return chi: 1, or less where Phi_n is round-off that would disturb a step of size h."""
    noise = _EPS * norm(q, system.weights)
    allowed = QUIET * motion * c.beta * c.h**2
    return 1.0 if noise <= allowed else allowed / noise


def small_from(system: MechanicalSystem, run: Solution, alpha: float) -> float:
    """Return the number of equal steps above which half of those of a run would be small.

    Where the system stands does not count, so that the same runs are foreseen everywhere.
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
    """Derivative of the constraints over a small step: values of G on their pattern, and g."""

    G: Array
    g: Array

    @staticmethod
    def of(
        system: MechanicalSystem, c: Coefficients, before: Node, after: Node
    ) -> ConstraintRow | None:
        """Return the row; None where the step is not small, so that eq. (23) is accurate."""
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
        chi = share_of_defect(system, c, q, motion)
        dq = predict_increment(c, before.v, before.a)[0] + (c.beta * c.h**2) * after.a
        G, g = chi * system.constraint_q(t, q), chi * system.constraint_total(t, (q,))
        for place, weight in zip(PLACES, WEIGHTS, strict=True):
            q, t = before.q + place * dq, before.t + place * c.h
            G = G + (weight * c.h) * system.constraint_q(t, q, dq / c.h)
            g = g + (weight * c.h) * system.constraint_total(t, (q, dq / c.h))
        return ConstraintRow(G, g)


def small_rows(rows: Sequence[ConstraintRow | None]) -> tuple[Array, Array, Array]:
    """Return which of k steps are small, (k,), with rows of G and g, zeros of all others."""
    some = [row for row in rows if row is not None]
    small = np.array([row is not None for row in rows], dtype=np.int32)
    G, g = (np.zeros((len(rows), *x.shape)) for x in (some[0].G, some[0].g))
    G[small == 1], g[small == 1] = [row.G for row in some], [row.g for row in some]
    return small, G, g


def node_after(run: Solution, n: int, alpha: float) -> Node:
    """Return the node that the step to instant n of a run arrived at.

    The accelerations of the run are A; a_{n+1} = (1 + alpha) A_{n+1} - alpha A_n.
    """
    a = (1 + alpha) * run.a[n] - alpha * run.a[n - 1]
    return Node(float(run.t[n]), run.q[n], run.v[n], a, run.lam[n], run.a[n])


@final
@dataclass(frozen=True)
class Nodes:
    """States of the recurrence at the instants of a finished run; `first` is its start."""

    problem: InitialValueProblem
    run: Solution
    steps: Steps
    first: Node

    def after(self, n: int) -> Node:
        """Return the node that the step to instant n arrives at."""
        return node_after(self.run, n, self.steps.alpha)

    def maybe_small(self) -> Array:
        """Return for every instant whether the step that ends there may be small, shape (n_t,)."""
        weights = self.problem.system.weights
        h, beta = self.steps.h, self.steps.of(1).beta
        # A run that diverged overflows; its motion is not small.
        with np.errstate(over="ignore"):
            q, A = (np.sqrt(x.real**2 @ weights) for x in (self.run.q, self.run.a))
        # As in `ConstraintRow.of`, for all steps at once.
        allowed = _QUIET_DERIVATIVES * beta * h**2 * np.maximum(A[1:], A[:-1])
        return np.append(False, _EPS * q[:-1] > allowed)

    def row(self, n: int) -> ConstraintRow | None:
        """Return the row of the step to instant n; None where that is not small."""
        before = self.first
        if n > 1:
            before = rescaled(self.after(n - 1), self.steps.ratio(n - 1))
        return ConstraintRow.of(self.problem.system, self.steps.of(n), before, self.after(n))
