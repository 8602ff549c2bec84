"""Forces of all loads of a scene: Q = x(t) L^T F(U, V, p), with tangents and design partials.

F comes from the loads, each a closed form of a few numbers. Its Jacobians are
taken by complex step, all directions in one evaluation: exact to round-off,
and a new load needs no derivative of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.vectors import Vectors
from ancfdae.model.loads import Load
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern


@final
@dataclass(frozen=True)
class LoadInput:
    """One load with its vectors, parameters, (n_p,), and vectors of the reference, (n_v, d).

    Instants t have the leading axes of the vectors.
    """

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

    @cached_property
    def real(self) -> LoadInput:
        """The load at the real parameters."""
        return replace(self, p=self.p.real, reference=self.reference.real)

    def factor(self, t: Array, order: int) -> Array:
        """Return the law of time or its derivative, shape (..., 1, 1)."""
        return self.load.factor(self.p, t, order)[..., None, None]

    def force(self, U: Array, V: Array, t: Array) -> Array:
        """Return the forces on the vectors."""
        F: Array = self.load.force(U, V, self.p, self.reference)
        return F if self.load.law is None else self.factor(t, 0) * F

    def force_along(
        self, U: Array, V: Array, rates: tuple[Array, Array], t: Array, dt: float
    ) -> Array:
        """Return their derivative along rates of the vectors, of their velocities and of time."""
        dF = self.load.force_along(U, V, rates, self.p, self.reference)
        if self.load.law is None:
            return dF
        F = self.load.force(U, V, self.p, self.reference)
        return np.asarray(self.factor(t, 0) * dF + dt * self.factor(t, 1) * F)

    @property
    def active(self) -> list[int]:
        """Design variables that the force depends on with q and v held."""
        own = np.flatnonzero(np.any(self.p_b, axis=0) | self.vectors.moves)
        return sorted({*own.tolist(), *self.reference_b})

    def moved(self, i: int) -> LoadInput:
        """Return the load moved in design variable i by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        return replace(self, vectors=self.vectors.moved(i), p=p, reference=reference)


