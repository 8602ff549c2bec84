"""Controllers at rest: the states of a controlled system in its equilibrium, and in its modes.

A state x of a controller is the velocity of a coordinate y that no force depends on
(docs/theory/17-controllers.md). In an equilibrium x is constant, f(x, s, 0, r) = 0, and y moves on.

`Steady` has x in the place of y. With S v the velocities of which these coordinates take the place,

    Q'(q, v) = Q(q, v + S q) - k q_o,     K' = K - Q_v S + k,

so that its equilibrium is the equilibrium of mechanism and controllers together. The components q_o
of the vectors of states that nothing acts on are held by a spring k.

`Held` keeps the coordinates and adds the states x(b) of an equilibrium to all velocities. Its small
motions about rest are the small motions of the mechanism with its controllers,

    (s^2 M + s D + K) [q, y] + Phi_q^T mu = 0,     x = s y:

K has no columns for y, and each y adds a root s = 0 beside the roots of the loop.
"""

from __future__ import annotations

import abc
from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.equations import Linearisation, MechanicalSystem, StateDirection
from ancfdae.equations.solution_parts import ContactRecord
from ancfdae.numerics.arrays import Array, only


def idle_of(system: MechanicalSystem) -> Array:
    """Return the indices of the components of vectors of states, of which no force depends, (k,).

    Their motions at s = 0 are none of the system.
    """
    components = np.arange(system.vector_size)
    return np.asarray((system.state_places[:, None] + components).ravel())


class ControlledSystem(MechanicalSystem):
    """Base class of a system with controllers in which velocities are replaced by others."""

    def __init__(self, base: MechanicalSystem, weights: Array) -> None:
        self.base, self.weights = base, weights
        self.b, self.design_names = base.b, base.design_names
        self.n_q, self.n_lam, self.naming = base.n_q, base.n_lam, base.naming
        self.reach, self.vector_size = base.reach, base.vector_size
        self.called_functions, self.has_loops = base.called_functions, base.has_loops
        self.scleronomic, self.traits = base.scleronomic, replace(base.traits, symmetric=False)
        self.pattern, self.constraint_pattern = base.pattern, base.constraint_pattern
        self.constraint_names = base.constraint_names

    @abc.abstractmethod
    def _rates(self, q: Array, v: Array) -> Array:
        """Return the velocities on which the forces of the base depend at q and v, (n_q,)."""

    @abc.abstractmethod
    def _rates_along(self, dq: Array, dv: Array) -> Array:
        """Return the change of `_rates` along a direction at a fixed design, (n_q,)."""

    def start(self) -> tuple[Array, Array]:
        """Return q and v of the base at t = 0, the states taken out of v, (n_q,) each."""
        q, v = self.base.start()
        still = np.array(v)
        still[self.base.state_places] = 0.0
        return q, still

    def mass(self, q: Array) -> Array:
        """Return the values of M of the base, (nnz,)."""
        return self.base.mass(q)

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return the values of M_q dq of the base, (nnz,)."""
        return self.base.mass_along(q, dq)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return Q of the base at the velocities of `_rates`, (n_q,)."""
        return self.base.force(t, q, self._rates(q, v))

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of `force` along a direction of (t, q, v), (n_q,)."""
        moved = StateDirection(
            direction.t, direction.q, self._rates_along(direction.q, direction.v)
        )
        return self.base.force_along(t, q, self._rates(q, v), moved)

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi of the base or a time derivative, (n_lam,)."""
        return self.base.constraint(t, *motion)

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return the values of Phi_q of the base or of a time derivative, (nnz,)."""
        return self.base.constraint_q(t, *motion)

    def stress_force(self, q: Array) -> Array:
        """Return the forces of the base that vanish in stress-free bodies, (n_q,)."""
        return self.base.stress_force(q)

    def centred(self, q: Array) -> Array:
        """Return coordinates of the base that do not depend on its place, (n_q,)."""
        return self.base.centred(q)

    def folded(self, q: Array) -> str:
        """Return a text that names folded bodies of the base."""
        return self.base.folded(q)

    def coarse(self, states: Array, moving: bool = False) -> dict[str, float]:
        """Return, by name, bodies of the base whose mesh is too coarse in states, rows of q."""
        return self.base.coarse(states, moving)

    def opened(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first of k states of the base that opens an equation left out."""
        return self.base.opened(t, q)

    def contacts(self) -> ContactRecord | None:
        """Return a new record of the contacts of the base."""
        return self.base.contacts()


