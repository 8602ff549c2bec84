"""Smooth passage from one value to another."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.polynomial import Polynomial

from ancfdae.errors import require_positive
from ancfdae.model.design import numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array

# The polynomial of least degree from 0 to 1 whose first three derivatives vanish at both ends.
_STEP = Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
_STEPS = tuple(_STEP.deriv(order) for order in range(4))


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
        s = (t - begin) / duration
        s = np.where(s.real < 0, 0.0, np.where(s.real > 1, 1.0, s))
        x: Array = (final - initial) * _STEPS[order](s) / duration**order
        return initial + x if order == 0 else x
