"""Saddle-point matrices of a system, checked for independent constraints, and right-hand sides.

The matrix [[M, Phi_q^T], [Phi_q, 0]] gives (a, lam) and their derivatives. Functions named `held_`
differentiate M a + Phi_q^T lam at fixed a and lam. `Prepared` is a system with its matrices in the
form that kernels take.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, final

import numpy as np
import scipy

from ancfdae.equations.plans import CalledPlan, ListPlan, real_part
from ancfdae.equations.system import MechanicalSystem, planned
from ancfdae.errors.kinds import (
    InvalidInputError,
    RedundantConstraintsError,
    SingularMatrix,
)
from ancfdae.kernels import ComplexModel, March, Model
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization, MatrixLayout, SaddlePoint


def held_q(system: MechanicalSystem, t: float, q: Array, a: Array, lam: Array) -> Array:
    """Return the values of (M a + Phi_q^T lam)_q at fixed a, lam on the pattern, (nnz,)."""
    constant = system.traits.constant_mass and system.traits.linear_constraints
    if constant or not (a.any() or lam.any()):
        return np.zeros(system.pattern.size)
    return only(system.linearise(np.array([t]), q[None], None, a[None], lam[None]).f_q)


def held_total(
    system: MechanicalSystem, t: float, q: Array, a: Array, lam: Array, q_b: Array
) -> Array:
    """Return the total design derivative of M a + Phi_q^T lam at fixed a, lam, (n_q, n_b)."""
    if not (a.any() or lam.any()):
        return np.zeros((system.n_q, system.n_b))
    partials = system.design_partials(np.array([t]), q[None], None, a[None], lam[None])
    total = only(partials.f_b)
    if system.traits.constant_mass and system.traits.linear_constraints:
        return total
    return total + system.pattern.dot(held_q(system, t, q, a, lam), q_b)


def held_pull_back(
    system: MechanicalSystem, t: float, q: Array, a: Array, lam: Array, mu: Array
) -> Array:
    """Return mu^T (M a + Phi_q^T lam)_b at fixed q, a and lam, shape (n_b,)."""
    if not (a.any() or lam.any()):
        return np.zeros(system.n_b)
    none = np.zeros((1, len(lam)))
    return system.pull_back(np.array([t]), (q[None], None, a[None], lam[None]), (mu[None], none))


def held_totals(
    system: MechanicalSystem, t: float, q: Array, v: Array, x: Array
) -> tuple[Array, Array | None]:
    """Return total design derivatives of M a + Phi_q^T lam and d^2 Phi/dt^2 at fixed (a, lam).

    The rows of q and v are a state followed by its derivatives, x is (a, lam). The results are
    rows, (n_b, n_q) and (n_b, n_lam), the second None if zero. With Q_total they are in the
    right-hand sides of

    M a_b + Phi_q^T lam_b = Q_total - (M a + Phi_q^T lam)_total

    Phi_q a_b = -(d^2 Phi/dt^2)_total
    """
    n_q, q_b = system.n_q, q[1:].T
    force = held_total(system, t, q[0], x[:n_q], x[n_q:], q_b).T
    if system.traits.constant_constraints:
        return force, None
    motion = q[0], v[0], x[:n_q]
    return force, system.constraint_total(t, motion, (q_b, v[1:].T, np.zeros_like(q_b))).T


def force_total(
    system: MechanicalSystem, t: float, q: Array, v: Array, q_b: Array, v_b: Array
) -> Array:
    """Return the total design derivative of Q, shape (n_q, n_b)."""
    rows = (np.concatenate([x[None], x_b.T]) for x, x_b in ((q, q_b), (v, v_b)))
    return system.force_and_total(t, *rows)[1:].T


# What to do where joints open of which equations are left out.
OPENED: Final = (
    "At this design the other equations do not imply those that are left out. Change together all "
    "lengths that must fit, or leave nothing out."
)


def refuse_opened(system: MechanicalSystem, t: float, q: Array) -> None:
    """Raise InvalidInputError if q opens joints of a system with `rows_left_out`."""
    opened = system.opened(np.array([t]), q[None])
    if opened is not None:
        rule = "joints whose equations are left out must close by the others"
        raise InvalidInputError("Scene.left_out", rule, opened[1], OPENED)


def velocity_side(system: MechanicalSystem, t: float, q: Array) -> Array:
    """Return nu in Phi_q v = nu, which is -Phi_t, shape (n_lam,)."""
    return -system.constraint(t, q, np.zeros_like(q))


def acceleration_side(system: MechanicalSystem, t: float, q: Array, v: Array) -> Array:
    """Return gamma in Phi_q a = gamma, (n_lam,): -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt."""
    return -system.constraint(t, q, v, np.zeros_like(q))


def jerk_side(system: MechanicalSystem, t: float, q: Array, v: Array, a: Array) -> Array:
    """Return S in Phi_q q''' = S, the third time derivative of Phi at q''' = 0, (n_lam,)."""
    return -system.constraint(t, q, v, a, np.zeros_like(q))


@final
class Prepared:
    """A system with its matrices as kernels take it, for real or complex states.

    `rules` are `MarchRules`. `real` is the model of the real parts, which has the matrices; for
    real states it is `model`.
    """

    real: Model
    model: Model | ComplexModel

    def __init__(
        self, system: MechanicalSystem, matrices: SaddlePoint, rules: Array, dtype: np.dtype[Any]
    ) -> None:
        self.plan, self._matrices, self._rules = planned(system), matrices, rules
        self.dtype = dtype
        # Whether steps are taken one by one, because a Python function may raise in any of them.
        self.alone = isinstance(self.plan, CalledPlan)
        # A user's own system gets times instead of factors of laws.
        own = isinstance(self.plan, CalledPlan | ListPlan)
        turns = type(system).turn_rate is not MechanicalSystem.turn_rate
        driven = self.plan.joint_factors is not None or self.plan.load_factors(np.zeros(1)).size > 0
        # Whether joints or loads depend on time, or a user's system prescribes a rotation.
        self.timed = turns if own else driven
        # Time that a kernel adds to the times that it passes to a user's lists, s.
        self.start = self.plan.start if isinstance(self.plan, ListPlan) else 0.0
        self._prepare(matrices.layout(band=False) or matrices.layout_out_of_band())

    def add_band(self) -> None:
        """Add a banded factorisation to the layout, for matrices not positive definite."""
        layout = self._matrices.layout(band=True)
        assert layout is not None
        self._prepare(layout)

    def go(self, passed: Callable[[Model, int], tuple[int, int]], done: int) -> int:
        """Run a kernel from step `done` on; return the number of steps that are done afterwards.

        `passed` takes the model of the real parts and a step, and returns the step before which it
        stopped and the reason, a `March`. If a matrix is not positive definite it is run again with
        a banded factorisation.
        """
        done, end = passed(self.real, done)
        if end == March.INDEFINITE:
            self.add_band()
            done, _ = passed(self.real, done)
        return done

    def _prepare(self, layout: MatrixLayout) -> None:
        is_complex = self.dtype.kind == "c"
        plan = real_part(self.plan) if is_complex else self.plan
        self.real = Model(plan, layout, self._rules, self._matrices.exchanging(layout))
        self.model = self.real
        if is_complex:
            self.model = ComplexModel(self.plan, self.real, self._rules)


# Ratio of singular values below which scaled constraint rows count as dependent; for dependent rows
# round-off leaves 1e-16 times their number.
_DEPENDENT = 1e-11
# Smallest eigenvalue of B B^T, rows of unit length, that its factors distinguish from zero: above
# it the rows are clearly independent.
_CLEAR = 1e-12
_SWEEPS = 3
# Factor of the weights within which rows that are independent are not checked again.
_AS_NEAR = 4.0


def saddle_point(system: MechanicalSystem, t: float, q: Array | None = None) -> SaddlePoint:
    """Return the saddle-point matrices of a system after checking its constraints.

    They are checked and scaled at q, by default the start; RedundantConstraintsError if dependent.
    A design with the same weights and Phi_q as the design before reuses its matrices. Rows are not
    checked again if Phi_q is the same and the last check had nearly the same weights.
    """
    values = system.constraint_q(t, system.start()[0] if q is None else q)
    patterns, weights = (system.pattern, system.constraint_pattern), system.weights
    symmetric, known, near = system.traits.symmetric, system.pattern.checked, False
    if known is not None:
        last, (pattern, was_symmetric, its_weights, its_values, at) = known
        if pattern is patterns[1] and np.array_equal(its_values, values):
            if symmetric == was_symmetric and np.array_equal(its_weights, weights):
                return last
            near = bool(np.all((weights <= _AS_NEAR * at) & (at <= _AS_NEAR * weights)))
    matrices = SaddlePoint(*patterns, weights, values, symmetric)
    if not near:
        refuse_redundant(system, matrices, values)
        at = weights.copy()
    # Copies, because a user-defined system may write to its arrays.
    system.pattern.checked = matrices, (patterns[1], symmetric, weights.copy(), values.copy(), at)
    return matrices


def solve(factors: Factorization, force: Array, side: Array) -> tuple[Array, Array]:
    """Return the solution (a, lam) of a saddle-point system with the right sides force and side."""
    x = factors.solve(np.concatenate([force, side]))
    return x[: len(force)], x[len(force) :]


def solve_transposed(factors: Factorization, force: Array, side: Array) -> tuple[Array, Array]:
    """Return the two parts of the solution with the transposed saddle-point matrix."""
    x = factors.solve_transposed(np.concatenate([force, side]))
    return x[: len(force)], x[len(force) :]


def refuse_redundant(system: MechanicalSystem, matrices: SaddlePoint, values: Array) -> None:
    """Raise RedundantConstraintsError if rows of the scaled Phi_q are dependent.

    The rows are examined component by component of their graph.
    """
    if system.n_lam == 0 or _independent(system, matrices, values.real):
        return
    pattern = system.constraint_pattern
    scaled = values.real / np.sqrt(system.weights[pattern.columns])
    matrix = pattern.csr(scaled).tocsr()
    length = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel())
    empty = np.flatnonzero(length == 0)
    if len(empty):
        raise RedundantConstraintsError(
            f"joint {system.constraint_names[int(empty[0])]!r}",
            "every constraint must depend on a coordinate",
            "a row of zeros in Phi_q",
            "Remove the joint.",
        )
    connected = abs(matrix) @ abs(matrix).T
    count, labels = scipy.sparse.csgraph.connected_components(connected, directed=False)
    dependent: list[str] = []
    redundant = 0
    for component in range(count):
        rows = np.flatnonzero(labels == component)
        if len(rows) == 1:
            continue
        part = matrix[rows]
        part = part[:, np.unique(part.indices)].toarray() / length[rows, None]
        U, s, _ = np.linalg.svd(part, full_matrices=True)
        rank = int(np.sum(s > _DEPENDENT * s[0]))
        if rank == len(rows):
            continue
        involved = np.any(np.abs(U[:, rank:]) > 1e-6, axis=1)
        dependent += [system.constraint_names[int(row)] for row in rows[involved]]
        redundant += len(rows) - rank
    if redundant:
        raise RedundantConstraintsError(
            "joints " + ", ".join(repr(name) for name in sorted(set(dependent))),
            "constraints must be independent",
            f"{redundant} redundant of {system.n_lam}",
            "Remove a joint, or replace it by one that holds fewer directions; "
            "drop_redundant(scene) leaves out what other joints imply. If this is a dead point, "
            "where the mechanism could branch, start beside it.",
        )


def _independent(system: MechanicalSystem, matrices: SaddlePoint, B: Array) -> bool:
    """Whether rows are clearly independent, by inverse iteration with B W^-1 B^T.

    This matrix is the Schur complement of the saddle-point matrix with the weights W.
    """
    pattern, W = system.constraint_pattern, np.zeros(system.pattern.size)
    W[system.pattern.diagonal] = system.weights
    length = np.sqrt(np.bincount(pattern.rows, B * B / system.weights[pattern.columns]))
    none, x = np.zeros(system.n_q), np.cos(1.0 + np.arange(system.n_lam) ** 2)
    try:
        factors = matrices.factor(W, B)
    except SingularMatrix:
        return False
    for _ in range(_SWEEPS):
        x /= np.linalg.norm(x)
        x = length * solve(factors, none, -length * x)[1]
    return bool(np.linalg.norm(x) < 1 / _CLEAR)
