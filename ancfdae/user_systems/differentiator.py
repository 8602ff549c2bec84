"""Partials and totals of a system from its values at complex arguments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TypeAlias, final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.contour import derivative
from ancfdae.protocol.motion import Motion, require_perturbation
from ancfdae.protocol.system import MechanicalSystem
from ancfdae.user_systems.analytic import Reach

# What is differentiated: a function of a system, a motion and further numbers.
Kernel: TypeAlias = Callable[..., Array]
# Systems at other design values that are kept.
_KEPT = 1000


@final
class Differentiator:
    """Derivatives of kernels, in the numbers they take, along changes of the motion and in b.

    Kernels that depend on no velocity (`of_forces` false) are followed further.
    """

    def __init__(self, system: MechanicalSystem, of_forces: bool) -> None:
        self._system, self._of_forces = system, of_forces
        self._moved: dict[bytes, MechanicalSystem] = {}

    def of(self, system: MechanicalSystem) -> Differentiator:
        """Return the differentiator of the same system with imaginary parts in b."""
        other = Differentiator(system, self._of_forces)
        other.base, other.reach, other._moved = self.base, self.reach, self._moved
        return other

    @cached_property
    def base(self) -> MechanicalSystem:
        """The system at the real part of b."""
        if self._system.b.dtype.kind != "c":
            return self._system
        require_perturbation("b", self._system.b)
        return self._system.with_values(self._system.b.real.copy())

    @cached_property
    def reach(self) -> Reach:
        """How far circles reach."""
        reach = Reach.of(self.base)
        return reach if self._of_forces else replace(reach, v=np.inf)

    def motion(
        self,
        q: Array | None = None,
        v: Array | None = None,
        a: Array | None = None,
        lam: Array | None = None,
        *,
        t: complex = 0.0,
    ) -> Motion:
        """Put zeros for what is left out."""
        n_q, n_lam = self._system.n_q, self._system.n_lam
        q, v, a = (np.zeros(n_q) if x is None else np.asarray(x) for x in (q, v, a))
        return Motion(q, v, a, np.zeros(n_lam) if lam is None else np.asarray(lam), t)

    def value(self, kernel: Kernel, m: Motion, radii: tuple[float, ...], order: int = 1) -> Array:
        """Differentiate in the numbers of the kernel; carry what is imaginary in m and b."""
        base = self.base
        m, change = m.parts()
        value = derivative(
            lambda *z: kernel(base, m, *z), radii, order, lambda: self._beside(kernel, m, radii)
        )
        db = self._system.b.imag
        if not np.any(db) and change.is_zero:
            return value
        return value + 1j * self._total(kernel, m, change, db, radii, order)

    def gradient(
        self, kernel: Kernel, m: Motion, radii: tuple[float, ...] = (), order: int = 1
    ) -> Array:
        """Differentiate in every coordinate, which the kernel moves by its last number."""
        reach = self.reach.coordinates

        def towards(unit: Array) -> Kernel:
            return lambda system, m, *z: kernel(system, m, *z, unit)

        parts = [
            self.value(towards(unit), m, (*radii, reach[j]), order)
            for j, unit in enumerate(np.eye(self._system.n_q))
        ]
        return np.stack(parts, axis=-1)

    def _total(
        self,
        kernel: Kernel,
        m: Motion,
        change: Motion,
        db: Array,
        radii: tuple[float, ...],
        order: int,
    ) -> Array:
        """Differentiate once more, along a change of the state and of b."""
        base, changed = self.base, bool(np.any(db))

        def moved(*numbers: complex) -> Array:
            *z, e = numbers
            system = self._at(e * db) if changed else base
            return kernel(system, m.plus(e, change), *z)

        radius = self.reach.along(change, base.b, db, radii[0] if radii else 0.0)
        return derivative(moved, (*radii, radius), order, lambda: self._beside(kernel, m, radii))

    def _at(self, db: Array) -> MechanicalSystem:
        """Return the system at other design values; the same ones come again and again."""
        key = db.tobytes()
        if key not in self._moved:
            if len(self._moved) >= _KEPT:
                self._moved.clear()
            self._moved[key] = self.base.with_values(self.base.b + db)
        return self._moved[key]

    def _beside(self, kernel: Kernel, m: Motion, radii: tuple[float, ...]) -> Array:
        """Value at another configuration: of the size of the terms of the kernel."""
        beside = m._replace(q=m.q + self.reach.coordinates)
        value: Array = kernel(self.base, beside, *(0.0 for _ in radii))
        return value
