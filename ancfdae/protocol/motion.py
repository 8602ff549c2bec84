"""States with their rates as one value that can be moved, for derivatives along motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self, final

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import Array

# Imaginary parts that exceed both, the first relative to the real parts, are too large
# for a complex step. Real parts may pass through zero, so a relative limit alone is not enough.
_RELATIVE, _ABSOLUTE = 1e-12, 1e-20


@final
@dataclass(frozen=True)
class Motion:
    """State at one instant, or a change of it; what a quantity does not depend on is zero.

    t is real in the protocol, and complex only while derivatives are taken.
    """

    q: Array
    v: Array
    a: Array
    lam: Array
    t: Any

    def at(self, s: complex) -> Self:
        """Move on by the time s with the acceleration held."""
        q = self.q + s * (self.v + (0.5 * s) * self.a)
        return type(self)(q, self.v + s * self.a, self.a, self.lam, self.t + s)

    def plus(self, e: complex, change: Self) -> Self:
        """Add e times a change."""
        return type(self)(
            self.q + e * change.q,
            self.v + e * change.v,
            self.a + e * change.a,
            self.lam + e * change.lam,
            self.t + e * change.t,
        )

    @property
    def is_zero(self) -> bool:
        """Whether every part is zero."""
        return not any(np.any(x) for x in (self.q, self.v, self.a, self.lam, self.t))

    def parts(self) -> tuple[Self, Self]:
        """Return the real part, and the imaginary part as a change; see `require_perturbation`."""
        values = (self.q, self.v, self.a, self.lam)
        # Everything is linear in a and lam, where any complex number is treated exactly.
        require_perturbation("q", self.q)
        require_perturbation("v", self.v)
        q, v, a, lam = values
        real = type(self)(q.real, v.real, a.real, lam.real, np.real(self.t))
        return real, type(self)(q.imag, v.imag, a.imag, lam.imag, np.imag(self.t))


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
