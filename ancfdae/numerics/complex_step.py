"""Functions of a user that are differentiated by complex steps: which ones, and which are none."""

from collections.abc import Callable, Sequence

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array

#: Exceptions of functions that cannot work on a complex array, or on a jet.
FAILURES = (TypeError, ValueError, AttributeError, ArithmeticError, IndexError)


def require_derivative(
    where: str, function: Callable[..., Array], x: Sequence[Array], dx: Sequence[Array]
) -> None:
    """Refuse a function whose complex step along dx, of the size of x, is not its derivative.

    Refused is a function that fails on complex numbers, or whose complex step agrees with no
    central difference of six sizes; where no difference is finite, it is accepted.
    """

    def along(s: complex) -> Array:
        return np.asarray(function(*(a + s * da for a, da in zip(x, dx, strict=True))))

    try:
        base, slope = along(0.0), along(1j * STEP).imag / STEP
    except FAILURES as error:
        raise _unsafe(where, f"{type(error).__name__}: {error}") from error
    judged, agreed = np.zeros(base.shape, bool), np.zeros(base.shape, bool)
    with np.errstate(all="ignore"):
        # A function that vanishes with its slope has differences of the order s^2 f(x + dx).
        far = np.abs(along(1.0)) + np.abs(along(-1.0))
        curved = 10.0 * np.where(np.isfinite(far), far, 0.0)
        # Slopes below this are no numbers, or inexact ones, once they are times the step.
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
        "Write it without abs, real, conj, maximum, comparisons or arctan2, with NumPy functions.",
    )
