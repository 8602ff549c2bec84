"""Saddle-point matrices of a system, solved in their two parts; constraints must be independent."""

import numpy as np
import scipy

from ancfdae.equations.system import MechanicalSystem
from ancfdae.errors.kinds import RedundantConstraintsError, SingularMatrix
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint

# Singular-value ratio under which scaled constraint rows count as dependent; round-off leaves
# dependent rows at 1e-16 times their number.
_DEPENDENT = 1e-11
# Smallest eigenvalue of B B^T, rows of unit length, that its factors still tell from zero: above it
# the singular values are far from dependent.
_CLEAR = 1e-12
_SWEEPS = 3
# Rows that are independent with weights stay so with others within this factor of each.
_AS_NEAR = 4.0


def saddle_point(system: MechanicalSystem, t: float, q: Array | None = None) -> SaddlePoint:
    """Check the constraints and return the system's saddle-point matrices.

    They are checked and scaled at q, by default the start; RedundantConstraintsError if dependent.
    A design with the same weights and Phi_q as the design before takes over its matrices. Rows are
    not checked again where Phi_q is the same and the last check had nearly the same weights.
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
    # Copies: a system of a user's own may write to its arrays.
    system.pattern.checked = matrices, (patterns[1], symmetric, weights.copy(), values.copy(), at)
    return matrices


def solve(factors: Factorization, force: Array, side: Array) -> tuple[Array, Array]:
    """Solve a saddle-point system; returns the two parts of the solution."""
    x = factors.solve(np.concatenate([force, side]))
    return x[: len(force)], x[len(force) :]


def solve_transposed(factors: Factorization, force: Array, side: Array) -> tuple[Array, Array]:
    """Solve with the transposed saddle-point matrix; returns the two parts of the solution."""
    x = factors.solve_transposed(np.concatenate([force, side]))
    return x[: len(force)], x[len(force) :]


def refuse_redundant(system: MechanicalSystem, matrices: SaddlePoint, values: Array) -> None:
    """Find dependent rows of the scaled Phi_q, component by component of its graph."""
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
            "Remove a joint, or replace it by one that holds fewer directions; if this is a dead "
            "point, where the mechanism could branch, start beside it.",
        )


def _independent(system: MechanicalSystem, matrices: SaddlePoint, B: Array) -> bool:
    """Whether rows are clearly independent, by inverse iteration with B W^-1 B^T.

    This is the Schur complement of the saddle-point matrix of the weights W.
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
