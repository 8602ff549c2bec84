"""Forces of all loads of a scene, Q = x(t) L^T F(U, V, p), with tangents and design partials.

`LoadInput` holds the numeric data of one load; its force is recorded as a list of operations for
the kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np

from ancfdae.assembly.naming import SceneNaming, Vectors
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import LoadPlan, OperationList
from ancfdae.model.loads.contact import ContactLoad
from ancfdae.model.loads.load import Copies, Load
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.operations import Listed, Operations
from ancfdae.numerics.patterns import LinearMap, SparsityPattern


@final
@dataclass(frozen=True)
class LoadInput:
    """One load with its vectors, parameters, (n_p,), and reference vectors, (n_v, d).

    A load may have several copies: their vectors follow each other, and `own` holds the numbers of
    each copy, (n_copies, n_own), with design derivatives `own_b`, (n_copies, n_own, n_b). The
    reference holds the vectors of the first copy. `masses`, (n_states,), belong to the vectors of
    its states, which come last.
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
        """Whether the force depends on velocities for these design variables."""
        names = self.load.parameters()
        driven = [name for name, row in zip(names, self.p_b, strict=True) if np.any(row)]
        return self.load.uses_velocity(driven)

    def factors(self, t: Array, order: int) -> Array:
        """Return the law of time and the signals, or a time derivative, (k, 1 + n_signals)."""
        law = self.load.factor(self.p, t, order)[:, None]
        signals = self.load.signals(self.p, t, order)
        return law if signals is None else np.concatenate([law, signals], axis=1)

    def forces(self, U: Array, V: Array, signals: Array) -> Array:
        """Return the forces on the vectors of all copies, (..., n_vectors, d), without the law."""
        if not self.own.size:
            return np.asarray(self.force(U, V, signals))
        shape = len(self.own), *self.reference.shape
        U, V = (x.reshape(*x.shape[:-2], *shape) for x in (U, V))
        size = np.broadcast_shapes(U.shape[:-2], self.own.shape[:1])
        rows = (np.broadcast_to(x, (*size, x.shape[-1])) for x in (signals[..., None, :], self.own))
        F = np.asarray(self.force(U, V, np.concatenate(list(rows), axis=-1)))
        return F.reshape(*F.shape[:-3], -1, shape[-1])

    def force(self, U: Any, V: Any, signals: Any) -> Any:
        """Return the forces on the vectors of one copy without the law; w x' on states.

        The numbers of the copy follow the signals.
        """
        F = self.load.force_at(U, V, signals, self.p, self.reference)
        if not len(self.masses):
            return F
        n = len(self.reference) - len(self.masses)
        return F * np.concatenate([np.ones(n), self.masses])[:, None]

    def by_copies(self, U: Array) -> Array:
        """Return vectors of all copies, (k, n_vectors, d), in the shape (k, n_copies, n, d)."""
        return U.reshape(len(U), len(self.own), *self.reference.shape)

    def signals_of_copies(self, t: Array) -> Array:
        """Return the signals and numbers of each copy at times t, shape (k, n_copies, n)."""
        signals, shape = self.factors(t, 0)[:, None, 1:], (len(t), len(self.own))
        rows = (np.broadcast_to(x, (*shape, x.shape[-1])) for x in (signals, self.own))
        return np.real(np.concatenate(list(rows), axis=-1))

    def depth(self, U: Array, signals: Array) -> Array:
        """Return the contact depth of each copy, (k, n_copies), negative if apart; m."""
        assert isinstance(self.load, ContactLoad)
        return np.real(self.load.depth(U, signals, self.p, self.reference)[..., 0, 0])

    @cached_property
    def _divisors(self) -> OperationList:
        """Divisors in the force as operations on vectors, their rates, signals and own numbers."""
        n_signals = self.factors(np.zeros(1), 0).shape[1] - 1
        inputs = 2 * self.reference.size + n_signals + self.own.shape[1]
        operations = Operations(inputs)
        forces, _ = self.listed(operations, n_signals)
        return operations.compiled(operations.divisors(forces.ravel()), np.arange(inputs))

    def divisors(self, t: Array, q: Array, v: Array) -> Array:
        """Return the divisors in the force of all copies in k states, shape (k, n)."""
        U, V = (self.by_copies(self.vectors.of(x)).reshape(-1, self.reference.size) for x in (q, v))
        signals = self.signals_of_copies(t)
        found = self._divisors.values(U, V, signals.reshape(len(U), -1))
        return np.real(found).reshape(len(t), -1)

    def closing(self, U: Array, M: Array, signals: Array) -> Array:
        """Return bounds of the changes of contact depths by movements M, (k, n_copies); m."""
        assert isinstance(self.load, ContactLoad)
        return np.real(self.load.closing(U, M, signals, self.p, self.reference)[..., 0, 0])

    @property
    def couplings(self) -> tuple[Array, Array]:
        """Rows and columns of the tangents' entries, copy by copy.

        They are ordered by pairs of rows of L, and within a pair by pairs of their entries.
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

        InvalidInputError for a force made of functions that cannot be recorded, or that does not
        give a force on each of its vectors.
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
        """Record the force; return the operations of its entries, shape of the vectors, and gates.

        The inputs of the operations are the vectors U, their time derivatives V, the signals, and
        the numbers of a copy.
        """
        size = self.reference.size
        both = np.arange(2 * size).reshape(2, *self.reference.shape)
        U, V = (Listed(operations, x) for x in both)
        signals = Listed(operations, 2 * size + np.arange(n_signals + self.own.shape[1]))
        # The operations of gates come first.
        gates = self.load.gates(U, V, signals, self.p, self.reference)
        numbers = [U.numbers(x).ravel() for x in gates]
        forces = self._on_vectors(self.force(U, V, signals), U)
        return forces, np.concatenate([np.zeros(0, dtype=np.int64), *numbers])

    def _on_vectors(self, F: object, U: Listed) -> Array:
        """Return the operations of the forces F, in the shape of the reference vectors.

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
        """Design variables that the force depends on at fixed q and v."""
        own = np.any(self.own_b, axis=(0, 1))
        moving = np.flatnonzero(np.any(self.p_b, axis=0) | self.vectors.moves | own)
        return sorted({*moving.tolist(), *self.reference_b})

    def moved(self, i: int) -> LoadInput:
        """Return the load with design variable i perturbed by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        own = self.own + 1j * STEP * self.own_b[..., i]
        return replace(self, vectors=self.vectors.moved(i), p=p, reference=reference, own=own)


def own_numbers(
    copies: Copies | None, naming: SceneNaming, p: Array, p_b: Array
) -> tuple[Array, Array]:
    """Return the numbers of each copy of a load, (n, n_own), with design derivatives.

    A load without copies gets one row without numbers.
    """
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
    """Return a text on the shape or type of a force, for an error message."""
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
        """Return the generalised force of this load at times t, shape (k, n_q)."""
        return self.plan.forces(self.item.factors(t, 0), q, v)

    def force_along(
        self, states: tuple[Array, Array], rates: tuple[Array, Array], t: Array, dt: float
    ) -> Array:
        """Return the derivative of the load's Q along rates of q and v and the rate dt of time."""
        factors, of_time = self.item.factors(t, 0), dt * self.item.factors(t, 1)
        dQ = self.plan.forces_along(factors, of_time, *states, *rates)
        if self.item.load.law is None:
            return dQ
        return dQ + self.plan.forces(of_time, *states)

    def tangents(self, q: Array, v: Array, t: Array, velocity: bool) -> Array:
        """Return the values of Q_v if `velocity`, else of Q_q, on the pattern, (k, nnz)."""
        return self.plan.tangents(self.item.factors(t, 0), q, v, velocity)


