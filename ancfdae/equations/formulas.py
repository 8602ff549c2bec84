"""M, Q and Phi of a system as lists of operations, with every derivative that the protocol needs.

The functions of a user are called once, on symbols for t, q, v and b
(`ancfdae.numerics.operations`). With D for the derivative along a direction, which
`Operations.along` adds as further operations,

    Phi', Phi'', Phi'''      D Phi, D D Phi, D D D Phi along the motion (1, v, a, j) of (t, q, v, a)
    Phi_q and its rates      D along each coordinate, then along the motion
    f                        M a + Phi_q^T lam - Q
    f_q, f_v, f_b, Phi_b     D along each coordinate, velocity and design variable
    totals                   D along changes of all arguments of a value

Each list is compiled when its values are first asked for. Lists take real and complex numbers, so
that what the protocol derives from values by complex steps is exact to round-off as well. M, Q or
Phi that cannot be traced is one operation, a call (`ancfdae.numerics.external`).
"""

from __future__ import annotations

import copy
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations.complex_steps import FORGOTTEN
from ancfdae.equations.system import SystemProperties
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import OperationList
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.external import Called
from ancfdae.numerics.operations import TRACE_FAILURES, NotTraceable, Operations, Traced, told
from ancfdae.numerics.patterns import SparsityPattern

# A method of `Formulas` that returns indices of operations.
Value: TypeAlias = Callable[..., tuple[Array, ...]]
# Largest number of unknowns for which matrices have full patterns.
_FULL = 64
# Names of coordinates and their rates in a motion: each is the rate of the one before.
_MOTION = ("q", "v", "a", "j")


# Whether constructors of systems store b only and trace no formulas.
_BARE: ContextVar[bool] = ContextVar("_BARE", default=False)


@contextmanager
def bare() -> Iterator[None]:
    """Context in which systems are constructed with their b but without operation lists."""
    token = _BARE.set(True)
    try:
        yield
    finally:
        _BARE.reset(token)


def is_bare() -> bool:
    """Whether systems are currently constructed without operation lists."""
    return _BARE.get()


@final
class _Method:
    """A method of a system as a function of one array of its arguments, b last."""

    def __init__(self, system: Any, name: str, inputs: str, shape: tuple[int, ...]) -> None:
        self._system, self._method, self._shape = copy.copy(system), name, shape
        self.name = f"{type(system).__name__}.{name}"
        sizes = {"t": 1, "q": system.n_q, "v": system.n_q, "b": system.n_b}
        self._inputs, self._ends = inputs, np.cumsum([sizes[x] for x in inputs])
        self._at: tuple[bytes | None, Any] = None, None

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_at": (None, None)}

    def __call__(self, x: Array) -> Array:
        *given, b = np.split(x.copy(), self._ends[:-1])
        if self._at[0] != (key := b.tobytes()):
            with bare():
                self._at = key, self._system.with_values(b)
        method = getattr(self._at[1], self._method)
        found = np.asarray(method(*_arguments(self._inputs, given)))
        if found.shape != self._shape:
            raise wrong_shape(self.name, self._shape, found.shape)
        return found.ravel()


def _arguments(inputs: str, parts: Sequence[Array]) -> list[Any]:
    """Return the arguments of a method from arrays; t becomes a number."""
    return [x.item() if name == "t" else x for name, x in zip(inputs, parts, strict=False)]


def _has_symbols(function: Callable[[], Any]) -> bool:
    """Whether a function returns symbols, or fails when called with them."""
    try:
        return np.asarray(function()).dtype.kind not in "biuf"
    except (InvalidInputError, *TRACE_FAILURES):
        return True


def wrong_shape(where: str, shape: tuple[int, ...], got: tuple[int, ...]) -> InvalidInputError:
    """Return the error for a method that returns an array of another shape."""
    rule = f"must have shape {shape}"
    return InvalidInputError(where, rule, got, f"Return an array of the shape {shape}.")


