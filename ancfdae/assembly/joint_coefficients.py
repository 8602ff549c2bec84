"""Coefficients of all joints, flat and as functions of time.

Those of driven joints are sums over factors that depend on time; of all others they are constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.joint_input import JointInput
from ancfdae.model.joints import DrivenJoint
from ancfdae.model.naming import JointLayout
from ancfdae.numerics.arrays import Array, only


@final
@dataclass(frozen=True)
class Values:
    """Flat coefficients of all joints at an instant, or with a leading axis at many.

    Of the parts of a driven scene the leading axis counts the factors, the constant one first.
    """

    a: Array
    s: Array
    offset: Array

    def times(self, factors: Array) -> Values:
        """Return the sum over parts, for each row of factors."""
        return Values(factors @ self.a, factors @ self.s, factors @ self.offset)


@final
@dataclass(frozen=True)
class Slot:
    """A joint, its rows in Phi and its vectors in U, and where its coefficients are not zero.

    `linear` and `bilinear` are indices of the entries, those of one half of the symmetric matrix.
    """

    item: JointInput
    rows: slice
    vectors: slice
    linear: tuple[Array, Array, Array]
    bilinear: tuple[Array, Array, Array]

    @cached_property
    def parts(self) -> list[Values]:
        """The flat coefficients, of the constant part first."""
        _, i, j = self.bilinear
        # Both halves of the symmetric matrix in one entry, 1/2 on the diagonal.
        half = np.where(i == j, 0.5, 1.0)
        return [
            Values(c.linear[self.linear], c.bilinear[self.bilinear] * half, c.offset)
            for c in self.item.parts()
        ]

    def moved(self, i: int) -> Slot:
        """Return the joint moved in design variable i by an imaginary step."""
        return replace(self, item=self.item.moved(i)) if i in self.item.active else self

    def changes(self, i: int) -> bool:
        """Tell whether a design variable changes the coefficients with all vectors held."""
        if i not in self.item.active:
            return False
        if isinstance(self.item.joint, DrivenJoint) and np.any(self.item.p_b[:, i]):
            return True
        parts = self.moved(i).parts
        return any(bool(np.any(x.imag)) for c in parts for x in (c.a, c.s, c.offset))


@final
@dataclass(frozen=True)
class Entries:
    """Where linear (a) and bilinear (s) coefficients stand.

    `a_row` and `s_row` are rows of Phi, `a_at` components of U, counted through all vectors, s_i
    and s_j the vectors of the product.
    """

    a_row: Array
    a_at: Array
    s_row: Array
    s_i: Array
    s_j: Array

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """All five."""
        return self.a_row, self.a_at, self.s_row, self.s_i, self.s_j

    def only(self, rows: Array) -> Entries:
        """Return those of some rows, a mask of shape (n_lam,)."""
        a, s = rows[self.a_row], rows[self.s_row]
        return Entries(self.a_row[a], self.a_at[a], self.s_row[s], self.s_i[s], self.s_j[s])


def structure(
    inputs: Sequence[JointInput], d: int
) -> tuple[list[Slot], Entries, tuple[JointLayout, ...]]:
    """Find where coefficients of joints do not vanish, and number rows and vectors."""
    row = vector = 0
    empty = np.zeros(0, dtype=np.int64)
    found, joints, slots = [(empty,) * 5], [], []
    for item in inputs:
        c = item.structure()
        r, i, axis = np.nonzero(c.linear)
        s_r, s_i, s_j = np.nonzero(np.triu(c.bilinear))
        found.append((row + r, (vector + i) * d + axis, row + s_r, vector + s_i, vector + s_j))
        count, n = len(c.offset), len(item.reference)
        joints.append(JointLayout(item.joint.name, row, count, item.joint.holds_position))
        rows, own = slice(row, row + count), slice(vector, vector + n)
        slots.append(Slot(item, rows, own, (r, i, axis), (s_r, s_i, s_j)))
        row, vector = row + count, vector + n
    entries = Entries(*(np.concatenate(column) for column in zip(*found, strict=True)))
    return slots, entries, tuple(joints)


@final
class Coefficients:
    """Coefficients of some joints at any instant; n_lam counts the rows of all joints.

    `driven` tells whether any depends on time, `turning` whether those of products do.
    """

    def __init__(self, slots: Sequence[Slot], n_lam: int) -> None:
        self._slots = slots
        self.driven = any(isinstance(slot.item.joint, DrivenJoint) for slot in slots)
        self.parts = self._collect(n_lam)
        self.turning = bool(np.any(self.parts.s[1:]))
        self._last: tuple[float, Values] | None = None

    def _collect(self, n_lam: int) -> Values:
        """Flatten the coefficients of all joints onto the structure, the parts as rows."""
        each = [slot.parts for slot in self._slots]
        count = 1 + sum(len(parts) - 1 for parts in each)
        dtype = np.result_type(float, *(parts[0].a for parts in each))
        sizes = (sum(len(c.a) for c, *_ in each), sum(len(c.s) for c, *_ in each), n_lam)
        flat = Values(*(np.zeros((count, size), dtype) for size in sizes))
        a = s = 0
        factor = 1
        for slot, parts in zip(self._slots, each, strict=True):
            to_a, to_s = slice(a, a + len(parts[0].a)), slice(s, s + len(parts[0].s))
            factors = range(factor, factor + len(parts) - 1)
            for k, c in zip((0, *factors), parts, strict=True):
                flat.a[k, to_a], flat.s[k, to_s], flat.offset[k, slot.rows] = c.a, c.s, c.offset
            a, s, factor = to_a.stop, to_s.stop, factors.stop
        return flat

    @cached_property
    def _still(self) -> Values:
        return self.parts.times(np.ones(1))

    @cached_property
    def _zero(self) -> Values:
        return self.parts.times(np.zeros(1))

    @property
    def is_complex(self) -> bool:
        """Whether coefficients carry a complex perturbation."""
        return np.iscomplexobj(self.parts.a)

    def at(self, t: float, order: int = 0) -> Values:
        """Coefficients, or their time derivatives, at one instant."""
        if not self.driven:
            return self._still if order == 0 else self._zero
        if order == 0 and self._last is not None and self._last[0] == t:
            return self._last[1]
        many = self.over(np.array([t]), order)
        values = Values(only(many.a), only(many.s), only(many.offset))
        if order == 0:
            self._last = (t, values)
        return values

    def over(self, t: Array, order: int = 0) -> Values:
        """Coefficients at many instants; one row where they do not depend on time."""
        return self.parts.times(self.factors(t, order)) if self.driven else self.parts

    def factors(self, t: Array, order: int) -> Array:
        """Return the factors of the parts, or their time derivatives, shape (k, n_parts)."""
        still = np.full((1, len(t)), float(order == 0))
        return np.concatenate([still, *(slot.item.factors(t, order) for slot in self._slots)]).T

    def series(self, t: float, count: int) -> list[Values]:
        """Coefficients and their time derivatives."""
        return [self.at(t, order) for order in range(count)]
