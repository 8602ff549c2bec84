"""How forces of a load that moves are evaluated: by a kernel, or as its author wrote them.

Operations of NumPy on single numbers are listed once; a kernel takes the list, also to form
derivatives. A formula with other functions is called at all instants at once, and differentiated by
complex steps of all directions together. Both are the same to round-off.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.load_input import LoadInput
from ancfdae.kernels import LoadPlan, load_forces, load_forces_along, load_tangents
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.differentiable import FAILURES
from ancfdae.numerics.operations import Listed, Operations
from ancfdae.numerics.patterns import Pattern


class LoadFormula(abc.ABC):
    """Q = x L^T F(L q, L v) for factors x, (k,), and rows of states, (k, n_q).

    `plan` is what a kernel takes, None where none can.
    """

    plan: LoadPlan | None

    @abc.abstractmethod
    def forces(self, x: Array, q: Array, v: Array) -> Array:
        """Return Q."""

    @abc.abstractmethod
    def forces_along(self, x: Array, q: Array, v: Array, dq: Array, dv: Array) -> Array:
        """Return the derivative of Q along rows of dq and dv."""

    @abc.abstractmethod
    def tangents(self, x: Array, q: Array, v: Array, velocity: bool) -> Array:
        """Return values of Q_q or, with `velocity`, Q_v on the pattern, (k, nnz)."""


def load_formula(item: LoadInput, pattern: Pattern) -> LoadFormula:
    """Return what evaluates a load with tangents on a pattern that holds its couplings."""
    places = pattern.index(*item.couplings)
    listed = _listed(item)
    if listed is None:
        return CalledFormula(item, places, pattern.size)
    vectors = item.vectors
    constants, *operations = listed
    indices = tuple(
        np.asarray(x, np.int32) for x in (vectors.first, vectors.column, *operations, places)
    )
    numbers = vectors.value, constants
    return ListedFormula(LoadPlan(indices, numbers, vectors.n_q, pattern.size))


def _listed(item: LoadInput) -> tuple[Array, ...] | None:
    """Return constants, operations and results; None where the kernel has not all functions."""
    size = item.reference.size
    operations, at = Operations(2 * size), np.arange(2 * size).reshape(2, *item.reference.shape)
    U, V = (Listed(operations, x) for x in at)
    try:
        F = item.load.force(U, V, item.p, item.reference)
        results = np.broadcast_to(U.numbers(F), item.reference.shape)
    except FAILURES:
        return None
    return operations.arrays(results.ravel())


@final
@dataclass(frozen=True, eq=False)
class ListedFormula(LoadFormula):
    """A load that a kernel evaluates."""

    plan: LoadPlan

    def forces(self, x: Array, q: Array, v: Array) -> Array:
        """Return Q."""
        return load_forces(self.plan, x, q, v)

    def forces_along(self, x: Array, q: Array, v: Array, dq: Array, dv: Array) -> Array:
        """Return the derivative of Q."""
        return load_forces_along(self.plan, x, q, v, dq, dv)

    def tangents(self, x: Array, q: Array, v: Array, velocity: bool) -> Array:
        """Return Q_q or Q_v."""
        return load_tangents(self.plan, x, q, v, velocity)


@final
@dataclass(frozen=True, eq=False)
class CalledFormula(LoadFormula):
    """A load whose function is called for all rows at once."""

    item: LoadInput
    places: Array
    n_values: int
    plan: None = None

    def forces(self, x: Array, q: Array, v: Array) -> Array:
        """Return Q."""
        vectors = self.item.vectors
        return vectors.lift(x[:, None, None] * self.item.force(vectors.of(q), vectors.of(v)))

    def forces_along(self, x: Array, q: Array, v: Array, dq: Array, dv: Array) -> Array:
        """Return the derivative of Q by that of a jet."""
        item = self.item
        U, V, dU, dV = (item.vectors.of(state) for state in (q, v, dq, dv))
        dF = item.load.force_along(U, V, (dU, dV), item.p, item.reference)
        return item.vectors.lift(x[:, None, None] * dF)

    def tangents(self, x: Array, q: Array, v: Array, velocity: bool) -> Array:
        """Return Q_q or Q_v: derivatives along all components of the vectors."""
        item = self.item
        U, V = (item.vectors.of(state)[:, None] for state in (q, v))
        k, _, n_v, d = U.shape
        unit = np.eye(n_v * d).reshape(1, n_v * d, n_v, d) + 0 * U
        rates = (0 * unit, unit) if velocity else (unit, 0 * unit)
        U, V = U + 0 * unit, V + 0 * unit
        dF = item.load.force_along(U, V, rates, item.p, item.reference).reshape(k, n_v * d, -1)
        (i, j), row, l = item.pairs, item.rows, item.vectors.value
        entries = x[:, None] * dF[:, row[j], row[i]] * (l[i] * l[j])
        values = np.zeros((self.n_values, k), dtype=entries.dtype)
        np.add.at(values, self.places, entries.T)
        return values.T
