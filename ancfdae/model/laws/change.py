"""Smooth passage from one law to another."""

import math
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import require_positive
from ancfdae.model.design import numbers
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.laws.smooth_step import smooth_step
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Change(Law):
    """One law before, another after: x = (1 - S) before + S after.

    S passes from 0 to 1 as a `Ramp` does, so that three derivatives are continuous. A law in more
    pieces is a change of a change. Design targets: ``before_...`` and ``after_...`` with the names
    of both laws' own, ``duration`` and ``begin``.

    Parameters
    ----------
    before, after : Law
    duration : float
        Of the passage, positive; s.
    begin : float
        s.
    """

    before: Law
    after: Law
    duration: float
    begin: float

    design_fields = (
        ("before", require_law),
        ("after", require_law),
        ("duration", require_positive),
        *numbers("begin"),
    )

    def numbers_of(self, name: str) -> dict[str, float]:
        """Return the numbers of a field; those of a law have the field's name before theirs."""
        values = super().numbers_of(name)
        if not isinstance(getattr(self, name), Law):
            return values
        return {f"{name}_{key}": value for key, value in values.items()}

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Leibniz' rule."""
        before, after, duration, begin = self.split(p)
        x = self.before.derivative(before, t, order)
        for k in range(order + 1):
            rate = order - k
            apart = self.after.derivative(after, t, rate) - self.before.derivative(before, t, rate)
            x = x + math.comb(order, k) * smooth_step(t, begin, duration, k) * apart
        return x
