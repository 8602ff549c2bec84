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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy import sparse

from ancfdae.ancf.vectors import Vectors
from ancfdae.joints import Coefficients, Joint
from ancfdae.naming import JointLayout
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern

# Imaginary step for derivatives of polynomials of a few numbers; exact, its square vanishes.
_STEP = 1e-40


@final
@dataclass(frozen=True)
class _Values:
    """Flat coefficients of all joints at one instant: linear, bilinear, offset.

    Design partials have a leading axis n_b.
    """

    a: Array
    s: Array
    offset: Array

    def moved(self, other: _Values, size: complex) -> _Values:
        return _Values(
            self.a + size * other.a, self.s + size * other.s, self.offset + size * other.offset
        )

    def of(self, variable: int) -> _Values:
        """Pick one design variable of partials."""
        return _Values(self.a[variable], self.s[variable], self.offset[variable])


@final
@dataclass(frozen=True)
class JointInput:
    """One joint with its parameter values and reference vectors, and their design partials.

    Attributes
    ----------
    joint : Joint
    p : array, shape (n_p,); p_b : array, shape (n_p, n_b)
    reference : array, shape (n_vectors, d); reference_b : array, shape (n_vectors, d, n_b)
    """

    joint: Joint
    p: Array
    p_b: Array
    reference: Array
    reference_b: Array

    def at(self, t: float, order: int) -> Coefficients:
        """Return the coefficients."""
        return self.joint.coefficients(self.p, self.reference, t, order)

    def partial(self, t: float, order: int, variable: int) -> Coefficients:
        """Return their partial in one design variable."""
        p = self.p.real + 1j * _STEP * self.p_b[:, variable]
        reference = self.reference.real + 1j * _STEP * self.reference_b[..., variable]
        c = self.joint.coefficients(p, reference, t, order)
        return Coefficients(c.linear.imag / _STEP, c.bilinear.imag / _STEP, c.offset.imag / _STEP)

    def structure(self) -> Coefficients:
        """Return coefficients that vanish only where they do at all times and parameters."""
        found = self.at(0.0, 0)
        linear, bilinear = np.abs(found.linear), np.abs(found.bilinear)
        # Generic parameters and instants: a coefficient that is not zero by structure shows.
        p = self.p * (1 + 1j * _STEP) + 1j * _STEP * np.sqrt(1.0 + np.arange(len(self.p)))
        reference = self.reference + 1j * _STEP * np.sum(self.reference_b, axis=-1)
        for order in range(4 if self.joint.driven else 1):
            for t in (0.0, 0.37):
                c = self.joint.coefficients(p, reference, t, order)
                linear = linear + np.abs(c.linear.real) + np.abs(c.linear.imag)
                bilinear = bilinear + np.abs(c.bilinear.real) + np.abs(c.bilinear.imag)
        return Coefficients(linear, bilinear, found.offset)


