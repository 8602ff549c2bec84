"""Compiled inner loops: element forces and tangents, sparse products, banded solutions.

Real and complex numbers go through the same formulas, each of which stands once, in C: those of
elements in `elements.h`, their sums over a scene in `blocks.h`. `_kernels.pyi` says what each
function computes, of what fits together; all else is a ValueError or a TypeError. Why this is
compiled, and by what: docs/measurements.md, section 11.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
import numpy.typing as npt

try:
    from ancfdae.kernels import _kernels
except ImportError as error:  # a checkout that was updated since it was installed
    raise ImportError(
        "the kernels of ancfdae are not compiled; run `python -m pip install -e .` in the checkout"
    ) from error

Array = np.ndarray[tuple[Any, ...], np.dtype[Any]]


class Block(NamedTuple):
    """Elements of one kind: their law, (n or 1, ...), and their node vectors, (n, n_a).

    `bending`, (n or 1, 2), holds E I and the length of cables, zeros of beams; None without cables.

    Vector k has the coordinates d k to d k + d - 1 of n_q; tau, (n,), is None without damping.
    """

    A: Array
    g_o: Array
    bending: Array | None
    tau: Array | None
    vectors: Array
    d: int
    n_q: int


@final
class Constraints(IntEnum):
    """Quantities that the kernel computes of constraints: Phi, values of Phi_q, or Phi_q^T lam."""

    RATE = 0
    VALUES = 1
    FORCE = 2


#: A matrix in compressed sparse rows: where rows begin, columns, values.
Csr: TypeAlias = tuple[Array, Array, Array]


ConstraintPlan = _kernels.ConstraintPlan
LoadPlan = _kernels.LoadPlan
OperationList = _kernels.OperationList


class Plan(NamedTuple):
    """A system of elements, joints and loads, for `march`.

    `mass` is M on the system's pattern, `places` those of the elements' tangents on it, and M the
    same without zeros. `loads` are rows of forces, and `B` is Phi_q with any values. Factors of
    time are functions of instants, (k,): those of constraints with derivatives, (orders, k,
    n_parts), None where nothing is driven, and those of loads, (k, n_loads), of `moving` ones
    last. Of these it says whether they use velocities, and whether they turn with the motion
    without being elastic, as numbers.
    """

    block: Block
    places: Array
    M: Csr
    mass: Csr
    gravity: Array
    loads: Array
    weights: Array
    inverse_weights: Array
    constraints: ConstraintPlan
    B: Csr
    joint_factors: Callable[[Array, int], Array] | None
    load_factors: Callable[[Array], Array]
    moving: tuple[tuple[LoadPlan, bool], ...]
    turning: Array


@final
class ListPlan(NamedTuple):
    """A system of lists of operations, for `march` and `solve_stages`.

    Lists take t, q, v, A, lam and b, and return Phi_q, Phi, dPhi/dt, Q, M, and f_q with f_v behind
    it if forces use velocities. Values of matrices stand on the patterns B of Phi_q and K of all
    others.
    """

    lists: tuple[OperationList, ...]
    b: Array
    weights: Array
    inverse_weights: Array
    B: Csr
    K: Csr
    velocity: bool

    def joint_factors(self, t: Array, orders: int) -> Array:
        """Return the instants in place of factors, (orders, k, 1)."""
        return np.stack([t[:, None]] * orders)

    def load_factors(self, t: Array) -> Array:
        """Return the instants, (k, 1)."""
        return t[:, None]


#: Fronts of a sparse elimination, whose indices are numbers in the order of elimination: the first
#: pivot of each front, and n; where its row numbers begin; row numbers; where its factors begin;
#: how many waiting updates it takes; room of all updates; rows of the largest front; where columns
#: of the lower triangle begin; their rows, the diagonal first; signs of pivots.
FrontArrays: TypeAlias = tuple[Array, Array, Array, Array, Array, int, int, Array, Array, Array]


class MatrixLayout(NamedTuple):
    """Order and scale of the unknowns, and where values stand in an envelope, a band or fronts.

    The envelope is (first, chosen, places, signs) as for `ldl_factor`, the band (half, flat,
    factors) as for `band_factor`, and fronts are (chosen, places, arrays) as for `fronts_factor`.
    """

    order: Array
    scale: Array
    envelope: tuple[Array, Array, Array, Array] | None
    band: tuple[int, Array, Array] | None
    fronts: tuple[Array, Array, FrontArrays] | None = None


#: Why a march ends: with all steps, or before one that it does not solve, that needs factors at
#: Gauss points, whose matrix needs a band, or that no time is left for.
ALL_TAKEN, NOT_SOLVED, NEEDS_GAUSS, INDEFINITE, OUT_OF_TIME = range(5)

#: How Newton's method for the stages of a step ends.
STAGES_SOLVED, STAGES_DIVERGED, STAGES_NOT_FINITE, STAGES_SINGULAR = range(4)

#: Numbers among the rules of `prepare`.
RULES = 17


@final
class Rest(IntEnum):
    """Why `rest` ends: solved or not, or where it needs a band, or is stuck at its round-off."""

    SOLVED = 0
    NO_CONVERGENCE = 1
    NOT_FINITE = 2
    SINGULAR = 3
    INDEFINITE = 4
    STUCK = 5


add_scaled = _kernels.add_scaled
balance = _kernels.balance
band_factor = _kernels.band_factor
band_solve = _kernels.band_solve
constraint_curvature = _kernels.constraint_curvature
constraint_gradient = _kernels.constraint_gradient
constraint_totals = _kernels.constraint_totals
constraints = _kernels.constraints
csr_rows = _kernels.csr_rows
csr_rows_transposed = _kernels.csr_rows_transposed
csr_subtract = _kernels.csr_subtract
differentiate_steps = _kernels.differentiate_steps
eliminate = _kernels.eliminate
finite = _kernels.finite
force_partials = _kernels.force_partials
force_totals = _kernels.force_totals
forces = _kernels.forces
forces_along = _kernels.forces_along
fronts_factor = _kernels.fronts_factor
fronts_solve = _kernels.fronts_solve
gram = _kernels.gram
ldl_factor = _kernels.ldl_factor
list_values = _kernels.list_values
index_1_rows = _kernels.index_1_rows
index_1_projected = _kernels.index_1_projected
index_1_stages = _kernels.index_1_stages
load_forces = _kernels.load_forces
load_forces_along = _kernels.load_forces_along
load_tangents = _kernels.load_tangents
ldl_solve = _kernels.ldl_solve
lifted = _kernels.lifted
prepare = _kernels.prepare
march = _kernels.march
narrow_order = _kernels.narrow_order
norm = _kernels.norm
pull_back_steps = _kernels.pull_back_steps
recombine = _kernels.recombine
relative = _kernels.relative
rest = _kernels.rest
solve_stages = _kernels.solve_stages
strain = _kernels.strain
stressed = _kernels.stressed
tangents = _kernels.tangents
