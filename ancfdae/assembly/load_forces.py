"""Forces of all loads of a scene, Q = x(t) L^T F(U, V, p), with tangents and design partials.

One load as numbers, and its force as a list of operations, which kernels take.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from ancfdae.assembly.naming import SceneNaming, Vectors
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import LoadPlan
from ancfdae.model.loads.contact import ContactLoad
from ancfdae.model.loads.load import Copies, Load
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.operations import Listed, Operations
from ancfdae.numerics.patterns import SparsityPattern


@final
@dataclass(frozen=True)
class LoadInput:
    """One load with its vectors, parameters, (n_p,), and vectors of the reference, (n_v, d).

    A load may stand in several copies: their vectors follow each other, and `own` has their own
    numbers, (n_copies, n_own), with design derivatives `own_b`, (n_copies, n_own, n_b). The
    reference holds the vectors of the first copy. `masses` belong to the vectors of its states,
    (n_states,), which come last.
    """

    load: Load
    vectors: Vectors
    p: Array
    p_b: Array
    reference: Array
    reference_b: dict[int, Array]
    masses: Array
    own: Array
    own_b: Array

    @property
    def uses_velocity(self) -> bool:
        """Whether the force depends on velocities at these design variables."""
        names = self.load.parameters()
        driven = [name for name, row in zip(names, self.p_b, strict=True) if np.any(row)]
        return self.load.uses_velocity(driven)

    def factors(self, t: Array, order: int) -> Array:
        """Return the law of time and its signals, or their derivatives, (k, 1 + n_signals)."""
        law = self.load.factor(self.p, t, order)[:, None]
        signals = self.load.signals(self.p, t, order)
        return law if signals is None else np.concatenate([law, signals], axis=1)

    def forces(self, U: Array, V: Array, signals: Array) -> Array:
        """Return the forces on the vectors of all copies, (..., n_vectors, d), as `force`."""
        if not self.own.size:
            return np.asarray(self.force(U, V, signals))
        shape = len(self.own), *self.reference.shape
        U, V = (x.reshape(*x.shape[:-2], *shape) for x in (U, V))
        size = np.broadcast_shapes(U.shape[:-2], self.own.shape[:1])
        rows = (np.broadcast_to(x, (*size, x.shape[-1])) for x in (signals[..., None, :], self.own))
        F = np.asarray(self.force(U, V, np.concatenate(list(rows), axis=-1)))
        return F.reshape(*F.shape[:-3], -1, shape[-1])

    def force(self, U: Any, V: Any, signals: Any) -> Any:
        """Return the forces on the vectors of a copy, without the law; w x' on vectors of states.

        Its own numbers stand behind the signals.
        """
        F = self.load.force_at(U, V, signals, self.p, self.reference)
        if not len(self.masses):
            return F
        n = len(self.reference) - len(self.masses)
        return F * np.concatenate([np.ones(n), self.masses])[:, None]

    def by_copies(self, U: Array) -> Array:
        """Return vectors of all copies, (k, n_vectors, d), as (k, n_copies, n, d)."""
        return U.reshape(len(U), len(self.own), *self.reference.shape)

    def signals_of_copies(self, t: Array) -> Array:
        """Return signals and own numbers of each copy at times t, (k, n_copies, n)."""
        signals, shape = self.factors(t, 0)[:, None, 1:], (len(t), len(self.own))
        rows = (np.broadcast_to(x, (*shape, x.shape[-1])) for x in (signals, self.own))
        return np.real(np.concatenate(list(rows), axis=-1))

    def depth(self, U: Array, signals: Array) -> Array:
        """Return depths of contacts of copies, (k, n_copies), negative where surfaces are apart."""
        assert isinstance(self.load, ContactLoad)
        return np.real(self.load.depth(U, signals, self.p, self.reference)[..., 0, 0])

    def closing(self, U: Array, M: Array, signals: Array) -> Array:
        """Return bounds of the changes of depths by movements, (k, n_copies)."""
        assert isinstance(self.load, ContactLoad)
        return np.real(self.load.closing(U, M, signals, self.p, self.reference)[..., 0, 0])

    @property
    def couplings(self) -> tuple[Array, Array]:
        """Rows and columns of what tangents have, by pairs of rows of L and of their entries.

        Of one copy after the other.
        """
        first, column, size = self.vectors.first, self.vectors.column, self.reference.size
        known = dict[bytes, tuple[Array, Array]]()
        pairs = list[tuple[Array, Array]]()
        for begin in range(0, len(first) - 1, size):
            counts = np.diff(first[begin : begin + size + 1])
            key = counts.tobytes()
            if key not in known:
                row = np.repeat(np.arange(size), counts)
                i, j = (x.ravel() for x in np.indices((len(row), len(row))))
                order = np.lexsort((j, i, row[j], row[i]))
                known[key] = i[order], j[order]
            i, j = known[key]
            pairs.append((column[first[begin] + i], column[first[begin] + j]))
        rows, columns = (np.concatenate(x) for x in zip(*pairs, strict=True))
        return rows, columns

    def plan(self, pattern: SparsityPattern) -> LoadPlan:
        """Return the force as operations, with tangents on a pattern that holds the couplings.

        InvalidInputError for a force that is made of other functions than lists have, or that is no
        force on each of its vectors.
        """
        size, vectors, copies = self.reference.size, self.vectors, max(len(self.own), 1)
        n_signals = self.factors(np.zeros(1), 0).shape[1] - 1
        operations = Operations(2 * size + n_signals + self.own.shape[1])
        forces, gates = self.listed(operations, n_signals)
        needed = np.concatenate([forces.ravel(), gates])
        constants, *lists, outputs = operations.arrays(needed)
        places = pattern.index(*self.couplings), operations.order(gates, needed)
        arrays = vectors.first, vectors.column, *lists, outputs[:size], *places
        indices = tuple(np.asarray(x, np.int32) for x in arrays)
        numbers = vectors.value, constants, self.own.ravel()
        return LoadPlan(indices, numbers, vectors.n_q, pattern.size, n_signals, copies)

    def listed(self, operations: Operations, n_signals: int) -> tuple[Array, Array]:
        """Write the force down; return the numbers of its entries, in the shape of the vectors.

        The first inputs of the operations are the vectors U, their time derivatives V, the signals
        and own numbers of a copy. Returns the numbers of gates, too.
        """
        size = self.reference.size
        both = np.arange(2 * size).reshape(2, *self.reference.shape)
        U, V = (Listed(operations, x) for x in both)
        signals = Listed(operations, 2 * size + np.arange(n_signals + self.own.shape[1]))
        # What gates need comes first.
        gates = self.load.gates(U, V, signals, self.p, self.reference)
        numbers = [U.numbers(x).ravel() for x in gates]
        forces = self._on_vectors(self.force(U, V, signals), U)
        return forces, np.concatenate([np.zeros(0, dtype=np.int64), *numbers])

    def _on_vectors(self, F: object, U: Listed) -> Array:
        """Return the numbers of the forces F, in the shape of the reference vectors.

        Raises InvalidInputError if F cannot be brought to that shape.
        """
        shape = self.reference.shape
        try:
            numbers = np.asarray(U.numbers(F))
            # On several vectors one force would act without its opposite.
            if shape[0] > 1 and numbers.shape != shape:
                raise ValueError(numbers.shape)
            return np.broadcast_to(numbers, shape)
        except InvalidInputError:
            raise
        except (TypeError, ValueError) as error:
            where, rule = f"force of load {self.load.name!r}", f"must have the shape {shape} here"
            repair = (
                "Return an array of the shape of U, made by functions of NumPy. Of forces f and g, "
                "(..., d), on two vectors it is np.stack([f, g], axis=-2), not np.array([f, g])."
            )
            raise InvalidInputError(where, rule, _described(F), repair) from error

    @property
    def active(self) -> list[int]:
        """Design variables that the force depends on with q and v held."""
        own = np.any(self.own_b, axis=(0, 1))
        moving = np.flatnonzero(np.any(self.p_b, axis=0) | self.vectors.moves | own)
        return sorted({*moving.tolist(), *self.reference_b})

    def moved(self, i: int) -> LoadInput:
        """Return the load moved in design variable i by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        own = self.own + 1j * STEP * self.own_b[..., i]
        return replace(self, vectors=self.vectors.moved(i), p=p, reference=reference, own=own)


