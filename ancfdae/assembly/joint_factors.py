"""Dependence of the coefficients of all joints on time and on the design."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.joint_structure import JointStructure, Slot
from ancfdae.numerics.arrays import STEP, Array

_ORDERS = 4
# Number of times whose factors are kept; a start and the checks of a run ask for four.
_KEPT = 8
# Tables of factors are kept for as many times: designs of a sweep often share their steps.
_FEW = 1000


@final
class JointFactors:
    """Factors at instants, (orders, k, n_parts); of the first part, which stays, one and zeros.

    Of a scene without driven joints there is one row for all times. Factors at single times and
    short tables are kept: an iteration asks for the same again and again, and so does each design
    of a sweep.
    """

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._slots = [slot for slot in slots if slot.parts.start < slot.parts.stop]
        self._count = 1 + sum(slot.parts.stop - slot.parts.start for slot in self._slots)
        self.driven = len(self._slots) > 0
        self._still = np.eye(_ORDERS, 1)[:, :, None]
        self._known: dict[float, Array] = {}
        self._tables: dict[tuple[bytes, int], Array] = {}

    @property
    def active(self) -> set[int]:
        """Design variables that change a factor."""
        return {int(i) for slot in self._slots for i in np.flatnonzero(np.any(slot.item.p_b, 0))}

    def at(self, t: float, orders: int = 1) -> Array:
        """Return the factors at time t (s) and their time derivatives of order 1 to orders - 1.

        Shape (k, 1, n_factors) with k >= `orders`.
        """
        if not self.driven:
            return self._still
        factors = self._known.get(t)
        if factors is None or len(factors) < orders:
            # A start asks for one order after the other.
            factors = self._over(np.array([t]), orders if factors is None else _ORDERS)
            if len(self._known) >= _KEPT:
                self._known = {}
            self._known[t] = factors
        return factors

    def over(self, t: Array, orders: int = 1) -> Array:
        """Return the factors and their rates at times t, s; one row if no joint is driven."""
        if not self.driven:
            return self._still[:orders]
        return self._table(t, orders)

    def _table(self, t: Array, orders: int) -> Array:
        """Return the table of `over`, or of `by_turn` for zero orders, kept; (orders, k, n)."""
        key = t.tobytes(), orders
        table = self._tables.get(key)
        if table is None:
            table = self._over(t, orders) if orders else self._by_turn(t)
            if len(self._tables) >= _KEPT:
                self._tables = {}
            if len(t) <= _FEW:
                self._tables[key] = table
        return table

    def _over(self, t: Array, orders: int) -> Array:
        each = [[slot.item.factors(t, order).T for order in range(orders)] for slot in self._slots]
        still = np.zeros((orders, len(t), 1))
        still[0] = 1.0
        return np.concatenate([still, *(np.array(x) for x in each)], axis=2)

    def spread(self, t: Array, orders: int = 1) -> Array:
        """Return the factors and rates at times t with one row per time, shape (orders, k, n)."""
        factors = self.over(t, orders)
        return factors if self.driven else np.repeat(factors, len(t), axis=1)

    @cached_property
    def turns(self) -> bool:
        """Whether a joint prescribes an angle."""
        return bool(np.any(self.by_turn(np.zeros(1))))

    def by_turn(self, t: Array) -> Array:
        """Return the derivatives of the factors in prescribed angles, (1, k, n_parts)."""
        return self._table(t, 0)

    def _by_turn(self, t: Array) -> Array:
        each = [slot.item.by_turn(t).T for slot in self._slots]
        return np.concatenate([np.zeros((len(t), 1)), *each], axis=1)[None]

    def turn_rate(self, t: Array) -> Array:
        """Return the largest rate of a prescribed angle, (k,); rad/s."""
        rates = [np.abs(slot.item.turn_rate(t)) for slot in self._slots]
        return np.max([np.zeros(len(t)), *rates], axis=0)

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


@final
@dataclass(frozen=True, eq=False)
class JointPartials:
    """Partials of entries of L and of coefficients, joint by joint that each variable reaches."""

    structure: JointStructure
    factors: JointFactors
    n_b: int

    @cached_property
    def arrays(self) -> tuple[Array, ...]:
        """Arguments of `constraint_totals`: variable, number, first, part, entry, value."""
        numbers, variable, first, changes = [], [0], [0], [(np.zeros(0, dtype=np.int64),) * 3]
        for i in range(self.n_b):
            for number, change in self._reached(i):
                numbers.append(number)
                changes.append(change)
                first.append(first[-1] + len(change[0]))
            variable.append(len(numbers))
        part, entry, value = (np.concatenate(x) for x in zip(*changes, strict=True))
        indices = (np.asarray(x, np.int32) for x in (variable, numbers, first, part, entry))
        return *indices, value.real.astype(float)

    @cached_property
    def active(self) -> list[int]:
        """Design variables that constraints depend on with q held."""
        return np.flatnonzero(np.diff(self.arrays[0])).tolist()

    def _reached(self, i: int) -> list[tuple[int, tuple[Array, Array, Array]]]:
        """Return the joints that variable i changes: index, with parts, entries and values."""
        structure, reached = self.structure, []
        vectors = structure.vectors
        chosen = vectors.variable == i
        changed, change = vectors.changed[chosen], vectors.change[chosen]
        entries = len(vectors.value)
        for number, slot in enumerate(structure.slots):
            ends = vectors.first[[slot.vectors.start * vectors.d, slot.vectors.stop * vectors.d]]
            within = slice(*np.searchsorted(changed, ends).tolist())
            changes = [(np.zeros_like(changed[within]), changed[within], change[within])]
            driven = False
            if i in slot.item.active:
                part, at, value = slot.partials(i)
                changes.append((part, entries + at, value))
                driven = slot.parts.start < slot.parts.stop and bool(np.any(slot.item.p_b[:, i]))
            part, at, value = (np.concatenate(x) for x in zip(*changes, strict=True))
            if driven or len(at):
                reached.append((number, (part, at, value)))
        return reached

    def contract(self, on_l: Array, on_c: Array, t: Array) -> Array:
        """Return partials in b from those in entries of L, (k, n_l), and coefficients, (k, n, n_c).

        The n are orders of time derivatives.
        """
        orders, structure = on_c.shape[1], self.structure
        variable, _, first, part, entry, value = self.arrays
        on_parts = np.einsum("koc,okp->pc", on_c, self.factors.spread(t, orders))
        of_l = entry < on_l.shape[1]
        on_entries = np.where(
            of_l,
            np.sum(on_l, axis=0)[np.where(of_l, entry, 0)] if on_l.size else 0.0,
            on_parts[part, np.where(of_l, 0, entry - on_l.shape[1])] if on_parts.size else 0.0,
        )
        owner = np.repeat(np.arange(self.n_b), first[variable[1:]] - first[variable[:-1]])
        result = np.bincount(owner, value * on_entries, self.n_b)
        factors_b = self.factors.partials(t, orders, self.n_b)
        if factors_b is None:
            return result
        _, at, parts, moving = structure.moving()
        on_factors = np.zeros((factors_b.shape[-1], len(t), orders))
        np.add.at(on_factors, parts, np.moveaxis(on_c[..., at] * moving, -1, 0))
        return np.asarray(result + np.einsum("bokp,pko->b", factors_b, on_factors))
