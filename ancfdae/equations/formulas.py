"""M, Q and Phi of a system as lists of operations, with every derivative that the protocol needs.

The functions of a user run once, on tracers of t, q, v and b (`ancfdae.numerics.operations`). With
D for the derivative along a direction, which `Operations.along` writes as more operations,

    Phi', Phi'', Phi'''      D Phi, D D Phi, D D D Phi along the motion (1, v, a, j) of (t, q, v, a)
    Phi_q and its rates      D along each coordinate, then along the motion
    f                        M a + Phi_q^T lam - Q
    f_q, f_v, f_b, Phi_b     D along each coordinate, velocity and design variable
    totals                   D along changes of everything that a value depends on

Each list is compiled when its values are first asked for. Lists take real and complex numbers, so
that what the protocol derives from values by complex steps is exact to round-off as well.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations.complex_steps import FORGOTTEN
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import OperationList, list_values
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.operations import NotTraceable, Operations, Traced

# A method of `Formulas` that returns numbers of the list of operations.
Value: TypeAlias = Callable[..., tuple[Array, ...]]
# What ends a trace.
_FAILURES = (NotTraceable, TypeError, ValueError, AttributeError, ArithmeticError, IndexError)
# What a motion consists of: each is the rate of the one before.
_MOTION = ("q", "v", "a", "j")


class _List(NamedTuple):
    """Several values as one list: the inputs that they follow from, their ends and shapes."""

    operations: OperationList
    inputs: tuple[str, ...]
    places: tuple[slice, ...]
    shapes: tuple[tuple[int, ...], ...]


@final
class Formulas:
    """M, Q and Phi of a system at any values of its design variables.

    Methods other than `values` return numbers of the list of operations, in arrays; `values` takes
    one of them with its arguments, and evaluates what it returns.

    Parameters
    ----------
    system : FormulaSystem
    """

    def __init__(self, system: Any) -> None:
        n = system.n_q
        sizes = {"t": 1, **dict.fromkeys(_MOTION, n), "lam": system.n_lam, "b": system.n_b}
        sizes |= {f"d{name}": size for name, size in sizes.items()}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self._at = {name: np.arange(*ends[i : i + 2]) for i, name in enumerate(sizes)}
        self._operations = operations = Operations(ends[-1])
        self._one = np.array([operations.constant(1.0)])
        self._made: dict[tuple[str, int], Array] = {}
        self._lists: dict[tuple[Any, ...], _List] = {}
        self.kind, self.called = type(system), dict[str, str]()
        where = f"{self.kind.__name__}.with_values"
        (t,), q, v, b = (Traced.array(operations, self._at[x]) for x in ("t", "q", "v", "b"))
        moved = self._traced_or_refused(where, lambda: system.with_values(b))
        if not np.array_equal(Traced.numbers(operations, moved.b), self._at["b"]):
            raise InvalidInputError(where, *FORGOTTEN)
        self._M = self._or_called("mass_matrix", (n, n), lambda: moved.mass_matrix(q.copy()))
        self._Q = self._or_called("force", (n,), lambda: moved.force(t, q.copy(), v.copy()))
        where = f"{self.kind.__name__}.position_constraint"
        Phi = self._traced_or_refused(where, lambda: moved.position_constraint(t, q.copy()))
        self._Phi = self._numbers("position_constraint", Phi, (system.n_lam,))

    def _or_called(self, name: str, shape: tuple[int, ...], value: Callable[[], Any]) -> Array:
        """Return numbers of a value; NaN in their place, and why, if it cannot be traced."""
        try:
            return self._numbers(name, value(), shape)
        except _FAILURES as error:
            if isinstance(error, InvalidInputError):
                raise
            self.called[name] = told(error)
            return np.full(shape, self._operations.constant(np.nan))

    def _traced_or_refused(self, where: str, value: Callable[[], Any]) -> Any:
        try:
            return value()
        except _FAILURES as error:
            if isinstance(error, InvalidInputError):
                raise
            repair = "Write it so, or write all values by formulas (MechanicalSystem)."
            rule = "must be made of functions of NumPy that take symbols"
            raise InvalidInputError(where, rule, told(error), repair) from error

    def _numbers(self, name: str, value: Any, shape: tuple[int, ...]) -> Array:
        numbers = Traced.numbers(self._operations, value)
        if numbers.shape != shape:
            where, rule = f"{self.kind.__name__}.{name}", f"must have shape {shape}"
            raise InvalidInputError(
                where, rule, numbers.shape, f"Return an array of the shape {shape}."
            )
        return numbers

    def values(self, of: Value, *which: Any, rows: int | None = None, **at: Any) -> list[Array]:
        """Return values at one state, or at `rows` states, which are rows of what `at` holds."""
        key = of.__name__, *which
        made = self._lists.get(key)
        if made is None:
            made = self._lists[key] = self._compiled(of(self, *which))
        parts = [np.asarray(at[name]) for name in made.inputs]
        if rows is None:
            x = np.concatenate(parts) if parts else np.zeros(0)
            out = list_values(made.operations, x)
            pairs = zip(made.places, made.shapes, strict=True)
            return [out[i].reshape(shape) for i, shape in pairs]
        wide = [np.broadcast_to(part, (rows, part.shape[-1])) for part in parts]
        x = np.concatenate([np.zeros((rows, 0)), *wide], axis=1)
        out = list_values(made.operations, x)
        pairs = zip(made.places, made.shapes, strict=True)
        return [out[:, i].reshape(rows, *shape) for i, shape in pairs]

    def _compiled(self, values: tuple[Array, ...]) -> _List:
        outputs = np.concatenate([x.ravel() for x in values])
        used = self._operations.inputs(outputs)
        inputs = tuple(name for name, at in self._at.items() if not used.isdisjoint(at.tolist()))
        numbers = [x for name in inputs for x in self._at[name].tolist()]
        ends = np.cumsum([0, *(x.size for x in values)]).tolist()
        places = tuple(slice(*ends[i : i + 2]) for i in range(len(values)))
        shapes = tuple(x.shape for x in values)
        return _List(self._operations.compiled(outputs, numbers), inputs, places, shapes)

    def depends(self, of: Value, *which: Any, on: str) -> bool:
        """Whether values follow from an input."""
        used = self._operations.inputs(np.concatenate([x.ravel() for x in of(self, *which)]))
        return not used.isdisjoint(self._at[on].tolist())

    # -- what is evaluated -----------------------------------------------------------------------

    def mass(self) -> tuple[Array, ...]:
        """M."""
        return (self._M,)

    def force(self) -> tuple[Array, ...]:
        """Q."""
        return (self._Q,)

    def mass_along(self) -> tuple[Array, ...]:
        """M_q dq."""
        return (self._along(self._M, q="dq"),)

    def force_along(self) -> tuple[Array, ...]:
        """Q_t dt + Q_q dq + Q_v dv."""
        return (self._along(self._Q, t="dt", q="dq", v="dv"),)

    def force_total(self) -> tuple[Array, ...]:
        """Q_q dq + Q_v dv + Q_b db."""
        return (self._along(self._Q, q="dq", v="dv", b="db"),)

    def constraint(self, order: int) -> tuple[Array, ...]:
        """Phi or its time derivative of an order."""
        return (self._rate(order, "constraint", lambda: self._Phi),)

    def constraint_q(self, order: int) -> tuple[Array, ...]:
        """Phi_q or its time derivative of an order."""
        return (self._rate(order, "constraint_q", lambda: self._by(self._Phi, "q")),)

    def constraint_total(self, order: int) -> tuple[Array, ...]:
        """Return D of `constraint` along changes of the motion and of b."""
        (Phi,) = self.constraint(order)
        return (self._along(Phi, q="dq", v="dv", a="da", j="dj", b="db"),)

    def linearised(self, forces: bool, velocities: bool) -> tuple[Array, ...]:
        """M, f_q, f_v if asked for, and Phi_q; f without Q unless `forces`."""
        f = self._residual(forces)
        f_v = (self._by(f, "v"),) if velocities else ()
        return (self._M, self._by(f, "q"), *f_v, *self.constraint_q(0))

    def partials(self, forces: bool) -> tuple[Array, ...]:
        """f_b and Phi_b; f without Q unless `forces`."""
        return self._by(self._residual(forces), "b"), self._by(self._Phi, "b")

    @cached_property
    def index_1(self) -> tuple[OperationList, ...]:
        """Return what accelerations and their derivatives follow from (`kernels/index_1.h`)."""
        moved = {"q": "dq", "v": "dv", "b": "db"}
        Phi, rate, second = (self.constraint(order)[0] for order in range(3))
        held = {"t": self._one, "q": self._at["v"]}
        right = [self._moved(rate, held)[0], self._along(self._residual(True), **moved)]
        right.append(self._along(second, **moved))
        gamma, *sides = (Traced.numbers(self._operations, -self._traced(x)) for x in right)
        state, changes = ("t", "q", "v"), ("b", "dq", "dv", "db")
        return (
            self._list([self._M, *self.constraint_q(0), self._Q, gamma], *state, "b"),
            self._list(sides, *state, "a", "lam", *changes),
            self._list([Phi], *state, "b"),
            self._list([rate], *state, "b"),
            self._list([self._along(Phi, **moved)], *state, *changes),
            self._list([self._along(rate, **moved)], *state, *changes),
        )

    def right_side(self) -> tuple[Operations, list[Array], dict[str, Array]]:
        """Return the list, numbers of Q, M, Phi_q and Phi'' at a = 0, and numbers of inputs.

        Functions that are called are left out.
        """
        held = {"t": self._one, "q": self._at["v"]}
        gamma = self._moved(self._rate(1, "constraint", lambda: self._Phi), held)[0]
        parts = [*([] if "force" in self.called else [self._Q])]
        parts += [*([] if "mass_matrix" in self.called else [self._M])]
        return self._operations, [*parts, *self.constraint_q(0), gamma], self._at

    def march(self, velocity: bool) -> tuple[OperationList, ...]:
        """Return the lists of a `ListPlan`."""
        f = self._residual(True)
        tangents = [self._by(f, "q"), *([self._by(f, "v")] if velocity else [])]
        Phi, rate = (self.constraint(order)[0] for order in range(2))
        values = ([*self.constraint_q(0)], [Phi], [rate], [self._Q], [self._M], tangents)
        return tuple(self._list(outputs, "t", "q", "v", "a", "lam", "b") for outputs in values)

    def _list(self, outputs: Sequence[Array], *inputs: str) -> OperationList:
        """Compile outputs as a list that takes all of some inputs."""
        numbers = [x for name in inputs for x in self._at[name].tolist()]
        flat = np.concatenate([x.ravel() for x in outputs])
        return self._operations.compiled(flat, numbers)

    def _residual(self, forces: bool) -> Array:
        """M a + Phi_q^T lam - Q."""
        M, Q, a, lam = (self._traced(x) for x in (self._M, self._Q, self._at["a"], self._at["lam"]))
        Phi_q = self._traced(self.constraint_q(0)[0])
        f = M @ a + lam @ Phi_q - (Q if forces else 0.0)
        return Traced.numbers(self._operations, f)

    def _traced(self, numbers: Array) -> Array:
        return Traced.array(self._operations, numbers)

    # -- derivatives -----------------------------------------------------------------------------

    def _along(self, values: Array, **direction: str) -> Array:
        """Return D of values where inputs move by other inputs."""
        pairs = {name: self._at[by] for name, by in direction.items()}
        return self._moved(values, pairs)[0]

    def _rate(self, order: int, name: str, value: Callable[[], Array]) -> Array:
        """Return a time derivative of values along the motion."""
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
        """Return partials with respect to each entry of an input, shape (*values.shape, n)."""
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


def told(error: Exception) -> str:
    """Return the line of a user's code at which tracing ended, and why."""
    own = str(Path(np.__file__).parent), str(Path(__file__).parents[1])
    frames = traceback.extract_tb(error.__traceback__)
    lines = [x for x in frames if not x.filename.startswith(own)]
    known = isinstance(error, NotTraceable)
    why = f"asks for {error}" if known else f"fails on symbols ({type(error).__name__}: {error})"
    if not lines:
        return why
    last = lines[-1]
    return f"line {last.lineno} of {Path(last.filename).name}, `{last.line}`, {why}."
