"""Sparsity of the coefficients of all joint equations, and their nonzero numbers for kernels.

The numbers are ordered joint by joint: entries of L, and coefficients c = (linear, products,
offsets, inputs of formulas). Coefficients of driven joints are sums over parts times factors of
time; the first part, common to all joints, is constant in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from ancfdae.assembly.joint_input import FormulaTrace, JointInput
from ancfdae.assembly.layout import JointLayout
from ancfdae.assembly.naming import Vectors
from ancfdae.kernels import ConstraintPlan, OperationList
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern


@final
@dataclass(frozen=True)
class Slot:
    """One joint among all joints: its vectors in U and its parts after the first.

    `linear` and `products` are indices of its nonzero coefficients (`products` in the upper
    triangle), and `at` the indices of all its coefficients, offsets and inputs last, among the
    numbers of all joints. `lists` are the operation lists of its formulas, if any.
    """

    item: JointInput
    vectors: slice
    parts: slice
    linear: tuple[Array, ...]
    products: tuple[Array, ...]
    at: Array
    lists: tuple[OperationList, ...]

    def coefficients(self, item: JointInput) -> Array:
        """Return the coefficients of all parts of a joint, (n_parts, n), original or perturbed."""
        _, i, j = self.products
        # Both halves of the symmetric matrix in one entry, 1/2 on the diagonal.
        half = np.where(i == j, 0.5, 1.0)
        rows = (
            (c.linear[self.linear], c.bilinear[self.products] * half, c.offset, inputs)
            for c, inputs in zip(item.parts, item.inputs(), strict=True)
        )
        return np.array([np.concatenate(row) for row in rows])

    @property
    def fits(self) -> bool:
        """Whether indices `linear` and `products` include all nonzero coefficients of a joint."""
        return len(self.item.parts) == 1 + self.parts.stop - self.parts.start and all(
            np.count_nonzero(c.linear) == np.count_nonzero(c.linear[self.linear])
            and np.count_nonzero(np.triu(c.bilinear)) == np.count_nonzero(c.bilinear[self.products])
            for c in self.item.parts
        )

    def partials(self, i: int) -> tuple[Array, Array, Array]:
        """Return parts, entries and values of the partials with respect to a design variable."""
        change = self.coefficients(self.item.moved(i)) - self.coefficients(self.item)
        part, at = np.nonzero(change.imag)
        # The first part is common to all joints.
        parts = np.where(part == 0, 0, self.parts.start + part - 1)
        return parts, self.at[at], change.imag[part, at] / STEP


@final
@dataclass(frozen=True, eq=False)
class JointStructure:
    """Structure of all joints of a scene: `indices` and pattern of Phi_q for a `ConstraintPlan`.

    `indices` lacks the indices of the curvature and of the moving coefficients. `couplings` are
    rows and columns of the entries of the curvature.
    """

    slots: tuple[Slot, ...]
    vectors: Vectors
    joints: tuple[JointLayout, ...]
    indices: tuple[Array, ...]
    pattern: SparsityPattern
    couplings: tuple[Array, Array]

    @staticmethod
    def of(inputs: Sequence[JointInput], vectors: Vectors) -> JointStructure:
        """Return the structure of joints whose vectors, in order, are `vectors`."""
        shapes, slots, layouts = list[_Shape](), [], []
        known: dict[object, _Shape] = {}
        listed: dict[object, tuple[OperationList, ...]] = {}
        for item in inputs:
            shape = None if item.reference_b else known.get(item.kind)
            if shape is None:
                c, count = item.structure(), item.input_count
                linear, products = np.nonzero(c.linear), np.nonzero(np.triu(c.bilinear))
                entries = len(item.reference), len(linear[0]), len(products[0]), len(c.offset)
                lists = FormulaTrace(item).lists(listed) if count else ()
                shape = _Shape(linear, products, lists, (*entries, len(item.parts) - 1, count))
            shapes.append(shape)
            known[item.kind] = shape
        # The first part is common to all joints.
        begin = np.cumsum([(0, 0, 0, 0, 1, 0), *(shape.sizes for shape in shapes)], axis=0)
        # Linear entries, products, rows, and inputs of formulas.
        columns = [1, 2, 3, 5]
        *ahead, size = np.cumsum([0, *begin[-1, columns]]).tolist()
        at = np.arange(size)
        firsts = begin.tolist()
        for item, shape, first, last in zip(inputs, shapes, firsts, firsts[1:], strict=False):
            name, row = item.joint.name, first[3]
            holds = item.joint.holds_position and min(item.dropped, default=vectors.d) >= vectors.d
            layouts.append(JointLayout(name, row, last[3] - row, holds))
            pairs = zip(columns, ahead, strict=True)
            places = np.concatenate([at[x + first[k] : x + last[k]] for k, x in pairs])
            where = slice(first[0], last[0]), slice(first[4], last[4])
            slots.append(Slot(item, *where, shape.linear, shape.products, places, shape.lists))
        return _placed(slots, vectors, layouts, begin)

    @property
    def n_lam(self) -> int:
        """Number of constraint equations of all joints."""
        return self.pattern.shape[0]

    @cached_property
    def by_formulas(self) -> Array:
        """Whether each equation is given by formulas, shape (n_lam,)."""
        pairs = zip(self.slots, self.joints, strict=True)
        rows = [np.full(layout.rows, len(slot.lists) > 0) for slot, layout in pairs]
        return np.concatenate([np.zeros(0, dtype=bool), *rows])

    @cached_property
    def parts(self) -> list[Array]:
        """Coefficients of each joint, shape (n_parts, n) each."""
        return [slot.coefficients(slot.item) for slot in self.slots]

    def with_numbers(self, inputs: Sequence[JointInput], vectors: Vectors) -> JointStructure | None:
        """Return the same structure with other numbers; None if a number does not fit into it."""
        pairs = zip(self.slots, inputs, strict=True)
        slots = tuple(replace(slot, item=item) for slot, item in pairs)
        if not (vectors.is_like(self.vectors) and all(slot.fits for slot in slots)):
            return None
        return replace(self, slots=slots, vectors=vectors)

    def moved(self, i: int) -> JointStructure:
        """Return the joints with design variable i perturbed by an imaginary step."""
        slots = tuple(replace(slot, item=slot.item.moved(i)) for slot in self.slots)
        return replace(self, slots=slots, vectors=self.vectors.moved(i))

    def moving(self) -> tuple[Array, Array, Array, Array]:
        """Return joint coefficients times time factors: first index, entries, parts, values."""
        counts, moving = [0], [(np.zeros(0, dtype=np.int64),) * 2 + (np.zeros(0),)]
        for slot, c in zip(self.slots, self.parts, strict=True):
            part, at = np.nonzero(c[1:])
            moving.append((slot.at[at], slot.parts.start + part, c[1:][part, at]))
            counts.append(counts[-1] + len(at))
        entries, parts, values = (np.concatenate(x) for x in zip(*moving, strict=True))
        return np.array(counts), entries, parts, values

    def plan(self, curved: Array, n_curved: int) -> ConstraintPlan:
        """Return the kernel's plan; `curved` are the indices of the couplings among values."""
        counts, entries, parts, values = self.moving()
        inputs = int(self.indices[0][-1, 5])
        still = np.zeros(len(self.indices[3]) + len(self.indices[5]) + self.n_lam + inputs)
        still = still.astype(np.result_type(still, *self.parts))
        for slot, c in zip(self.slots, self.parts, strict=True):
            still[slot.at] = c[0]
        joints, *others = self.indices
        table = np.insert(joints, 5, counts, axis=1)
        indices = tuple(np.asarray(x, np.int32) for x in (table, *others, curved, entries, parts))
        vectors = self.vectors
        sizes = vectors.d, vectors.n_q, self.pattern.size, n_curved
        lists = tuple(x for slot in self.slots for x in slot.lists)
        return ConstraintPlan(indices, (vectors.value, still, values), *sizes, lists)


