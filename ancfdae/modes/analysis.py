"""Modes of a system about a configuration: the requested number, of all kinds."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.modes.damped import damped
from ancfdae.modes.derivatives import PullBack, differentiate, differentiate_back
from ancfdae.modes.eigenpairs import Eigenpairs, coincident
from ancfdae.modes.linearised import LinearisationPoint, Linearised
from ancfdae.modes.precise import NoModes
from ancfdae.modes.result import ModeDerivatives, ModeKind, Modes
from ancfdae.modes.undamped import undamped
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.statics.outcome import motions_in_words

# A group of coinciding modes, such as a pair of a square bar, is completed by at most GROUP modes
# beyond the requested number; a larger group is cut. If modes are differentiated the end of the
# group is searched up to _CROWD modes, which takes a minute.
GROUP, _CROWD = 8, 800


def solve(small: Linearised, count: int, highest: bool, whole: bool = False) -> Eigenpairs:
    """Return the lowest modes, growing ones first, or the highest, by decreasing frequency.

    A group of coinciding modes is complete if `whole`, or if it ends within GROUP further modes.
    InvalidInputError if no motion is free, or a motion has no inertia; NoModes if ARPACK finds
    none, or the end of a whole group is more than _CROWD modes away.
    """
    asked, n = min(count, small.n_modes), small.n_modes
    if n <= 0:
        raise InvalidInputError(
            "modes", "need a motion that the joints leave free", "none", "Remove a joint or clamp."
        )
    wanted = min(asked + 2, n)
    while True:
        method = partial(undamped, asked=asked) if small.D is None else damped
        try:
            pairs = method(small, wanted, highest)
        except scipy.sparse.linalg.ArpackError as error:
            raise NoModes(f"{wanted} modes: {error}. Ask for another number.") from error
        first = pairs.first(asked)
        if len(first.z) < len(pairs.z) or wanted == n:
            return first
        # All rigid motions are searched: if they do not end, the other modes are below round-off.
        if not whole and wanted > asked + GROUP and first.z[-1] != 0:
            return first
        wanted = min(max(2 * wanted, asked + GROUP + 1), n)
        if wanted > asked + _CROWD:
            _refuse_crowd(small, first)


def _refuse_crowd(small: Linearised, pairs: Eigenpairs) -> None:
    """Raise NoModes for a last group of coinciding modes that is too large."""
    alone = coincident(pairs)[-1][0]
    repairs = [f"ask for {alone} modes or fewer"] if alone else []
    repairs += ["pass damped=False"] if np.iscomplexobj(pairs.z) else []
    raise NoModes(
        f"mode {alone}: more than {len(pairs.z) - alone - 1} others coincide with it to round-off"
        + small.words(
            ", as motions that creep do next to -1 over the retardation time. Leave out the design "
            "variables, use fewer elements",
            ". Change the design so that they differ by more than a millionth of themselves",
        )
        + f"{''.join(f', or {repair}' for repair in repairs)}."
    )


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
    """Return modes about a configuration; InvalidInputError if it does not fit the system.

    Also if a motion has no inertia. Velocity forces are included if `damped`, by default if there
    are any. `pull_back` maps derivatives in q, lam and b to the design (adjoint); without it modes
    are differentiated directly, along the derivatives of the configuration.
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
    """Return the exponents s with Im s >= 0, or s > 0 if z = -s^2 is negative, shape (count,)."""
    if small.D is not None:
        return z
    s = np.sqrt(-z.astype(complex))
    return np.asarray(np.where(s.imag < 0, -s, s)) + 0.0  # Adding zero turns -0 into 0.


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
