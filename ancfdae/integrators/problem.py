"""The initial value problem of a run with the scales of its unknowns, and its index-1 form.

The index-1 form solves for accelerations and multipliers of a state,

    [ M      Phi_q^T ] [ a   ]   [ Q     ]
    [ Phi_q  0       ] [ lam ] = [ gamma ],

and with the same matrix for their design derivatives. Drifted positions and velocities are moved
onto the constraints in the norm of M,

    M dq + Phi_q^T sigma = 0,   Phi_q dq = -Phi,
    M dv + Phi_q^T sigma = 0,   Phi_q dv = nu - Phi_q v,

by one Newton step: the drift of one integration step is small, and its square is round-off. The
matrix is that at the state before, the right side of the second line is at the moved q. The design
derivatives of the state are moved onto the derivatives of the constraints in the same way.

**Sizes.** Coordinates are compared in the weighted form sqrt(w_i) q_i, which has one unit for all
of them. Positions count from the mean position of the start, the place p of the system. The size of
a coordinate is the root mean square of its vector. So no size depends on where a scene stands or
how it is rotated. The scale of q is the root mean square of q - p at the start in the weighted
form. The scale of v is the speed that the start has or that its accelerations reach over that
length. The scale of the multipliers follows from the forces at the start through the rows of Phi_q.
Forces that are round-off count as zero: for a mechanism at rest they would give a meaningless speed
scale, 1e-8 of the speed that the mechanism is to reach.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Self, TypeAlias, final

import numpy as np

from ancfdae.equations import ListedSystem, MechanicalSystem, PlannedSystem, reaction
from ancfdae.equations.plans import Plan
from ancfdae.equations.saddle_points import acceleration_side, held_totals, saddle_point
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import InvalidInputError, SingularMatrix
from ancfdae.integrators.start import (
    InitialSensitivity,
    InitialState,
    consistent_start,
    start_sensitivity,
)
from ancfdae.kernels import (
    RULES,
    SINGULAR,
    ListAccelerations,
    Model,
    SceneAccelerations,
    finite,
    norm,
)
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint

# Solves the index-1 equations for rows of right sides, (..., n_q) and (..., n_lam); one of the two
# may be None for zeros.
Solve: TypeAlias = Callable[[Array | None, Array | None], Array]


def stacked(q: Array, v: Array, q_b: Array | None = None, v_b: Array | None = None) -> Array:
    """Return a state and its design derivatives as one array, shape (2, 1 + n_b, n_q).

    q and v have the shape (n_q,), q_b and v_b (n_q, n_b); without these n_b is zero. Entry [0]
    of the result holds q and below it the columns of q_b as rows, entry [1] holds v and the columns
    of v_b.
    """
    rows = 1 if q_b is None else 1 + q_b.shape[1]
    states = np.empty((2, rows, len(q)), dtype=np.result_type(q, v))
    states[:, 0] = q, v
    if q_b is not None and v_b is not None:
        states[:, 1:] = q_b.T, v_b.T
    return states


class Accelerations:
    """Solves the index-1 equations for (a, lam) in Python; see `accelerations` for which systems.

    With a constant mass matrix and constant Phi_q one factorisation serves the whole run.
    """

    def __init__(self, system: MechanicalSystem, matrices: SaddlePoint) -> None:
        self._system, self._matrices = system, matrices
        self._Phi_q: Array | None = None
        self._factors: Factorization | None = None
        self.factorisations = 0

    def factors(self, t: float, q: Array) -> Factorization:
        """Return the factors of the index-1 matrix at time t (s) and coordinates q, (n_q,)."""
        Phi_q = self._system.constraint_q(t, q)
        if self._factors is None or not self._unchanged(Phi_q):
            self._factors = self._matrices.factor(self._system.mass(q), Phi_q)
            self._Phi_q = Phi_q
            self.factorisations += 1
        return self._factors

    def _unchanged(self, Phi_q: Array) -> bool:
        if not self._system.traits.constant_mass or self._Phi_q is None:
            return False
        return Phi_q is self._Phi_q or np.array_equal(Phi_q, self._Phi_q)

    def _solver(self, t: float, q: Array) -> Solve:
        """Return a function that solves at q."""
        factors, size, n = self.factors(t, q), self._matrices.size, len(q)
        return lambda force, side: factors.solve(_joined(force, side, n, size).T).T

    def solve(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return accelerations a, (n_q,), and multipliers lam, (n_lam,), of a state."""
        x, n = self.rows(t, q[None], v[None])[0], self._system.n_q
        return x[:n], x[n:]

    def rows(self, t: float, q: Array, v: Array) -> Array:
        """Return a row (a, lam), (n_q + n_lam,), above one row of derivatives per design variable.

        q and v have the shape (rows, n_q), their design derivatives below them.
        """
        system, side = self._system, None
        if not system.traits.constant_constraints:
            side = acceleration_side(system, t, q[0], v[0])
        solve = self._solver(t, q[0])
        if len(q) == 1:
            return solve(system.force(t, q[0], v[0]), side)[None]
        Q = system.force_and_total(t, q, v)
        x = np.empty((len(q), self._matrices.size))
        first = x[0] = solve(Q[0], side)
        force, side_b = held_totals(system, t, q, v, first)
        x[1:] = solve(Q[1:] - force, None if side_b is None else -side_b)
        return x

    def projected(self, t: float, rows: Array) -> Array:
        """Return a state and its derivatives, (2, rows, n_q), moved onto the constraints."""
        system, n, dot = self._system, self._system.n_q, self._system.constraint_pattern.dot
        solve = self._solver(t, rows[0, 0])

        def nearest(defect: Array) -> Array:
            """Return the smallest changes x with Phi_q x = defect, a row per column of it."""
            return solve(None, defect.T)[..., :n]

        if system.traits.constant_constraints:
            all_rows = rows.reshape(-1, n)
            defect = dot(system.constraint_q(t, rows[0, 0]), all_rows.T)
            defect[:, 0] = system.constraint(t, rows[0, 0])
            return (all_rows - nearest(defect)).reshape(rows.shape)
        q, v = rows = rows.copy()
        q[0] -= nearest(system.constraint(t, q[0]))
        v[0] -= nearest(system.constraint(t, q[0], v[0]))
        if len(q) > 1:
            q_b, v_b = q[1:].T, v[1:].T
            q[1:] -= nearest(system.constraint_total(t, (q[0],), (q_b,)))
            v[1:] -= nearest(system.constraint_total(t, (q[0], v[0]), (q_b, v_b)))
        return rows

    def rows_of(self, t: Array, states: Array) -> Array:
        """Return `rows` of k states, (k, 2, rows, n_q), as (k, rows, n_q + n_lam)."""
        return np.array([self.rows(s, *state) for s, state in zip(t.tolist(), states, strict=True)])

    def projected_of(self, t: Array, states: Array) -> Array:
        """Return k states, (k, 2, rows, n_q), moved onto the constraints."""
        pairs = zip(t.tolist(), states, strict=True)
        return np.array([self.projected(s, state) for s, state in pairs])

    #: Steps that one call of the kernel takes: one, because every evaluation here calls Python.
    steps_at_once: int = 1

    def for_kernel(self, rows: int) -> Any:
        """Return the equations for states of `rows` rows, as an `ExplicitRun` takes them."""

        def told(
            function: Callable[[float, Array], Array],
        ) -> Callable[[float, Array], Array | int]:
            def call(t: float, state: Array) -> Array | int:
                try:
                    return function(t, state)
                except SingularMatrix:
                    return SINGULAR

            return call

        found = told(lambda t, state: self.rows(t, *state))
        return found, told(self.projected)

    def count(self) -> None:
        """Count the factorisations of a kernel; here nothing, as the functions it calls count."""

    @property
    def weights(self) -> Array:
        """Least masses of the coordinates, shape (n_q,)."""
        return self._system.weights

    def reaction_size(self, t: float, q: Array, lam: Array) -> float:
        """Return the norm of W^(-1/2) Phi_q^T lam, comparable to W^(1/2) a for accelerations."""
        force = reaction(self._system, t, q, lam) / np.sqrt(self._system.weights)
        return float(np.linalg.norm(force))