@final
class LoadForces:
    """Sum of the forces of all loads; states have the shape (k, n_q) at times t, (k,).

    Of loads that depend on neither positions nor velocities, those without a law are summed in one
    vector, `_steady`; each of the others has a row in `_timed` that its law multiplies. The pattern
    must hold the couplings of all other loads.
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
        # Kernel plans of moving loads, and whether each uses velocities.
        self.plans = tuple((load.plan, load.item.uses_velocity) for load in self._moving)
        self.touching = [load for load in self._moving if load.item.load.touches]  # contacts
        # Whether a load depends on positions or velocities.
        self.moving = len(self._moving) > 0
        # Loads whose force may be infinite in some states. Smooth loads of the package and contacts
        # are finite.
        loads = [load.item for load in self._moving]
        self.dividing = [x for x in loads if x.load.sharp and not x.load.touches]
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
        # The sum of constant loads, (n_q,), and the rows that laws multiply, (n, n_q).
        rows = [row for _, row in self._timed]
        self.timed = self._steady, np.array(rows).reshape(len(rows), self._n_q)
        # One for each law of `factors` whose load depends on the motion and is no stiffness, else
        # zero.
        turning = np.zeros(len(self._timed))
        for load in self._moving:
            signals = np.zeros(load.item.factors(np.zeros(1), 0).shape[1] - 1)
            turning = np.concatenate([turning, [float(not load.item.load.elastic)], signals])
        self.turning = turning

    def sharp(self) -> list[LoadInput]:
        """Return the loads whose force may change abruptly with positions or velocities."""
        return [load.item for load in self._moving if load.item.load.sharp]

    def factors(self, t: Array) -> Array:
        """Return law values of loads at times t, (k, n): of constant loads, then of moving loads.

        The law of a load is followed by its signals.
        """
        columns = [item.factors(t, 0) for item in self._items]
        return np.concatenate(columns, axis=1) if columns else np.zeros((len(t), 0))

    @property
    def _items(self) -> list[LoadInput]:
        """Loads in the order of `factors`: those that laws multiply, then moving ones."""
        return [item for item, _ in self._timed] + [load.item for load in self._moving]

    @property
    def changing(self) -> bool:
        """Whether a load has a law of time, or reads one."""
        return any(item.load.law is not None for item in self._items) or (
            self.factors(np.zeros(1)).shape[1] > len(self._items)
        )

    @cached_property
    def changes(self) -> tuple[Array, LinearMap, tuple[tuple[int, int, LoadPlan], ...]]:
        """Design derivatives of steady loads and rows of loads, and moved plans (`DesignPlan`).

        Steady loads have the shape (n_b, n_q), the map takes factors of constant loads with a law.
        """
        steady, n_timed = np.zeros((self._n_b, self._n_q)), len(self._timed)
        rows, moved = np.zeros((self._n_b, self._n_q, n_timed)), []
        for i in self._active:
            own = self._reaching(i)
            steady[i] = own._steady.imag / STEP
            numbers = [k for k, (item, _) in enumerate(self._timed) if i in item.active]
            for k, (_, row) in zip(numbers, own._timed, strict=True):
                rows[i, :, k] = row.imag / STEP
            numbers = [k for k, load in enumerate(self._moving) if i in load.item.active]
            moved += [(k, i, load.plan) for k, load in zip(numbers, own._moving, strict=True)]
        flat = rows.reshape(self._n_b * self._n_q, n_timed)
        at, of = np.nonzero(flat)
        shape = self._n_b * self._n_q, n_timed
        return steady, LinearMap.of(at, of, flat[at, of], shape), tuple(moved)

    def factors_b(self, t: Array) -> Array | None:
        """Return the design partials of `factors`, shape (n_b, k, n); None if all are zero."""
        widths = [item.factors(t, 0).shape[1] for item in self._items]
        ends = np.cumsum([0, *widths]).tolist()
        factors_b = np.zeros((self._n_b, len(t), ends[-1]))
        for i in self._active:
            numbers = [k for k, item in enumerate(self._items) if i in item.active]
            for k, item in zip(numbers, self._reaching(i)._items, strict=True):
                factors_b[i, :, ends[k] : ends[k + 1]] = item.factors(t, 0).imag / STEP
        return factors_b if factors_b.any() else None

    def force(self, q: Array, v: Array, t: Array) -> Array:
        """Return the sum Q of all loads at times t, shape (k, n_q)."""
        Q = self._steady[None]
        if len(q) != 1:
            Q = np.broadcast_to(Q, (len(q), self._n_q))
        for item, row in self._timed:
            Q = Q + item.factors(t, 0) * row
        for load in self._moving:
            Q = Q + load.force(q, v, t)
        return Q

    def following(self, q: Array, t: Array) -> tuple[Array, Array]:
        """Return the follower loads at zero velocity, (n_q,), and the values of their tangent.

        They are the loads that depend on the motion and are no stiffness, at one time.
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
        """Return the derivative of Q along rates of q and v and the rate dt of time, (k, n_q)."""
        change = np.zeros((len(states[0]), self._n_q), dtype=np.result_type(*states, *rates))
        for item, row in self._timed:
            change = change + dt * item.factors(t, 1) * row
        for load in self._moving:
            change = change + load.force_along(states, rates, t, dt)
        return change

    def subtract_tangents(self, q: Array, v: Array, t: Array, K: Array, D: Array | None) -> None:
        """Subtract Q_q from K, and Q_v from D unless None, on the pattern, shape (k, nnz)."""
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
        """Add the derivatives of Q_q and Q_v along rates, at one time, to arrays (1, nnz)."""
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
        """Return mu^T d/db `force_along` at fixed states and rates, at one time, shape (n_b,)."""
        q, v, u, z = (x[None] for x in (*states, *rates))
        return self._partial(
            lambda moved: np.sum(moved.force_along((q, v), (u, z), t, dt) * mu), ()
        )

    def force_total(self, q: Array, v: Array, t: Array, q_b: Array, v_b: Array) -> Array:
        """Return the total design derivative of Q at one time, shape (n_q, n_b)."""
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
        """Return the total design derivative of `force_along` at one time, shape (n_q, n_b).

        `moved_by` are the design derivatives of the states and of the rates.
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
        """Return the design partials of Q at times t, shape (k, n_q, n_b)."""
        return self._partial(lambda moved: moved.force(q.real, v.real, t), (len(q), self._n_q))

    def pull_back(self, q: Array, v: Array, t: Array, mu: Array) -> Array:
        """Return the sum over times of Q_b^T mu, shape (n_b,); mu has shape (k, n_q)."""
        return self._partial(lambda moved: np.sum(moved.force(q, v, t) * mu), ())

    def _partial(self, of: Callable[[LoadForces], Array], shape: tuple[int, ...]) -> Array:
        """Return the design partial, (*shape, n_b), of a function `of` the loads."""
        result = np.zeros((*shape, self._n_b))
        for i in self._active:
            result[..., i] = of(self._reaching(i)).imag / STEP
        return result

    def _reaching(self, i: int) -> LoadForces:
        """Return the loads that depend on design variable i, perturbed by an imaginary step."""
        if i not in self._moved:
            inputs = [item.moved(i) for item in self._inputs if i in item.active]
            self._moved[i] = LoadForces(inputs, self._pattern, self._n_b)
        return self._moved[i]
