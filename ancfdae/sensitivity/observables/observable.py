"""Base class of observables: a number at every time, with partials in states and design.

Values are computed from states over time, and from a system or solution that knows the names of
points and joints.
"""

from __future__ import annotations

import abc
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol, cast, final

import numpy as np

from ancfdae.assembly.beam_sections import StatePartials
from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem, Naming, Solution
from ancfdae.equations.event_solution import START, EventSolution
from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.complex_step import require_derivative
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.time_grid import TimeGrid
from ancfdae.sensitivity.observables.expression import (
    Expression,
    Function,
    Operation,
    evaluated,
    leaf_weights,
    leaves,
    operands_of,
)


class Named(Protocol):
    """An object that knows named points and joints: a mechanical system or a solution."""

    @property
    def naming(self) -> Naming | None:
        """Names of points and joints; None for a system without them."""


@final
@dataclass(frozen=True)
class States:
    """States of a system at k times, one row each, real or complex; shapes as in `Solution`.

    `degree` is the degree of the polynomials between the time points (`TimeGrid`). Some leaves,
    such as angles counted over turns, depend on earlier values: `past` holds their values at the
    first time point of a part of a run, by leaf.
    """

    t: Array
    q: Array
    v: Array
    lam: Array
    degree: int = 1
    past: Mapping[object, float] = field(default_factory=dict)

    @property
    def grid(self) -> TimeGrid:
        """The time points of the states as a grid, for integrals and interpolation."""
        return TimeGrid(self.t, self.degree)

    def rows(self, which: slice | list[int]) -> States:
        """Return the states at the time points with indices `which`."""
        return States(self.t[which], self.q[which], self.v[which], self.lam[which])


def states_of(solution: Solution) -> States:
    """Return the states of a solution as `States`."""
    return States(solution.t, solution.q, solution.v, solution.lam, solution.degree)


def known_naming(system: Named) -> SceneNaming:
    """Return the names of an ANCF scene; raise InvalidInputError for a system without them."""
    if not isinstance(system.naming, SceneNaming):
        raise InvalidInputError(
            "observable of a named point or joint",
            "needs an assembled scene",
            "a system of another kind",
            "Use custom(function, name) for a system of your own.",
        )
    return system.naming


def require_index(where: str, index: int, count: int = 3) -> None:
    """Raise InvalidInputError unless `index` is an integer from 0 to count - 1."""
    given: object = index
    whole = isinstance(given, int | np.integer) and not isinstance(given, bool)
    if not whole or not 0 <= index < count:
        raise InvalidInputError(
            where,
            f"must be an integer from 0 to {count - 1}",
            repr(index),
            "Counting starts at 0, so that axes 0, 1 and 2 are x, y and z.",
        )


def known_system(name: str, system: Named) -> MechanicalSystem:
    """Return `system` if it is a mechanical system; raise InvalidInputError for a solution."""
    if not isinstance(system, MechanicalSystem):
        raise InvalidInputError(
            f"observable {name!r}",
            "needs the mechanical system, not its solution alone",
            type(system).__name__,
            "Pass the system, for a scene assemble(scene, design).",
        )
    return system


def known_scene(system: Named) -> AncfSystem:
    """Return `system` as an assembled scene; raise InvalidInputError for any other system."""
    if not isinstance(system, AncfSystem):
        rule, repair = "needs the assembled scene", "Pass assemble(scene, design)."
        raise InvalidInputError("observable of beams", rule, type(system).__name__, repair)
    return system


# -- observables -------------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class Columns:
    """Partials of one number per time point that vanish outside some columns of the state.

    The values have shape (k, m), or (1, m) if all time points share them; columns are distinct.
    """

    columns: Array | slice
    values: Array

    def add_to(self, total: Array | None, weight: Array, n: int) -> Array:
        """Return `total`, (k, n), or a new array, with the rows added, times a weight per time."""
        total = np.zeros((len(weight), n)) if total is None else total
        total[:, self.columns] += weight[:, None] * self.values
        return total


@final
@dataclass(frozen=True)
class LeafGradient:
    """Partials of a leaf in q, v, lam and, at fixed states, b, (k, n_b); None where they vanish."""

    q: Columns | None = None
    v: Columns | None = None
    lam: Columns | None = None
    b: Array | None = None

    @staticmethod
    def of(p: StatePartials) -> LeafGradient:
        """Return the gradient of a leaf from its partials in some columns of q and v."""
        v = Columns(p.columns, p.v) if np.any(p.v) else None
        return LeafGradient(q=Columns(p.columns, p.q), v=v, b=p.b)


