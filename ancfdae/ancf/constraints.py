"""Constraints of all joints at once, from the coefficients that the joints state.

With the point vectors U = L q of all joints,

    Phi = sum over linear entries a (e . U) + sum over bilinear entries s U_i . U_j - offset,

where a linear entry picks one component of one vector. `a` and `offset` may
depend on time (driven joints), s does not. The *raw* Jacobian is the list of
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

from ancfdae.ancf.vectors import Vectors
from ancfdae.joints import Equations, Joint
from ancfdae.naming import JointLayout
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern


@final
@dataclass(frozen=True)
class _Values:
    """Flat coefficients of all joints at one instant; moved in every variable, (n_b, ...)."""

    a: Array
    s: Array
    offset: Array


@final
@dataclass(frozen=True)
class JointInput:
    """One joint with its parameters, (n_p,), reference vectors, (n_vectors, d), and partials.

    `reference_b` has those of the design variables that move the reference.
    """

    joint: Joint
    p: Array
    p_b: Array
    reference: Array
    reference_b: dict[int, Array]

    def at(self, t: float, order: int) -> Equations:
        """Return the coefficients."""
        return self.joint.coefficients(self.p, self.reference, t, order)

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
        found = self.at(0.0, 0)
        linear, bilinear = np.abs(found.linear), np.abs(found.bilinear)
        # Generic parameters and instants: a coefficient that is not zero by structure shows.
        p = self.p * (1 + 1j * STEP) + 1j * STEP * np.sqrt(1.0 + np.arange(len(self.p)))
        reference = self.reference + 1j * STEP * sum(self.reference_b.values())
        for order in range(4 if self.joint.driven else 1):
            for t in (0.0, 0.37):
                c = self.joint.coefficients(p, reference, t, order)
                linear = linear + np.abs(c.linear.real) + np.abs(c.linear.imag)
                bilinear = bilinear + np.abs(c.bilinear.real) + np.abs(c.bilinear.imag)
        return Equations(linear, bilinear, found.offset)


@final
class JointConstraints:
    """Phi and all that follows from it, from joints and their vectors in the same order.

    Arrays of states have instants as leading axis, (k, n_q); methods that take one instant say
    so.
    """

    def __init__(self, inputs: Sequence[JointInput], vectors: Vectors, n_b: int, d: int) -> None:
        self._inputs, self._vectors = inputs, vectors
        self._n_b, self._d = n_b, d
        self._number(inputs)
        self.driven = any(item.joint.driven for item in inputs)
        self.linear = len(self._s_row) == 0
        self._cache: tuple[float, _Values] | None = None
        self._constant, self._moved = self._collect(0), dict[int, JointConstraints]()
        self._place()
        self.active = self._find_active()

    # -- structure -----------------------------------------------------------------------------

    def _number(self, inputs: Sequence[JointInput]) -> None:
        """Collect where coefficients stand: rows, and components of U."""
        row = vector = 0
        lists: list[list[Array]] = [[] for _ in range(5)]
        joints, picks = [], []
        for item in inputs:
            c = item.structure()
            r, i, axis = np.nonzero(c.linear)
            s_r, s_i, s_j = np.nonzero(np.triu(c.bilinear))
            parts = (row + r, (vector + i) * self._d + axis, row + s_r, vector + s_i, vector + s_j)
            for store, part in zip(lists, parts, strict=True):
                store.append(part)
            picks.append(((r, i, axis), (s_r, s_i, s_j)))
            count = len(c.offset)
            joints.append(JointLayout(item.joint.name, row, count, item.joint.holds_position))
            row, vector = row + count, vector + len(item.reference)
        empty = np.zeros(0, dtype=np.int64)
        self._a_row, self._a_at, self._s_row, self._s_i, self._s_j = (
            np.concatenate([empty, *store]) for store in lists
        )
        self._picks = picks
        self.n_lam, self.joints = row, tuple(joints)

    def _collect(self, order: int, t: float = 0.0) -> _Values:
        """Flatten the coefficients of all joints, or their time derivatives, onto the structure."""
        a, s, offset = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
        for item, (linear, bilinear) in zip(self._inputs, self._picks, strict=True):
            c = item.at(t, order if item.joint.driven else 0)
            # What does not depend on time: all but the rows of driven joints, all of s.
            moving = 1.0 if order == 0 or item.joint.driven else 0.0
            a.append(moving * c.linear[linear])
            # Both halves of the symmetric matrix in one entry, 1/2 on the diagonal.
            half = np.where(bilinear[1] == bilinear[2], 0.5, 1.0) * (order == 0)
            s.append(c.bilinear[bilinear] * half)
            offset.append(moving * c.offset)
        return _Values(np.concatenate(a), np.concatenate(s), np.concatenate(offset))

    def _place(self) -> None:
        """Constant maps from raw entries to Phi_q, Phi_q^T lam and (Phi_q^T lam)_q."""
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
        rows = self._raw_row[spread.row]
        self.pattern = Pattern((self.n_lam, n_q), rows, spread.col)
        index = self.pattern.index(rows, spread.col)
        self._to_values = LinearMap.of(index, spread.row, spread.data, (self.pattern.size, count))
        self._to_force = LinearMap.of(spread.col, spread.row, spread.data, (n_q, count))
        self._row_map, self._s_row_map, self._raw_row_map = (
            LinearMap.of(at, np.arange(len(at)), np.ones(len(at)), (self.n_lam, len(at)))
            for at in (self._a_row, self._s_row, self._raw_row)
        )
        self._simple = self.linear and not self.driven
        if self._simple:
            self._place_constant()

    def _place_constant(self) -> None:
        """Constraints that are linear and do not depend on time are one map."""
        self._B_values = self._to_values(self._constant.a)
        self._B = LinearMap(self.pattern.csr(self._B_values))

    def couplings(self) -> tuple[Array, Array, Array, Array]:
        """Rows, columns, weights and bilinear entry of the products L_i^T L_j + L_j^T L_i."""
        d, L = self._d, self._vectors.matrix
        parts: list[tuple[Array, Array, Array, Array]] = []
        for entry, (i, j) in enumerate(zip(self._s_i, self._s_j, strict=True)):
            for axis in range(d):
                left, right = L[[i * d + axis]].tocoo(), L[[j * d + axis]].tocoo()
                weights = np.outer(left.data, right.data).ravel()
                rows = np.repeat(left.col, len(right.col))
                columns = np.tile(right.col, len(left.col))
                number = np.full(len(rows), entry)
                parts += [(rows, columns, weights, number), (columns, rows, weights, number)]
        empty = np.zeros(0, dtype=np.int64)
        start = (empty, empty, np.zeros(0), empty)
        rows, columns, weights, numbers = (
            np.concatenate(column) for column in zip(start, *parts, strict=True)
        )
        return rows, columns, weights, numbers

    def place_curvature(self, pattern: Pattern) -> None:
        """Prepare (Phi_q^T lam)_q on the system's pattern, which must hold the couplings."""
        rows, columns, weights, numbers = self.couplings()
        shape = (pattern.size, len(self._s_row))
        self._curvature = LinearMap.of(pattern.index(rows, columns), numbers, weights, shape)

    # -- coefficients --------------------------------------------------------------------------

    def _at(self, t: float, order: int = 0) -> _Values:
        if not self.driven:
            return self._constant if order == 0 else self._zero
        if order == 0 and self._cache is not None and self._cache[0] == t:
            return self._cache[1]
        values = self._collect(order, t)
        if order == 0:
            self._cache = (t, values)
        return values

    def _series(self, t: float, count: int) -> list[_Values]:
        """Coefficients and their time derivatives."""
        return [self._at(t, order) for order in range(count)]

    def _U(self, x: Array) -> Array:
        """Vectors of one instant."""
        return only(self._vectors.of(x[None]))

    @cached_property
    def _zero(self) -> _Values:
        return self._collect(1)

    def _find_active(self) -> list[int]:
        """Design variables that constraints depend on with q held."""
        moves = {int(i) for i in np.flatnonzero(self._vectors.moves)}
        candidates = moves.union(*(item.active for item in self._inputs))
        if self.driven:
            return sorted(candidates)
        found = []
        for i in candidates:
            c = self._move(i)._constant
            if i in moves or any(np.any(x.imag) for x in (c.a, c.s, c.offset)):
                found.append(i)
        return sorted(found)

    def moved(self, i: int) -> JointConstraints:
        """Return the constraints moved in design variable i by an imaginary step."""
        if i not in self.active:
            return self
        if i not in self._moved:
            self._moved[i] = self._move(i)
        return self._moved[i]

    def _move(self, i: int) -> JointConstraints:
        other = copy.copy(self)
        other._inputs = [item.moved(i) for item in self._inputs]
        other._cache, other._constant = None, other._collect(0)
        other._vectors = self._vectors.moved(i)
        if other._vectors is not self._vectors:
            other._place()
        elif self._simple:
            other._place_constant()
        return other

    def _over(self, t: Array, order: int = 0) -> _Values:
        """Coefficients, or time derivatives, at many instants; a leading axis if they vary."""
        if not self.driven:
            return self._at(0.0, order)
        each = [self._at(float(time), order) for time in t]
        return _Values(
            *(np.stack(x) for x in zip(*((c.a, c.s, c.offset) for c in each), strict=True))
        )

    def _partial(self, of: Callable[[JointConstraints], Array], shape: tuple[int, ...]) -> Array:
        """Design partial of something of this shape that the constraints give, (*shape, n_b)."""
        result = np.zeros((*shape, self._n_b))
        for i in self.active:
            result[..., i] = of(self.moved(i)).imag / STEP
        return result

    def _together(self, t: float, order: int) -> _Values:
        """Coefficients moved in every design variable, with a leading axis n_b."""
        c = self._at(t, order)
        if not self.active:
            return c
        parts = [np.repeat(x[None].astype(complex), self._n_b, 0) for x in (c.a, c.s, c.offset)]
        for i in self.active:
            m = self.moved(i)._at(t, order)
            for part, x in zip(parts, (m.a, m.s, m.offset), strict=True):
                part[i] = x
        return _Values(*parts)

    # -- values, one instant -------------------------------------------------------------------

    def constraint(self, q: Array, t: float) -> Array:
        """Phi, one instant."""
        if self._simple:
            return self._B(q) - self._constant.offset
        return self._phi(self._at(t), self._U(q))

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

    def constraint_force_q(self, lam: Array) -> Array:
        """Values of (Phi_q^T lam)_q for rows of lam, shape (k, nnz); independent of q."""
        return self._curvature.rows(lam[:, self._s_row] * self._constant.s)

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
        return self._partial(lambda moved: moved.constraints(q, t), (len(q), self.n_lam))

    def constraint_forces_b(self, q: Array, lam: Array, t: Array) -> Array:
        """(Phi_q^T lam)_b, shape (k, n_q, n_b)."""
        return self._partial(lambda moved: moved.constraint_forces(q, lam, t), q.shape)

    def pull_back(self, q: Array, lam: Array, t: Array, mu: Array, zeta: Array) -> Array:
        """Sum over instants of (Phi_q^T lam)_b^T mu + Phi_b^T zeta, shape (n_b,)."""

        def work(moved: JointConstraints) -> Array:
            c, U, X = moved._over(t), moved._vectors.of(q), moved._vectors.of(mu)
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

    def constraint_q_rate(self, x: Array, t: float, order: int) -> Array:
        """Values of the time derivative of Phi_q of this order, 1 to 3; x is that of q."""
        return self._to_values(self._raw_rate([self._at(t), self._at(t, order)], self._U(x)))

    def rate_b(self, t: float, q: Array, rates: tuple[Array, ...]) -> Array:
        """Design partial of the time derivative of Phi of order 1 to 3, its rates held."""
        return self._partial(lambda moved: moved._rate(t, q, rates), (self.n_lam,))

    def constraint_force_rate_pull_back(self, v: Array, lam: Array, t: float, mu: Array) -> Array:
        """Design partial of mu . (dPhi_q^T/dt) lam with everything else held, shape (n_b,)."""
        return self._partial(lambda moved: mu @ moved.constraint_force_rate(v, v, lam, t), ())

    def side(self, t: float, *states: Array) -> Array:
        """Right side of Phi_q v, Phi_q a or Phi_q q''', by how many of q, v and a are given.

        -Phi_t; -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt; the third is S of the theory.
        """
        if self._simple:
            return np.zeros(self.n_lam)
        return self._side(self._series(t, len(states) + 1), *self._vectors.of(np.stack(states)))

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
        return self._to_force(self._raw_rate(self._series(t, 2), self._U(v)) * lam[self._raw_row])

    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Total design derivative of `constraint_force_rate`."""
        loads = (lam + 1j * STEP * lam_b.T)[:, self._raw_row]

        def entries(series: Sequence[_Values], V: Array) -> Array:
            return self._raw_rate(series, V) * loads

        total = self._to_force.columns(self._total(entries, t, 2, (v,), (v_b,)))
        still = self._raw_rate(self._series(t, 2), self._U(v)) * lam[self._raw_row]
        for i in np.flatnonzero(self._vectors.moves):
            total[:, i] += self.moved(int(i))._to_force(still).imag / STEP
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

    def _raw_rate(self, series: Sequence[_Values], V: Array) -> Array:
        """Time derivative of `_raw`: bilinear entries at that of U, linear ones differentiated."""
        return self._raw(_Values(series[1].a, series[0].s, series[1].offset), V)

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
        for j in range(1, n // 2 + 1):
            share = math.comb(n, j) / (2 if 2 * j == n else 1)
            side = side - share * self._product(series[0], X[j], X[n - j])
        return side

    def _rate(self, t: float, q: Array, rates: tuple[Array, ...]) -> Array:
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
