"""States with their rates as one value that can be moved, and directions of them."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import Array

# Imaginary parts that exceed both, the first relative to the real parts, are too large
# for a complex step. Real parts may pass through zero, so a relative limit alone is not enough.
_RELATIVE, _ABSOLUTE = 1e-12, 1e-20


#: (q, v, a, lam) at an instant, or their derivatives.
States: TypeAlias = tuple[Array, Array, Array, Array]


class Direction(NamedTuple):
    """A direction of (t, q, v): along the motion it is (1, v, a)."""

    t: float
    q: Array
    v: Array


class Motion(NamedTuple):
    """State at one instant, or a change of it; what a quantity does not depend on is zero.

    t is real in the protocol, and complex only while derivatives are taken.
    """

    q: Array
    v: Array
    a: Array
    lam: Array
    t: Any

    def at(self, s: complex) -> Motion:
        """Move on by the time s with the acceleration held."""
        q = self.q + s * (self.v + (0.5 * s) * self.a)
        return Motion(q, self.v + s * self.a, self.a, self.lam, self.t + s)

    def plus(self, e: complex, change: Motion) -> Motion:
        """Return the motion plus e times a change of it."""
        return Motion(*(x + e * dx for x, dx in zip(self, change, strict=True)))

    @property
    def is_zero(self) -> bool:
        """Whether every array of the motion is zero."""
        return not any(np.any(x) for x in self)

    def parts(self) -> tuple[Motion, Motion]:
        """Return the real part, and the imaginary part as a change; see `require_perturbation`."""
        # Everything is linear in a and lam, where any complex number is treated exactly.
        require_perturbation("q", self.q)
        require_perturbation("v", self.v)
        return Motion(*map(np.real, self)), Motion(*map(np.imag, self))


def require_perturbation(name: str, x: Array) -> None:
    """Refuse complex numbers whose imaginary part is too large for a complex step."""
    if x.dtype.kind != "c":
        return
    size, imaginary = (np.max(np.abs(part), initial=0.0) for part in (x.real, x.imag))
    if imaginary > max(_RELATIVE * size, _ABSOLUTE):
        raise InvalidInput(
            f"ComplexStepSystem, {name}",
            "complex values must be those of a complex step",
            f"an imaginary part of {imaginary:.3g} beside {size:.3g}",
            "Use steps of 1e-40, as ComplexStep does.",
        )