def own_numbers(
    copies: Copies | None, naming: SceneNaming, p: Array, p_b: Array
) -> tuple[Array, Array]:
    """Return the own numbers of copies, (n, n_own), with design derivatives; one by default."""
    n_b = naming.lengths_b.shape[1]
    if copies is None:
        return np.zeros((1, 0)), np.zeros((1, 0, n_b))
    own = copies.own.astype(np.result_type(copies.own, naming.lengths))
    own_b = np.zeros((*own.shape, n_b))
    first = {beam.name: beam.first_element for beam in naming.layout.beams}
    for column, elements in copies.lengths.items():
        at = np.array([first[beam] + element for beam, element in elements])
        own_b[:, column] = copies.own[:, [column]] * naming.lengths_b[at]
        own[:, column] *= naming.lengths[at]
    if copies.parameters is None:
        return own, own_b
    which = copies.parameters
    own = np.concatenate([own, p[which]], axis=1)
    return own, np.concatenate([own_b, p_b[which]], axis=1)


def _described(force: Any) -> str:
    """Say what a force is, with the kind of its entries instead of symbols."""
    if isinstance(force, Listed):
        return f"shape {force.shape}"
    if isinstance(force, list | tuple | np.ndarray):
        return f"a {type(force).__name__} of {len(force)} entries that are arrays of symbols"
    return repr(force)


@final
@dataclass(frozen=True, eq=False)
class MovingLoad:
    """A load that depends on positions or velocities."""

    item: LoadInput
    plan: LoadPlan

    def force(self, q: Array, v: Array, t: Array) -> Array:
        """Return the force of this load, shape (n_q,), at time t."""
        return self.plan.forces(self.item.factors(t, 0), q, v)

    def force_along(
        self, states: tuple[Array, Array], rates: tuple[Array, Array], t: Array, dt: float
    ) -> Array:
        """Differentiate its Q along rates of (q, v) and of time."""
        factors, of_time = self.item.factors(t, 0), dt * self.item.factors(t, 1)
        dQ = self.plan.forces_along(factors, of_time, *states, *rates)
        if self.item.load.law is None:
            return dQ
        return dQ + self.plan.forces(of_time, *states)

    def tangents(self, q: Array, v: Array, t: Array, velocity: bool) -> Array:
        """Return values of Q_q or Q_v."""
        return self.plan.tangents(self.item.factors(t, 0), q, v, velocity)


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
            Q_q += load.plan.tangents(factors, q, v, False).imag / STEP
            if Q_v is not None and load.item.uses_velocity:
                Q_v += load.plan.tangents(factors, q, v, True).imag / STEP

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