@final
class LoadForces:
    """Sum of all loads; states have instants as leading axis, (k, n_q), and t is (k,).

    Of loads that depend on neither positions nor velocities those without a law are one vector,
    `_steady`, and those with one a row each that the law multiplies.
    """

    def __init__(self, inputs: Sequence[LoadInput], n_q: int, n_b: int, d: int) -> None:
        self._inputs, self._n_q, self._n_b, self._d = inputs, n_q, n_b, d
        self.uses_velocity = any(item.uses_velocity for item in inputs)
        self._moving = [item for item in inputs if not item.load.constant]
        self._active = sorted({i for item in inputs for i in item.active})
        self._steady = np.zeros(n_q)
        self._timed: list[tuple[LoadInput, Array]] = []
        zero = np.zeros((1, n_q))
        for item in inputs:
            if not item.load.constant:
                continue
            U = item.vectors.of(zero)
            row = item.vectors.lift(item.load.force(U, U, item.p, item.reference))[0]
            if item.load.law is None:
                self._steady = self._steady + row
            else:
                self._timed.append((item, row))

    @property
    def moving(self) -> bool:
        """Whether a load depends on positions or velocities."""
        return len(self._moving) > 0

    def timed(self) -> tuple[Array, Array]:
        """Return the sum of constant loads, (n_q,), and what laws multiply, (n_loads, n_q)."""
        rows = [row for _, row in self._timed]
        return self._steady, np.array(rows).reshape(len(rows), self._n_q)

    def factors(self, t: Array) -> Array:
        """Return the laws at instants, shape (k, n_loads)."""
        columns = [item.factor(t, 0)[:, 0, 0] for item, _ in self._timed]
        return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))

    def couplings(self) -> tuple[Array, Array]:
        """Rows and columns of all entries that tangents may have."""
        rows, columns = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for item in self._moving:
            used = np.unique(item.vectors.matrix.tocoo().col)
            rows.append(np.repeat(used, len(used)))
            columns.append(np.tile(used, len(used)))
        return np.concatenate(rows), np.concatenate(columns)

    def place(self, pattern: Pattern) -> None:
        """Prepare tangents on the system's pattern, which must hold the couplings."""
        self._maps, self._size = [], pattern.size
        for item in self._moving:
            L = item.vectors.matrix.toarray()
            size = len(L)
            used = np.flatnonzero(np.any(L != 0, axis=0))
            rows, columns = np.repeat(used, len(used)), np.tile(used, len(used))
            # L^T F_U L, entry (r, c): sum over i, j of L_ir F_U,ij L_jc.
            weights = np.einsum("ir,jc->rcij", L[:, used], L[:, used]).reshape(-1, size * size)
            entry, raw = np.nonzero(weights)
            index = pattern.index(rows, columns)[entry]
            shape = (pattern.size, size * size)
            self._maps.append(LinearMap.of(index, raw, weights[entry, raw], shape))

    def force(self, q: Array, v: Array, t: Array) -> Array:
        """Q, shape (k, n_q)."""
        Q = np.broadcast_to(self._steady, (len(q), self._n_q))
        for item, row in self._timed:
            Q = Q + item.factor(t, 0)[..., 0] * row
        for item in self._moving:
            Q = Q + item.vectors.lift(item.force(item.vectors.of(q), item.vectors.of(v), t))
        return Q

    def following(self, q: Array, t: Array) -> tuple[Array, Array]:
        """Return the loads that turn with the motion, at rest, of one instant, and their tangent.

        Shape (n_q,), and values on the pattern.
        """
        Q, Q_q = np.zeros(self._n_q, dtype=q.dtype), np.zeros((1, self._size))
        for item, to_values in zip(self._moving, self._maps, strict=True):
            if not item.load.elastic:
                U = item.vectors.of(q[None])
                Q = Q + item.vectors.lift(item.force(U, 0 * U, t))[0]
                real = U.real
                Q_q = Q_q + to_values.rows(_flat(_jacobian(_at(item, t), real, 0 * real, True)))
        return Q, only(Q_q)

    def force_along(
        self, states: tuple[Array, Array], rates: tuple[Array, Array], t: Array, dt: float
    ) -> Array:
        """Differentiate Q along rates of (q, v) and of time, shape (k, n_q)."""
        change = np.zeros((len(states[0]), self._n_q), dtype=np.result_type(*states, *rates))
        for item, row in self._timed:
            change = change + dt * item.factor(t, 1)[..., 0] * row
        for item in self._moving:
            U, V, dU, dV = (item.vectors.of(x) for x in (*states, *rates))
            change = change + item.vectors.lift(item.force_along(U, V, (dU, dV), t, dt))
        return change

    def subtract_tangents(self, q: Array, v: Array, t: Array, K: Array, D: Array | None) -> None:
        """Subtract Q_q, and Q_v where asked for, from values on the pattern, shape (k, nnz)."""
        for item, to_values in zip(self._moving, self._maps, strict=True):
            U, V = item.vectors.of(q).real, item.vectors.of(v).real
            K -= to_values.rows(_flat(_jacobian(_at(item, t), U, V, True)))
            if D is not None and item.uses_velocity:
                D -= to_values.rows(_flat(_jacobian(_at(item, t), U, V, False)))

    def add_tangents_along(
        self,
        states: tuple[Array, Array],
        rates: tuple[Array, Array],
        t: Array,
        dt: float,
        Q_q: Array,
        Q_v: Array | None,
    ) -> None:
        """Add the derivatives of Q_q and Q_v along rates of one instant, shape (1, nnz).

        They are the partials of the derivative of Q, the rates held.
        """
        for item, to_values in zip(self._moving, self._maps, strict=True):
            U, V, dU, dV = (item.vectors.of(x[None]).real for x in (*states, *rates))
            real = item.real

            def along(
                U: Array, V: Array, dU: Array = dU, dV: Array = dV, real: LoadInput = real
            ) -> Array:
                moving = dU[:, None] + 0 * U, dV[:, None] + 0 * V
                return real.force_along(U, V, moving, t[:, None], dt)

            Q_q += to_values.rows(_flat(_jacobian(along, U, V, True)))
            if Q_v is not None and item.uses_velocity:
                Q_v += to_values.rows(_flat(_jacobian(along, U, V, False)))

    def force_along_pull_back(
        self,
        states: tuple[Array, Array],
        rates: tuple[Array, Array],
        t: Array,
        dt: float,
        mu: Array,
    ) -> Array:
        """Design partial of mu . `force_along` with everything else held, shape (n_b,)."""
        q, v, u, z = (x[None] for x in (*states, *rates))
        return self._partial(
            lambda moved: np.sum(moved.force_along((q, v), (u, z), t, dt) * mu), ()
        )

    def force_total(self, q: Array, v: Array, t: Array, q_b: Array, v_b: Array) -> Array:
        """Total design derivative of Q for one instant, shape (n_q, n_b)."""
        along = self.force(q + 1j * STEP * q_b.T, v + 1j * STEP * v_b.T, t)
        return along.imag.T / STEP + only(self.force_b(q[None], v[None], t))

    def force_along_total(
        self,
        states: tuple[Array, ...],
        rates: tuple[Array, ...],
        t: Array,
        dt: float,
        moved_by: tuple[Array, ...],
    ) -> Array:
        """Total design derivative of `force_along` for one instant, shape (n_q, n_b).

        `moved_by` are the derivatives of the states and of the rates.
        """
        q, v, u, z = (x[None] for x in (*states, *rates))
        total = self._partial(
            lambda moved: only(moved.force_along((q, v), (u, z), t, dt)), (self._n_q,)
        )
        pairs = zip((*states, *rates), moved_by, strict=True)
        q, v, u, z = (x + 1j * STEP * x_b.T for x, x_b in pairs)
        return self.force_along((q, v), (u, z), t, dt).imag.T / STEP + total

    def force_b(self, q: Array, v: Array, t: Array) -> Array:
        """Q_b, shape (k, n_q, n_b)."""
        return self._partial(lambda moved: moved.force(q.real, v.real, t), (len(q), self._n_q))

    def pull_back(self, q: Array, v: Array, t: Array, mu: Array) -> Array:
        """Sum over instants of Q_b^T mu, shape (n_b,); mu has shape (k, n_q)."""
        return self._partial(lambda moved: np.sum(moved.force(q, v, t) * mu), ())

    def _partial(self, of: Callable[[LoadForces], Array], shape: tuple[int, ...]) -> Array:
        """Design partial of something of this shape that the loads give, (*shape, n_b)."""
        result = np.zeros((*shape, self._n_b))
        for i in self._active:
            result[..., i] = of(self.moved(i)).imag / STEP
        return result

    def moved(self, i: int) -> LoadForces:
        """Return the loads moved in design variable i by an imaginary step."""
        if i not in self._active:
            return self
        inputs = [item.moved(i) for item in self._inputs]
        return LoadForces(inputs, self._n_q, self._n_b, self._d)


def _at(item: LoadInput, t: Array) -> Callable[[Array, Array], Array]:
    """Return the force of a load at its real parameters, of perturbed vectors."""
    real = item.real
    return lambda U, V: real.force(U, V, t[:, None])


def _flat(matrices: Array) -> Array:
    return matrices.reshape(len(matrices), -1)


def _jacobian(
    force: Callable[[Array, Array], Array], U: Array, V: Array, in_position: bool
) -> Array:
    """Return F_U or F_V, shape (k, n, n) with n = n_v d; all directions at once."""
    k, n_v, d = U.shape
    n = n_v * d
    moves = 1j * STEP * np.eye(n).reshape(1, n, n_v, d)
    still = np.zeros((1, n, 1, 1))
    U, V = U[:, None], V[:, None]
    positions, velocities = (U + moves, V + still) if in_position else (U + still, V + moves)
    F = force(positions, velocities)
    jacobian: Array = np.swapaxes(F.imag.reshape(k, n, n) / STEP, 1, 2)
    return jacobian
