"""Integrals beside the motion, refined until their own error is within the tolerance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.integrators.index_1 import Accelerations
from ancfdae.integrators.integrand import Integrand, PartialIntegral, Points, Rule

# Gauss-Lobatto rule of four points with its Kronrod extension of seven, of degrees 5 and 9
# (Gander & Gautschi, BIT 40, 2000), moved from [-1, 1] to [0, 1].
_X = np.sqrt([1.0, 2 / 3, 1 / 5, 0.0])
SHARES = 0.5 + 0.5 * np.array([-_X[0], -_X[1], -_X[2], 0.0, _X[2], _X[1], _X[0]])
_W = 0.5 * np.array([11 / 210, 72 / 245, 125 / 294, 16 / 35, 125 / 294, 72 / 245, 11 / 210])
_LOBATTO = 0.5 * np.array([1 / 6, 0.0, 5 / 6, 0.0, 5 / 6, 0.0, 1 / 6])
KRONROD = Rule(_W, _W - _LOBATTO, np.zeros(7))


@final
class Quadrature:
    """Feeds integrands part by part; multipliers at points without come from `accelerations`."""

    def __init__(
        self, integrands: Sequence[Integrand], accelerations: Accelerations, rtol: float
    ) -> None:
        self._integrands, self._accelerations = tuple(integrands), accelerations
        self._rtol = rtol

    @property
    def wanted(self) -> bool:
        """Whether there is anything to integrate."""
        return bool(self._integrands)

    def add(self, choices: Iterable[Points]) -> None:
        """Take in the next part of the run.

        The choices are the same part on ever finer panels; each integrand takes the first on which
        its error is within the tolerance, or the last.
        """
        pending, unfinished = self._integrands, list[tuple[Integrand, PartialIntegral]]()
        for choice in choices:
            points, unfinished = self._completed(choice, pending), []
            for integrand in pending:
                part = integrand.part(points)
                if part.error <= self._rtol:
                    integrand.add(part)
                else:
                    unfinished.append((integrand, part))
            pending = tuple(integrand for integrand, _ in unfinished)
            if not pending:
                return
        for integrand, part in unfinished:
            integrand.add(part)

    def _completed(self, points: Points, integrands: Sequence[Integrand]) -> Points:
        """Add multipliers where an integrand needs them."""
        if points.lam is not None or not any(x.multipliers for x in integrands):
            return points
        lam, lam_b = [], []
        for k, t in enumerate(points.t):
            q, v = points.q[k], points.v[k]
            a, multipliers = self._accelerations.solve(float(t), q, v)
            lam.append(multipliers)
            if points.q_b is not None and points.v_b is not None:
                state = (q, v, a, multipliers)
                q_b, v_b = points.q_b[k], points.v_b[k]
                lam_b.append(self._accelerations.solve_b(float(t), state, q_b, v_b)[1])
        return replace(points, lam=np.array(lam), lam_b=np.array(lam_b) if lam_b else None)