@final
class CompiledAccelerations(Accelerations):
    """Accelerations and multipliers of a scene, or of lists of operations, by a kernel.

    `make` returns the equations of the kernel, with design derivatives or without.
    """

    steps_at_once = 64

    def __init__(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        make: Callable[[bool], ListAccelerations | SceneAccelerations],
    ) -> None:
        super().__init__(system, matrices)
        self._make = make
        self._made: dict[bool, ListAccelerations | SceneAccelerations] = {}

    def rows(self, t: float, q: Array, v: Array) -> Array:
        """Return a row (a, lam), (n_q + n_lam,), above a row of derivatives per variable.

        Complex states, as of complex steps of an integrator, are solved in Python.
        """
        if np.iscomplexobj(q) or np.iscomplexobj(v):
            return super().rows(t, q, v)
        return only(self.rows_of(np.array([t]), np.array([[q, v]])))

    def rows_of(self, t: Array, states: Array) -> Array:
        """Return `rows` of k states, (k, 2, rows, n_q), as (k, rows, n_q + n_lam)."""
        found = self.for_kernel(states.shape[2]).at(False, t, states)
        return self._found(found, states, self._matrices.size)

    def projected(self, t: float, rows: Array) -> Array:
        """Return a state and its derivatives, (2, rows, n_q), moved onto the constraints."""
        return only(self.projected_of(np.array([t]), rows[None]))

    def projected_of(self, t: Array, states: Array) -> Array:
        """Return k states, (k, 2, rows, n_q), moved onto the constraints."""
        found = self.for_kernel(states.shape[2]).at(True, t, states)
        return self._found(found, states, states.shape[3])

    def _found(self, found: Array | int, states: Array, size: int) -> Array:
        """Return the kernel's result, or NaN if a value is not finite; raise SingularMatrix."""
        self.count()
        if not isinstance(found, int):
            return found
        if found == SINGULAR:
            raise SingularMatrix
        return np.full((*states.shape[:-1], size), np.nan)

    def for_kernel(self, rows: int) -> ListAccelerations | SceneAccelerations:
        """Return the equations for states of `rows` rows, as an `ExplicitRun` takes them."""
        if (rows > 1) not in self._made:
            self._made[rows > 1] = self._make(rows > 1)
        return self._made[rows > 1]

    def count(self) -> None:
        """Count the factorisations of the kernel since the last call."""
        self.factorisations += sum(x.factorisations() for x in self._made.values())


