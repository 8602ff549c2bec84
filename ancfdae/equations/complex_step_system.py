"""Mechanical systems given by their physics alone; the partials are taken by complex numbers.

Every partial of the protocol is a derivative, at zero, of M x, Q or Phi in at most three numbers:

    Phi_q                    d/dx of Phi(t, q + x e_j), for every j
    (Phi_q^T lam)_q          d/dx d/dy of lam . Phi(t, q + x e_i + y e_j)
    d^k Phi/dt^k             d^k/ds^k of Phi(t + s, q + s v + s^2/2 a), plus Phi_q j in the third
    dPhi_q/dt                d/dx d/ds of Phi on that path, moved by x e_j
    Q along (dt, dq, dv)     d/ds of Q(t + s dt, q + s dq, v + s dv)
    M along dq               d/ds of M(q + s dq)

and a `_total` is d/de of one of these with the state moved by e (q_b, v_b, ...) and b by e.
`ancfdae.numerics.contour` takes a single first derivative by a complex step, to round-off, and
all others on circles: it derives their errors, some 1e-14 to 1e-12 of the largest value.

**Within a complex-step run** q or b carry an imaginary part of 1e-40. On a circle it would be
lost next to imaginary parts of order one. So a derivative F of complex arguments x + i y is

    F(x) + i F_x y,

with F_x y a `_total` along (y, Im b): exact, for y^2 vanishes against one. M, Q and Phi
themselves are evaluated in complex numbers as written. So the partials in b and the totals that
the protocol derives by complex steps need nothing of their own. Only tangents that steer Newton's
method, Q_q, Q_v and (Phi_q^T lam)_q, drop the perturbation.
Imaginary parts of q, v or b that are too large for a perturbation are refused.

**Radii.** A circle should reach as far as M, Q and Phi are smooth. How far that is in q, v and t is
found by trial once per system: of radii that round-off resolves, the one with the least
max|f| / r^3, in the norm of the weights. A path is followed as long as it stays within all three
lengths. Errors are relative to the terms at that distance: a prescribed motion that is a million
times slower than the rest has an acceleration that is lost next to theirs.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import replace
from functools import cache, cached_property
from typing import Self, TypeAlias, cast, final

import numpy as np

from ancfdae.equations.analytic import Reach, require_analytic
from ancfdae.equations.motion import Direction, Motion, require_perturbation
from ancfdae.equations.rows import RowCalls
from ancfdae.equations.system import MechanicalSystem
from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.contour import derivative
from ancfdae.numerics.patterns import Pattern

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
        """Radii up to which values may be followed into the complex plane."""
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
        """Return a motion (q, v, a, lam), with zeros for omitted arrays."""
        n_q, n_lam = self._system.n_q, self._system.n_lam
        q, v, a = (np.zeros(n_q) if x is None else np.asarray(x) for x in (q, v, a))
        return Motion(q, v, a, np.zeros(n_lam) if lam is None else np.asarray(lam), t)

    def value(self, kernel: Kernel, m: Motion, radii: tuple[float, ...], order: int = 1) -> Array:
        """Differentiate in the numbers of the kernel; carry what is imaginary in m and b."""
        base = self.base
        m, change = m.parts()
        value = derivative(
            lambda *z: kernel(base, m, *z), radii, order, lambda: self.terms(kernel, m, radii)
        )
        db = self._system.b.imag
        if not np.any(db) and change.is_zero:
            return value
        return value + 1j * self._total(kernel, m, change, db, radii, order)

    def gradient(
        self, kernel: Kernel, m: Motion, radii: tuple[float, ...] = (), order: int = 1
    ) -> Array:
        """Differentiate with respect to every coordinate; shape (n, n_q).

        The kernel takes rows of changes of q as its last argument, and returns a row for each.
        """
        changes = np.diag(self.reach.coordinates)

        def moved(system: MechanicalSystem, m: Motion, *z: complex) -> Array:
            *before, x = z
            return kernel(system, m, *before, x * changes)

        rows = self.value(moved, m, (*radii, 1.0), order)
        return np.asarray((rows / self.reach.coordinates[:, None]).T)

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
        return derivative(moved, (*radii, radius), order, lambda: self.terms(kernel, m, radii))

    def _at(self, db: Array) -> MechanicalSystem:
        key = db.tobytes()  # The same values come again and again.
        if key not in self._moved:
            if len(self._moved) >= _KEPT:
                self._moved.clear()
            self._moved[key] = self.base.with_values(self.base.b + db)
        return self._moved[key]

    def terms(self, kernel: Kernel, m: Motion, radii: tuple[float, ...]) -> Array:
        """Values of the size of the terms of the kernel: it may cancel, its round-off does not.

        An argument that is off by round-off moves a value by its slope times that; slopes are
        differences within reach. What is left of a value beside the state counts as it is.
        """
        zeros, t, steps = [0.0] * len(radii), self.reach.t, self.reach.coordinates
        beside = [m._replace(q=m.q + x) for x in np.diag(steps)] + [m._replace(t=m.t + t)]
        sizes = np.append(np.abs(m.q) / steps, abs(m.t) / t)
        value = kernel(self.base, m, *zeros)
        with np.errstate(all="ignore"):
            changes = [np.abs(kernel(self.base, x, *zeros) - value) for x in beside]
        weighted = [x * max(1.0, size) for x, size in zip(changes, sizes, strict=True)]
        return np.abs(value) + np.nansum(weighted, axis=0)


class ComplexStepSystem(MechanicalSystem):
    """A system that is given by M, Q, Phi and its start.

    Subclasses set `n_q`, `n_lam` and `design_names`, implement `mass_matrix`, `force`,
    `position_constraint`, `start` and `with_values`, and call ``super().__init__(b)`` at the end
    of their own constructor. All of it must be analytic in q, v, t and ``self.b`` and accept
    complex numbers: no ``abs``, no comparison, no writing into an array of floats. Any partial may
    be overridden by a formula of the user; `check_system` compares.

    Parameters
    ----------
    b : sequence of number, shape (n_b,)
        Values of the design variables.

    Raises
    ------
    InvalidInput
        If a method does not accept complex numbers, drops an imaginary part or returns another
        shape, or if a weight is not positive.
    """

    _last: tuple[tuple[bytes, float], Array] | None = None

    def __init__(self, b: Array | tuple[complex, ...]) -> None:
        self.b = np.asarray(b) * 1.0
        where = type(self).__name__
        if self.b.shape != (self.n_b,):
            rule = f"must have shape ({self.n_b},), one value per name in `design_names`"
            raise InvalidInput(f"{where}.b", rule, f"shape {self.b.shape}")
        self.pattern = _full(self.n_q, self.n_q)
        self.constraint_pattern = _full(self.n_lam, self.n_q)
        if self.b.dtype.kind != "c":
            require_analytic(self)
        self.weights = self.coordinate_weights()
        if not np.all(self.weights > 0):
            repair = "Override `coordinate_weights` to return positive masses or inertias."
            raise InvalidInput(f"{where}.weights", "must be positive", self.weights, repair)

    # -- what a user writes --------------------------------------------------------------------

    @abc.abstractmethod
    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (n_q, n_q); to be written."""

    @abc.abstractmethod
    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the constraints Phi(t, q), shape (n_lam,); to be written."""

    def coordinate_weights(self) -> Array:
        """Return `weights`; by default the diagonal of M at the start."""
        M = np.asarray(self.mass_matrix(self.start()[0]))
        if M.shape != (self.n_q, self.n_q):
            where, rule = f"{type(self).__name__}.mass_matrix", f"must have shape {(self.n_q,) * 2}"
            raise InvalidInput(where, rule, f"shape {M.shape}")
        return np.diagonal(M).real.astype(float)

    def _at_step(self, i: int) -> Self:
        """Return the system moved in design variable i; what was found by trial stays."""
        if i not in self._at_steps:
            other = super()._at_step(i)
            other._d, other._d_forces = self._d.of(other), self._d_forces.of(other)
        return self._at_steps[i]

    # -- inertia and forces --------------------------------------------------------------------

    @final
    def mass(self, q: Array) -> Array:
        """Return the entries of M row by row, shape (n_q n_q,)."""
        return self.mass_matrix(q).ravel()

    def mass_along(self, q: Array, dq: Array) -> Array:
        """Return M_q dq, its entries row by row, by complex steps of `mass_matrix`."""
        m = self._d.motion(q, dq)
        return self._d.value(_mass_at, m, (self._d.reach.time(m),)).ravel()

    def force_along(self, t: float, q: Array, v: Array, direction: Direction) -> Array:
        """Differentiate Q along a direction; of a complex one, in which it is linear, by parts."""
        dt, *rates = direction
        if any(x.dtype.kind == "c" for x in rates):
            parts = (
                Direction(dt, *(x.real for x in rates)),
                Direction(0.0, *(x.imag for x in rates)),
            )
            along = [self.force_along(t, q, v, part) for part in parts]
            return along[0] + 1j * along[1]
        forces = self._d_forces
        change = forces.motion(*rates, t=dt)
        radius = forces.reach.along(change, np.zeros(0), np.zeros(0), 0.0)
        return forces.value(_force_along(change), forces.motion(q, v, t=t), (radius,))

    # -- constraints ---------------------------------------------------------------------------

    def constraint(self, t: float, *motion: Array) -> Array:
        """Differentiate Phi along the motion; of the jerk, Phi_q times it."""
        if len(motion) == 1:
            return self.position_constraint(t, motion[0])
        m = self._d.motion(*motion[:3], t=t)
        order, radius = len(motion) - 1, self._d.reach.time(m)
        value = self._d.value(_constraint_at, m, (radius,), order)
        if order < 3:
            return value
        return value + self.constraint_pattern.dot(self.constraint_q(t, motion[0]), motion[3])

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Differentiate Phi in q, and along the motion."""
        if len(motion) == 1:
            return self._constraint_jacobian(t, motion[0])
        if len(motion) > 2:
            return super().constraint_q(t, *motion)
        m = self._d.motion(*motion, t=t)
        return self._d.gradient(_constraint_rate, m, (self._d.reach.time(m),), 1).ravel()

    def _constraint_jacobian(self, t: float, q: Array) -> Array:
        """Phi_q; constraints and their forces ask at the same state."""
        key = q.tobytes(), t
        if self._last is None or self._last[0] != key:
            Phi_q = self._d.gradient(_constraint_moved, self._d.motion(q, t=t)).ravel()
            self._last = key, Phi_q
        return self._last[1]

    def _residual_q(self, t: float, q: Array, v: Array | None, a: Array, lam: Array) -> Array:
        """Differentiate M a - Q in q, and lam . Phi twice."""
        f_q, (steps, still) = np.zeros(self.n_q**2), self._steps
        if not self.traits.constant_mass:
            f_q = f_q + _by_row(self.rows.of(self.mass_matrix, q + steps) @ a)
        if v is not None:
            f_q = f_q - self._force_by(t, q + steps, v + still)
        return f_q if self.traits.linear_constraints else f_q + self._curvature(t, q, lam)

    def _residual_v(self, t: float, q: Array, v: Array) -> Array:
        steps, still = self._steps
        return -self._force_by(t, q + still, v + steps)

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """Rows of imaginary steps along no coordinate and along each, and as many zeros."""
        steps = 1j * STEP * np.eye(self.n_q + 1, self.n_q, -1)
        return steps, np.zeros_like(steps)

    def _force_by(self, t: float, q: Array, v: Array) -> Array:
        """Differentiate Q along rows of steps, the first of which does not move."""

        def of_state(state: Array) -> Array:
            return self.force(t, *np.split(state, 2))

        return _by_row(self.rows.of(of_state, np.concatenate([q, v], axis=1)))

    def _curvature(self, t: float, q: Array, lam: Array) -> Array:
        """(Phi_q^T lam)_q, along every coordinate and every sum of two."""
        m, _ = self._d.motion(q, lam=lam, t=t).parts()
        base, reach, n = self._d.base, self._d.reach.coordinates, self.n_q
        i, j = np.triu_indices(n)
        changes = np.eye(n)[i] + np.eye(n)[j] * (i != j)[:, None]

        def moved(s: Array) -> Array:
            rows = (s[:, None, None] * changes * reach).reshape(-1, n)
            return _constraint_moved(base, m, rows).reshape(*s.shape, len(i), -1)

        def terms() -> Array:
            return self._d.terms(_constraint_at, m, (0.0,))

        curvature = np.zeros((n, n))
        second = derivative(moved, (1.0,), 2, terms, together=True)
        curvature[i, j] = second @ m.lam
        pure = np.diag(curvature)
        mixed = np.triu(0.5 * (curvature - pure[:, None] - pure), 1)
        result = (mixed + mixed.T + np.diag(pure)) / np.outer(reach, reach)
        return np.asarray(result.ravel())

    @cached_property
    def rows(self) -> RowCalls:
        """Evaluator of Phi, M and Q at many states in one call."""
        return RowCalls({self.n_q, 2 * self.n_q, self.n_lam})

    @cached_property
    def _d(self) -> Differentiator:
        return Differentiator(self, of_forces=False)

    @cached_property
    def _d_forces(self) -> Differentiator:
        return Differentiator(self, of_forces=True)