@final
class Steady(ControlledSystem):
    """A controlled system at rest, with its states as coordinates; see the module."""

    def __init__(self, base: MechanicalSystem, weights: Array | None = None) -> None:
        """Set up the system; `weights`, (n_q,), are given where another design has set them."""
        super().__init__(base, _weights_at_rest(base) if weights is None else weights)
        self.traits = replace(self.traits, velocity_forces=False)
        self.state_places = base.state_places
        self._idle = np.setdiff1d(idle_of(base), self.state_places)
        self._spring = base.weights[self._idle]

    def with_values(self, b: Array) -> Steady:
        """Return the same system at other values b of the design variables."""
        return Steady(self.base.with_values(b), self.weights)

    def start(self) -> tuple[Array, Array]:
        """Return the coordinates at t = 0, states included, and zero velocities."""
        q = with_states(self, *self.base.start())
        return q, 0.0 * q

    def _rates(self, q: Array, v: Array) -> Array:
        rates = np.array(v, dtype=np.result_type(q, v))
        rates[self.state_places] += q[self.state_places]
        return rates

    def _rates_along(self, dq: Array, dv: Array) -> Array:
        return self._rates(dq, dv)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return Q'(q, v) of the module, (n_q,)."""
        Q = np.array(super().force(t, q, v))
        Q[self._idle] -= self._spring * q[self._idle]
        return Q

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of `force` along a direction, (n_q,)."""
        dQ = np.array(super().force_along(t, q, v, direction))
        dQ[self._idle] -= self._spring * direction.q[self._idle]
        return dQ

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return the Jacobians of f and Phi at k times; f_v is left out, for nothing moves."""
        if v is None:
            return self.base.linearise(t, q, None, a, lam)
        rates = np.array([self._rates(*x) for x in zip(q, v, strict=True)])
        at = self.base.linearise(t, q, rates, a, lam)
        assert at.f_v is not None
        of_states = np.isin(self.pattern.columns, self.state_places)
        f_q = at.f_q + np.where(of_states, at.f_v, 0.0)
        f_q[:, self.pattern.diagonal[self._idle]] += self._spring
        return Linearisation(at.M, f_q, None, at.Phi_q)


def at_rest(system: MechanicalSystem) -> MechanicalSystem:
    """Return the system whose equilibrium is sought: `Steady` where there are controllers."""
    base = system.base if isinstance(system, Held) else system
    return Steady(base) if base.controllers else base


def with_states(system: MechanicalSystem, q: Array, v: Array) -> Array:
    """Return the coordinates of `at_rest` in a state q, v, (n_q,), or their derivatives."""
    q = np.array(q, dtype=np.result_type(q, v))
    q[system.state_places] = v[system.state_places]
    return q


def without_states(system: MechanicalSystem, q: Array) -> tuple[Array, Array]:
    """Return q and v from coordinates of `at_rest`, (n_q,), or their derivatives."""
    q, v, places = np.array(q), np.zeros_like(q), system.state_places
    v[places], q[places] = q[places], 0.0
    return q, v


def _weights_at_rest(base: MechanicalSystem) -> Array:
    """Return the weights of coordinates with states among them, (n_q,).

    A state has the mass w = (g T)^2, with g the force of a unit of it in the norm of the weights
    and T a time of the loop. So T^2 w is the square of the displacement that it causes in T.
    States without a force have the longest T of the states with one.
    """
    q, v = (x.real for x in base.start())
    none = np.zeros((1, base.n_lam))
    at = base.linearise(np.zeros(1), q[None], v[None], 0 * q[None], none)
    assert at.f_v is not None
    pattern, weights, places = base.pattern, np.array(base.weights), base.state_places
    squares = only(at.f_v).real ** 2 / weights[pattern.rows]
    squares[np.isin(pattern.rows, places)] = 0.0
    g = np.sqrt(np.bincount(pattern.columns, squares, base.n_q))[places]
    acts = g > 0
    T = np.sqrt(weights[places]) / np.where(acts, g, 1.0)
    T = np.where(acts, T, np.max(T[acts], initial=0.0) or 1.0)
    weights[places] *= T**2
    return weights


