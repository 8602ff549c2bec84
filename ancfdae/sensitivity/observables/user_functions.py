"""Observables from functions of a user: of other observables, or of states and design."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import ClassVar, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_function, require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import OperationList
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.complex_step import FAILURES, require_derivative
from ancfdae.numerics.operations import NotTraceable, Operations, Traced
from ancfdae.sensitivity.observables.expression import Function, require_vectorised
from ancfdae.sensitivity.observables.observable import (
    Columns,
    Leaf,
    LeafGradient,
    Named,
    Observable,
    States,
    known_system,
)


def apply(function: Callable[..., Array], *observables: Observable) -> Observable:
    """Return a function of your own of observables.

    Parameters
    ----------
    function : callable
        Takes one array (k,) per observable and returns an array (k,), element by element and with
        operations that accept complex numbers: its derivative is taken by a complex step.
    *observables : Observable
        At least one.

    Raises
    ------
    InvalidInputError
        If the function mixes time points, fails on complex numbers, or its complex step disagrees
        with finite differences. It is checked on a few numbers now and at a few time points of
        every run that is differentiated.
    """
    require_function("apply, function", function)
    name = getattr(function, "__name__", repr(function))
    if not observables or not all(isinstance(x, Observable) for x in observables):
        raise InvalidInputError(
            f"apply({name})", "needs observables", observables, "Pass one or more, and no numbers."
        )
    checked = Function(name, function, edged=True, by_user=True)
    base = np.array([-1.7, -0.6, 0.3, 0.9, 2.3])
    tried = [np.roll(base, j) * (1 + 0.1 * j) for j in range(len(observables))]
    with np.errstate(all="ignore"):
        require_vectorised(name, lambda rows: function(*(x[rows] for x in tried)), len(base))
        require_derivative(name, function, tried, [np.ones_like(x) for x in tried])
    return observables[0].combined(checked, observables)


def custom(function: Callable[..., Array], name: str = "custom") -> Observable:
    """Return a function H(t, q, v, lam, b) of your own, for any mechanical system.

    It takes t (k,), q (k, n_q), v (k, n_q), lam (k, n_lam) and b (n_b,) and returns an array (k,),
    each time point by itself and with operations that accept complex numbers. Its partials follow
    from its NumPy operations, at compiled speed, if it runs on symbols as the formulas of a
    `FormulaSystem` do. Otherwise they are complex steps, which take one evaluation per coordinate,
    velocity, multiplier and design variable. Error messages use `name`.
    """
    require_function("custom, function", function)
    require_kind("custom, name", name, (str,), "Messages name the function by it.")
    return Custom(function, name)


@final
@dataclass(frozen=True)
class Custom(Leaf):
    """A user's function H(t, q, v, lam, b) of time, states and design variables."""

    names_time: ClassVar[bool] = True

    function: Callable[..., Array]
    name: str

    def check_leaf(self, system: Named) -> None:
        """Raise InvalidInputError, as `apply` does, if the function fails near the start."""
        system = known_system(self.name, system)
        q, v = system.start()
        # Near the start, but not at it, where velocities and multipliers may be zero.
        spread = 1e-3 * np.arange(1.0, 4.0)[:, None]
        states = States(
            t=np.array([0.0, 0.1, 0.2]),
            q=q.real + spread * np.cos(np.arange(system.n_q)),
            v=v.real + spread * np.sin(1.0 + np.arange(system.n_q)),
            lam=1.0 + spread * np.cos(2.0 + np.arange(system.n_lam)),
        )
        with np.errstate(all="ignore"):
            y = require_vectorised(
                self.name, lambda rows: self._call(states.rows(rows), system.b), 3
            )
        traced, b = self._traced(system), system.b.real
        if traced is None or not _agree(traced.values(states, b)[:, 0], y.real):
            self._require_derivative(states, b)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the values H of the user's function, shape (n_t,)."""
        system = known_system(self.name, system)
        if any(np.iscomplexobj(x) for x in (states.q, states.v, states.lam, system.b)):
            traced = self._traced(system)
            if traced is not None:
                return traced.values(states, system.b)[:, 0]
        return np.asarray(self._call(states, system.b))

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Differentiate H by its operations, or by a complex step in one column after another."""
        some, traced = [0, len(states.t) // 2, -1], self._traced(system)
        if traced is not None:
            found = traced.values(states, system.b)
            if _agree(found[some, 0], self._call(states.rows(some), system.b)):
                return traced.gradient(found[:, 1:], len(system.b))
        self._require_derivative(states.rows(some), system.b)
        q, v, lam = (x.astype(complex) for x in (states.q, states.v, states.lam))
        complex_states = States(states.t, q, v, lam, states.degree)
        b = system.b.astype(complex)
        parts = []
        for moved in (complex_states.q, complex_states.v, complex_states.lam, b):
            partial = np.zeros((len(states.t), moved.shape[-1]))
            for i in range(moved.shape[-1]):
                moved[..., i] += 1j * STEP
                partial[:, i] = np.imag(self._call(complex_states, b)) / STEP
                moved[..., i] = moved[..., i].real
            parts.append(partial)
        on_q, on_v, on_lam = (Columns(slice(None), partial) for partial in parts[:3])
        return LeafGradient(on_q, on_v, on_lam, parts[3])

    def _call(self, states: States, b: Array) -> Array:
        return self.function(states.t, states.q, states.v, states.lam, b)

    def _traced(self, system: MechanicalSystem) -> _Formula | None:
        return _traced(self.function, system.n_q, system.n_lam, system.n_b)

    def _require_derivative(self, states: States, b: Array) -> None:
        """Raise InvalidInputError if complex steps of the function are not its derivatives."""
        x = (states.q, states.v, states.lam, b)
        # A direction without symmetry, of the size of the arguments.
        dx = [
            np.where(a == 0, 1.0, a) * np.cos(0.7 * j + 1.3 * np.arange(a.shape[-1]))
            for j, a in enumerate(x)
        ]
        require_derivative(self.name, lambda *moved: self.function(states.t, *moved), x, dx)


# Largest difference between values of an operation list and its function, relative to the largest.
_SAME = 1e-9


def _agree(listed: Array, called: Array) -> bool:
    """Return whether an operation list has the values of its function, all of them finite."""
    return bool(np.max(np.abs(listed - called)) <= _SAME * np.max(np.abs(called)))


@final
@dataclass(frozen=True)
class _Formula:
    """A user's function as a list of operations, with its value and its partials.

    `columns` are the indices of the entries of t, q, v, lam and b on which it depends.
    """

    operations: OperationList
    columns: tuple[Array, ...]

    def values(self, states: States, b: Array) -> Array:
        """Return the value and its partials in the inputs `columns`, shape (k, 1 + n_columns)."""
        parts = (states.t[:, None], states.q, states.v, states.lam, b)
        used = [x[..., at] for x, at in zip(parts, self.columns, strict=True)]
        return self.operations.values(*used)

    def gradient(self, partials: Array, n_b: int) -> LeafGradient:
        """Return partials in q, v, lam and design from partials in the inputs `columns`."""
        begin, parts = len(self.columns[0]), list[Columns | None]()
        for at in self.columns[1:]:
            rows, begin = partials[:, begin : begin + len(at)], begin + len(at)
            parts.append(Columns(at, rows) if len(at) else None)
        q, v, lam, b = parts
        on_b = None if b is None else b.add_to(None, np.ones(len(partials)), n_b)
        return LeafGradient(q, v, lam, on_b)


@lru_cache(maxsize=32)
def _traced(function: Callable[..., Array], n_q: int, n_lam: int, n_b: int) -> _Formula | None:
    """Return the function as a list of operations; None if it cannot run on symbols."""
    ends = list(accumulate((1, n_q, n_q, n_lam, n_b), initial=0))
    parts = [np.arange(*end) for end in pairwise(ends)]
    operations = Operations(ends[-1])
    t, q, v, lam, b = (Traced.array(operations, x) for x in parts)
    try:
        value = np.asarray(function(t, q[None], v[None], lam[None], b))
        (output,) = Traced.numbers(operations, value).tolist()
    except (NotTraceable, InvalidInputError, *FAILURES):
        return None
    partials = operations.partials(output)
    columns = tuple(
        np.array([i for i, x in enumerate(part.tolist()) if x in partials], dtype=int)
        for part in parts
    )
    used = [x for part, at in zip(parts, columns, strict=True) for x in part[at].tolist()]
    outputs = np.array([output, *(partials[x] for x in used)])
    return _Formula(operations.compiled(outputs, used), columns)