@final
class JointConstraints:
    """Phi and all that follows from it.

    Arrays of states have instants as leading axis, (k, n_q); methods that take one instant say
    so.

    Parameters
    ----------
    inputs : sequence of JointInput
    vectors : Vectors
        The vectors of all joints, in the order of the inputs.
    n_q, n_b, d : int
    """

    def __init__(
        self, inputs: Sequence[JointInput], vectors: Vectors, n_q: int, n_b: int, d: int
    ) -> None:
        self._inputs, self._vectors = inputs, vectors
        self._n_b, self._d = n_b, d
        self._number(inputs)
        self.driven = any(item.joint.driven for item in inputs)
        self.linear = len(self._s_row) == 0
        self._cache: tuple[float, _Values] | None = None
        self._constant = self._collect(lambda item: item.at(0.0, 0))
        self._constant_b = self._read_partials(0.0, 0)
        self._place(n_q)
        self._active = self._find_active()

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

    def _collect(self, read: Callable[[JointInput], Coefficients]) -> _Values:
        """Flatten the coefficients of all joints onto the structure."""
        a, s, offset = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
        for item, (linear, bilinear) in zip(self._inputs, self._picks, strict=True):
            c = read(item)
            a.append(c.linear[linear])
            # Both halves of the symmetric matrix in one entry, 1/2 on the diagonal.
            s.append(c.bilinear[bilinear] * np.where(bilinear[1] == bilinear[2], 0.5, 1.0))
            offset.append(c.offset)
        return _Values(np.concatenate(a), np.concatenate(s), np.concatenate(offset))

    def _place(self, n_q: int) -> None:
        """Constant maps from raw entries to Phi_q, Phi_q^T lam and (Phi_q^T lam)_q."""
        d, L = self._d, self._vectors.matrix
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
        self._row_map = LinearMap.of(
            self._a_row,
            np.arange(len(self._a_row)),
            np.ones(len(self._a_row)),
            (self.n_lam, len(self._a_row)),
        )
        self._s_row_map = LinearMap.of(
            self._s_row,
            np.arange(len(self._s_row)),
            np.ones(len(self._s_row)),
            (self.n_lam, len(self._s_row)),
        )
        self._raw_row_map = LinearMap.of(
            self._raw_row, np.arange(count), np.ones(count), (self.n_lam, count)
        )
        self._simple = self.linear and not self.driven
        if self._simple:
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
            zero = self._constant
            return zero if order == 0 else zero.moved(zero, -1.0)
        if order == 0 and self._cache is not None and self._cache[0] == t:
            return self._cache[1]
        values = self._collect(lambda item: item.at(t, order if item.joint.driven else 0))
        if order > 0:
            values = self._only_driven(values)
        else:
            self._cache = (t, values)
        return values

    def _only_driven(self, values: _Values) -> _Values:
        """Zero what does not depend on time: all but the rows of driven joints, all of s."""
        rows = np.zeros(self.n_lam, dtype=bool)
        for place, item in zip(self.joints, self._inputs, strict=True):
            rows[place.first_row : place.first_row + place.rows] = item.joint.driven
        return _Values(values.a * rows[self._a_row], 0 * values.s, values.offset * rows)

    def _partials(self, t: float, order: int = 0) -> _Values:
        if not self.driven:
            known = self._constant_b
            return known if order == 0 else known.moved(known, -1.0)
        return self._read_partials(t, order)

    def _read_partials(self, t: float, order: int) -> _Values:
        columns = []
        for i in range(self._n_b):
            values = self._collect(
                lambda item, i=i: item.partial(t, order if item.joint.driven else 0, i)  # type: ignore[misc]  # bound per pass
            )
            columns.append(values if order == 0 else self._only_driven(values))
        empty = (len(self._a_row), len(self._s_row), self.n_lam)
        parts = zip(*((c.a, c.s, c.offset) for c in columns), strict=True) if columns else None
        if parts is None:
            return _Values(*(np.zeros((0, size)) for size in empty))
        return _Values(*(np.stack(part) for part in parts))

    def _find_active(self) -> list[int]:
        """Design variables that constraints depend on with q held."""
        if self.driven:
            return list(range(self._n_b))
        c = self._constant_b
        found = np.any(c.a, axis=1) | np.any(c.s, axis=1) | np.any(c.offset, axis=1)
        return [int(i) for i in np.flatnonzero(found | self._vectors.moves)]

    # -- values, one instant -------------------------------------------------------------------

    def constraint(self, q: Array, t: float) -> Array:
        """Phi, one instant."""
        if self._simple:
            return self._B(q) - self._constant.offset
        U = self._vectors.of(q[None])[0]
        return self._phi(self._at(t), U)

    def constraint_q(self, q: Array, t: float) -> Array:
        """Values of Phi_q, one instant."""
        if self._simple:
            return self._B_values
        return self._to_values(self._raw(self._at(t), self._vectors.of(q[None])[0]))

    def constraint_force(self, q: Array, lam: Array, t: float) -> Array:
        """Phi_q^T lam, one instant."""
        if self._simple:
            return self._B.transposed(lam)
        raw = self._raw(self._at(t), self._vectors.of(q[None])[0])
        return self._to_force(raw * lam[self._raw_row])

    def constraint_force_q(self, lam: Array) -> Array:
        """Values of (Phi_q^T lam)_q for rows of lam, shape (k, nnz); independent of q."""
        return self._curvature.rows(lam[:, self._s_row] * self._constant.s)

    # -- values, many instants -----------------------------------------------------------------

    def constraints_q(self, q: Array, t: Array) -> Array:
        """Values of Phi_q, shape (k, nnz)."""
        if self._simple:
            return np.broadcast_to(self._B_values, (len(q), len(self._B_values)))
        U = self._vectors.of(q)
        raw = np.stack([self._raw(self._at(time), u) for time, u in zip(t, U, strict=True)])
        return self._to_values.rows(raw)

    def constraints_b(self, q: Array, t: Array) -> Array:
        """Phi_b, shape (k, n_lam, n_b)."""
        U, U_b = self._vectors.of(q), self._vectors.of_b(q)
        result = np.zeros((len(q), self.n_lam, self._n_b), dtype=q.dtype)
        for k in range(len(q)) if self.driven else [slice(None)]:
            time = float(t[k]) if self.driven else 0.0
            c, partials = self._at(time), self._partials(time)
            for i in self._active:
                moved = c.moved(partials.of(i), 1j * _STEP)
                u = U[k].real + 1j * _STEP * U_b[k][..., i]
                result[k, ..., i] = self._phi(moved, u).imag / _STEP
        return result

    def constraint_forces_b(self, q: Array, lam: Array, t: Array) -> Array:
        """(Phi_q^T lam)_b, shape (k, n_q, n_b)."""
        U, U_b = self._vectors.of(q), self._vectors.of_b(q)
        n_q = q.shape[1]
        result = np.zeros((len(q), n_q, self._n_b), dtype=q.dtype)
        if len(self._active) == 0:
            return result
        on_vectors = np.zeros((len(q), U.shape[1] * self._d))
        for k in range(len(q)) if self.driven else [slice(None)]:
            time = float(t[k]) if self.driven else 0.0
            c, partials = self._at(time), self._partials(time)
            loads = lam[k][..., self._raw_row]
            for i in self._active:
                moved = c.moved(partials.of(i), 1j * _STEP)
                u = U[k].real + 1j * _STEP * U_b[k][..., i]
                raw_b = self._raw(moved, u).imag / _STEP
                force = np.atleast_2d(raw_b * loads)
                result[k, ..., i] = self._to_force.rows(force).reshape(result[k, ..., i].shape)
            weighted = np.atleast_2d(self._raw(c, U[k]).real * loads)
            np.add.at(np.atleast_2d(on_vectors[k]).T, self._raw_at, weighted.T)
        return result + self._vectors.lift_b(on_vectors.reshape(U.shape))

    # -- start: rates and their total derivatives, one instant -----------------------------------

    def constraint_q_rate(self, v: Array, t: float) -> Array:
        """Values of dPhi_q/dt."""
        return self._rate_values(v, t, 1)

    def constraint_q_second_rate(self, a: Array, t: float) -> Array:
        """Values of d^2 Phi_q/dt^2."""
        return self._rate_values(a, t, 2)

    def constraint_q_third_rate(self, jerk: Array, t: float) -> Array:
        """Values of d^3 Phi_q/dt^3."""
        return self._rate_values(jerk, t, 3)

    def rate_b(self, t: float, q: Array, rates: tuple[Array, ...]) -> Array:
        """Design partial of the time derivative of Phi of order 1 to 3, its rates held."""

        def rate(series: Sequence[_Values], U: Array, *V: Array) -> Array:
            side = (self._velocity_side, self._acceleration_side, self._jerk_side)[len(V) - 1]
            moving: Array = self._jacobian_times(series, U, V[-1]) - side(series, U, *V[:-1])
            return moving

        return self._held(rate, t, len(rates) + 1, (q, *rates))

    def constraint_force_pull_back(self, q: Array, lam: Array, t: float, mu: Array) -> Array:
        """Design partial of mu . Phi_q^T lam with everything else held, shape (n_b,)."""
        total: Array = lam @ self._held(self._jacobian_times, t, 1, (q, mu))
        return total

    def constraint_force_rate_pull_back(self, v: Array, lam: Array, t: float, mu: Array) -> Array:
        """Design partial of mu . (dPhi_q^T/dt) lam with everything else held, shape (n_b,)."""

        def turning(series: Sequence[_Values], V: Array, X: Array) -> Array:
            rate = _Values(series[1].a, series[0].s, series[1].offset)
            return self._jacobian_times([rate], V, X)

        total: Array = lam @ self._held(turning, t, 2, (v, mu))
        return total

    def velocity_side(self, q: Array, t: float) -> Array:
        """-Phi_t."""
        if self._simple:
            return np.zeros(self.n_lam)
        U = self._vectors.of(q[None])[0]
        return self._velocity_side([self._at(t, n) for n in range(2)], U)

    def velocity_side_total(self, q: Array, t: float, q_b: Array) -> Array:
        """Total design derivative of `velocity_side`."""
        if self._simple:
            return np.zeros((self.n_lam, self._n_b))
        return self._total(self._velocity_side, t, 2, (q,), (q_b,))

    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """-(Phi_q v)_q v - 2 Phi_qt v - Phi_tt."""
        if self._simple:
            return np.zeros(self.n_lam)
        U, V = self._vectors.of(np.stack([q, v]))
        return self._acceleration_side([self._at(t, n) for n in range(3)], U, V)

    def acceleration_side_total(
        self, q: Array, v: Array, t: float, q_b: Array, v_b: Array
    ) -> Array:
        """Total design derivative of `acceleration_side`."""
        if self._simple:
            return np.zeros((self.n_lam, self._n_b))
        return self._total(self._acceleration_side, t, 3, (q, v), (q_b, v_b))

    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Right side of Phi_q q''' = S."""
        U, V, Z = self._vectors.of(np.stack([q, v, a]))
        return self._jerk_side([self._at(t, n) for n in range(4)], U, V, Z)

    def jerk_side_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Total design derivative of `jerk_side`."""
        return self._total(self._jerk_side, t, 4, (q, v, a), (q_b, v_b, a_b))

    def constraint_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Total design derivative of Phi_q x with x held."""
        if self._simple and not self._active:
            return np.zeros((self.n_lam, self._n_b))
        return self._total(self._jacobian_times, t, 1, (q, x), (q_b, np.zeros_like(q_b)))

    def constraint_force_rate(self, q: Array, v: Array, lam: Array, t: float) -> Array:
        """(dPhi_q^T/dt) lam."""
        V = self._vectors.of(v[None])[0]
        return self._to_force(
            self._raw_rate([self._at(t, n) for n in range(2)], V) * lam[self._raw_row]
        )

    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Total design derivative of `constraint_force_rate`."""
        series = [self._at(t, n) for n in range(2)]
        V = self._vectors.of(v[None])[0]
        raw = self._raw_rate(series, V)
        raw_b = self._total(self._raw_rate, t, 2, (v,), (v_b,))
        loads, loads_b = lam[self._raw_row], lam_b[self._raw_row]
        total = self._to_force.columns(raw_b * loads[:, None] + raw[:, None] * loads_b)
        on_vectors = np.zeros(V.size, dtype=raw.dtype)
        np.add.at(on_vectors, self._raw_at, raw * loads)
        return total + only(self._vectors.lift_b(on_vectors.reshape(1, *V.shape)))

    # -- polynomials ---------------------------------------------------------------------------

    def _phi(self, c: _Values, U: Array) -> Array:
        flat = _flat(U)
        products = np.sum(U[..., self._s_i, :] * U[..., self._s_j, :], axis=-1)
        linear = _sum_rows(self._row_map, c.a * flat[..., self._a_at])
        return linear + _sum_rows(self._s_row_map, c.s * products) - c.offset

    def _raw(self, c: _Values, U: Array) -> Array:
        """Nonzero entries of Phi_U."""
        s = c.s[..., None]
        a = np.broadcast_to(c.a, (*U.shape[:-2], c.a.shape[-1]))
        to_i, to_j = _flat(s * U[..., self._s_j, :]), _flat(s * U[..., self._s_i, :])
        return np.concatenate([a, to_i, to_j], axis=-1)

    def _rate_values(self, x: Array, t: float, order: int) -> Array:
        """Bilinear entries at the time derivative x of q, linear ones differentiated."""
        rate = _Values(self._at(t, order).a, self._at(t).s, self._at(t).offset)
        return self._to_values(self._raw(rate, self._vectors.of(x[None])[0]))

    def _raw_rate(self, series: Sequence[_Values], V: Array) -> Array:
        """Time derivative of `_raw`."""
        return self._raw(_Values(series[1].a, series[0].s, series[1].offset), V)

    def _jacobian_times(self, series: Sequence[_Values], U: Array, X: Array) -> Array:
        flat = _flat(X)
        return _sum_rows(self._raw_row_map, self._raw(series[0], U) * flat[..., self._raw_at])

    def _linear(self, c: _Values, U: Array) -> Array:
        flat = _flat(U)
        return _sum_rows(self._row_map, c.a * flat[..., self._a_at])

    def _product(self, c: _Values, U: Array, V: Array) -> Array:
        """Sum of s (U_i . V_j + V_i . U_j)."""
        i, j = self._s_i, self._s_j
        products = np.sum(U[..., i, :] * V[..., j, :] + V[..., i, :] * U[..., j, :], axis=-1)
        return _sum_rows(self._s_row_map, c.s * products)

    def _velocity_side(self, series: Sequence[_Values], U: Array) -> Array:
        return series[1].offset - self._linear(series[1], U)

    def _acceleration_side(self, series: Sequence[_Values], U: Array, V: Array) -> Array:
        moving = self._product(series[0], V, V) + 2 * self._linear(series[1], V)
        side: Array = series[2].offset - moving - self._linear(series[2], U)
        return side

    def _jerk_side(self, series: Sequence[_Values], U: Array, V: Array, Z: Array) -> Array:
        moving = self._product(series[0], V, Z) + self._linear(series[1], Z)
        moving = moving + self._linear(series[2], V)
        side: Array = series[3].offset - 3 * moving - self._linear(series[3], U)
        return side

    def _held(
        self, function: Callable[..., Array], t: float, orders: int, states: tuple[Array, ...]
    ) -> Array:
        """Design partial of a polynomial with the states held, shape (n_lam, n_b)."""
        result = np.zeros((self.n_lam, self._n_b))
        if not self._active:
            return result
        U, U_b = self._vectors.of(np.stack(states)), self._vectors.of_b(np.stack(states))
        series = [(self._at(t, n), self._partials(t, n)) for n in range(orders)]
        for i in self._active:
            moved = [c.moved(partials.of(i), 1j * _STEP) for c, partials in series]
            arguments = (x + 1j * _STEP * x_b[..., i] for x, x_b in zip(U, U_b, strict=True))
            result[:, i] = function(moved, *arguments).imag / _STEP
        return result

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
        moved = [self._at(t, n).moved(self._partials(t, n), 1j * _STEP) for n in range(orders)]
        arguments = []
        for k, x_b in enumerate(states_b):
            along = self._vectors.of(x_b.T) + np.moveaxis(U_b[k], -1, 0)
            arguments.append(U[k] + 1j * _STEP * along)
        columns: Array = function(moved, *arguments).imag / _STEP
        return columns.T


def _flat(U: Array) -> Array:
    """Join the last two axes; also where a leading axis is empty."""
    return U.reshape(*U.shape[:-2], U.shape[-2] * U.shape[-1])


def _sum_rows(rows: LinearMap, x: Array) -> Array:
    return rows(x) if x.ndim == 1 else rows.rows(x)
