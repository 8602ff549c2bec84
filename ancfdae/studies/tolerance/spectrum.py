"""Whether motions that steps do not resolve fade: by the spectrum about the start of a run.

A method that damps waves may be believed where physics damps them too, and does so faster. The
waves of a run tell of the largest one only; the eigenvalues s of M s^2 + D s + K on the motions
that constraints leave tell of all.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.errors import AncfdaeError
from ancfdae.numerics.arrays import Array

# Coordinates up to which dense matrices take milliseconds.
_DENSE: Final = 60
# Steps of HHT-I3 resolve motions of less than this, |s| h.
_RESOLVED: Final = 0.5
# Fraction of its amplitude that a motion may keep to the end of a run, as a logarithm.
_FADED: Final = -5.0


def fades(system: MechanicalSystem, run: Solution) -> bool:
    """Return whether all motions about the start that steps do not resolve die out in the run.

    False if there are none, or more coordinates than dense matrices are made for.
    """
    if system.n_q > _DENSE or len(run.t) < 3:
        return False
    try:
        at = system.linearise(*(x[1:2] for x in (run.t, run.q, run.v, run.a, run.lam)))
    except AncfdaeError:
        return False
    if at.f_v is None:
        return False
    s = _spectrum(system, at.M[0], at.f_v[0], at.f_q[0], at.Phi_q[0])
    fast = s[np.abs(s) * (run.t[2] - run.t[1]) > _RESOLVED]
    return bool(fast.size) and bool(np.all(fast.real * run.t[-1] < _FADED))


def _spectrum(system: MechanicalSystem, M: Array, D: Array, K: Array, Phi_q: Array) -> Array:
    """Return the eigenvalues of M s^2 + D s + K on the motions that Phi_q leaves."""
    Z = np.eye(system.n_q)
    if system.n_lam:
        Z = scipy.linalg.null_space(system.constraint_pattern.dense(Phi_q))
    m, d, k = (Z.T @ system.pattern.dense(x) @ Z for x in (M, D, K))
    none, one = np.zeros_like(m), np.eye(len(m))
    left = np.block([[none, one], [-np.linalg.solve(m, k), -np.linalg.solve(m, d)]])
    return np.asarray(np.linalg.eigvals(left))
