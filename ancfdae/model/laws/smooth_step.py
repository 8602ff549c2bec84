"""Passage from zero to one of which three time derivatives are continuous."""

from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from ancfdae.numerics.arrays import Array

# The polynomial of least degree from 0 to 1 whose first three derivatives vanish at both ends.
_STEP = Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
_ORDERS = {order: _STEP.deriv(order) for order in range(4)} | {-1: _STEP.integ()}


def smooth_step(t: Any, begin: complex, duration: complex, order: int) -> Array:
    """Return 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7, s = (t - begin)/duration held between 0 and 1.

    Its time derivative of this order, 0 to 3, or -1 for its integral from `begin`.
    """
    s = (t - begin) / duration
    held = np.where(s.real < 0, 0.0, np.where(s.real > 1, 1.0, s))
    x: Array = _ORDERS[order](held)
    if order == -1:
        x = x + np.where(s.real > 1, s - 1.0, 0.0)
    return x / duration**order
