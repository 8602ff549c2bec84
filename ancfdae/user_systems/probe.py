"""Random states near the start of a system, and derivatives of its values by differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np

from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.extrapolation import real_derivative
from ancfdae.protocol.motion import Motion
from ancfdae.protocol.system import MechanicalSystem

# Distance of a random state from the start, relative to its size.
_BESIDE = 0.05
# Part of the largest value below which an entry is compared with that instead of with itself.
_SMALL = 1e-3


@final
class Probe:
    """A system at a random state m, with changes of the size of the state itself.

    d is a change of it, d_b one for every design variable, of the size b_sizes; `arguments` are the
    state, the change "x" of q and the changes "q_b", ... per unit of b, as members take them. In
    `time` the system moves by its own size.
    """

    def __init__(self, system: MechanicalSystem, rng: np.random.Generator) -> None:
        self.system, self._rng = system, rng
        self.b_sizes = np.where(system.b == 0, 1.0, np.abs(system.b))
        self._moved: dict[bytes, MechanicalSystem] = {}
        q, v = system.start()
        self._q_sizes = _sizes(q, system.weights)
        self.time, self._lam_size = self._natural_sizes(q, v)
        self._v_sizes = np.maximum(self._q_sizes / self.time, np.abs(v))
        self.m = self._state(q, v)
        self.d = self.change()
        self.d_b = [self.change() for _ in range(system.n_b)]
        self.arguments: dict[str, Any] = {**self.m._asdict(), "x": self.d.q}
        for name in ("q", "v", "a", "lam"):
            rows = np.array([getattr(d, name) for d in self.d_b])
            columns = rows.reshape(system.n_b, len(self.arguments[name])).T
            self.arguments[f"{name}_b"] = columns / self.b_sizes

    def change(self) -> Motion:
        """Return a random change of the size of the state, and of a natural time."""
        random = self._rng.uniform
        q, v, a = random(-1, 1, (3, self.system.n_q))
        lam = random(-1, 1, self.system.n_lam) * self._lam_size
        speeds = self._v_sizes
        return Motion(q * self._q_sizes, v * speeds, a * speeds / self.time, lam, self.time)

    def along(self, f: Callable[[Motion], Array], part: str) -> Array:
        """Differentiate f along the change of one part of the state."""
        still = self.d.plus(-1.0, self.d)
        change = still._replace(**{part: getattr(self.d, part)})
        return real_derivative(lambda e: f(self.m.plus(e, change)))

    def differences(self, f: Callable[[float], Array]) -> Array:
        """Differentiate a function of one number of the order of one."""
        return real_derivative(f)

    def in_time(self, f: Callable[[Motion], Array]) -> Array:
        """Differentiate f along the motion."""
        return real_derivative(lambda s: f(self.m.at(s * self.time))) / self.time

    def by_design(self, f: Callable[[MechanicalSystem, Motion], Array], moving: bool) -> Array:
        """Differentiate f in b, times b, along the changes `d_b` or with the state held."""
        columns = []
        for unit, d in zip(np.eye(self.system.n_b), self.d_b, strict=True):
            still = d._replace(t=0.0)

            def moved(e: float, unit: Array = unit, still: Motion = still) -> Array:
                m = self.m.plus(e, still) if moving else self.m
                return f(self.at(e * unit), m)

            columns.append(real_derivative(moved))
        shape = np.shape(f(self.system, self.m))
        return np.stack(columns, axis=-1) if columns else np.zeros((*shape, 0))

    def at(self, change: Array) -> MechanicalSystem:
        """Return the system with b moved by parts of its size; the same ones come again."""
        key = change.tobytes()
        if key not in self._moved:
            self._moved[key] = self.system.with_values(self.system.b + change * self.b_sizes)
        return self._moved[key]

    def _state(self, q: Array, v: Array) -> Motion:
        d = self.change()
        t = _BESIDE * self.time * (1 + self._rng.uniform())
        return Motion(q + _BESIDE * d.q, v + _BESIDE * d.v + 0.5 * d.v, d.a, d.lam, t)

    def _natural_sizes(self, q: Array, v: Array) -> tuple[float, float]:
        """Time in which the system moves by its size, and multipliers of the size of Q."""
        system, w = self.system, self.system.weights
        Q = system.force(q, v, 0.0)
        size, pull = norm(q, w) or 1.0, norm(Q, 1 / w)
        times = [np.sqrt(size / pull)] if pull > 0 else []
        times += [size / norm(v, w)] if norm(v, w) > 0 else []
        slope = np.max(np.abs(system.constraint_q(q, 0.0)), initial=0.0)
        return float(min(times, default=1.0)), float((np.max(np.abs(Q)) or 1.0) / (slope or 1.0))


def gap(claimed: Array, found: Array, value: Array | float) -> float:
    """Largest difference, entry by entry against its size or a small part of the largest.

    `value` is what was differentiated, along a change of its arguments by their size: entries that
    vanish beside it are compared with it.
    """
    if not np.size(claimed):
        return 0.0
    sizes = np.maximum(np.abs(claimed), np.abs(found))
    largest = max(float(np.max(sizes)), float(np.max(np.abs(value), initial=0.0)))
    if largest == 0:
        return 0.0
    worst = float(np.max(np.abs(claimed - found) / (sizes + _SMALL * largest)))
    return worst if np.isfinite(worst) else np.inf


def _sizes(x: Array, weights: Array) -> Array:
    """Size of every coordinate: its own, or where it vanishes that of the others."""
    common = (norm(x, weights) or 1.0) / np.sqrt(weights * len(x))
    largest = np.max(np.abs(x)) or 1.0
    return np.where(np.abs(x) > 1e-3 * largest, np.abs(x), np.minimum(common, largest))
