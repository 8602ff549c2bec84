"""Factors of time that coefficients of driven joints have, of all joints at once."""

from collections.abc import Callable, Sequence
from typing import final

import numpy as np

from ancfdae.assembly.joint_structure import Slot
from ancfdae.numerics.arrays import STEP, Array

_ORDERS = 4


@final
class JointFactors:
    """Factors at instants, (orders, k, n_parts); of the first part, which stays, one and zeros.

    Of a scene without driven joints there is one row for all instants. The last instant is kept:
    an iteration asks for it again and again.
    """

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._slots = [slot for slot in slots if slot.parts.start < slot.parts.stop]
        self._count = 1 + sum(slot.parts.stop - slot.parts.start for slot in self._slots)
        self.driven = len(self._slots) > 0
        self._still = np.eye(_ORDERS, 1)[:, :, None]
        self._last: tuple[float, Array] = np.nan, self._still

    @property
    def active(self) -> set[int]:
        """Design variables that change a factor."""
        return {int(i) for slot in self._slots for i in np.flatnonzero(np.any(slot.item.p_b, 0))}

    @property
    def table(self) -> Callable[[Array, int], Array] | None:
        """What gives the factors at many instants; None where nothing is driven."""
        return self.over if self.driven else None

    def at(self, t: float, orders: int = 1) -> Array:
        """Return the factors at one instant, of so many orders at least."""
        if not self.driven:
            return self._still
        last, factors = self._last
        if t != last or len(factors) < orders:
            factors = self.over(np.array([t]), orders)
            self._last = t, factors
        return factors

    def over(self, t: Array, orders: int = 1) -> Array:
        """Return the factors at many instants."""
        if not self.driven:
            return self._still[:orders]
        each = [[slot.item.factors(t, order).T for order in range(orders)] for slot in self._slots]
        still = np.zeros((orders, len(t), 1))
        still[0] = 1.0
        return np.concatenate([still, *(np.array(x) for x in each)], axis=2)

    def spread(self, t: Array, orders: int = 1) -> Array:
        """Return the factors with a row for every instant."""
        factors = self.over(t, orders)
        return factors if self.driven else np.repeat(factors, len(t), axis=1)

    def partials(self, t: Array, orders: int, n_b: int) -> Array | None:
        """Return the design partials of `spread`, (n_b, orders, k, n_parts), None without any."""
        active = self.active
        if not active:
            return None
        result = np.zeros((n_b, orders, len(t), self._count))
        for slot in self._slots:
            for i in np.flatnonzero(np.any(slot.item.p_b, axis=0)).tolist():
                moved = slot.item.moved(i)
                for order in range(orders):
                    slopes = moved.factors(t, order).imag.T / STEP
                    result[i, order, :, slot.parts] = slopes
        return result
