"""What the base class derives from the values of a system, by differences of real numbers.

A system is its values: M, Q, Phi and the start, and dQ/dt, Phi_q, its rate, nu, gamma and S. Every
other member is a formula of `MechanicalSystem` in them with one derivative. `Derived` runs these
very formulas, whatever the system overrides, and takes the derivative from real values; `Related`
derives the values from M, Q and Phi.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import isfunction
from types import FunctionType, MethodType
from typing import Any, final

import numpy as np

from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.extrapolation import real_derivative
from ancfdae.numerics.patterns import Pattern
from ancfdae.protocol.motion import Motion
from ancfdae.protocol.system import MechanicalSystem


def members() -> dict[str, FunctionType]:
    """Return the methods of the protocol."""
    methods = vars(MechanicalSystem).items()
    return {name: f for name, f in methods if isfunction(f) and not name.startswith("_")}


def is_written(name: str) -> bool:
    """Tell whether every system writes a member."""
    abstract: frozenset[str] = MechanicalSystem.__abstractmethods__
    return name in abstract


def is_value(name: str) -> bool:
    """Tell whether a member is no formula in others."""
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

    def along(self, value: Callable[..., Array], *states: tuple[Array, Array]) -> Array:
        """Differentiate in the design variables along given derivatives of states."""
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

    def _by_coordinate(self, value: Callable[[Array], Array], x: Array, pattern: Pattern) -> Array:
        steps = np.diag(coordinate_sizes(x, self.system.weights))
        columns = [real_derivative(lambda e, y=y: value(x + e * y)) / y.sum() for y in steps]  # type: ignore[misc]
        return np.asarray(np.stack(columns, axis=-1)[pattern.rows, pattern.columns])

    def _by_number(self, value: Callable[[Any], Array]) -> Array:
        return real_derivative(lambda e: value(e * self.time)) / self.time


@final
class Related(Derived):
    """The values that others determine."""

    def inertia_q(self, q: Array, a: Array) -> Array:
        """(M a)_q."""
        s = self.system
        return self._by_coordinate(lambda x: s.mass_times(x, a), q, s.pattern)

    def force_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """dQ/dt."""
        return self._in_time(lambda m: self.system.force(m.q, m.v, m.t), t, q, v, a)

    def force_q_times(self, q: Array, x: Array, t: float) -> Array:
        """Q_q x at v = 0."""
        return self._by_number(lambda e: self.system.force(q + e * x, 0 * q, t))

    def following_load(self, q: Array, t: float) -> Array:
        """Nothing tells which loads turn."""
        return self.system.following_load(q, t)

    def following_load_q(self, q: Array, t: float) -> Array:
        """Its partial."""
        s = self.system
        return self._by_coordinate(lambda x: s.following_load(x, t), q, s.pattern)

    def constraint_q(self, q: Array, t: float) -> Array:
        """Phi_q."""
        s = self.system
        return self._by_coordinate(lambda x: s.constraint(x, t), q, s.constraint_pattern)

    def constraint_q_rate(self, q: Array, v: Array, t: float) -> Array:
        """dPhi_q/dt."""
        return self._in_time(lambda m: self.system.constraint_q(m.q, m.t), t, q, v)

    def velocity_side(self, q: Array, t: float) -> Array:
        """-Phi_t."""
        return self._in_time(lambda m: -self.system.constraint(m.q, m.t), t, q)

    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """-d/dt (Phi_q v - nu), v held."""
        return -self._in_time(lambda m: self._speed(m, m.v), t, q, v)

    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """-d/dt (Phi_q a - gamma), a held."""
        s = self.system

        def rate(m: Motion) -> Array:
            gamma = s.acceleration_side(m.q, m.v, m.t)
            return gamma - s.constraint_pattern.dot(s.constraint_q(m.q, m.t), a)

        return self._in_time(rate, t, q, v, a)

    def _speed(self, m: Motion, v: Array) -> Array:
        s = self.system
        moving = s.constraint_pattern.dot(s.constraint_q(m.q, m.t), v)
        return moving - s.velocity_side(m.q, m.t)

    def _in_time(self, value: Callable[[Motion], Array], t: float, *states: Array) -> Array:
        q, v, a = (*states, *[np.zeros_like(states[0])] * 2)[:3]
        m = Motion(q, v, a, np.zeros(0), t)
        return self._by_number(lambda e: value(m.at(e)))


def design_sizes(system: MechanicalSystem) -> Array:
    """Size of every design variable: its own, or one."""
    return np.where(system.b == 0, 1.0, np.abs(system.b))


def coordinate_sizes(x: Array, weights: Array) -> Array:
    """Size of every coordinate: its own, or where it vanishes that of the others."""
    common = (norm(x, weights) or 1.0) / np.sqrt(weights * len(x))
    largest = np.max(np.abs(x)) or 1.0
    return np.where(np.abs(x) > 1e-3 * largest, np.abs(x), np.minimum(common, largest))
