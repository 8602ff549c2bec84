"""Forces of all loads of a scene, Q = x(t) L^T F(U, V, p), with tangents and design partials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.load_input import LoadInput
from ancfdae.kernels import LoadPlan, load_forces, load_forces_along, load_tangents
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.patterns import SparsityPattern


@final
@dataclass(frozen=True, eq=False)
class MovingLoad:
    """A load that depends on positions or velocities."""

    item: LoadInput
    plan: LoadPlan

    def force(self, q: Array, v: Array, t: Array) -> Array:
        """Return the force of this load, shape (n_q,), at time t."""
        return load_forces(self.plan, self.item.factors(t, 0), q, v)

    def force_along(
        self, states: tuple[Array, Array], rates: tuple[Array, Array], t: Array, dt: float
    ) -> Array:
        """Differentiate its Q along rates of (q, v) and of time."""
        factors, of_time = self.item.factors(t, 0), dt * self.item.factors(t, 1)
        dQ = load_forces_along(self.plan, factors, of_time, *states, *rates)
        if self.item.load.law is None:
            return dQ
        return dQ + load_forces(self.plan, of_time, *states)

    def tangents(self, q: Array, v: Array, t: Array, velocity: bool) -> Array:
        """Return values of Q_q or Q_v."""
        return load_tangents(self.plan, self.item.factors(t, 0), q, v, velocity)


@final
class LoadForces:
    """Sum of all loads; states have instants as leading axis, (k, n_q), and t is (k,).

    Of loads that depend on neither positions nor velocities those without a law are one vector,
    `_steady`, and those with one a row each that the law multiplies. The pattern must hold the
    couplings of the loads that move.
    """

    def __init__(self, inputs: Sequence[LoadInput], pattern: SparsityPattern, n_b: int) -> None:
        self._inputs, self._pattern, self._n_b = inputs, pattern, n_b
        self._n_q = pattern.shape[0]
        self.uses_velocity = any(item.uses_velocity for item in inputs)
        self._active = sorted({i for item in inputs for i in item.active})
        self._moved: dict[int, LoadForces] = {}
        self._moving = [
            MovingLoad(item, item.plan(pattern)) for item in inputs if not item.load.constant
        ]
        # Whether a load depends on positions or velocities.
        self.moving = len(self._moving) > 0
        self._steady = np.zeros(self._n_q)
        self._timed: list[tuple[LoadInput, Array]] = []
        zero = np.zeros((1, self._n_q))
        for item in inputs:
            if not item.load.constant:
                continue
            U = item.vectors.of(zero)
            row = item.vectors.lift(item.forces(U, U, zero[:, :0]))[0]
            if item.load.law is None:
                self._steady = self._steady + row
            else:
                self._timed.append((item, row))
        # One for each law of `factors` whose load turns with the motion, else zero.
        turning = np.zeros(len(self._timed))
        for load in self._moving:
            signals = np.zeros(load.item.factors(np.zeros(1), 0).shape[1] - 1)
            turning = np.concatenate([turning, [float(not load.item.load.elastic)], signals])
        self.turning = turning

    def plans(self) -> tuple[tuple[LoadPlan, bool], ...]:
        """Return plans of the moving loads for the kernels, and whether they use velocities."""
        return tuple((load.plan, load.item.uses_velocity) for load in self._moving)

    def touching(self) -> list[MovingLoad]:
        """Return the loads that act during short contacts."""
        return [load for load in self._moving if load.item.load.touches]

    def sharp(self) -> list[LoadInput]:
        """Return the loads that may change more suddenly than the motion does."""
        return [load.item for load in self._moving if load.item.load.sharp]

    def timed(self) -> tuple[Array, Array]:
        """Return the sum of constant loads, (n_q,), and what laws multiply, (n_loads, n_q)."""
        rows = [row for _, row in self._timed]
        return self._steady, np.array(rows).reshape(len(rows), self._n_q)

    def factors(self, t: Array) -> Array:
        """Return the laws at times t, (k, n): of loads that do not move, then of others.

        Behind the law of a load stand its signals.
        """
        items = [item for item, _ in self._timed] + [load.item for load in self._moving]
        columns = [item.factors(t, 0) for item in items]
        return np.concatenate(columns, axis=1) if columns else np.zeros((len(t), 0))

    def force(self, q: Array, v: Array, t: Array) -> Array:
        """Return the sum Q of all loads in k states, shape (k, n_q)."""
        Q = self._steady[None]
        if len(q) != 1:
            Q = np.broadcast_to(Q, (len(q), self._n_q))
        for item, row in self._timed:
            Q = Q + item.factors(t, 0) * row
        for load in self._moving:
            Q = Q + load.force(q, v, t)
        return Q

    def following(self, q: Array, t: Array) -> tuple[Array, Array]:
        """Return the loads that turn with the motion, at rest, of one instant, and their tangent.

        Shape (n_q,), and values on the pattern.
        """
        Q, Q_q = np.zeros(self._n_q, dtype=q.dtype), np.zeros(self._pattern.size)
        rest = np.zeros((1, self._n_q))
        for load in self._moving:
            if not load.item.load.elastic:
                Q = Q + only(load.force(q[None], rest, t))
                Q_q = Q_q + only(load.tangents(q[None].real, rest, t, False)).real
        return Q, Q_q

    def force_along(
        self, states: tuple[Array, Array], rates: tuple[Array, Array], t: Array, dt: float
    ) -> Array:
        """Differentiate Q along rates of (q, v) and of time, shape (k, n_q)."""
        change = np.zeros((len(states[0]), self._n_q), dtype=np.result_type(*states, *rates))
        for item, row in self._timed:
            change = change + dt * item.factors(t, 1) * row
        for load in self._moving:
            change = change + load.force_along(states, rates, t, dt)
        return change

    def subtract_tangents(self, q: Array, v: Array, t: Array, K: Array, D: Array | None) -> None:
        """Subtract Q_q, and Q_v where asked for, from values on the pattern, shape (k, nnz)."""
        q, v = q.real, v.real
        for load in self._moving:
            K -= load.tangents(q, v, t, False).real
            if D is not None and load.item.uses_velocity:
                D -= load.tangents(q, v, t, True).real

    def add_tangents_along(
        self,
        states: tuple[Array, Array],
        rates: tuple[Array, Array],
        t: Array,
        dt: float,
        Q_q: Array,
        Q_v: Array | None,
    ) -> None:
        """Add the derivatives of Q_q and Q_v along rates of one instant, shape (1, nnz)."""
        q, v = (x[None].real + 1j * STEP * dx.real for x, dx in zip(states, rates, strict=True))
        for load in self._moving:
            factors = load.item.factors(t, 0).real + 1j * STEP * dt * load.item.factors(t, 1).real
            Q_q += load_tangents(load.plan, factors, q, v, False).imag / STEP
            if Q_v is not None and load.item.uses_velocity:
                Q_v += load_tangents(load.plan, factors, q, v, True).imag / STEP

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
        moved = q + 1j * STEP * q_b.T, v + 1j * STEP * v_b.T
        along = self.force(*moved, np.repeat(t, len(moved[0])))
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
        along = self.force_along((q, v), (u, z), np.repeat(t, len(q)), dt)
        return along.imag.T / STEP + total

    def force_b(self, q: Array, v: Array, t: Array) -> Array:
        """Return the design partials of Q in k states, shape (k, n_q, n_b)."""
        return self._partial(lambda moved: moved.force(q.real, v.real, t), (len(q), self._n_q))

    def pull_back(self, q: Array, v: Array, t: Array, mu: Array) -> Array:
        """Sum over instants of Q_b^T mu, shape (n_b,); mu has shape (k, n_q)."""
        return self._partial(lambda moved: np.sum(moved.force(q, v, t) * mu), ())

    def _partial(self, of: Callable[[LoadForces], Array], shape: tuple[int, ...]) -> Array:
        """Design partial of something of this shape that the loads give, (*shape, n_b)."""
        result = np.zeros((*shape, self._n_b))
        for i in self._active:
            result[..., i] = of(self._reaching(i)).imag / STEP
        return result

    def _reaching(self, i: int) -> LoadForces:
        """Return the loads that design variable i reaches, moved by an imaginary step."""
        if i not in self._moved:
            inputs = [item.moved(i) for item in self._inputs if i in item.active]
            self._moved[i] = LoadForces(inputs, self._pattern, self._n_b)
        return self._moved[i]
