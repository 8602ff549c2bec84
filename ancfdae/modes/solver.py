"""Eigenvalues of small motions: as many as asked for, of any kind."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.modes.damped import damped
from ancfdae.modes.linearised import Linearised
from ancfdae.modes.pairs import Eigenpairs, coincident
from ancfdae.modes.precise import NoModes
from ancfdae.modes.undamped import undamped

# A group of modes that coincide is completed by at most GROUP modes beyond those asked for, as a
# pair of a square bar is; a larger group is cut. Where it is differentiated its end is sought up to
# _CROWD modes: a minute.
GROUP, _CROWD = 8, 800


def solve(small: Linearised, count: int, highest: bool, whole: bool = False) -> Eigenpairs:
    """Return the lowest modes, growing ones first, or the highest, by falling frequency.

    A group of modes that coincide has all of them if it is asked for `whole`, or ends within GROUP
    modes more. InvalidInputError if nothing can move, or a motion has no inertia; NoModes if ARPACK
    finds none, or the end of a whole group is more than _CROWD modes away.
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
        # Rigid motions are all sought: where they have no end round-off has taken the others.
        if not whole and wanted > asked + GROUP and first.z[-1] != 0:
            return first
        wanted = min(max(2 * wanted, asked + GROUP + 1), n)
        if wanted > asked + _CROWD:
            _refuse_crowd(small, first)


def _refuse_crowd(small: Linearised, pairs: Eigenpairs) -> None:
    """Refuse a last group of modes that coincide, whose end is far."""
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
