"""Checks along a run that is to be differentiated: where its derivatives would mean nothing.

Functions of a user that are called with complex numbers must be analytic at the states of the run,
and constraints must keep full rank.
"""

from __future__ import annotations

import warnings

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.kinds import StabilityWarning
from ancfdae.integrators.prescribed_motion import singular_position
from ancfdae.integrators.recorder import Rows
from ancfdae.numerics.arrays import Array

# Number of states, evenly spaced in the run, at which called functions are tried.
_STATES = 64


def require_differentiable(system: MechanicalSystem, t: Array, q: Array, v: Array) -> None:
    """Check states at times t, shape (k,), with q and v, shape (k, n_q).

    InvalidInputError if a called function is not analytic at one of them; StabilityWarning if a
    step passes over a singular position.
    """
    if system.called_functions:
        some = np.unique(np.linspace(0, len(t) - 1, _STATES).astype(int))
        for each in some:
            system.require_derivatives_at(float(t[each]), q[each], v[each])
    if system.traits.linear_constraints or not system.n_lam or not system.has_loops:
        return
    singular = singular_position(system, Rows(t, q, v))
    if singular is not None:
        warnings.warn(
            f"The run passes a singular position at t = {singular:.6g} s, where Phi_q loses rank: "
            "constraints have several branches there. Neighbouring designs may leave on others, "
            "or lock: the motion beyond has no derivative then, and the gradient depends on the "
            "steps. Compare two steps, end the run before, or change a length.",
            StabilityWarning,
            stacklevel=4,
        )
