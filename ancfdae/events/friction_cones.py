"""Contacts with cones of friction: Newton's method on the natural map.

In units in which A has a unit diagonal, N >= N_0 and T solve the contact problem where

    min(N - N_0, g') = 0,   T = projection of T - s on the disc of radius mu N,

with (g', s) = A (N, T) + r (P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991).
The map has kinks where a contact begins to push, to stick or to slide; Newton's method takes the
derivative on its side of a kink. Corrections are halved until the map gets smaller.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ancfdae.numerics.arrays import Array

# Largest norm of the map at a solution, relative to the rates; most corrections, and most halvings.
_SOLVED, _CORRECTIONS, _HALVED = 1e-12, 60, 12
# Largest norm of the map at impulses that keep the law, relative to the rates.
_KEPT = 1e-10
# Sweeps of Gauss-Seidel's method, and a length below any.
_SWEEPS, _TINY = 100, float(np.finfo(float).tiny)
# Rates of round-off may add up to this number of times the round-off of one.
_NOISE = 200.0


class Cones(NamedTuple):
    """The contact problem in scaled units: A, contact and mu of each friction row, r, and N_0.

    `noise` is the round-off of r.
    """

    A: Array
    rough: Array
    mu: Array
    r: Array
    low: Array
    noise: float

    @property
    def fast(self) -> float:
        """Return the largest rate before the impact or by the impulses N_0; 1 if all are zero."""
        rates = np.abs(self.r) + np.abs(self.A[:, : len(self.low)]) @ np.abs(self.low)
        return float(np.max(rates, initial=0.0)) or 1.0

    def small(self, part: float) -> float:
        """Return `part` times the largest rate, or what round-off of rates adds up to."""
        return max(part * self.fast, _NOISE * self.noise)


class _Map(NamedTuple):
    """The natural map and its Jacobian at (N, T), with the branch there."""

    value: Array
    jacobian: Array
    pushes: Array
    sticks: Array
    slides: Array


def on_cones(problem: Cones, P: Array) -> tuple[Array, Array, Array, Array] | None:
    """Return which contacts push, stick and slide, and N and T, (m + k,), from a first guess P.

    None if Newton's method does not converge from there.
    """
    small = problem.small(_SOLVED)
    at = _natural_map(problem, P)
    for _ in range(_CORRECTIONS):
        size = float(np.linalg.norm(at.value))
        if size <= small:
            return at.pushes, at.sticks, at.slides, P
        step = np.linalg.lstsq(at.jacobian, -at.value, rcond=None)[0]
        share = 1.0
        for _ in range(_HALVED):
            moved = _natural_map(problem, P + share * step)
            if np.linalg.norm(moved.value) < size:
                break
            share /= 2
        else:
            return None
        P, at = P + share * step, moved
    return None


def swept(problem: Cones, P: Array) -> Array:
    """Return N and T, (m + k,), after sweeps of projected Gauss-Seidel: N, then T, by contact."""
    A, rough, mu, r, low, _ = problem
    m, P = len(low), P.copy()
    rows = [m + np.flatnonzero(rough == i) for i in range(m)]
    stiff = [float(np.trace(A[np.ix_(t, t)])) for t in rows]
    for _ in range(_SWEEPS):
        for i, t in enumerate(rows):
            P[i] = max(low[i], P[i] - (A[i] @ P + r[i]) / A[i, i])
            if stiff[i] > 0:
                z, radius = P[t] - (A[t] @ P + r[t]) / stiff[i], mu[t - m][0] * P[i]
                P[t] = z * min(1.0, radius / max(float(np.linalg.norm(z)), _TINY))
    return P


def keep_law(problem: Cones, P: Array) -> bool:
    """Return whether N and T, (m + k,), solve the contact problem up to round-off."""
    return bool(np.linalg.norm(_natural_map(problem, P).value) <= problem.small(_KEPT))


def _natural_map(problem: Cones, P: Array) -> _Map:
    """Evaluate the natural map and its Jacobian at N and T, (m + k,)."""
    A, rough, mu, r, low, _ = problem
    m, y, unit = len(low), A @ P + r, np.eye(len(P))
    more, T, gap, s = P[:m] - low, P[m:], y[:m], y[m:]
    pushes = more > gap
    value, J = np.empty_like(P), np.empty_like(A)
    value[:m] = np.where(pushes, gap, more)
    J[:m] = np.where(pushes[:, None], A[:m], unit[:m])
    same = rough[:, None] == rough
    z, radius = T - s, mu * np.maximum(P[rough], 0.0)
    length = np.sqrt(same @ (z * z))
    sticks = length <= radius
    far = np.where(sticks, 1.0, length)
    e = z / far
    value[m:] = np.where(sticks, s, T - radius * e)
    # The projection's derivative: mu dN along e, and radius/|z| across it.
    across = (radius / far)[:, None] * (np.eye(len(T)) - np.outer(e, e) * same)
    slip = unit[m:] - across @ (unit[m:] - A[m:])
    slip -= (mu * e * (P[rough] > 0))[:, None] * unit[rough]
    J[m:] = np.where(sticks[:, None], A[m:], slip)
    loaded = P[rough] > _SOLVED * np.max(np.abs(P), initial=0.0)
    slides = np.where(loaded & ~sticks, -e, 0.0)
    return _Map(value, J, pushes, loaded & sticks, slides)