@final
@dataclass(frozen=True)
class ObservablePartials:
    """Value, (k,), and partials of an observable at every time point.

    Partials in states, (k, n), are None where the observable does not depend on them; partials in
    the design variables, b, (k, n_b), are at fixed states.
    """

    value: Array
    q: Array | None
    v: Array | None
    lam: Array | None
    b: Array

    def total(self, q_b: Array | None, v_b: Array | None, lam_b: Array | None) -> Array:
        """Return total design derivatives, (k, n_b), from those of the states; None is zero."""
        total = self.b
        for rows, x_b in ((self.q, q_b), (self.v, v_b), (self.lam, lam_b)):
            if rows is not None and x_b is not None:
                used = np.flatnonzero(rows.any(axis=0))
                total = total + np.einsum("kn,knb->kb", rows[:, used], x_b[:, used])
        return total


class Observable(Expression["Observable"]):
    """A number at every time, H(t, q, v, lam, b) of eq. (20).

    Observables combine by + - * / ** and elementary NumPy functions with each other and with
    numbers into observables.
    """

    def of(self, function: Function, operands: tuple[object, ...]) -> Observable:
        """Return a function of observables as an observable."""
        return Composite(function, operands)

    def accepts(self, other: object) -> bool:
        """Return whether `other` is an observable."""
        return isinstance(other, Observable)

    def check(self, system: Named) -> None:
        """Raise UnknownNameError or InvalidInputError if the system lacks the observable."""
        for leaf in self.leaves():
            leaf.check_leaf(system)

    def leaves(self) -> list[Leaf]:
        """Return the distinct elementary observables (leaves) of the expression."""
        return cast("list[Leaf]", leaves(self))

    @property
    def remembers_any(self) -> bool:
        """Whether a value depends on earlier times, so that parts of a run need their `past`."""
        return any(leaf.remembers for leaf in self.leaves())

    def value(self, system: Named, states: States) -> Array:
        """Return the values, shape (k,); complex if a state or a design variable is complex."""
        return list(self.node_values(system, states).values())[-1]

    def node_values(self, system: Named, states: States) -> dict[object, Array]:
        """Return the values, (k,), of all nodes of the expression tree, the observable last."""
        return evaluated(self, lambda leaf: leaf.leaf_value(system, states))

    def partials(self, system: MechanicalSystem, states: States) -> ObservablePartials:
        """Return values and partial derivatives of the observable at real states."""
        values = self.node_values(system, states)
        return self.weighted_partials(system, states, values, np.ones(len(states.t)))

    def weighted_partials(
        self, system: MechanicalSystem, states: States, values: dict[object, Array], weight: Array
    ) -> ObservablePartials:
        """Return the partials times a weight per time point, shape (k,).

        `values` are the values of all nodes at these states, from `node_values`. Raises
        InvalidInputError for complex states, and for a user's function that lacks derivatives at
        three of the times.
        """
        if any(np.iscomplexobj(x) for x in values.values()):
            raise InvalidInputError(
                "partials",
                "need real states and design values",
                "complex ones",
                "`value` takes complex ones.",
            )
        for node in values:
            if isinstance(node, Operation) and node.function.by_user:
                x = [a[[0, len(a) // 2, -1]] for a in operands_of(node, values)]
                dx = [np.where(a == 0, 1.0, a) for a in x]
                require_derivative(node.function.name, node.function.call, x, dx)
        parts: dict[str, Array | None] = dict.fromkeys(("q", "v", "lam"))
        b = np.zeros((len(weight), system.n_b))
        with np.errstate(all="ignore"):  # the caller checks for values that are not finite
            for leaf, factor in leaf_weights(values, weight).items():
                gradient = cast(Leaf, leaf).leaf_gradient(system, states)
                for name, states_of in (("q", states.q), ("v", states.v), ("lam", states.lam)):
                    rows: Columns | None = getattr(gradient, name)
                    if rows is not None:
                        parts[name] = rows.add_to(parts[name], factor, states_of.shape[1])
                if gradient.b is not None:
                    b += factor[:, None] * gradient.b
        return ObservablePartials(list(values.values())[-1], **parts, b=b)


class Leaf(Observable):
    """An elementary observable, not made of others; immutable and compared by value."""

    #: Whether its value depends on earlier times, as a count of turns does; it is then piecewise
    #: constant.
    remembers: ClassVar[bool] = False
    #: Whether its value may depend on time explicitly, at fixed states.
    names_time: ClassVar[bool] = False

    @abc.abstractmethod
    def check_leaf(self, system: Named) -> None:
        """Raise if the system lacks what the leaf observes; see `Observable.check`."""

    @abc.abstractmethod
    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the values of this elementary observable at the states, shape (k,)."""

    @abc.abstractmethod
    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partial derivatives of this elementary observable at real states."""


@final
@dataclass(frozen=True, eq=False)
class Composite(Operation, Observable):
    """A function of observables, such as their sum, as an observable."""


def remembered(nodes: Mapping[object, Array]) -> dict[object, float]:
    """Return the last values of leaves with a memory: the `past` for the next part of the run."""
    last = ((node, x) for node, x in nodes.items() if isinstance(node, Leaf) and node.remembers)
    return {node: float(x[-1]) for node, x in last}


def followed(
    observable: Observable, parts: Iterable[tuple[Named, States]]
) -> Iterator[dict[object, Array]]:
    """Yield the values of all nodes of an observable, itself last, in each part of a run.

    What an observable remembers (counts of turns) passes from one part to the next.
    """
    past: Mapping[object, float] = {}
    for system, states in parts:
        nodes = observable.node_values(system, replace(states, past=past))
        yield nodes
        past = remembered(nodes)


@in_one_thread
def observe(
    observable: Observable,
    solution: Solution | EventSolution,
    system: MechanicalSystem | Mapping[str, MechanicalSystem] | None = None,
) -> Array:
    """Return the values of an observable along a solution, shape (n_t,).

    Energies, design variables and `custom` functions need the system that was integrated. Of a run
    with events the values belong to the times `EventSolution.t`, in which an event has two entries:
    the value just before it, then the value just after it. If the run passes modes, `system` is a
    mapping of their names to their systems, ``{"start": assemble(scene), "closed": ...}``.
    """
    repair = "Pass the observable that an objective is made of, without Integral or Terminal."
    require_kind("observe, observable", observable, (Observable,), repair)
    kinds = Solution, EventSolution
    require_kind("observe, solution", solution, kinds, "Call simulate or differentiate.")
    phases: Sequence[Solution] = (solution,) if isinstance(solution, Solution) else solution.phases
    names = (START,) if isinstance(solution, Solution) else solution.modes
    parts = []
    for mode, phase in zip(names, phases, strict=True):
        known = _known(system, mode, phase)
        observable.check(known)
        parts.append((known, states_of(phase)))
    return np.concatenate([list(x.values())[-1] for x in followed(observable, parts)])


def _known(
    system: MechanicalSystem | Mapping[str, MechanicalSystem] | None, mode: str, phase: Solution
) -> Named:
    """Return the system of a phase, or the phase itself without one; raise for unfit ones."""
    if isinstance(system, Mapping):
        if mode not in system:
            raise UnknownNameError("system of mode", mode, list(system))
        system = system[mode]
    elif system is not None and mode != START:
        rule, got = "must be a mapping for a run that passes modes", f"one system and {mode!r}"
        repair = f'For example {{"start": assemble(scene), "{mode}": assemble(other)}}.'
        raise InvalidInputError("observe, system", rule, got, repair)
    if system is None:
        return phase
    require_kind("observe, system", system, (MechanicalSystem,), "For example assemble(scene).")
    require_same_sizes("observe, system", system, phase)
    if system.n_b > 0 and not np.iscomplexobj(system.b) and np.iscomplexobj(phase.q):
        raise InvalidInputError(
            "observe",
            "a complex solution needs a system at complex design values",
            "real ones",
            "Use Observable.partials for derivatives.",
        )
    return system


def require_same_sizes(where: str, system: MechanicalSystem, solution: Solution) -> None:
    """Raise InvalidInputError unless a solution has the sizes of a system."""
    sizes, got = (system.n_q, system.n_lam), (solution.q.shape[1], solution.lam.shape[1])
    if sizes != got:
        rule, repair = "must be that of the solution", "Pass the system that was integrated."
        counts = (
            f"{sizes[0]} coordinates and {sizes[1]} multipliers where that has {got[0]}, {got[1]}"
        )
        raise InvalidInputError(where, rule, counts, repair)
