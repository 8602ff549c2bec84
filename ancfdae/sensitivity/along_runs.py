"""Checks along a run that is to be differentiated: where its derivatives would mean nothing.

Functions of a user that are called with complex numbers must be analytic at the states of the run,
and constraints must keep full rank.
"""

from __future__ import annotations

import warnings

import numpy as np

from ancfdae.equations import ErrorEstimates, MechanicalSystem
from ancfdae.errors.kinds import StabilityWarning
from ancfdae.integrators.prescribed_motion import nearest_to_singular, singular_position
from ancfdae.integrators.recorder import Rows
from ancfdae.numerics.arrays import Array

# Number of states, evenly spaced in the run, at which called functions are tried.
_STATES = 64
# Nearness to a singular position, relative to the best in a run, from which errors are said to be
# amplified there; and amplified errors, relative to the coordinates, that are warned of.
_NEAR, _WRONG = 5.0, 0.05
# Entries of Phi_q up to which singular values are taken.
_DENSE = 100_000


def require_differentiable(
    system: MechanicalSystem,
    t: Array,
    q: Array,
    v: Array,
    errors: ErrorEstimates | None = None,
) -> None:
    """Check states at times t, shape (k,), with q and v, shape (k, n_q), of a run with `errors`.

    InvalidInputError if a called function is not analytic at one of them; StabilityWarning if a
    step passes over a singular position, or if errors are large beside one.
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
    else:
        # Errors of derivatives grow twice: from errors of the motion, and by themselves.
        warn_near_singular(system, Rows(t, q, v), errors, 2, stacklevel=5)


def warn_near_singular(
    system: MechanicalSystem,
    rows: Rows,
    errors: ErrorEstimates | None,
    power: int = 1,
    stacklevel: int = 3,
) -> None:
    """Warn of a run whose estimated errors are large where constraints nearly lose rank.

    Along the free motion errors grow there by the nearness to the singular position, to the given
    power (docs/theory/13-errors.md).
    """
    if errors is None or system.traits.linear_constraints or not system.n_lam:
        return
    if not system.has_loops or system.n_lam * system.n_q > _DENSE or np.iscomplexobj(rows.q):
        return
    if not _WRONG * 1e-2 < errors.motion < np.inf:
        return
    time, nearness = nearest_to_singular(system, rows)
    if nearness < _NEAR or errors.motion * nearness**power < _WRONG:
        return
    of = "derivatives" if power > 1 else "positions"
    warnings.warn(
        f"The motion passes near a singular position at t = {time:.6g} s, where Phi_q is "
        f"{nearness:.2g} times nearer to losing rank than elsewhere: errors of the run, estimated "
        f"at {errors.motion:.2g} of the size of the coordinates, grow there, in {of} to "
        f"{errors.motion * nearness**power:.2g} and more. Take shorter steps, or rtol, and compare "
        "two of them.",
        StabilityWarning,
        stacklevel=stacklevel,
    )
