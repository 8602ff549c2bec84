"""What the motion itself misses in the recurrence of HHT-I3, for adjoint-weighted error estimates.

Inserted in eqs. (2)-(4), with a_n standing for q'' at t_n + alpha h, the smooth solution leaves

    q: C h^3 q''',  C = -(1 + 3 alpha^2)/12         from (2), see docs/theory/13-errors.md
    v: h^3 (alpha^2/2 - 1/12) q''''                 from (3)
    A: -alpha h^2/2 q''''                           from A = (a + alpha A_n)/(1 + alpha)

per step, and the shift of v_0 at the start. That a_0 misses alpha^2 h^2/2 q'''' changes a run by
O(h^3) and is left out, as is alpha^2/2 h' (h' - h) q'''' of a change of the step. Time derivatives
are differences of the accelerations A of the run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators.hht.equations import Steps
from ancfdae.numerics.arrays import Array


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
