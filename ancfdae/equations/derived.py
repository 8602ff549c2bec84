"""Systems derived from another for `check_system`: by differences, and with full matrices.

`Generic` is a system of the sizes of another in which everything depends on everything. Its members
have the magnitudes expected of the other's: an entry that is far smaller is a difference of larger
terms, or round-off in place of zero. With the sum s of all arguments over their sizes, zero at the
state,

    M = diag(w) e^s,     Q = F e^s,     Phi = C e^s,

and every derivative is a derivative of s times the value.

A system is given by its values: M, Q, Phi and the start, the derivatives of M and Q along a
direction, and the derivatives of Phi in time and in q. Every other member is a formula of
`MechanicalSystem` in them with one derivative. `Derived` evaluates these formulas even if the
system overrides them, and takes the derivative by real differences; `Related` derives the values
from M, Q and Phi.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import isfunction
from math import factorial
from types import FunctionType, MethodType
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.equations.system import MechanicalSystem, Motion, StateDirection, SystemProperties
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.complex_step import real_derivative
from ancfdae.numerics.patterns import SparsityPattern


class Sizes(NamedTuple):
    """Magnitudes of the arguments of a system, of its forces and of its constraints."""

    q: Array
    v: Array
    b: Array
    time: float
    force: Array
    constraint: Array


@final
class Generic(MechanicalSystem):
    """A system with the sizes and patterns of another, whose values depend on all arguments."""

    def __init__(self, system: MechanicalSystem, m: Motion, sizes: Sizes, b: Array) -> None:
        self._of, self._m, self._sizes, self.b = system, m, sizes, b
        self.n_q, self.n_lam, self.design_names = system.n_q, system.n_lam, system.design_names
        self.pattern, self.constraint_pattern = system.pattern, system.constraint_pattern
        self.weights, given = system.weights, system.traits
        self.traits = SystemProperties(given.constant_mass, velocity_forces=given.velocity_forces)
        # Partial derivatives of s in q, v and t.
        q, v, b_sizes = (np.cos(np.arange(len(x))) / x for x in (sizes.q, sizes.v, sizes.b))
        self._q, self._v, self._t = q, v, 1 / sizes.time
        self._grown = np.exp(b_sizes @ (b - system.b))

    def with_values(self, b: Array) -> Generic:
        """Return the same generic system at other design values."""
        return Generic(self._of, self._m, self._sizes, b)

    def start(self) -> tuple[Array, Array]:
        """Return q and v at t = 0 with the magnitudes of the other system's, (n_q,) each."""
        return self._sizes.q * self._grown, self._sizes.v * self._grown

    def mass(self, q: Array) -> Array:
        """Return the values of M = diag(w) e^s on the pattern, shape (nnz,)."""
        values = np.zeros(self.pattern.size)
        values[self.pattern.diagonal] = self.weights
        return values * (self._grown if self.traits.constant_mass else self._grown_at(q))

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return values of M_q dq = M s_q dq for M = diag(w) e^s on the pattern, shape (nnz,)."""
        return self.mass(q) * (self._q @ dq)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the force Q = F e^s, shape (n_q,)."""
        along_v = self._v @ (v - self._m.v) if self.traits.velocity_forces else 0.0
        return self._sizes.force * self._grown_at(q, t) * np.exp(along_v)

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return F e^s ds, the derivative of Q = F e^s along (dt, dq, dv), shape (n_q,)."""
        dt, dq, dv = direction
        along_v = self._v @ dv if self.traits.velocity_forces else 0.0
        return self.force(t, q, v) * (self._q @ dq + along_v + self._t * dt)

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return Q = F e^s as a follower load, shape (n_q,), and values of Q_q on the pattern."""
        Q = self.force(t, q, self._m.v)
        return Q, self._product(self.pattern, Q)

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi = C e^s, or its time derivatives by the chain rule, shape (n_lam,)."""
        q, *rates = motion
        v, a, j = (self._q @ x for x in (*rates, *3 * [0.0 * q])[:3])
        v = v + self._t
        growth = [1.0, v, v**2 + a, v**3 + 3 * v * a + j][len(rates)]
        return self._sizes.constraint * self._grown_at(q, t) * growth

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return the values of Phi_q = Phi s_q, or of its time derivative, shape (nnz,)."""
        return self._product(self.constraint_pattern, self.constraint(t, *motion))

    def _grown_at(self, q: Array, t: float | None = None) -> Array:
        s = self._q @ (q - self._m.q) + (0.0 if t is None else self._t * (t - self._m.t))
        return np.asarray(self._grown * np.exp(s))

    def _product(self, pattern: SparsityPattern, values: Array) -> Array:
        return np.asarray(values[pattern.rows] * self._q[pattern.columns])