class _Shape(NamedTuple):
    """Sparsity of the coefficients of a joint, lists of its formulas, and counts.

    `sizes` counts vectors, linear entries, products, rows, factors and inputs of formulas.
    """

    linear: tuple[Array, ...]
    products: tuple[Array, ...]
    lists: tuple[OperationList, ...]
    sizes: tuple[int, int, int, int, int, int]


def _placed(
    slots: list[Slot],
    vectors: Vectors,
    layouts: list[JointLayout],
    begin: Array,
) -> JointStructure:
    """Return the structure: find the indices of products of Phi_U with L in Phi_q."""
    d, first, column = vectors.d, vectors.first, vectors.column
    linear_row, at, axis = _counted([slot.linear for slot in slots], begin, 1)
    row, i, j = _counted([slot.products for slot in slots], begin, 2)
    linear_at, i, j = at * d + axis, i * d, j * d
    where, axes = (linear_row, linear_at, row, i, j), np.arange(d)
    raw_at = np.concatenate([i[:, None] + axes, j[:, None] + axes], axis=1).ravel()
    ahead, formula_row, formula_at = _formula_entries(slots, layouts, d)
    of_linear, of_products = _entries(first, linear_at), _entries(first, raw_at)
    of_formulas = _entries(first, formula_at)
    rows = (
        linear_row[of_linear[0]],
        np.repeat(row, 2 * d)[of_products[0]],
        formula_row[of_formulas[0]],
    )
    columns = tuple(column[x[1]] for x in (of_linear, of_products, of_formulas))
    pattern = SparsityPattern(
        (int(begin[-1][3]), vectors.n_q), *map(np.concatenate, (rows, columns))
    )
    places = tuple(pattern.index(*x) for x in zip(rows, columns, strict=True))
    linear = np.searchsorted(of_linear[0], begin[:, 1])
    products = np.searchsorted(of_products[0], begin[:, 2] * 2 * d)
    formulas = np.searchsorted(of_formulas[0], ahead)
    table = np.concatenate([begin, np.stack([linear, products, formulas], axis=1)], axis=1)
    has = np.array([len(slot.lists) > 0 for slot in slots], dtype=bool)
    indices = (table, first, column, *where, *places, np.where(has, np.cumsum(has) - 1, -1))
    coupled = [vectors.couplings(slot.vectors) for slot in slots if slot.lists]
    # Products L_i^T L_j and their transposes.
    number, one = _entries(first, (i[:, None] + axes).ravel())
    pair, other = _entries(first, (j[:, None] + axes).ravel()[number])
    both = np.stack([column[one[pair]], column[other]], axis=1)
    left, right = zip((both.ravel(), both[:, ::-1].ravel()), *coupled, strict=True)
    couplings = np.concatenate(left), np.concatenate(right)
    return JointStructure(tuple(slots), vectors, tuple(layouts), indices, pattern, couplings)


