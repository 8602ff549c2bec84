"""Derivatives of a user's functions by complex steps, and by extrapolated differences.

A function is checked for a complex step that is its derivative (`require_derivative`). First
derivatives from real values alone are central differences, extrapolated (Ridders 1982). Differences
of steps h, h/c, h/c^2, ... have errors in even powers of h, which Neville's scheme removes one by
one. Truncation falls from row to row while round-off grows; they balance at the entry that changed
least against its neighbours. With values good to eps it is good to about 1e-11, ten times better
than a plain central difference at its best step.
"""

import warnings
from collections.abc import Callable, Sequence

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array

#: Exceptions of functions that cannot work on a complex array, or on a jet.
FAILURES = (TypeError, ValueError, AttributeError, ArithmeticError, IndexError)


def require_derivative(
    where: str, function: Callable[..., Array], x: Sequence[Array], dx: Sequence[Array]
) -> None:
    """Raise InvalidInputError unless a function's complex step along dx is its derivative.

    dx has the size of x. The function must accept complex numbers, and its complex step must agree
    with a central difference of one of six sizes; where no difference is finite, it is accepted.
    """

    def along(s: complex) -> Array:
        return np.asarray(function(*(a + s * da for a, da in zip(x, dx, strict=True))))

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            base, slope = along(0.0), along(1j * STEP).imag / STEP
    except (*FAILURES, np.exceptions.ComplexWarning) as error:
        raise _unsafe(where, f"{type(error).__name__}: {error}") from error
    judged, agreed = np.zeros(base.shape, bool), np.zeros(base.shape, bool)
    with np.errstate(all="ignore"):
        # A function that vanishes with its slope has differences of the order s^2 f(x + dx).
        far = np.abs(along(1.0)) + np.abs(along(-1.0))
        curved = 10.0 * np.where(np.isfinite(far), far, 0.0)
        # Slopes below this underflow, or lose digits, when multiplied by the step.
        lost = np.finfo(float).tiny / STEP
        for s in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8):
            difference = (along(s) - along(-s)).real / (2 * s)
            # A difference carries the round-off of the values over its size.
            allowed = 1e-3 * np.abs(slope) + 1e-15 * np.abs(base) / s + curved * s**2 + lost
            judged |= np.isfinite(difference) & np.isfinite(slope)
            agreed |= np.abs(difference - slope) <= allowed
    if np.any(judged & ~agreed):
        raise _unsafe(where, "a complex step that differs from the finite difference")


def _unsafe(where: str, got: str) -> InvalidInputError:
    return InvalidInputError(
        where,
        "must be differentiable by a complex step",
        got,
        "Write it without abs, real, conj, maximum, comparisons or arctan2, and without arrays of "
        "floats that are filled in, or pass a table and its derivative as an ExternalFunction.",
    )


# Steps of the differences, for functions that vary over arguments of the order of one.
_DIVISOR = 1.6
_STEPS = tuple(0.05 / _DIVISOR**k for k in range(6))


# Scales of the argument, tried in this order, and the relative change that ends the trials.
_SCALES = tuple(4.0 ** (k * sign) for k in range(20) for sign in (1, -1)[: 1 + (k > 0)])
_GOOD = 1e-9
# With larger relative changes the differences are round-off.
_RESOLVED = 1e-2


def real_derivative(f: Callable[[float], Array]) -> Array:
    """Return f'(0) of a function that varies over arguments of the order of one; shape of f.

    Every entry of the array is extrapolated as long as that reduces its error.
    """
    return _extrapolated(f)[0]


def scaled_derivative(f: Callable[[float], Array]) -> Array:
    """Return f'(0), shape of f, of a function that varies over arguments of unknown order.

    The scale of the argument is found by trial.
    """
    best, least, value = np.zeros(()), np.inf, np.max(np.abs(f(0.0)), initial=0.0)
    with np.errstate(all="ignore"):
        for scale in _SCALES:
            found, change = _extrapolated(lambda s, scale=scale: f(scale * s))  # type: ignore[misc]
            # Differences carry the round-off of the values, which may exceed them.
            error = np.max(change, initial=0.0) + np.finfo(float).eps * value
            size = np.max(np.abs(found), initial=0.0)
            if error < least * size:
                best, least = found / scale, error / size
            if least <= _GOOD:
                return best
    # If differences are round-off at every scale, the function is constant.
    return best if least < _RESOLVED else np.zeros_like(found)


def _extrapolated(f: Callable[[float], Array]) -> tuple[Array, Array]:
    """Return extrapolated central differences of f at 0 and their last change, by entry."""
    before: list[Array] = []
    best, change = np.zeros(()), np.array(np.inf)
    for step in _STEPS:
        row = [(np.asarray(f(step)) - np.asarray(f(-step))) / (2 * step)]
        for k, old in enumerate(before):
            gain = _DIVISOR ** (2 * (k + 1))
            new = (gain * row[k] - old) / (gain - 1)
            moved = np.maximum(np.abs(new - row[k]), np.abs(new - old))
            best = np.where(moved < change, new, best)
            change = np.minimum(moved, change)
            row.append(new)
        before = row
    return best, change
