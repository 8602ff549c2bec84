"""A number that stays."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.model.design import numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Constant(Law):
    """x = value."""

    value: float

    design_fields = numbers("value")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Value, then zero."""
        return p[0] * np.full_like(t, order == 0, dtype=float)
