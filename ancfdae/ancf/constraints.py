"""Constraints of all joints at once, from the coefficients that the joints state.

With the point vectors U = L q of all joints,

    Phi = sum over linear entries a (e . U) + sum over bilinear entries s U_i . U_j - offset,

where a linear entry picks one component of one vector. Coefficients of driven
joints are sums over factors that depend on time. The *raw* Jacobian is the list of
nonzero entries of Phi_U: a for linear entries; s U_j and s U_i, component by
component, for bilinear ones. Constant maps turn it into Phi_q on its pattern
and into Phi_q^T lam. Every other quantity is a polynomial in the same
ingredients; docs/theory.md, section 3, lists them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
from scipy import sparse

from ancfdae.ancf.held_angles import HeldAngles
from ancfdae.ancf.vectors import Vectors
from ancfdae.errors import InconsistentStart
from ancfdae.joints import DrivenJoint, Equations, Joint
from ancfdae.naming import JointLayout
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern


@final
@dataclass(frozen=True)
class _Values:
    """Flat coefficients of all joints at an instant, or with a leading axis at many.

    Of the parts of a driven scene the leading axis counts the factors, the constant one first.
    """

    a: Array
    s: Array
    offset: Array

    def times(self, factors: Array) -> _Values:
        """Return the sum over parts, for each row of factors."""
        return _Values(factors @ self.a, factors @ self.s, factors @ self.offset)


@final
@dataclass(frozen=True)
class JointInput:
    """One joint with its parameters, (n_p,), reference vectors, (n_vectors, d), and partials.

    `reference_b` has those of the design variables that move the reference. Equations `dropped`
    say nothing here.
    """

    joint: Joint
    p: Array
    p_b: Array
    reference: Array
    reference_b: dict[int, Array]
    dropped: tuple[int, ...] = ()

    def parts(self) -> list[Equations]:
        """Return the constant coefficients, and what goes with each factor."""
        parts = [self.joint.coefficients(self.p, self.reference)]
        if isinstance(self.joint, DrivenJoint):
            parts += self.joint.moving(self.p, self.reference)
        return [c.without(self.dropped) for c in parts]

    def factors(self, t: Array, order: int) -> Array:
        """Return the time derivative of the factors, shape (n_factors, k)."""
        if isinstance(self.joint, DrivenJoint):
            return self.joint.factors(self.p, t, order)
        return np.zeros((0, len(t)))

    def shaped(self, held: HeldAngles) -> JointInput:
        """Leave out right angles that are held without this joint."""
        c = self.joint.coefficients(self.p, self.reference)
        shapes = enumerate(c.shapes, len(c.offset) - len(c.shapes))
        return replace(self, dropped=tuple(row for row, angle in shapes if not held.add(angle)))

    @property
    def active(self) -> set[int]:
        """Design variables that the coefficients may depend on."""
        return {*np.flatnonzero(np.any(self.p_b, axis=0)).tolist(), *self.reference_b}

    def moved(self, i: int) -> JointInput:
        """Return the joint moved in design variable i by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        return replace(self, p=p, reference=reference)

    def structure(self) -> Equations:
        """Return coefficients that vanish only where they do at all times and parameters."""
        # Generic parameters: a coefficient that is not zero by structure shows.
        p = self.p * (1 + 1j * STEP) + 1j * STEP * np.sqrt(1.0 + np.arange(len(self.p)))
        reference = self.reference + 1j * STEP * sum(self.reference_b.values())
        parts = [*self.parts(), *replace(self, p=p, reference=reference).parts()]

        def size(x: Sequence[Array]) -> Array:
            return np.asarray(sum(np.abs(part.real) + np.abs(part.imag) for part in x))

        linear, bilinear = size([c.linear for c in parts]), size([c.bilinear for c in parts])
        return Equations(linear, bilinear, parts[0].offset)


