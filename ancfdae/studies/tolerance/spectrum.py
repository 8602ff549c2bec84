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
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array

# Coordinates up to which dense matrices take milliseconds.
_DENSE: Final = 60
# Steps of HHT-I3 resolve motions of less than this, |s| h.
_RESOLVED: Final = 0.5
# Instants at which the spectrum of a run is taken.
_PLACES: Final = 7
# Fraction of its amplitude that a motion may keep to the end of a run, as a logarithm.
_FADED: Final = -5.0


def fades(system: MechanicalSystem, run: Solution) -> bool:
    """Return whether all motions about the start that steps do not resolve die out in the run.

    False if there are none, or more coordinates than dense matrices are made for.
    """
    spectra = _spectra(system, run, 1) if len(run.t) > 2 else []
    if not spectra:
        return False
    s = spectra[0]
    fast = s[np.abs(s) * (run.t[2] - run.t[1]) > _RESOLVED]
    return bool(fast.size) and bool(np.all(fast.real * run.t[-1] < _FADED))


def speed(problem: InitialValueProblem) -> float:
    """Return the largest |s| about the start; zero where nothing vibrates; 1/s."""
    from ancfdae.modes.configuration import LinearisationPoint
    from ancfdae.modes.periods import fastest

    initial = problem.initial
    try:
        at = LinearisationPoint(initial.q, initial.lam, t=initial.t)
        return fastest(problem.system, at)
    except AncfdaeError:
        return 0.0


def pace(system: MechanicalSystem, run: Solution) -> float | None:
    """Return the largest |s| about the motion, its mean over instants of a run; 1/s.

    None where `fades` cannot tell.
    """
    spectra = _spectra(system, run, *np.linspace(0, len(run.t) - 1, _PLACES + 2)[1:-1].astype(int))
    return float(np.mean([np.abs(s).max() for s in spectra])) if spectra else None


def _spectra(system: MechanicalSystem, run: Solution, *places: int) -> list[Array]:
    """Return the eigenvalues about instants of a run, whose numbers are given; none if unknown."""
    if system.n_q > _DENSE:
        return []
    rows = np.array(places)
    try:
        at = system.linearise(*(x[rows] for x in (run.t, run.q, run.v, run.a, run.lam)))
    except AncfdaeError:
        return []
    if at.f_v is None:
        return []
    masses = np.broadcast_to(at.M, (len(rows), at.M.shape[1]))
    parts = zip(masses, at.f_v, at.f_q, at.Phi_q, strict=True)
    return [_spectrum(system, *x) for x in parts]


def _spectrum(system: MechanicalSystem, M: Array, D: Array, K: Array, Phi_q: Array) -> Array:
    """Return the eigenvalues of M s^2 + D s + K on the motions that Phi_q leaves."""
    Z = np.eye(system.n_q)
    if system.n_lam:
        Z = scipy.linalg.null_space(system.constraint_pattern.dense(Phi_q))
    m, d, k = (Z.T @ system.pattern.dense(x) @ Z for x in (M, D, K))
    none, one = np.zeros_like(m), np.eye(len(m))
    left = np.block([[none, one], [-np.linalg.solve(m, k), -np.linalg.solve(m, d)]])
    return np.asarray(np.linalg.eigvals(left))
