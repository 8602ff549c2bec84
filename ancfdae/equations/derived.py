"""Derivatives that the base class takes from the values of a system, by real differences.

A system is its values: M, Q, Phi and the start, the derivatives of M and Q along a direction, and
those of Phi in time and in q. Every other member is a formula of `MechanicalSystem` in them with
one derivative. `Derived` runs these formulas even where the system overrides them, and takes the
derivative from real values; `Related` derives the values from M, Q and Phi.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import isfunction
from math import factorial
from types import FunctionType, MethodType
from typing import Any, final

import numpy as np

from ancfdae.equations.motion import StateDirection
from ancfdae.equations.system import MechanicalSystem
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.extrapolation import real_derivative
from ancfdae.numerics.patterns import SparsityPattern

# Methods that forces, masses and constraints do not determine: where a system stands, which states
# no body can have, which part of a force is stress, which root of a constraint is meant, and which
# functions of time there are.
_UNDETERMINED = frozenset(
    {
        "breakpoints",
        "centred",
        "coarse",
        "folded",
        "mirrored",
        "off_root",
        "over_time",
        "require_derivatives_at",
        "strained",
        "missed_contact",
        "stress_force",
        "turn_rate",
    }
)


def members() -> dict[str, FunctionType]:
    """Return the methods of `MechanicalSystem` that follow from the values of a system."""
    methods = vars(MechanicalSystem).items()
    named = {name: f for name, f in methods if isfunction(f) and not name.startswith("_")}
    return {name: f for name, f in named.items() if name not in _UNDETERMINED}


def is_written(name: str) -> bool:
    """Whether every system writes a member."""
    abstract: frozenset[str] = MechanicalSystem.__abstractmethods__
    return name in abstract


def is_value(name: str) -> bool:
    """Whether a member is no formula in others."""
    return is_written(name) or name in vars(Related)


class Derived:
    """Values of a system with all that follows; attributes are those of the system.

    In `time` it moves by its own size.
    """

    def __init__(self, system: MechanicalSystem, time: float) -> None:
        self.system, self.time = system, time
        self._others: dict[bytes, Derived] = {}

    def __getattr__(self, name: str) -> Any:
        formula = vars(MechanicalSystem).get(name)
        if isfunction(formula) and not is_value(name):
            return MethodType(formula, self)
        return getattr(self.system, name)

    def _total(self, value: Callable[..., Array], *states: tuple[Array, Array]) -> Array:
        """Differentiate with respect to the design variables along given derivatives of states."""
        columns = []
        for i, size in enumerate(design_sizes(self.system)):
            unit = size * np.eye(self.system.n_b)[i]

            def moved(e: float, unit: Array = unit) -> Array:
                return value(self._at(e * unit), *(x + e * (x_b @ unit) for x, x_b in states))

            columns.append(real_derivative(moved) / size)
        if not columns:
            return np.zeros((*np.shape(value(self, *(x for x, _ in states))), 0))
        return np.stack(columns, axis=-1)

    def _at(self, db: Array) -> Derived:
        key = db.tobytes()
        if key not in self._others:
            self._others[key] = Derived(self.system.with_values(self.system.b + db), self.time)
        return self._others[key]

    def _by_coordinate(
        self, value: Callable[[Array], Array], x: Array, pattern: SparsityPattern, *_: Array | None
    ) -> Array:
        steps = np.diag(coordinate_sizes(x, self.system.weights))
        columns = [real_derivative(lambda e, y=y: value(x + e * y)) / y.sum() for y in steps]  # type: ignore[misc]
        return np.asarray(np.stack(columns, axis=-1)[pattern.rows, pattern.columns])

    def _by_number(self, value: Callable[[Any], Array]) -> Array:
        return real_derivative(lambda e: value(e * self.time)) / self.time


@final
class Related(Derived):
    """Values of a system that its other values determine, for `check_system`."""

    def mass_along(self, q: Array, dq: Array) -> Array:
        """M_q dq from `mass` by differences, values on the pattern."""
        return self._by_number(lambda e: self.system.mass(q + e * dq))

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Q_t dt + Q_q dq + Q_v dv."""
        dt, dq, dv = direction
        return self._by_number(lambda e: self.system.force(t + e * dt, q + e * dq, v + e * dv))

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """No load is known to turn: zero, and its Jacobian."""
        s = self.system
        tangent = self._by_coordinate(lambda x: s.following_load(t, x)[0], q, s.pattern)
        return s.following_load(t, q)[0], tangent

    def constraint(self, t: float, *motion: Array) -> Array:
        """Phi, or the time derivative of that of the order before."""
        if len(motion) == 1:
            return self.system.constraint(t, *motion)
        return self._by_number(lambda e: self.system.constraint(t + e, *moved_on(motion, e)))

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Phi_q, or the partial of a time derivative of Phi."""
        s, (q, *rates) = self.system, motion
        return self._by_coordinate(lambda x: s.constraint(t, x, *rates), q, s.constraint_pattern)


def moved_on(motion: tuple[Array, ...], s: float) -> list[Array]:
    """Return a motion (q, v, a, ...) a time s later, without its last rate, which is constant."""
    count = len(motion)
    return [
        sum((motion[i + n] * (s**n / factorial(n)) for n in range(count - i)), 0.0 * motion[i])
        for i in range(count - 1)
    ]


def design_sizes(system: MechanicalSystem) -> Array:
    """Size of every design variable: its own, or one."""
    return np.where(system.b == 0, 1.0, np.abs(system.b))


def coordinate_sizes(x: Array, weights: Array) -> Array:
    """Size of every coordinate: its own, or where it vanishes that of the others."""
    common = (norm(x, weights) or 1.0) / np.sqrt(weights * len(x))
    largest = np.max(np.abs(x)) or 1.0
    return np.where(np.abs(x) > 1e-3 * largest, np.abs(x), np.minimum(common, largest))