@final
@dataclass(frozen=True)
class _Slot:
    """A joint, its rows in Phi and its vectors in U, and where its coefficients are not zero.

    `linear` and `bilinear` are indices of the entries, those of one half of the symmetric matrix.
    """

    item: JointInput
    rows: slice
    vectors: slice
    linear: tuple[Array, Array, Array]
    bilinear: tuple[Array, Array, Array]

    @cached_property
    def parts(self) -> list[_Values]:
        """The flat coefficients, of the constant part first."""
        _, i, j = self.bilinear
        # Both halves of the symmetric matrix in one entry, 1/2 on the diagonal.
        half = np.where(i == j, 0.5, 1.0)
        return [
            _Values(c.linear[self.linear], c.bilinear[self.bilinear] * half, c.offset)
            for c in self.item.parts()
        ]

    def moved(self, i: int) -> _Slot:
        """Return the slot moved in design variable i by an imaginary step."""
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
class _Reached:
    """Which entries of all joints belong to some of them: linear, bilinear and raw ones."""

    a: Array
    s: Array
    raw: Array


@final
class JointConstraints:
    """Phi and all that follows from it, from joints and their vectors in the same order.

    Arrays of states have instants as leading axis, (k, n_q); methods that take one instant say
    so.
    """

    _reached: _Reached

    def __init__(self, inputs: Sequence[JointInput], vectors: Vectors, n_b: int, d: int) -> None:
        self._vectors, self._n_b, self._d = vectors, n_b, d
        self._number(inputs)
        self.driven = any(isinstance(item.joint, DrivenJoint) for item in inputs)
        self.linear = len(self._s_row) == 0
        self._cache: tuple[float, _Values] | None = None
        self._parts = self._collect()
        self._moved, self._parts_moved = (
            dict[int, JointConstraints](),
            dict[int, JointConstraints](),
        )
        # Whether bilinear coefficients depend on time.
        self._turning = bool(np.any(self._parts.s[1:]))
        self._place()
        self.active = self._find_active()

    # -- structure -----------------------------------------------------------------------------

    def _number(self, inputs: Sequence[JointInput]) -> None:
        """Collect where coefficients stand: rows, and components of U."""
        row = vector = 0
        lists: list[list[Array]] = [[] for _ in range(5)]
        joints, slots = [], []
        for item in inputs:
            c = item.structure()
            r, i, axis = np.nonzero(c.linear)
            s_r, s_i, s_j = np.nonzero(np.triu(c.bilinear))
            parts = (row + r, (vector + i) * self._d + axis, row + s_r, vector + s_i, vector + s_j)
            for store, part in zip(lists, parts, strict=True):
                store.append(part)
            count, n = len(c.offset), len(item.reference)
            joints.append(JointLayout(item.joint.name, row, count, item.joint.holds_position))
            rows, own = slice(row, row + count), slice(vector, vector + n)
            slots.append(_Slot(item, rows, own, (r, i, axis), (s_r, s_i, s_j)))
            row, vector = row + count, vector + n
        empty = np.zeros(0, dtype=np.int64)
        self._a_row, self._a_at, self._s_row, self._s_i, self._s_j = (
            np.concatenate([empty, *store]) for store in lists
        )
        self._slots = slots
        self.n_lam, self.joints = row, tuple(joints)

    def _collect(self) -> _Values:
        """Flatten the coefficients of all joints onto the structure, the parts as rows."""
        each = [slot.parts for slot in self._slots]
        count = 1 + sum(len(parts) - 1 for parts in each)
        dtype = np.result_type(float, *(parts[0].a for parts in each))
        sizes = (len(self._a_row), len(self._s_row), self.n_lam)
        flat = _Values(*(np.zeros((count, size), dtype) for size in sizes))
        a = s = 0
        factor = 1
        for slot, parts in zip(self._slots, each, strict=True):
            to_a, to_s = slice(a, a + len(parts[0].a)), slice(s, s + len(parts[0].s))
            factors = range(factor, factor + len(parts) - 1)
            for k, c in zip((0, *factors), parts, strict=True):
                flat.a[k, to_a], flat.s[k, to_s], flat.offset[k, slot.rows] = c.a, c.s, c.offset
            a, s, factor = to_a.stop, to_s.stop, factors.stop
        return flat

    def _place(self) -> None:
        """Constant maps from raw entries to Phi_q on its pattern, and all others."""
        spread = self._place_maps()
        rows = self._raw_row[spread.row]
        self.pattern = Pattern((self.n_lam, self._vectors.matrix.shape[1]), rows, spread.col)
        index = self.pattern.index(rows, spread.col)
        shape = (self.pattern.size, len(self._raw_row))
        self._to_values = LinearMap.of(index, spread.row, spread.data, shape)
        self._simple = self.linear and not self.driven
        if self._simple:
            self._B_values = self._to_values(self._at(0.0).a)
            self._B = LinearMap(self.pattern.csr(self._B_values))

    def _place_maps(self) -> sparse.coo_array:
        """Constant maps from raw entries to Phi_q^T lam, and from entries to rows.

        Returns what raw entries are made of, (n_raw, n_q).
        """
        d, L = self._d, self._vectors.matrix
        n_q = L.shape[1]
        axes = np.arange(d)
        to_i = (self._s_i[:, None] * d + axes).ravel()
        to_j = (self._s_j[:, None] * d + axes).ravel()
        s_row = np.repeat(self._s_row, d)
        self._raw_row = np.concatenate([self._a_row, s_row, s_row])
        self._raw_at = np.concatenate([self._a_at, to_i, to_j])
        count = len(self._raw_row)
        spread = L[self._raw_at].tocoo() if count else sparse.coo_array((0, n_q))
        self._to_force = LinearMap.of(spread.col, spread.row, spread.data, (n_q, count))
        self._row_map, self._s_row_map, self._raw_row_map = (
            LinearMap.of(at, np.arange(len(at)), np.ones(len(at)), (self.n_lam, len(at)))
            for at in (self._a_row, self._s_row, self._raw_row)
        )
        return spread

    def couplings(self) -> tuple[Array, Array, Array, Array]:
        """Rows, columns, weights and bilinear entry of the products L_i^T L_j + L_j^T L_i."""
        d, L = self._d, self._vectors.matrix
        entry = np.repeat(np.arange(len(self._s_row)), d)
        axis = np.tile(np.arange(d), len(self._s_row))
        left, right = self._s_i[entry] * d + axis, self._s_j[entry] * d + axis
        sizes = np.diff(L.indptr)
        # Every entry of one row of L with every entry of the other.
        pairs = sizes[left] * sizes[right]
        of = np.repeat(np.arange(len(entry)), pairs)
        count = np.arange(len(of)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
        i = L.indptr[left][of] + count // sizes[right][of]
        j = L.indptr[right][of] + count % sizes[right][of]
        rows, columns = L.indices[i], L.indices[j]
        weights, numbers = np.tile(L.data[i] * L.data[j], 2), np.tile(entry[of], 2)
        rows, columns = np.concatenate([rows, columns]), np.concatenate([columns, rows])
        return rows, columns, weights, numbers

    def place_curvature(self, pattern: Pattern) -> None:
        """Prepare (Phi_q^T lam)_q on the system's pattern, which must hold the couplings."""
        rows, columns, weights, numbers = self.couplings()
        shape = (pattern.size, len(self._s_row))
        self._curvature = LinearMap.of(pattern.index(rows, columns), numbers, weights, shape)

    # -- coefficients --------------------------------------------------------------------------

    def _at(self, t: float, order: int = 0) -> _Values:
        """Coefficients, or their time derivatives, at one instant."""
        if order == 0 and self._cache is not None and self._cache[0] == t:
            return self._cache[1]
        if not self.driven:
            return self._still if order == 0 else self._zero
        many = self._over(np.array([t]), order)
        values = _Values(only(many.a), only(many.s), only(many.offset))
        if order == 0:
            self._cache = (t, values)
        return values

    def _over(self, t: Array, order: int = 0) -> _Values:
        """Coefficients at many instants; one row where they do not depend on time."""
        if not self.driven:
            return self._parts
        still = np.full((1, len(t)), float(order == 0))
        factors = np.concatenate([still, *(slot.item.factors(t, order) for slot in self._slots)])
        return self._parts.times(factors.T)

    @cached_property
    def _still(self) -> _Values:
        return self._parts.times(np.ones(1))

    @cached_property
    def _zero(self) -> _Values:
        return self._parts.times(np.zeros(1))

    def _series(self, t: float, count: int) -> list[_Values]:
        """Coefficients and their time derivatives."""
        return [self._at(t, order) for order in range(count)]

    def _U(self, x: Array) -> Array:
        """Vectors of one instant."""
        return only(self._vectors.of(x[None]))

    def _states(self, states: Sequence[Array]) -> Array:
        """Vectors of some states, with them as leading axis."""
        return self._vectors.of(np.stack(states))

    def _find_active(self) -> list[int]:
        """Design variables that constraints depend on with q held."""
        moves = {int(i) for i in np.flatnonzero(self._vectors.moves)}
        changes = {i for slot in self._slots for i in slot.item.active if slot.changes(i)}
        return sorted(moves | changes)

    @property
    def is_complex(self) -> bool:
        """Whether coefficients carry a complex perturbation."""
        return np.iscomplexobj(self._parts.a)

    def moved(self, i: int) -> JointConstraints:
        """Return the constraints moved in design variable i by an imaginary step."""
        if i not in self.active:
            return self
        if i not in self._moved:
            slots = [slot.moved(i) for slot in self._slots]
            other = self._with(slots, self._vectors.moved(i), np.ones(self.n_lam, dtype=bool))
            other._place()
            self._moved[i] = other
        return self._moved[i]

    def _reaching(self, i: int) -> JointConstraints:
        """Return the joints that design variable i reaches, moved by an imaginary step.

        Of the others they know the rows only, as zeros.
        """
        if i not in self._parts_moved:
            touched, rows = self._vectors.moved_by(i), np.zeros(self.n_lam, dtype=bool)
            reached = [
                slot.moved(i)
                for slot in self._slots
                if i in slot.item.active or np.any(touched[slot.vectors])
            ]
            for slot in reached:
                rows[slot.rows] = True
            other = self._with(reached, self._vectors.moved(i), rows)
            other._place_maps()
            self._parts_moved[i] = other
        return self._parts_moved[i]

    def _with(self, slots: list[_Slot], vectors: Vectors, rows: Array) -> JointConstraints:
        """Return constraints of some of the joints, those of the rows given."""
        other = copy.copy(self)
        for name in ("_still", "_zero"):
            other.__dict__.pop(name, None)
        other._slots, other._vectors = slots, vectors
        other._reached = _Reached(rows[self._a_row], rows[self._s_row], rows[self._raw_row])
        a, s = other._reached.a, other._reached.s
        other._a_row, other._a_at = self._a_row[a], self._a_at[a]
        other._s_row, other._s_i, other._s_j = self._s_row[s], self._s_i[s], self._s_j[s]
        other.driven = any(isinstance(slot.item.joint, DrivenJoint) for slot in slots)
        other._cache, other._parts = None, other._collect()
        return other

    def _seen(self, moved: JointConstraints, q: Array, U: Array) -> Array:
        """Return the vectors of moved constraints: those known unless the move is theirs."""
        return U if moved._vectors is self._vectors else moved._vectors.of(q)

    def _partial(self, of: Callable[[JointConstraints], Array], shape: tuple[int, ...]) -> Array:
        """Design partial of something of this shape that the constraints give, (*shape, n_b)."""
        result = np.zeros((*shape, self._n_b))
        for i in self.active:
            result[..., i] = of(self._reaching(i)).imag / STEP
        return result

    def _together(self, t: float, order: int) -> _Values:
        """Coefficients moved in every design variable, with a leading axis n_b."""
        c = self._at(t, order)
        if not self.active:
            return c
        together = _Values(
            *(np.repeat(x[None].astype(complex), self._n_b, 0) for x in (c.a, c.s, c.offset))
        )
        for i in self.active:
            moved = self._reaching(i)
            m = moved._at(t, order)
            together.a[i, moved._reached.a], together.s[i, moved._reached.s] = m.a, m.s
            together.offset[i] += 1j * m.offset.imag
        return together

    # -- values, one instant -------------------------------------------------------------------

    def constraint(self, q: Array, t: float) -> Array:
        """Phi, one instant."""
        if self._simple:
            return self._B(q) - self._at(0.0).offset
        return self._phi(self._at(t), self._U(q))

    def refuse_opposite(self, q: Array, t: float) -> None:
        """Refuse a start at which a drive is half a turn off, where its equation holds as well.

        Raises
        ------
        InconsistentStart
        """
        name = self.opposite(q, t)
        if name is not None:
            raise InconsistentStart(
                f"joint {name!r}",
                "the section must start at the angle of the law",
                "one that points the other way",
                "Add pi to the offset of the law, or declare the body turned to that angle.",
            )

    def opposite(self, q: Array, t: float) -> str | None:
        """Return the name of a drive that is half a turn off, None without one."""
        U = self._U(q).real if self.driven else np.zeros(0)
        for slot in self._slots:
            item = slot.item
            p, reference = item.p.real, item.reference.real
            if isinstance(item.joint, DrivenJoint) and not item.joint.faces(
                p, reference, U[slot.vectors], t
            ):
                return item.joint.name
        return None

    def constraint_q(self, q: Array, t: float) -> Array:
        """Values of Phi_q, one instant."""
        if self._simple:
            return self._B_values
        return self._to_values(self._raw(self._at(t), self._U(q)))

    def constraint_force(self, q: Array, lam: Array, t: float) -> Array:
        """Phi_q^T lam, one instant."""
        if self._simple:
            return self._B.transposed(lam)
        return self._to_force(self._raw(self._at(t), self._U(q)) * lam[self._raw_row])

    def constraint_force_q(self, lam: Array, t: Array) -> Array:
        """Values of (Phi_q^T lam)_q for rows of lam, shape (k, nnz); independent of q."""
        return self._curvature.rows(lam[:, self._s_row] * self._over(t).s)

    def constraint_force_rate_q(self, lam: Array, t: float) -> Array:
        """Values of ((dPhi_q^T/dt) lam)_q, one instant; only driven products depend on time."""
        return only(self._curvature.rows((lam[self._s_row] * self._at(t, 1).s)[None]))

    # -- values, many instants -----------------------------------------------------------------

    def constraints_q(self, q: Array, t: Array) -> Array:
        """Values of Phi_q, shape (k, nnz)."""
        if self._simple:
            return np.broadcast_to(self._B_values, (len(q), len(self._B_values)))
        return self._to_values.rows(self._raw(self._over(t), self._vectors.of(q)))

    def constraints(self, q: Array, t: Array) -> Array:
        """Phi, shape (k, n_lam)."""
        return self._phi(self._over(t), self._vectors.of(q))

    def constraint_forces(self, q: Array, lam: Array, t: Array) -> Array:
        """Phi_q^T lam, shape (k, n_q)."""
        raw = self._raw(self._over(t), self._vectors.of(q))
        return self._to_force.rows(raw * lam[:, self._raw_row])

    def constraints_b(self, q: Array, t: Array) -> Array:
        """Phi_b, shape (k, n_lam, n_b)."""
        U = self._vectors.of(q)
        return self._partial(
            lambda moved: moved._phi(moved._over(t), self._seen(moved, q, U)),
            (len(q), self.n_lam),
        )

    def constraint_forces_b(self, q: Array, lam: Array, t: Array) -> Array:
        """(Phi_q^T lam)_b, shape (k, n_q, n_b)."""
        U = self._vectors.of(q)

        def force(moved: JointConstraints) -> Array:
            raw = moved._raw(moved._over(t), self._seen(moved, q, U))
            return moved._to_force.rows(raw * lam[:, moved._raw_row])

        return self._partial(force, q.shape)

    def pull_back(self, q: Array, lam: Array, t: Array, mu: Array, zeta: Array) -> Array:
        """Sum over instants of (Phi_q^T lam)_b^T mu + Phi_b^T zeta, shape (n_b,)."""
        U_o, X_o = self._vectors.of(q), self._vectors.of(mu)

        def work(moved: JointConstraints) -> Array:
            U, X = self._seen(moved, q, U_o), self._seen(moved, mu, X_o)
            c = moved._over(t)
            terms = lam * moved._jacobian_times([c], U, X) + zeta * moved._phi(c, U)
            return np.asarray(np.sum(terms))

        return self._partial(work, ())

    # -- what drives do, many instants ---------------------------------------------------------

    def works(self, q: Array, lam: Array, t: Array) -> Array:
        """Lam . Phi_t, shape (k,)."""
        rates: Array = self._phi(self._over(t, 1), self._vectors.of(q))
        return np.asarray(np.sum(lam * rates, axis=1))

    def works_partials(self, q: Array, lam: Array, t: Array) -> tuple[Array, Array, Array]:
        """Return partials of `works` in q, lam and b; shape (k, n) each."""
        c, U = self._over(t, 1), self._vectors.of(q)
        on_q = self._to_force.rows(self._raw(c, U) * lam[:, self._raw_row])
        return on_q, self._phi(c, U), self._partial(lambda x: x.works(q, lam, t), (len(q),))

    # -- start: rates and their total derivatives, one instant -----------------------------------

    def constraint_q_rate(self, t: float, *states: Array) -> Array:
        """Values of the time derivative of Phi_q of order 1 to 3; states are q and its rates."""
        return self._to_values(self._raw_rate(self._series(t, len(states)), *self._states(states)))

    def rate_b(self, t: float, q: Array, rates: tuple[Array, ...]) -> Array:
        """Design partial of the time derivative of Phi of order 1 to 3, its rates held."""
        return self._partial(lambda moved: moved.rate(t, q, rates), (self.n_lam,))

    def constraint_force_rate_pull_back(
        self, q: Array, v: Array, lam: Array, t: float, mu: Array
    ) -> Array:
        """Design partial of mu . (dPhi_q^T/dt) lam with everything else held, shape (n_b,)."""
        return self._partial(lambda moved: mu @ moved.constraint_force_rate(q, v, lam, t), ())

    def side(self, t: float, *states: Array) -> Array:
        """Right side of Phi_q v, Phi_q a or Phi_q q''', by how many of q, v and a are given.

        -Phi_t; -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt; the third is S of the theory.
        """
        if self._simple:
            return np.zeros(self.n_lam)
        return self._side(self._series(t, len(states) + 1), *self._states(states))

    def side_total(self, t: float, states: tuple[Array, ...], states_b: tuple[Array, ...]) -> Array:
        """Total design derivative of `side`."""
        if self._simple:
            return np.zeros((self.n_lam, self._n_b))
        return self._total(self._side, t, len(states) + 1, states, states_b)

    def constraint_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Total design derivative of Phi_q x with x held."""
        if self._simple and not self.active:
            return np.zeros((self.n_lam, self._n_b))
        return self._total(self._jacobian_times, t, 1, (q, x), (q_b, np.zeros_like(q_b)))

    def constraint_force_rate(self, q: Array, v: Array, lam: Array, t: float) -> Array:
        """(dPhi_q^T/dt) lam."""
        raw = self._raw_rate(self._series(t, 2), *self._states((q, v)))
        return self._to_force(raw * lam[self._raw_row])

    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Total design derivative of `constraint_force_rate`."""
        loads = (lam + 1j * STEP * lam_b.T)[:, self._raw_row]

        def entries(series: Sequence[_Values], U: Array, V: Array) -> Array:
            return self._raw_rate(series, U, V) * loads

        total = self._to_force.columns(self._total(entries, t, 2, (q, v), (q_b, v_b)))
        still = self._raw_rate(self._series(t, 2), *self._states((q, v))) * lam[self._raw_row]
        for i in np.flatnonzero(self._vectors.moves):
            moved = self._reaching(int(i))
            total[:, i] += moved._to_force(still[moved._reached.raw]).imag / STEP
        return total

    # -- polynomials ---------------------------------------------------------------------------

    def _phi(self, c: _Values, U: Array) -> Array:
        products = np.sum(U[..., self._s_i, :] * U[..., self._s_j, :], axis=-1)
        return self._linear(c, U) + self._s_row_map.rows(c.s * products) - c.offset

    def _raw(self, c: _Values, U: Array) -> Array:
        """Nonzero entries of Phi_U."""
        s = c.s[..., None]
        a = np.broadcast_to(c.a, (*U.shape[:-2], c.a.shape[-1]))
        to_i, to_j = _flat(s * U[..., self._s_j, :]), _flat(s * U[..., self._s_i, :])
        return np.concatenate([a, to_i, to_j], axis=-1)

    def _raw_rate(self, series: Sequence[_Values], *X: Array) -> Array:
        """Time derivative of `_raw` of order n by Leibniz' rule; X_k is U^(k), k to n."""
        n = len(X) - 1
        rate = self._raw(_Values(series[n].a, series[0].s, series[n].offset), X[n])
        for k in range(1, n + 1) if self._turning else ():
            still = _Values(np.zeros_like(series[k].a), series[k].s, series[k].offset)
            rate = rate + math.comb(n, k) * self._raw(still, X[n - k])
        return rate

    def _jacobian_times(self, series: Sequence[_Values], U: Array, X: Array) -> Array:
        return self._raw_row_map.rows(self._raw(series[0], U) * _flat(X)[..., self._raw_at])

    def _linear(self, c: _Values, U: Array) -> Array:
        return self._row_map.rows(c.a * _flat(U)[..., self._a_at])

    def _product(self, c: _Values, U: Array, V: Array) -> Array:
        """Sum of s (U_i . V_j + V_i . U_j)."""
        i, j = self._s_i, self._s_j
        products = np.sum(U[..., i, :] * V[..., j, :] + V[..., i, :] * U[..., j, :], axis=-1)
        return self._s_row_map.rows(c.s * products)

    def _side(self, series: Sequence[_Values], *X: Array) -> Array:
        """Leibniz' rule for the n-th time derivative of Phi without Phi_q q^(n); X_k is U^(k)."""
        n = len(X)
        side = series[n].offset
        for k in range(1, n + 1):
            side = side - math.comb(n, k) * self._linear(series[k], X[n - k])
        for k in range(n + 1 if self._turning else 1):
            # Of s^(k) and the derivative of order m of the products; U^(n) is what is asked for.
            m = n - k
            for j in range(1 if k == 0 else 0, m // 2 + 1):
                share = math.comb(n, k) * math.comb(m, j) / (2 if 2 * j == m else 1)
                side = side - share * self._product(series[k], X[j], X[m - j])
        return side

    def rate(self, t: float, q: Array, rates: tuple[Array, ...]) -> Array:
        """Time derivative of Phi, of the order of the number of rates."""
        U, *V = self._vectors.of(np.stack([q, *rates]))
        series = self._series(t, len(V) + 1)
        return self._jacobian_times(series, U, V[-1]) - self._side(series, U, *V[:-1])

    def _total(
        self,
        function: Callable[..., Array],
        t: float,
        orders: int,
        states: tuple[Array, ...],
        states_b: tuple[Array, ...],
    ) -> Array:
        """Differentiate a polynomial of coefficients and vectors along the design."""
        U, U_b = self._vectors.of(np.stack(states)), self._vectors.of_b(np.stack(states))
        moved = [self._together(t, n) for n in range(orders)]
        arguments = []
        for k, x_b in enumerate(states_b):
            along = self._vectors.of(x_b.T) + np.moveaxis(U_b[k], -1, 0)
            arguments.append(U[k] + 1j * STEP * along)
        columns: Array = function(moved, *arguments).imag / STEP
        return columns.T


def _flat(U: Array) -> Array:
    """Join the last two axes; also where a leading axis is empty."""
    return U.reshape(*U.shape[:-2], U.shape[-2] * U.shape[-1])
