"""One load as numbers, and its force as a list of operations, which kernels take."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.vectors import Vectors
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import LoadPlan
from ancfdae.model.loads.load import Copies, Load
from ancfdae.numerics.arrays import STEP, Array
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

        InvalidInputError for a force that is made of other functions than jets have, or that is no
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
