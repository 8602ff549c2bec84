"""From a system and a configuration to its modes."""

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.modes.adjoint import PullBack
from ancfdae.modes.configuration import LinearisationPoint
from ancfdae.modes.derivatives import differentiate, differentiate_back
from ancfdae.modes.linearised import Linearised
from ancfdae.modes.pairs import coincident
from ancfdae.modes.result import ModeDerivatives, ModeKind, Modes
from ancfdae.modes.solver import GROUP, solve
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.statics.outcome import motions_in_words


def modes_about(
    system: MechanicalSystem,
    at: LinearisationPoint,
    count: int,
    highest: bool,
    damped: bool | None,
    pull_back: PullBack | None,
    saddle: SaddlePoint | None,
    mass: Factorization | None,
) -> Modes:
    """Return modes about a configuration; InvalidInputError if it does not fit, or without inertia.

    Velocity forces count if `damped`, by default if there are any. `pull_back` takes derivatives in
    q, lam and b back to the design; without it they go forward, along those of the configuration.
    """
    small = Linearised.of(system, at, damped, saddle, mass)
    pairs = solve(small, count, highest, whole=system.n_b > 0)
    mu = small.multipliers(pairs.z, pairs.X)
    groups = coincident(pairs)
    s, derivatives = exponents(small, pairs.z), None
    shown = len(s) if len(s) <= count + GROUP else count
    if system.n_b:
        parts = small, pairs, mu, groups
        back = pull_back
        z_b, X_b = differentiate(*parts) if back is None else differentiate_back(*parts, back)
        s_b = _exponents_b(small, s, z_b)
        derivatives = ModeDerivatives(system.design_names, s_b[:shown], X_b[:shown])
    s, X = s[:shown], pairs.X[:, :shown]
    rigid = X[:, s == 0].real
    within = [tuple(j for j in group if j < shown) for group in groups]
    cut = [part for group, part in zip(groups, within, strict=True) if 0 < len(part) < len(group)]
    return Modes(
        s,
        X,
        mu[:, :shown],
        tuple(map(_kind, s)),
        tuple(part for part in within if len(part) > 1),
        cut[0] if cut else (),
        small.at,
        small.unbalanced,
        motions_in_words(system.naming, at.q, rigid) if rigid.size else "",
        derivatives,
    )


def exponents(small: Linearised, z: Array) -> Array:
    """Return s with Im s >= 0, or s > 0 where z = -s^2 is negative."""
    if small.D is not None:
        return z
    s = np.sqrt(-z.astype(complex))
    return np.asarray(np.where(s.imag < 0, -s, s)) + 0.0  # No -0.


def _exponents_b(small: Linearised, s: Array, z_b: Array) -> Array:
    """Return the design derivatives s_b, shape (count, n_b); zero for rigid motions."""
    if small.D is not None:
        return z_b
    s, infinite = s[:, None], np.isinf(z_b)
    s_b = -0.5 * np.where(infinite, 0.0, z_b) / np.where(s == 0, 1.0, s)
    return np.where(infinite, np.inf, np.where(s == 0, 0.0, s_b))


def _kind(s: complex) -> ModeKind:
    if s == 0:
        return ModeKind.RIGID
    if s.real > 0:
        return ModeKind.GROWING
    return ModeKind.VIBRATION if s.imag else ModeKind.DECAYING
