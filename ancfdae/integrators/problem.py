"""The problem of a run: a system, its consistent start and the scales of its unknowns.

**Sizes.** Coordinates are compared in the weighted form sqrt(w_i) q_i, which has one unit for all
of them. Positions count from the mean position of the start, the place p of the system, and the
size of a coordinate is the root mean square of its vector, so that no size depends on where a
scene stands or how it is turned. The scale of q is the root mean square of q - p at the start in
the weighted form; that of v is the speed that the start has or that its accelerations reach over
that length; that of the multipliers follows from the forces at the start through the rows of
Phi_q. Forces that are round-off count as zero: of
a mechanism at rest they would give a speed of no meaning, 1e-8 of that which it is to have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, final

import numpy as np

from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.index_1 import Accelerations, accelerations
from ancfdae.integrators.start import (
    InitialSensitivity,
    InitialState,
    consistent_start,
    start_sensitivity,
)
from ancfdae.kernels import finite, norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint

# Forces at rest that are smaller than this many times their round-off have no size.
_ROUND_OFF = 100.0
# Starts of one system, computed twice, differ by round-off of their projection.
_SAME = 1e-7


@final
@dataclass(frozen=True)
class Scales:
    """Positive sizes of q, v, forces and design variables, one per unknown; `place` is p, (n_q,).

    `row` is the length of the rows of Phi_q in the norm of the inverse weights; position, speed and
    load are the common sizes of sqrt(w) q, sqrt(w) v and Q / sqrt(w).
    """

    place: Array
    q: Array
    v: Array
    force: Array
    row: Array
    position: float
    speed: float
    load: float
    b: Array

    @property
    def lam(self) -> Array:
        """Scale of the multipliers: load over row of the constraints."""
        return self.load / self.row

    @property
    def eta(self) -> Array:
        """Size of the multipliers that keep positions on the constraints (GGL)."""
        return self.speed / self.row

    @staticmethod
    def of(system: MechanicalSystem, initial: InitialState, t_end: float) -> Scales:
        """Return the scales of coordinates, velocities and forces for a run to `t_end`."""
        t, q = initial.t, initial.q
        root, count = np.sqrt(system.weights), np.sqrt(system.n_q)
        reactions = reaction(system, t, q, initial.lam)
        Q = system.force(t, q, initial.v)
        inverse = 1 / system.weights
        forces = norm(Q, inverse), norm(reactions, inverse), norm(initial.a, system.weights)
        least = _ROUND_OFF * system.traits.force_round_off
        load = float(np.max(forces, initial=0.0, where=np.greater(forces, least))) / count
        v_0 = norm(initial.v, system.weights) / count
        centred = system.centred(q.real)
        position = norm(centred, system.weights) / count
        position = position or v_0 * t_end or load * t_end**2 or 1.0
        speed = max(v_0, min(load * t_end, np.sqrt(position * load))) or position / t_end
        load = load or speed / t_end
        pattern = system.constraint_pattern
        squared = system.constraint_q(t, q).real ** 2 * inverse[pattern.columns]
        row = np.sqrt(np.bincount(pattern.rows, squared, minlength=system.n_lam))
        return Scales(
            place=q.real - centred,
            q=position / root,
            v=speed / root,
            force=load * root,
            row=row,
            position=position,
            speed=speed,
            load=load,
            b=np.where(system.b.real == 0, 1.0, np.abs(system.b.real)),
        )


@final
@dataclass(frozen=True)
class InitialValueProblem:
    """A system at its consistent start, with derivatives where sensitivities are asked for."""

    system: MechanicalSystem
    matrices: SaddlePoint
    initial: InitialState
    scales: Scales
    derivative: InitialSensitivity | None = None

    @classmethod
    def of(cls, system: MechanicalSystem, t_end: float) -> Self:
        """Return the problem of a system up to t_end, with its consistent start and scales."""
        require_positive("t_end", t_end)
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)[0]
        scales = Scales.of(system, initial, t_end)
        return cls(system, matrices, initial, scales)

    def size(self, q: Array) -> Array:
        """Return for every coordinate the size of its vector from the place p, shape (n_q,)."""
        return vector_sizes(q.real - self.scales.place, self.system.vector_size)

    @cached_property
    def accelerations(self) -> Accelerations:
        """Accelerations and multipliers of states."""
        return accelerations(self.system, self.matrices)

    def differentiated(self) -> Self:
        """Add the design derivatives of the start."""
        derivative = start_sensitivity(self.system, self.matrices, self.initial)
        return replace(self, derivative=derivative)

    def require_finite(self) -> None:
        """Refuse a start at which accelerations, multipliers or derivatives are not finite."""
        accelerations = (self.initial.a, self.initial.lam)
        for what, arrays in (
            ("accelerations", accelerations),
            ("design derivatives", self.derivative or ()),
        ):
            if not all(finite(x) for x in arrays):
                rule, got = "must be finite", "NaN or infinity"
                raise InvalidInputError(
                    f"{what} at the start", rule, got, "Check forces and start."
                )

    def require_run(self, run: Solution, t_end: float, where: str) -> None:
        """Refuse a run that did not begin as this problem does, or went further than `t_end`."""
        start, scales, system = self.initial, self.scales, self.system
        rule, repair = "must be a run of this model at this design", "Pass the model that it ran."
        sizes = run.q.shape[1], run.lam.shape[1]
        if sizes != (system.n_q, system.n_lam):
            got = f"{sizes[0]} coordinates and {sizes[1]} multipliers"
            raise InvalidInputError(where, rule, got, repair)
        unbalanced = system.mass_times(start.q, run.a[0] - start.a)
        for difference, size in (
            (run.q[0] - start.q, scales.q),
            (run.v[0] - start.v, scales.v),
            (unbalanced, scales.force),
        ):
            if not np.max(np.abs(difference) / size, initial=0.0) <= _SAME:
                raise InvalidInputError(where, rule, "another start", repair)
        if run.t[-1] > t_end * (1 + 1e-9):
            rule = f"must end at {t_end:.6g} or before"
            raise InvalidInputError(
                where, rule, f"{run.t[-1]:.6g}", "Raise `t_end` to the last time of the run."
            )


def vector_sizes(x: Array, d: int) -> Array:
    """Return for every coordinate the root mean square of its vector; the last axis holds vectors.

    They have d components.
    """
    sizes = np.sqrt(np.mean(x.reshape(*x.shape[:-1], -1, d) ** 2, axis=-1))
    return np.repeat(sizes, d, axis=-1)