def accelerations(system: MechanicalSystem, matrices: SaddlePoint) -> Accelerations:
    """Return the solver for accelerations of a system, in a kernel where it can be.

    Python evaluates the equations of systems that are given by functions, of scenes in a rotating
    frame, of systems that start at an event, and at complex design values.
    """
    if np.iscomplexobj(system.b):
        return Accelerations(system, matrices)
    if isinstance(system, ListedSystem):
        listed, parts = system, (system.b, matrices.scale)
        return CompiledAccelerations(
            system, matrices, lambda b: ListAccelerations(listed.index_1(b), *parts)
        )
    plan = system.plan if isinstance(system, PlannedSystem) else None
    if not isinstance(system, PlannedSystem) or plan is None:
        return Accelerations(system, matrices)
    return CompiledAccelerations(system, matrices, partial(_of_scene, system, plan, matrices))


def _of_scene(
    system: PlannedSystem, plan: Plan, matrices: SaddlePoint, derivatives: bool
) -> SceneAccelerations:
    """Return the equations of a scene for a kernel, with design derivatives or without."""
    of_mass = matrices.of_mass()
    layout = of_mass.layout(band=True) or of_mass.layout_out_of_band()
    model = Model(plan, layout, np.zeros(RULES), of_mass.exchanging(layout))
    design = system.design_plan if derivatives else None
    if not system.timed:
        return SceneAccelerations(model, design, system.factor_table(np.zeros(1), derivatives))
    return SceneAccelerations(model, design, partial(system.factor_table, derivatives=derivatives))


