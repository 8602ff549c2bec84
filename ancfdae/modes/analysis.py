"""From a system and a configuration to its modes."""

from __future__ import annotations

import numpy as np

from ancfdae.modes.configuration import Configuration
from ancfdae.modes.derivatives import differentiate
from ancfdae.modes.linearised import Linearised
from ancfdae.modes.result import Kind, ModeDerivatives, Modes
from ancfdae.modes.solver import coincident, solve
from ancfdae.modes.totals import require_steady
from ancfdae.numerics.arrays import Array
from ancfdae.protocol import MechanicalSystem


def modes_about(
    system: MechanicalSystem, at: Configuration, count: int, highest: bool, damped: bool | None
) -> Modes:
    """Return modes about a configuration; see `ancfdae.modes`.

    Raises
    ------
    InvalidInput
        If the configuration does not fit the system, a motion has no inertia, or derivatives are
        wanted of forces that depend on time.
    """
    small = Linearised.of(system, at, damped)
    if system.n_b:
        require_steady(small)
    pairs = solve(small, count, highest)
    mu = small.multipliers(pairs.z, pairs.X)
    groups = coincident(pairs)
    s = exponents(small, pairs.z)
    derivatives = None
    if system.n_b:
        own = differentiate(small, pairs, mu, groups)
        # A rigid motion of a design stays one: s = 0.
        slope = np.where(s == 0, 0.0, _slope(small, s))[:, None]
        derivatives = ModeDerivatives(system.design_names, slope * own.z_b, own.X_b)
    return Modes(
        s,
        pairs.X,
        mu,
        tuple(map(_kind, s)),
        tuple(tuple(group) for group in groups if len(group) > 1),
        small.at,
        small.unbalanced,
        derivatives,
    )


def exponents(small: Linearised, z: Array) -> Array:
    """Return s with Im s >= 0, or s > 0 where z = -s^2 is negative."""
    if small.D is not None:
        return z
    s = np.sqrt(-z.astype(complex))
    return np.asarray(np.where(s.imag < 0, -s, s))


def _slope(small: Linearised, s: Array) -> Array:
    """Return ds/dz."""
    return np.asarray(np.ones_like(s) if small.D is not None else -0.5 / np.where(s == 0, 1.0, s))


def _kind(s: complex) -> Kind:
    if s == 0:
        return Kind.RIGID
    if s.real > 0:
        return Kind.GROWING
    return Kind.VIBRATION if s.imag else Kind.DECAYING
