"""Derivatives of analytic functions of any order, by sums over circles in the complex plane.

One first derivative is a complex step, Im f(i s)/s with s = `STEP` radii: exact to round-off.
Higher and mixed ones need several perturbations at once, and one as small would be lost next to
the imaginary part of another. They come from Cauchy's formula (Lyness & Moler 1967).

For f(z_1, ..., z_p) analytic and real for real arguments, wanted is the derivative of order k in
z_1 and of order 1 in every other argument, at zero. On lines z = r (s, c_2 s, ..., c_p s), with
radii r and numbers c, the terms of total degree K = k + p - 1 are

    s^K sum c_2^{m_2} ... c_p^{m_p} a_m,     m_1 + ... + m_p = K.

The mean over all c_i in the (k+1)-st roots of unity of f / (c_2 ... c_p) keeps the m with every
m_i = 1 modulo k + 1. An m_i above 1 would be k + 2 or more and leave a negative m_1: of degree K
only the wanted term is left. The mean g(s) over s = exp(i pi (2 j + 1)/N) of g(s) s^{-K} is
then its coefficient a, up to

- aliasing: coefficients of degree K + N, 2 N + K, ... with signs. If the nearest singularity lies
  R radii away they are about R^{-N} against f; N = 24 and R > 4 give 4e-15;
- round-off: eps max|f| in a, so eps max|f| K!/r^K in the derivative. At a radius of a quarter of
  the length over which f varies that is 1e-14 for K = 2 and 5e-14 for K = 3.

f takes conjugate values at conjugate arguments, so half of the circle is enough. The
coefficients of highest degree that N points resolve show whether aliasing is round-off; if it is
not, all radii shrink, and a function whose coefficients never decay is refused.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import STEP, Array

# Points on a circle.
_POINTS = 24
_UPPER = np.exp(1j * np.pi * (2 * np.arange(_POINTS // 2) + 1) / _POINTS)
# Coefficients of the highest degrees that count as round-off, against the size of their own
# component and against that of the largest one.
_OWN, _LARGEST = 1e-13, 1e-15
_SHRINKS, _SHRINK = 14, 0.25


def derivative(
    f: Callable[..., Array],
    radii: tuple[float, ...],
    order: int = 1,
    scale: Callable[[], Array] = lambda: np.zeros(1),
    *,
    together: bool = False,
) -> Array:
    """Return the derivative at zero of order `order` in the first argument, 1 in the others.

    f takes as many complex numbers as there are radii, which say how far each may be followed:
    about a quarter of the length over which f varies serves best. `scale` returns values of the
    size of the terms of f. Where these cancel on the whole circle, as those of a constraint do
    along its own motion, only round-off is left, and these values show it; asked for where the
    values on the circle do not explain the residual. `together` says that f takes arrays of
    numbers, and returns a row for each. InvalidInput if f is not analytic.
    """
    of_all = f if together else _one_by_one(f)
    if not math.prod((radii[0] ** order, *radii[1:])) > 0:
        # The state is so large, or not finite, that no circle is small enough: a run diverges.
        return np.full_like(of_all(*np.zeros((len(radii), 1)))[0], np.nan, dtype=float)
    if len(radii) == 1 and order == 1:
        step = STEP * radii[0]
        return np.asarray(np.imag(of_all(np.array([1j * step]))[0]) / step)
    terms = cache(lambda: float(np.max(np.abs(scale()), initial=0.0)))
    for _ in range(_SHRINKS):
        circle = _on_circle(of_all, radii, order)
        # Mostly the values on the circle suffice.
        if circle.resolved(0.0) or circle.resolved(terms()):
            return circle.value
        radii = tuple(_SHRINK * radius for radius in radii)
    raise InvalidInput(
        "functions of the system",
        "must be analytic near the state",
        "values on small circles in the complex plane that fit no power series",
        "Write them with operations that accept complex numbers, without kinks.",
    )


def circle_size(f: Callable[..., Array], radius: float) -> float | None:
    """Largest value on the circle; None if the circle does not resolve f to round-off."""
    circle = _on_circle(_one_by_one(f), (radius,), 1)
    return circle.largest if circle.resolved(0.0) else None


def _one_by_one(f: Callable[..., Array]) -> Callable[..., Array]:
    return lambda *z: np.array([f(*numbers) for numbers in zip(*z, strict=True)])


class _Circle(NamedTuple):
    """The derivative, sizes of the components and of their last coefficients, and the largest."""

    value: Array
    sizes: Array
    tails: Array
    largest: float

    def resolved(self, terms: float) -> bool:
        """Whether aliasing is round-off, of terms that may be larger than the values."""
        allowed = _OWN * self.sizes + _LARGEST * max(self.largest, terms)
        return bool(np.all(self.tails <= allowed) and np.all(np.isfinite(self.value)))


def _on_circle(f: Callable[..., Array], radii: tuple[float, ...], order: int) -> _Circle:
    degree = order + len(radii) - 1
    roots = np.exp(2j * np.pi * np.arange(order + 1) / (order + 1))
    with np.errstate(all="ignore"):
        mean, size = np.zeros(()), np.zeros(())
        for c in product(roots, repeat=len(radii) - 1):
            factors = np.multiply(radii, (1.0, *c))
            values = f(*np.outer(factors, _UPPER))
            size = np.maximum(size, np.max(np.abs(values), axis=0))
            mean = mean + values / np.prod(c)
        mean = mean / len(roots) ** (len(radii) - 1)
        last = np.arange(3 * _POINTS // 4, _POINTS)
        tails = np.max(np.abs(_coefficients(mean, last)), axis=0)
        value = _coefficients(mean, np.array([degree]))[0]
        value = value * (math.factorial(order) / (radii[0] ** order * math.prod(radii[1:])))
    return _Circle(value, size, tails, float(np.max(size, initial=0.0)))


def _coefficients(values: Array, degrees: Array) -> Array:
    """Coefficients of the power series with values on the upper half circle."""
    powers = _UPPER[None, :] ** -degrees[:, None]
    return np.asarray(np.real(np.tensordot(powers, values, axes=1)) * (2 / _POINTS))


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


def _unsafe(where: str, got: str) -> InvalidInput:
    return InvalidInput(
        where,
        "must be differentiable by a complex step",
        got,
        "Write it without abs, real, conj, maximum, comparisons or arctan2, with NumPy functions.",
    )