# Methods that forces, masses and constraints do not determine: positions, states that no body can
# have, the elastic part of a force, the root of a constraint that is meant, functions of time,
# pairs of bodies that are near.
_UNDETERMINED = frozenset(
    {
        "along",
        "breakpoints",
        "centred",
        "coarse",
        "contacts",
        "divisors",
        "folded",
        "in_all_states",
        "left_out",
        "mirrored",
        "off_root",
        "off_route",
        "opened",
        "over_time",
        "require_derivatives_at",
        "strained",
        "stress_force",
        "turn_rate",
    }
)


def members() -> dict[str, FunctionType]:
    """Return the methods of `MechanicalSystem` that the basic values of a system determine."""
    methods = vars(MechanicalSystem).items()
    named = {name: f for name, f in methods if isfunction(f) and not name.startswith("_")}
    return {name: f for name, f in named.items() if name not in _UNDETERMINED}


def is_written(name: str) -> bool:
    """Whether every system must implement a method or property of `MechanicalSystem` itself."""
    abstract: frozenset[str] = MechanicalSystem.__abstractmethods__
    return name in abstract


def is_value(name: str) -> bool:
    """Whether a method gives a value of the system, not a formula in other methods' values."""
    return is_written(name) or name in vars(Related)


class Derived:
    """A system whose optional methods are replaced by real differences of its basic values.

    It has the attributes of `system`. In the time `time`, s, the system moves by its own size.
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
        """Return a value's total design derivative by real differences, shape (m, n_b)."""
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
    """Values of a system derived from its other values by differences, for `check_system`."""

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return M_q dq by differences of `mass`, values on the pattern, shape (nnz,)."""
        return self._by_number(lambda e: self.system.mass(q + e * dq))

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return Q_t dt + Q_q dq + Q_v dv by differences of `force`, shape (n_q,)."""
        dt, dq, dv = direction
        return self._by_number(lambda e: self.system.force(t + e * dt, q + e * dq, v + e * dv))

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return the follower load of the system, and its derivative in q by differences."""
        s = self.system
        tangent = self._by_coordinate(lambda x: s.following_load(t, x)[0], q, s.pattern)
        return s.following_load(t, q)[0], tangent

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi, or the time derivative, by differences, of its rate of one order less."""
        if len(motion) == 1:
            return self.system.constraint(t, *motion)
        return self._by_number(lambda e: self.system.constraint(t + e, *moved_on(motion, e)))

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return Phi_q, or the partial in q of a time derivative of Phi, shape (nnz,)."""
        s, (q, *rates) = self.system, motion
        return self._by_coordinate(lambda x: s.constraint(t, x, *rates), q, s.constraint_pattern)


def moved_on(motion: tuple[Array, ...], s: float) -> list[Array]:
    """Return a motion (q, v, a, ...) a time s later, without its last rate.

    The last rate is constant.
    """
    count = len(motion)
    return [
        sum((motion[i + n] * (s**n / factorial(n)) for n in range(count - i)), 0.0 * motion[i])
        for i in range(count - 1)
    ]


def design_sizes(system: MechanicalSystem) -> Array:
    """Return the magnitude of every design variable, shape (n_b,); one for zeros."""
    return np.where(system.b == 0, 1.0, np.abs(system.b))


def coordinate_sizes(x: Array, weights: Array) -> Array:
    """Return the magnitudes of the coordinates x, (n_q,); for small ones a common magnitude."""
    common = (norm(x, weights) or 1.0) / np.sqrt(weights * len(x))
    largest = np.max(np.abs(x)) or 1.0
    return np.where(np.abs(x) > 1e-3 * largest, np.abs(x), np.minimum(common, largest))
