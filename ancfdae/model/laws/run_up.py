"""Run up to a rate, which is held."""

from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_positive
from ancfdae.model.design import numbers
from ancfdae.model.laws.law import Law
from ancfdae.model.laws.smooth_step import smooth_step
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class RunUp(Law):
    """At rest before, with a constant rate after: the angle of a motor that runs up and is held.

    The rate is that of a `Ramp` from zero to `rate`, so that at the end of the passage
    x = initial + rate duration/2.

    Parameters
    ----------
    rate : float
    duration : float
        Of the run-up, positive; s.
    initial : float, optional
    begin : float, optional
        s.
    """

    rate: float
    duration: float
    initial: float = 0.0
    begin: float = 0.0

    design_fields = (
        *numbers("rate"),
        ("duration", require_positive),
        *numbers("initial", "begin"),
    )

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Integral of the ramp."""
        rate, duration, initial, begin = p
        x: Array = rate * smooth_step(t, begin, duration, order - 1)
        return initial + x if order == 0 else x
