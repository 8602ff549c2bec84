"""Sizes that derivatives reach in a run, which error control of them needs beforehand.

Derivatives in parameters start from zero, so that the start does not tell their sizes S_j
(`tolerance`), but a run before does.
"""

from collections.abc import Callable

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.problem import Scales
from ancfdae.numerics.arrays import Array

_TWICE = 2.0
# A change of the design by its own size that moves the coordinates by less than this part of
# theirs is none (measured where the influence is zero, E = 1e7 to 1e13 Pa: 1e-15 at most).
_ROUND_OFF = 1e-12


def with_own_sizes(rough: Solution, run: Callable[[Array], Solution], scales: Scales) -> Solution:
    """Repeat a run until its derivatives have the sizes that it was controlled under.

    They come from a rough run under error control of the motion alone. Where that had them too
    large the tolerance was too loose; then the sizes found count, and all is run again.
    """
    solution, sizes_b = rough, None
    while solution.outcome.verdict is not Verdict.INTERRUPTED:
        assert solution.sensitivities is not None
        shown = derivative_sizes(scales, solution.sensitivities.q_b)
        if sizes_b is None:
            # A rough run that broke off may have seen the beginning of a derivative only.
            sizes_b = shown if solution.outcome.success else np.full(len(shown), np.inf)
        elif not solution.outcome.success or sizes_hold(sizes_b, shown):
            break
        else:
            sizes_b = smaller_sizes(sizes_b, shown)
        solution = run(sizes_b)
    return solution


def derivative_sizes(scales: Scales, q_b: Array) -> Array:
    """Return S_j of the derivatives of a run, shape (n_t, n_q, n_b).

    Infinite if they are not finite, and zero if they are round-off.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        squares = mean_squares(q_b, scales.q)
        sizes = np.sqrt(np.max(squares, axis=0, initial=0.0))
    sizes = np.where(np.isfinite(sizes), sizes, np.inf)
    return np.where(sizes * scales.b > _ROUND_OFF, sizes, 0.0)


def mean_squares(x: Array, sizes: Array) -> Array:
    """Return means of (x / sizes)^2 over coordinates, shape (n, n_q, ...) to (n, ...)."""
    rows = x if x.ndim == 2 else np.moveaxis(x, 1, -1)
    return np.asarray(np.square(rows) @ (1 / (sizes**2 * x.shape[1])))


def sizes_hold(assumed: Array, shown: Array) -> bool:
    """Whether sizes under which a run was controlled are at most twice those it shows.

    Round-off has no size to compare with, and no error either.
    """
    return bool(np.all((shown == 0) | ((assumed > 0) & (assumed <= _TWICE * shown))))


def smaller_sizes(assumed: Array, shown: Array) -> Array:
    """Return the smaller ones; zero, which bounds nothing, counts as none.

    Where `sizes_hold` is false one of them at least falls to half or stops being zero, which none
    becomes again, so that repeating a run ends.
    """
    smaller = np.where(assumed > 0, np.minimum(assumed, shown), shown)
    return np.where(shown > 0, smaller, assumed)