@final
class Held(ControlledSystem):
    """A controlled system about the states x of an equilibrium, x_b, (n_q, n_b), their derivatives.

    x, (n_q,), is zero where velocities are no states; see the module. Rows of states are multiplied
    by `scale`, (n_q,), which changes no motion: their masses belong to the start, where a
    controller may act with another slope than here.
    """

    def __init__(self, base: MechanicalSystem, x: Array, x_b: Array, scale: Array) -> None:
        super().__init__(base, base.weights * scale)
        self.state_places, self._x, self._x_b, self._scale = base.state_places, x, x_b, scale

    def with_values(self, b: Array) -> Held:
        """Return the same system at other values b; the states follow along their derivatives."""
        x = self._x + self._x_b @ (np.asarray(b) - self.b)
        return Held(self.base.with_values(b), x, self._x_b, self._scale)

    def _rates(self, q: Array, v: Array) -> Array:
        return v + self._x

    def _rates_along(self, dq: Array, dv: Array) -> Array:
        return dv

    def mass(self, q: Array) -> Array:
        """Return the values of M of the base with scaled rows, (nnz,)."""
        return super().mass(q) * self._scale[self.pattern.rows]

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return Q of the base about its states with scaled rows, (n_q,)."""
        return super().force(t, q, v) * self._scale

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of `force` along a direction, (n_q,)."""
        return super().force_along(t, q, v, direction) * self._scale

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return the Jacobians of f and Phi of the base at k times, with scaled rows of f."""
        at = self.base.linearise(t, q, None if v is None else v + self._x, a, lam)
        scale = self._scale[self.pattern.rows]
        f_v = None if at.f_v is None else at.f_v * scale
        return Linearisation(at.M * scale, at.f_q * scale, f_v, at.Phi_q)


def about_states(
    system: MechanicalSystem, q: Array, v: Array | None, v_b: Array | None = None
) -> MechanicalSystem:
    """Return a system with controllers about the states in v, and others as they are.

    q and v are (n_q,), and v_b, the design derivatives of v, (n_q, n_b); None for zero.
    """
    places = system.state_places
    if not len(places):
        return system
    x, x_b = np.zeros(system.n_q), np.zeros((system.n_q, system.n_b))
    if v is not None:
        x[places] = v[places]
    if v_b is not None:
        x_b[places] = v_b[places]
    return Held(system, x, x_b, _balance(system, q, x))


def _balance(system: MechanicalSystem, q: Array, x: Array) -> Array:
    """Return factors of the masses of states after which the loop is balanced at q, x, (n_q,).

    With Q_x, f_q and f_v there, in the norm of the inverse weights, the mass of a state is (g T)^2
    as at the start (docs/theory/17-controllers.md). States beside one of these stay as they are.
    """
    none, pattern, weights = np.zeros((1, system.n_lam)), system.pattern, system.weights
    at = system.linearise(np.zeros(1), q.real[None], x[None], 0 * q.real[None], none)
    assert at.f_v is not None
    scale, root = np.ones(system.n_q), np.sqrt(weights)
    f_q, f_v = (pattern.csr(only(each).real) for each in (at.f_q, at.f_v))
    mechanism = np.ones(system.n_q, dtype=bool)
    mechanism[idle_of(system)] = False
    for k in system.state_places.tolist():
        w = weights[k]
        g = np.linalg.norm((f_v[:, [k]].toarray()[:, 0] / root)[mechanism])
        e, d = (np.linalg.norm((x[[k]].toarray()[0] / root)[mechanism]) / w for x in (f_q, f_v))
        rate = max(abs(f_v[k, k]) / w, np.sqrt(g * d), np.cbrt(g * e))
        if g > 0 and rate > 0:
            scale[k] = (g / rate) ** 2 / w
    return scale
