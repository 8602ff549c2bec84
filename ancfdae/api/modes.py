"""Calls for natural frequencies and shapes, and for a step that follows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ancfdae.api.calls import as_system
from ancfdae.design import DesignVariable
from ancfdae.errors import require_count, require_kind, require_positive
from ancfdae.integrators.start import consistent_start, saddle_point, solve, start_sensitivity
from ancfdae.modes import Configuration, Modes, StepSuggestion, modes_about, suggestion
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.total_derivatives import constraint_force_total, inertia_total
from ancfdae.scene import Scene


def modes(
    model: Scene | MechanicalSystem,
    count: int = 6,
    *,
    at: Configuration | None = None,
    design: Sequence[str | DesignVariable] | None = None,
    damped: bool | None = None,
    highest: bool = False,
) -> Modes:
    """Return natural frequencies and shapes of small motions about a configuration at rest.

    Joints are kept exactly; those that are driven are held.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    count : int
        How many; modes that coincide are not separated, so there may be a few more.
    at : Configuration, optional
        Where; by default the start of the model, at rest, with the multipliers that hold it best.
        If the forces there are not in balance the modes are those of the motion held there: find
        an equilibrium first for the vibrations of a mechanism under load.
    design : sequence of str or DesignVariable, optional
        Design variables of a scene to differentiate in; a mechanical system brings its own.
    damped : bool, optional
        Whether velocity forces count; by default if there are any.
    highest : bool
        Whether the highest modes are wanted instead of the lowest.

    Returns
    -------
    Modes
        Lowest first: growing motions (of an unstable equilibrium), rigid ones (s = 0), then
        vibrations by frequency.

    Raises
    ------
    InvalidInput
        If the input makes no sense.
    """
    require_count("count", count, "Ask for one or more modes.")
    system = as_system(model, design)
    return modes_about(system, _place(system, at), count, highest, damped)


def suggest_step(
    model: Scene | MechanicalSystem,
    per_period: float = 20.0,
    *,
    follow: int | None = 6,
    at: Configuration | None = None,
) -> StepSuggestion:
    """Return a step that resolves the vibrations of a model, and its shortest and longest period.

    Parameters
    ----------
    model : Scene or MechanicalSystem
    per_period : float
        Steps in the shortest period that counts; HHT-I3 errs by about (2 pi / per_period)^2 / 12
        of a turn in each.
    follow : int, optional
        How many motions count, from the slowest; None for all of them. Waves through the sections
        of stiff beams are thousands of times faster than what one wants to see.
    at : Configuration, optional
        As in `modes`.

    Raises
    ------
    InvalidInput
        If the input makes no sense or nothing vibrates.
    """
    require_positive("per_period", per_period)
    if follow is not None:
        require_count("follow", follow, "Follow one motion or more, or None for all.")
    system = as_system(model)
    return suggestion(system, _place(system, at), per_period, follow)


def _place(system: MechanicalSystem, at: Configuration | None) -> Configuration:
    """Return where to linearise."""
    if at is None:
        return _start_at_rest(system)
    require_kind("at", at, (Configuration,), "For example Configuration(q, lam).")
    return at


def _start_at_rest(system: MechanicalSystem) -> Configuration:
    """Return the start with the multipliers of a motion that sets out from rest, joints held.

    They solve M a + Phi_q^T lam = Q, Phi_q a = 0: of all multipliers they leave the least
    unbalanced force M a in the norm of M^-1, and none in an equilibrium.
    """
    matrices, t, rest = saddle_point(system, 0.0), 0.0, np.zeros(system.n_q)
    state = consistent_start(system, matrices, t)
    q = state.q
    factors = matrices.factor(system.mass(q), system.constraint_q(q, t))
    a, lam = solve(factors, system.force(q, rest, t), np.zeros(system.n_lam))
    if not system.n_b:
        return Configuration(q, lam)
    q_b = start_sensitivity(system, matrices, state).q_b
    force = system.force_total(q, rest, t, q_b, np.zeros_like(q_b))
    force = force - inertia_total(system, q, a, q_b)
    force = force - constraint_force_total(system, q, lam, t, q_b)
    lam_b = solve(factors, force, -system.constraint_q_times_total(q, a, t, q_b))[1]
    return Configuration(q, lam, q_b, lam_b)
