"""Random states near the start of a system, as the arguments of its members."""

from __future__ import annotations

from inspect import Parameter, signature
from types import FunctionType
from typing import Any, TypeAlias, final

import numpy as np

from ancfdae.equations.derived import coordinate_sizes, design_sizes
from ancfdae.equations.generic import Sizes
from ancfdae.equations.motion import Motion, StateDirection
from ancfdae.equations.system import MechanicalSystem, reaction
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array

# Values of the arguments of members, by their names.
Given: TypeAlias = dict[str, Any]
# Distance of a random state from the start, relative to its size.
_BESIDE = 0.05
# Instants of what takes many.
_INSTANTS = 3


@final
class Probe:
    """Random states of a system, and changes of the size of the state itself.

    In `time` the system moves by its own size.
    """

    def __init__(self, system: MechanicalSystem, rng: np.random.Generator) -> None:
        self.system, self._rng = system, rng
        q, v = system.start()
        self._q_sizes = coordinate_sizes(q, system.weights)
        self.time, self._lam_size = self._natural_sizes(q, v)
        self._v_sizes = np.maximum(self._q_sizes / self.time, np.abs(v))
        d, t = self.change(), _BESIDE * self.time * (1 + rng.uniform())
        self.m = Motion(q + _BESIDE * d.q, v + (_BESIDE + 0.5) * d.v, d.a, d.lam, t)
        self.d = self.change()
        self.sizes = self._sizes_of_terms()

    def change(self) -> Motion:
        """Return a random change of the size of the state, and of a natural time."""
        random = self._rng.uniform
        q, v, a = random(-1, 1, (3, self.system.n_q))
        lam = random(-1, 1, self.system.n_lam) * self._lam_size
        speeds = self._v_sizes
        return Motion(q * self._q_sizes, v * speeds, a * speeds / self.time, lam, self.time)

    def one(self) -> list[Given]:
        """Return arguments at one instant, of all orders and along two directions.

        State, covectors, and changes per unit of b.
        """
        m, d, T, w = self.m, self.d, self.time, self.system.weights
        rates = m.q, m.v, m.a, d.a / T
        given: Given = {**m._asdict(), "x": d.q, "dq": d.v, "mu": self.change().q, "states": m[:4]}
        given |= {"on_q": w * d.q, "on_v": w * d.v * T**2}
        changes = [self.change() for _ in range(self.system.n_b)]
        for name in ("q", "v", "a", "lam"):
            rows = np.array([getattr(change, name) for change in changes])
            columns = rows.reshape(len(changes), len(given[name])).T
            given[f"{name}_b"] = columns / design_sizes(self.system)
            given[f"{name}_rows"] = np.concatenate([given[name][None], given[f"{name}_b"].T])
        given["states_b"] = tuple(given[f"{name}_b"] for name in ("q", "v", "a", "lam"))
        given["direction_b"] = given["v_b"], given["a_b"]
        rates_b = *given["states_b"][:3], given["a_b"] / T
        time, still = StateDirection(1.0, m.v, d.a), StateDirection(0.0, d.v, d.a)
        return [
            given
            | {"motion": rates[:order], "direction": time if order % 2 else still}
            | {"motion_b": rates_b[:order] if held is None else None}
            for order in (1, 2, 3, 4)
            for held in (None, order)
        ]

    def many(self) -> list[Given]:
        """Return arguments at several time points, of three orders, with and without velocities."""
        states = [self.m.plus(0.1 * k, self.d) for k in range(_INSTANTS)]
        given = {name: np.array([x._asdict()[name] for x in states]) for name in Motion._fields}
        changes = [self.change() for _ in range(_INSTANTS)]
        covectors = np.array([x.q for x in changes]), np.array([x.lam for x in changes])
        return [
            given
            | {"v": v, "states": (given["q"], v, given["a"], given["lam"])}
            | {"covectors": covectors, "motion": (given["q"], given["v"], given["a"])[:order]}
            for order, v in ((1, None), (2, given["v"]), (3, given["v"]))
        ]

    def _sizes_of_terms(self) -> Sizes:
        s, m, q, v = self.system, self.m, self._q_sizes, self._v_sizes
        terms = [s.force(m.t, m.q, m.v), s.mass_times(m.q, m.a), reaction(s, m.t, m.q, m.lam)]
        B, Phi = s.constraint_q(m.t, m.q), s.constraint(m.t, m.q)
        C = np.abs(Phi) + s.constraint_pattern.dot(np.abs(B), q)
        return Sizes(q, v, design_sizes(s), self.time, np.abs(terms).sum(axis=0), C)

    def _natural_sizes(self, q: Array, v: Array) -> tuple[float, float]:
        """Time in which the system moves by its size, and multipliers of the size of Q."""
        system, w = self.system, self.system.weights
        Q = system.force(0.0, q, v)
        size, pull = norm(q, w) or 1.0, norm(Q, 1 / w)
        times = [np.sqrt(size / pull)] if pull > 0 else []
        times += [size / norm(v, w)] if norm(v, w) > 0 else []
        slope = np.max(np.abs(system.constraint_q(0.0, q)), initial=0.0)
        return float(min(times, default=1.0)), float((np.max(np.abs(Q)) or 1.0) / (slope or 1.0))


def arguments(member: FunctionType, one: list[Given], many: list[Given]) -> list[list[Any]]:
    """Return all arguments that a member takes, once each."""
    _, *parameters = signature(member).parameters.values()
    instants = any(p.name == "t" and p.annotation != "float" for p in parameters)
    rows: dict[tuple[Any, ...], list[Any]] = {}
    for given in many if instants else one:
        row: list[Any] = []
        for p in parameters:
            value = given[p.name]
            row += value if p.kind is Parameter.VAR_POSITIONAL else (value,)
        rows[tuple(map(_identity, row))] = row
    return list(rows.values())


def _identity(x: Any) -> Any:
    return tuple(map(id, x)) if isinstance(x, tuple) else id(x)
