"""One load as numbers, and its force with derivatives by operations of NumPy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.vectors import Vectors
from ancfdae.model.loads import Load
from ancfdae.numerics.arrays import STEP, Array


@final
@dataclass(frozen=True)
class LoadInput:
    """One load with its vectors, parameters, (n_p,), and vectors of the reference, (n_v, d)."""

    load: Load
    vectors: Vectors
    p: Array
    p_b: Array
    reference: Array
    reference_b: dict[int, Array]

    @property
    def uses_velocity(self) -> bool:
        """Whether the force depends on velocities at these design variables."""
        names = self.load.parameters()
        driven = [name for name, row in zip(names, self.p_b, strict=True) if np.any(row)]
        return self.load.uses_velocity(driven)

    def factor(self, t: Array, order: int) -> Array:
        """Return the law of time or its derivative; shape as t."""
        return self.load.factor(self.p, t, order)

    def force(self, U: Array, V: Array) -> Array:
        """Return the forces on the vectors, without the law."""
        F: Array = self.load.force(U, V, self.p, self.reference)
        return F

    @cached_property
    def pairs(self) -> tuple[Array, Array]:
        """All pairs of entries of L in the order of their rows, as tangents take them."""
        row = self.rows
        i, j = (x.ravel() for x in np.indices((len(row), len(row))))
        order = np.lexsort((j, i, row[j], row[i]))
        return i[order], j[order]

    @property
    def rows(self) -> Array:
        """Row of every entry of L."""
        first = self.vectors.first
        return np.repeat(np.arange(len(first) - 1), np.diff(first))

    @property
    def couplings(self) -> tuple[Array, Array]:
        """Rows and columns of what tangents have, pair by pair."""
        i, j = self.pairs
        return self.vectors.column[i], self.vectors.column[j]

    @property
    def active(self) -> list[int]:
        """Design variables that the force depends on with q and v held."""
        moving = np.flatnonzero(np.any(self.p_b, axis=0) | self.vectors.moves)
        return sorted({*moving.tolist(), *self.reference_b})

    def moved(self, i: int) -> LoadInput:
        """Return the load moved in design variable i by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        return replace(self, vectors=self.vectors.moved(i), p=p, reference=reference)