def _joined(force: Array | None, side: Array | None, n: int, size: int) -> Array:
    """Return right sides (force, side) as rows, (..., size); zeros in place of None."""
    known = force if force is not None else side
    assert known is not None
    right = np.zeros((*known.shape[:-1], size), dtype=known.dtype)
    if force is not None:
        right[..., :n] = force
    if side is not None:
        right[..., n:] = side
    return right


# Forces at the start below _ROUND_OFF times their round-off count as zero in the scales.
_ROUND_OFF = 100.0
# Starts of one system, computed twice, differ by round-off of their projection.
_SAME = 1e-7


@final
@dataclass(frozen=True)
class Scales:
    """Positive scales of q, v, forces and design variables, one per unknown; `place` is p, (n_q,).

    `row`, (n_lam,), holds the lengths of the rows of Phi_q in the norm of the inverse weights;
    position, speed and load are the common scales of sqrt(w) q, sqrt(w) v and Q / sqrt(w).
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
        """Scale of the multipliers, `load` over `row`, one per constraint, shape (n_lam,)."""
        return self.load / self.row

    @property
    def eta(self) -> Array:
        """Scale of the multipliers that keep positions on the constraints (GGL), shape (n_lam,)."""
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
    """A system at its consistent start, with design derivatives if they are requested."""

    system: MechanicalSystem
    matrices: SaddlePoint
    initial: InitialState
    scales: Scales
    derivative: InitialSensitivity | None = None

    @classmethod
    def of(cls, system: MechanicalSystem, t_end: float, q: Array | None = None) -> Self:
        """Return the problem of a system up to `t_end`, with consistent start and scales.

        The system computes forces in the states q, (k, n_q), by default in its start.
        """
        require_positive("t_end", t_end)
        if system.traits.leaves_out:
            system = system.along(system.start()[0][None] if q is None else q)
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)[0]
        scales = Scales.of(system, initial, t_end)
        return cls(system, matrices, initial, scales)

    def size(self, q: Array) -> Array:
        """Return for every coordinate the size of its vector from the place p, shape (n_q,)."""
        return vector_sizes(q.real - self.scales.place, self.system.vector_size)

    @cached_property
    def accelerations(self) -> Accelerations:
        """Solver for accelerations and multipliers of the system."""
        return accelerations(self.system, self.matrices)

    def differentiated(self, for_accelerations: bool = False) -> Self:
        """Return the problem with the design derivatives of its start.

        With `for_accelerations` a and lam are differentiated by the kernel for accelerations, if
        there is one, which the run needs anyway.
        """
        solver = self.accelerations if for_accelerations else None
        rows = solver.rows if isinstance(solver, CompiledAccelerations) else None
        derivative = start_sensitivity(self.system, self.matrices, self.initial, rows)
        return replace(self, derivative=derivative)

    def require_finite(self) -> None:
        """Raise InvalidInputError if a, lam or design derivatives of the start are not finite."""
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
        """Raise InvalidInputError unless `run` starts like this problem and ends by `t_end`."""
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
    """Return for every coordinate the root mean square of its vector of d components, shaped as x.

    The last axis of x holds coordinates vector by vector.
    """
    squares = np.add.reduce(x.reshape(*x.shape[:-1], -1, d) ** 2, axis=-1)
    sizes = np.sqrt(squares / d)
    return sizes if d == 1 else np.repeat(sizes, d, axis=-1)