@cache
def _full(rows: int, columns: int) -> Pattern:
    return Pattern.full((rows, columns))


def _by_row(values: Array) -> Array:
    """Imaginary parts of rows of values beyond the first, as columns of a full pattern."""
    return np.asarray((np.imag(values[1:]) - np.imag(values[0])).T.ravel() / STEP)


def _force_along(change: Motion) -> Kernel:
    """Return Q moved along a change of time and state."""

    def moved(system: MechanicalSystem, m: Motion, s: complex) -> Array:
        return system.force(m.t + s * change.t, m.q + s * change.q, m.v + s * change.v)

    return moved


def _mass_at(system: MechanicalSystem, m: Motion, s: complex) -> Array:
    return cast(ComplexStepSystem, system).mass_matrix(m.q + s * m.v)


def _constraint_at(system: MechanicalSystem, m: Motion, s: complex) -> Array:
    moved = m.at(s)
    return cast(ComplexStepSystem, system).position_constraint(moved.t, moved.q)


def _constraint_moved(system: MechanicalSystem, m: Motion, changes: Array) -> Array:
    Phi = cast(ComplexStepSystem, system).position_constraint

    def of_coordinates(q: Array, t: complex) -> Array:
        return Phi(cast(float, t), q)

    return cast(ComplexStepSystem, system).rows.of(of_coordinates, m.q + changes, m.t)


def _constraint_rate(system: MechanicalSystem, m: Motion, s: complex, changes: Array) -> Array:
    return _constraint_moved(system, m.at(s), changes)
