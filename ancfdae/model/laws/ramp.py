"""Smooth passage from one value to another."""

from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_positive
from ancfdae.model.design import numbers
from ancfdae.model.laws.law import Law
from ancfdae.model.laws.smooth_step import smooth_step
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Ramp(Law):
    """From one value to another between two times, constant before and after.

    With s = (t - begin)/duration, held between 0 and 1:
    x = initial + (final - initial) (35 s^4 - 84 s^5 + 70 s^6 - 20 s^7). Three derivatives are
    continuous.

    Parameters
    ----------
    initial, final : float
    duration : float
        Positive; s.
    begin : float, optional
        s.
    """

    initial: float
    final: float
    duration: float
    begin: float = 0.0

    design_fields = (
        *numbers("initial", "final"),
        ("duration", require_positive),
        *numbers("begin"),
    )

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Polynomial of degree seven on the way."""
        initial, final, duration, begin = p
        x: Array = (final - initial) * smooth_step(t, begin, duration, order)
        return initial + x if order == 0 else x
