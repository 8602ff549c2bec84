"""Forces of all loads of a scene: Q = L^T F(U, V, p), with tangents and design partials.

F comes from the loads, each a closed form of a few numbers. Its Jacobians are
taken by complex step, all directions in one evaluation: exact to round-off,
and a new load needs no derivative of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.ancf.vectors import Vectors
from ancfdae.loads import Load
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern


@final
@dataclass(frozen=True)
class LoadInput:
    """One load with its vectors and parameter values.

    Attributes
    ----------
    load : Load
    vectors : Vectors
    p : array, shape (n_p,); p_b : array, shape (n_p, n_b)
    """

    load: Load
    vectors: Vectors
    p: Array
    p_b: Array

    @property
    def uses_velocity(self) -> bool:
        """Whether the force depends on velocities at these design variables."""
        names = self.load.parameters()
        driven = [name for name, row in zip(names, self.p_b, strict=True) if np.any(row)]
        return self.load.uses_velocity(driven)

    def force(self, U: Array, V: Array) -> Array:
        """Return the forces on the vectors at the real parameters."""
        return self.load.force(U, V, self.p.real)

    @property
    def active(self) -> list[int]:
        """Design variables that the force depends on with q and v held."""
        return [int(i) for i in np.flatnonzero(np.any(self.p_b, axis=0) | self.vectors.moves)]

    def moved(self, i: int) -> LoadInput:
        """Return the load moved in design variable i by an imaginary step."""
        p = self.p + 1j * STEP * self.p_b[:, i]
        return replace(self, vectors=self.vectors.moved(i), p=p)


@final
class LoadForces:
    """Sum of all loads; states have instants as leading axis, (k, n_q).

    Parameters
    ----------
    inputs : sequence of LoadInput
    n_q, n_b, d : int
    """

    def __init__(self, inputs: Sequence[LoadInput], n_q: int, n_b: int, d: int) -> None:
        self._inputs, self._n_q, self._n_b, self._d = inputs, n_q, n_b, d
        self.uses_velocity = any(item.uses_velocity for item in inputs)
        self._moving = [item for item in inputs if not item.load.constant]
        self._active = sorted({i for item in inputs for i in item.active})
        self._steady = np.zeros(n_q)
        zero = np.zeros((1, n_q))
        for item in inputs:
            if item.load.constant:
                U = item.vectors.of(zero)
                self._steady = self._steady + item.vectors.lift(item.load.force(U, U, item.p))[0]

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
        self._maps = []
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

    def force(self, q: Array, v: Array) -> Array:
        """Q, shape (k, n_q)."""
        Q = np.broadcast_to(self._steady, (len(q), self._n_q))
        for item in self._moving:
            F = item.load.force(item.vectors.of(q), item.vectors.of(v), item.p)
            Q = Q + item.vectors.lift(F)
        return Q

    def following(self, q: Array) -> Array:
        """Return the loads that turn with the motion, at rest, of one instant, shape (n_q,)."""
        Q = np.zeros(self._n_q, dtype=q.dtype)
        for item in self._moving:
            if not item.load.elastic:
                U = item.vectors.of(q[None])
                Q = Q + item.vectors.lift(item.load.force(U, 0 * U, item.p))[0]
        return Q

    def add_following_tangents(self, q: Array, values: Array) -> None:
        """Add the partial of `following` to values on the pattern, shape (1, nnz)."""
        for item, to_values in zip(self._moving, self._maps, strict=True):
            if not item.load.elastic:
                U = item.vectors.of(q[None]).real
                values += to_values.rows(_flat(_jacobian(item.force, U, 0 * U, True)))

    def force_rate(self, q: Array, v: Array, a: Array) -> Array:
        """dQ/dt along the motion, shape (k, n_q)."""
        rate = np.zeros((len(q), self._n_q), dtype=q.dtype)
        for item in self._moving:
            U, V, Z = (item.vectors.of(x) for x in (q, v, a))
            rate = rate + item.vectors.lift(item.load.force_rate(U, V, Z, item.p))
        return rate

    def add_tangents(self, q: Array, v: Array, Q_q: Array, Q_v: Array | None) -> None:
        """Add Q_q, and Q_v where asked for, to values on the pattern, shape (k, nnz)."""
        for item, to_values in zip(self._moving, self._maps, strict=True):
            U, V = item.vectors.of(q).real, item.vectors.of(v).real
            Q_q += to_values.rows(_flat(_jacobian(item.force, U, V, True)))
            if Q_v is not None and item.uses_velocity:
                Q_v += to_values.rows(_flat(_jacobian(item.force, U, V, False)))

    def add_tangent_rates(
        self, states: tuple[Array, Array, Array], Q_q: Array, Q_v: Array | None
    ) -> None:
        """Add the time derivatives of Q_q and Q_v along (q, v, a) of one instant, shape (1, nnz).

        With F' = F_U V + F_V Z of a load, F'_U = (F_U)' and F'_V = F_U + (F_V)'.
        """
        for item, to_values in zip(self._moving, self._maps, strict=True):
            U, V, Z = (item.vectors.of(x[None]).real for x in states)

            def rate(U: Array, V: Array, Z: Array = Z, item: LoadInput = item) -> Array:
                return item.load.force_rate(U, V, Z[:, None] + 0 * V, item.p.real)

            Q_q += to_values.rows(_flat(_jacobian(rate, U, V, True)))
            if Q_v is not None and item.uses_velocity:
                own = _jacobian(item.force, U, V, True)
                Q_v += to_values.rows(_flat(_jacobian(rate, U, V, False) - own))

    def pull_back_rate(self, states: tuple[Array, Array, Array], mu: Array) -> Array:
        """Design partial of mu . dQ/dt with the states held, shape (n_b,)."""
        result, rows = np.zeros(self._n_b), tuple(x[None] for x in states)
        for i in self._active:
            result[i] = np.sum(self.moved(i).force_rate(*rows).imag * mu) / STEP
        return result

    def force_total(self, q: Array, v: Array, q_b: Array, v_b: Array) -> Array:
        """Total design derivative of Q for one instant, shape (n_q, n_b)."""
        total: Array = self.force_b(q[None], v[None])[0]
        for item in self._moving:
            U, V = item.vectors.of(q[None]), item.vectors.of(v[None])
            F_b = _jacobian(item.force, U, V, True)[0] @ (item.vectors.matrix @ q_b)
            if item.uses_velocity:
                F_b = F_b + _jacobian(item.force, U, V, False)[0] @ (item.vectors.matrix @ v_b)
            total += item.vectors.matrix.T @ F_b
        return total

    def force_rate_total(self, states: Sequence[Array], states_b: Sequence[Array]) -> Array:
        """Total design derivative of `force_rate` for one instant, shape (n_q, n_b)."""
        total = np.zeros((self._n_q, self._n_b))
        for i in range(self._n_b) if self._moving else ():
            along = zip(states, states_b, strict=True)
            rows = ((x + 1j * STEP * x_b[:, i])[None] for x, x_b in along)
            total[:, i] = self.moved(i).force_rate(*rows)[0].imag / STEP
        return total

    def force_b(self, q: Array, v: Array) -> Array:
        """Q_b, shape (k, n_q, n_b)."""
        result = np.zeros((len(q), self._n_q, self._n_b))
        for i in self._active:
            result[..., i] = self.moved(i).force(q.real, v.real).imag / STEP
        return result

    def pull_back(self, q: Array, v: Array, mu: Array) -> Array:
        """Sum over instants of Q_b^T mu, shape (n_b,); mu has shape (k, n_q)."""
        total = np.zeros(self._n_b)
        for i in self._active:
            total[i] = np.sum(self.moved(i).force(q, v).imag * mu) / STEP
        return total

    def moved(self, i: int) -> LoadForces:
        """Return the loads moved in design variable i by an imaginary step."""
        if i not in self._active:
            return self
        inputs = [item.moved(i) for item in self._inputs]
        return LoadForces(inputs, self._n_q, self._n_b, self._d)


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