def _formula_entries(
    slots: list[Slot], layouts: list[JointLayout], d: int
) -> tuple[Array, Array, Array]:
    """Return rows of Phi and components of U for all entries of Phi_U given by formulas, by row.

    The first array has the number of such entries before each joint, and of all.
    """
    ahead, rows, at = [0], [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for slot, layout in zip(slots, layouts, strict=True):
        if slot.lists:
            own = np.arange(slot.vectors.start * d, slot.vectors.stop * d)
            rows.append(np.repeat(layout.first_row + np.arange(layout.rows), len(own)))
            at.append(np.tile(own, layout.rows))
        ahead.append(sum(map(len, at)))
    return np.array(ahead), np.concatenate(rows), np.concatenate(at)


def _counted(
    indices: list[tuple[Array, ...]], begin: Array, which: int
) -> tuple[Array, Array, Array]:
    """Return rows, vectors and last index of joint coefficients, numbered over all joints.

    They are the linear entries (`which` = 1), or the products (2), whose last index is a vector,
    too.
    """
    none = np.zeros((3, 0), dtype=np.int64)
    row, i, last = np.concatenate([none, *map(np.array, indices)], axis=1)
    vector, of_row = (np.repeat(begin[:-1, k], np.diff(begin[:, which])) for k in (0, 3))
    return row + of_row, i + vector, last if which == 1 else last + vector


def _entries(first: Array, rows: Array) -> tuple[Array, Array]:
    """Return, for all entries in some rows, the row's position in `rows`, and the entry."""
    sizes = first[rows + 1] - first[rows]
    number = np.arange(len(rows)).repeat(sizes)
    ahead = first[rows] - (sizes.cumsum() - sizes)
    return number, ahead[number] + np.arange(len(number))