class _List(NamedTuple):
    """Several values of a system as one operation list: inputs, and slices and shapes of values."""

    operations: OperationList
    inputs: tuple[str, ...]
    places: tuple[slice, ...]
    shapes: tuple[tuple[int, ...], ...]


@final
class Formulas:
    """M, Q and Phi of a system as operations, with their derivatives, for any design values.

    Methods other than `values` return arrays of indices of operations; `values` takes such a method
    with its arguments, and evaluates the operations.

    Parameters
    ----------
    system : FormulaSystem
    """

    def __init__(self, system: Any) -> None:
        n, m = system.n_q, system.n_lam
        sizes = {"t": 1, **dict.fromkeys(_MOTION, n), "lam": system.n_lam, "b": system.n_b}
        sizes |= {f"d{name}": size for name, size in sizes.items()}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self._at = {name: np.arange(*ends[i : i + 2]) for i, name in enumerate(sizes)}
        self._names, self._ends = tuple(sizes), ends[1:]
        self._operations = operations = Operations(ends[-1])
        self._one = np.array([operations.constant(1.0)])
        self._made: dict[tuple[str, int], Array] = {}
        self._lists: dict[tuple[Any, ...], _List] = {}
        self.kind, self.called = type(system), dict[str, str]()
        symbols = {x: Traced.array(operations, self._at[x]) for x in "tqvb"}
        try:
            moved, why = system.with_values(symbols["b"].copy()), ""
        except InvalidInputError:
            raise
        except TRACE_FAILURES as error:
            moved, why = None, told(error)
        if not (why or np.array_equal(Traced.numbers(operations, moved.b), self._at["b"])):
            raise InvalidInputError(f"{self.kind.__name__}.with_values", *FORGOTTEN)
        #: Whether the start may depend on b.
        self.moving_start = moved is None or _has_symbols(moved.start)

        def operations_of(name: str, inputs: str, shape: tuple[int, ...]) -> Array:
            # Copies, because a formula may write to its arguments.
            given = _arguments(inputs, [symbols[x].copy() for x in inputs])
            return self._traced_or_called(system, moved, why, name, inputs, given, shape)

        self._M = operations_of("mass_matrix", "q", (n, n))
        self._Q = operations_of("force", "tqv", (n,))
        self._Phi = operations_of("position_constraint", "tq", (m,))
        #: Sizes, operations, constants and roots of the formulas; None if they call functions.
        self.content = self._written()

    def _written(self) -> tuple[Any, ...] | None:
        outputs = np.concatenate([x.ravel() for x in (self._M, self._Q, self._Phi)])
        if self._operations.calls(outputs):
            return None
        lists = (x.tobytes() for x in self._operations.arrays(outputs))
        return *self._ends, len(self._Phi), self.moving_start, self.root_lines, *lists

    def _traced_or_called(
        self,
        system: Any,
        moved: Any,
        why: str,
        name: str,
        inputs: str,
        given: list[Any],
        shape: tuple[int, ...],
    ) -> Array:
        """Return operations of a value, of the given shape, or a call if it cannot be traced.

        `why` is the reason if no formula can be traced, else empty.
        """
        operations, where = self._operations, f"{self.kind.__name__}.{name}"
        try:
            if why:
                raise NotTraceable(why)
            numbers = Traced.numbers(operations, getattr(moved, name)(*given))
        except InvalidInputError:
            raise
        except TRACE_FAILURES as error:
            if not shape[0]:
                return np.zeros(shape, np.int64)
            self.called[name] = why or told(error)
            method = _Method(system, name, f"{inputs}b", shape)
            at = [x for part in f"{inputs}b" for x in self._at[part].tolist()]
            return operations.call(Called(method, int(np.prod(shape))), at).reshape(shape)
        if numbers.shape != shape:
            raise wrong_shape(where, shape, numbers.shape)
        return numbers

    def values(self, of: Value, *which: Any, rows: int | None = None, **at: Any) -> list[Array]:
        """Return values of the operations `of` at one state, or at states given as rows of `at`."""
        key = of.__name__, *which
        made = self._lists.get(key)
        if made is None:
            made = self._lists[key] = self._compiled(of(self, *which))
        out = made.operations.values(*[at[name] for name in made.inputs])
        if rows is not None and out.ndim == 1:  # No input of the values has rows.
            out = np.repeat(out[None], rows, axis=0)
        lead = out.shape[:-1]
        if len(made.shapes) == 1:
            return [out if len(made.shapes[0]) == 1 else out.reshape(*lead, *made.shapes[0])]
        pairs = zip(made.places, made.shapes, strict=True)
        return [out[..., i].reshape(*lead, *shape) for i, shape in pairs]

    def _compiled(self, values: tuple[Array, ...]) -> _List:
        outputs = np.concatenate([x.ravel() for x in values])
        inputs = self._inputs(outputs)
        numbers = np.concatenate([self._at[name] for name in inputs] or [outputs[:0]])
        ends = np.cumsum([0, *(x.size for x in values)]).tolist()
        places = tuple(slice(*ends[i : i + 2]) for i in range(len(values)))
        shapes = tuple(x.shape for x in values)
        return _List(self._operations.compiled(outputs, numbers), inputs, places, shapes)

    def _inputs(self, outputs: Array) -> tuple[str, ...]:
        """Return the names of the inputs that some output operations depend on."""
        found = {bisect_right(self._ends, x) for x in self._operations.inputs(outputs)}
        return tuple(self._names[i] for i in sorted(found))

    def depends(self, of: Value, *which: Any, on: str) -> bool:
        """Whether the values of `of` depend on an input."""
        return on in self._inputs(np.concatenate([x.ravel() for x in of(self, *which)]))

    def calls(self, of: Value, *which: Any) -> bool:
        """Whether the values of `of` depend on a function that is called, not traced."""
        return self._operations.calls(np.concatenate([x.ravel() for x in of(self, *which)]))

    @cached_property
    def patterns(self) -> tuple[SparsityPattern, SparsityPattern]:
        """Patterns of M with f_q and f_v, which is symmetric, and of Phi_q.

        For few unknowns they are full, otherwise they hold the entries that may be nonzero.
        """
        shapes = (self._M.shape, (len(self._Phi), len(self._M)))
        if sum(shapes[1]) <= _FULL:
            full, of_Phi = (SparsityPattern.full(shape) for shape in shapes)
            return full, of_Phi
        zero, f = self._operations.constant(0.0), self._residual(True)
        found = (zero != self._M) | (self._by(f, "q") != zero) | (self._by(f, "v") != zero)
        found |= found.T | np.eye(len(found), dtype=bool)
        parts = zip(shapes, (found, self._jacobian != zero), strict=True)
        of_M, of_Phi = (SparsityPattern(shape, *np.nonzero(x)) for shape, x in parts)
        return of_M, of_Phi

    # -- what is evaluated -----------------------------------------------------------------------

    def mass(self) -> tuple[Array, ...]:
        """Return the operations for the values of the mass matrix M on its pattern."""
        return (self._on(0, self._M),)

    def force(self) -> tuple[Array, ...]:
        """Return the operations for the force Q."""
        return (self._Q,)

    def roots(self) -> tuple[Array, ...]:
        """Return the operations of the square roots in the formulas, as in `root_lines`."""
        return (np.array(list(self._operations.roots), dtype=np.int64),)

    def divisors(self) -> tuple[Array, ...]:
        """Return the operations of the divisors in M, Q and Phi that depend on the state."""
        if ("divisors", 0) not in self._made:
            for i, values in enumerate((self._M, self._Q, self._Phi)):
                found = self._operations.divisors(values.ravel()).tolist()
                kept = [x for x in found if {*"tqv"} & {*self._inputs(np.array([x]))}]
                self._made["divisors", i] = np.array(kept, dtype=np.int64)
        return tuple(self._made["divisors", i] for i in range(3))

    @property
    def root_lines(self) -> tuple[tuple[str, int], ...]:
        """Files and lines of the user's code that contain the square roots; see `line_of`."""
        return tuple(self._operations.roots.values())

    def mass_along(self) -> tuple[Array, ...]:
        """Return the operations for the values of M_q dq on the pattern of M."""
        return (self._along(*self.mass(), q="dq"),)

    def force_along(self) -> tuple[Array, ...]:
        """Return operations for the differential of the force, Q_t dt + Q_q dq + Q_v dv."""
        return (self._along(self._Q, t="dt", q="dq", v="dv"),)

    def force_total(self) -> tuple[Array, ...]:
        """Return operations for the differential of the force, Q_q dq + Q_v dv + Q_b db."""
        return (self._along(self._Q, q="dq", v="dv", b="db"),)

    def constraint(self, order: int) -> tuple[Array, ...]:
        """Return the operations for Phi, or for its time derivative of this order."""
        return (self._rate(order, "constraint", lambda: self._Phi),)

    def constraint_q(self, order: int) -> tuple[Array, ...]:
        """Return the operations for Phi_q, or its time derivative of an order, on its pattern."""
        return (self._on(1, self._rate(order, "constraint_q", lambda: self._jacobian)),)

    def constraint_total(self, order: int) -> tuple[Array, ...]:
        """Return the operations of the derivative of `constraint` along the motion and b."""
        (Phi,) = self.constraint(order)
        return (self._along(Phi, q="dq", v="dv", a="da", j="dj", b="db"),)

    def linearised(self, forces: bool, velocities: bool) -> tuple[Array, ...]:
        """Return the operations of M, f_q, f_v if `velocities`, and Phi_q.

        Unless `forces`, f is taken without Q.
        """
        f = self._residual(forces)
        tangents = (self._on(0, self._by(f, x)) for x in "qv"[: 1 + velocities])
        return (*self.mass(), *tangents, *self.constraint_q(0))

    def partials(self, forces: bool) -> tuple[Array, ...]:
        """Return the operations of f_b and Phi_b; unless `forces`, f is taken without Q."""
        return self._by(self._residual(forces), "b"), self._by(self._Phi, "b")

    @cached_property
    def accelerations(self) -> tuple[OperationList, ...]:
        """Lists of operations for accelerations and projections (`kernels/index_1.h`)."""
        Phi, rate = (self.constraint(order)[0] for order in range(2))
        held = {"t": self._one, "q": self._at["v"]}
        gamma = Traced.numbers(self._operations, -self._traced(self._moved(rate, held)[0]))
        values = [self._M, self._jacobian, self._Q, gamma], [Phi], [rate]
        return tuple(self._list(x, "t", "q", "v", "b") for x in values)

    @cached_property
    def differentiated(self) -> tuple[OperationList, ...]:
        """Lists of operations for the derivatives of `accelerations`."""
        state, changes = ("t", "q", "v"), ("b", "dq", "dv", "db")
        moved = {"q": "dq", "v": "dv", "b": "db"}
        Phi, rate, second = (self.constraint(order)[0] for order in range(3))
        right = (self._along(x, **moved) for x in (self._residual(True), second))
        sides = [Traced.numbers(self._operations, -self._traced(x)) for x in right]
        return (
            self._list(sides, *state, "a", "lam", *changes),
            *(self._list([self._along(x, **moved)], *state, *changes) for x in (Phi, rate)),
        )

    @cached_property
    def scleronomic(self) -> bool:
        """Whether Phi does not depend on t."""
        return not self.depends(Formulas.constraint, 0, on="t")

    @cached_property
    def shown(self) -> SystemProperties:
        """Traits that the formulas prove for all b; "constant" means independent of t and b."""
        still = self.scleronomic and not self.depends(Formulas.constraint, 0, on="b")
        return SystemProperties(
            constant_mass=not self.depends(Formulas.mass, on="q"),
            linear_constraints=not self.depends(Formulas.constraint_q, 0, on="q"),
            constant_constraints=still,
            velocity_forces=self.depends(Formulas.force, on="v"),
        )

    def right_side(self) -> tuple[Operations, dict[str, Array], dict[str, Array]]:
        """Return the operations, numbers of Q, M, Phi_q and Phi'' at a = 0, and of the inputs.

        Values that depend on functions that are called are left out.
        """
        held = {"t": self._one, "q": self._at["v"]}
        gamma = self._moved(self._rate(1, "constraint", lambda: self._Phi), held)[0]
        parts = {"Q": self._Q, "M": self._M, "Phi_q": self.constraint_q(0)[0], "gamma": gamma}
        listed = {name: x for name, x in parts.items() if not self._operations.calls(x)}
        return self._operations, listed, self._at

    def march(self, velocity: bool) -> tuple[OperationList, ...]:
        """Return the operation lists of a `ListPlan` for time stepping in a kernel."""
        _, *tangents, Phi_q = self.linearised(True, velocity)
        rates = ([self.constraint(order)[0]] for order in range(3))
        values = ([Phi_q], *rates, [self._Q], [*self.mass()], tangents)
        return tuple(self._list(outputs, "t", "q", "v", "a", "lam", "b") for outputs in values)

    def _list(self, outputs: Sequence[Array], *inputs: str) -> OperationList:
        """Return operations compiled to a list that takes all numbers of the named inputs."""
        numbers = np.concatenate([self._at[name] for name in inputs])
        flat = np.concatenate([x.ravel() for x in outputs])
        return self._operations.compiled(flat, numbers)

    def _residual(self, forces: bool) -> Array:
        """Return the operations of M a + Phi_q^T lam - Q, or without Q, shape (n_q,)."""
        key = "residual", int(forces)
        if key in self._made:
            return self._made[key]
        M, Q, a, lam = (self._traced(x) for x in (self._M, self._Q, self._at["a"], self._at["lam"]))
        Phi_q = self._traced(self._jacobian)
        f = M @ a + lam @ Phi_q - (Q if forces else 0.0)
        self._made[key] = Traced.numbers(self._operations, f)
        return self._made[key]

    def _traced(self, numbers: Array) -> Array:
        return Traced.array(self._operations, numbers)

    @cached_property
    def _jacobian(self) -> Array:
        """Operations of Phi_q, shape (n_lam, n_q)."""
        return self._by(self._Phi, "q")

    def _on(self, which: int, matrix: Array) -> Array:
        """Return the entries of a matrix on the pattern of M (0) or of Phi_q (1), shape (nnz,)."""
        pattern = self.patterns[which]
        return matrix[pattern.rows, pattern.columns]

    # -- derivatives -----------------------------------------------------------------------------

    def _along(self, values: Array, **direction: str) -> Array:
        """Return the operations for the derivative of values along changes of inputs, by name."""
        pairs = {name: self._at[by] for name, by in direction.items()}
        return self._moved(values, pairs)[0]

    def _rate(self, order: int, name: str, value: Callable[[], Array]) -> Array:
        """Return the operations for the time derivative of values along the motion."""
        key = name, order
        if key not in self._made:
            if order == 0:
                self._made[key] = value()
            else:
                motion = {x: self._at[rate] for x, rate in pairwise(_MOTION)}
                motion["t"] = self._one
                before = self._rate(order - 1, name, value)
                self._made[key] = self._moved(before, motion)[0]
        return self._made[key]

    def _by(self, values: Array, name: str) -> Array:
        """Return the operations for partials in each entry of an input, (*values.shape, n)."""
        units = [{x: int(self._one[0])} for x in self._at[name].tolist()]
        columns = self._operations.along(values, *units)
        return np.stack(columns, axis=-1) if columns else np.zeros((*values.shape, 0), np.int64)

    def _moved(self, values: Array, direction: dict[str, Array]) -> list[Array]:
        pairs = [
            (x, dx)
            for name, by in direction.items()
            for x, dx in zip(self._at[name].tolist(), by.tolist(), strict=True)
        ]
        return self._operations.along(values, dict(pairs))
