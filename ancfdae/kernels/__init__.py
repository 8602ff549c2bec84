"""Compiled inner loops: element forces and tangents, sparse products, banded solutions.

Real and complex numbers go through the same formulas, each of which stands once, in C++: those of
elements in `elements.h`, their sums over a scene in `blocks.h`. `_kernels.pyi` says what each
function computes, of what fits together; all else is a ValueError or a TypeError. Why this is
compiled, and by what: docs/measurements.md, "What is compiled".
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
import numpy.typing as npt

# isort: off
try:
    from ancfdae.kernels._kernels import (
        ComplexModel as ComplexModel,
        ConstraintPlan as ConstraintPlan,
        LoadPlan as LoadPlan,
        Model as Model,
        OperationList as OperationList,
        OperationTrace as OperationTrace,
        band_factor as band_factor,
        band_solve as band_solve,
        constraint_curvature as constraint_curvature,
        constraint_gradient as constraint_gradient,
        constraint_totals as constraint_totals,
        constraints as constraints,
        csr_rows as csr_rows,
        eliminate as eliminate,
        explicit_march as explicit_march,
        explicit_terms as explicit_terms,
        finite as finite,
        force_partials as force_partials,
        force_totals as force_totals,
        forces as forces,
        forces_along as forces_along,
        fronts_factor as fronts_factor,
        fronts_signs as fronts_signs,
        fronts_solve as fronts_solve,
        index_1 as index_1,
        judge_step as judge_step,
        keeps_sides as keeps_sides,
        ldl_factor as ldl_factor,
        ldl_solve as ldl_solve,
        lifted as lifted,
        list_values as list_values,
        load_forces as load_forces,
        load_forces_along as load_forces_along,
        load_tangents as load_tangents,
        narrow_order as narrow_order,
        norm as norm,
        plan_step as plan_step,
        relative as relative,
        strain as strain,
        stressed as stressed,
        tangents as tangents,
    )
except ImportError as error:  # a checkout that was updated since it was installed
    raise ImportError(
        "the kernels of ancfdae are not compiled; run `python -m pip install -e .` in the checkout"
    ) from error
# isort: on

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


class Plan(NamedTuple):
    """A system of elements, joints and loads, for `Model` and `ComplexModel`.

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
    """A system of lists of operations, for `Model` and `ComplexModel`.

    Lists take t, q, v, A, lam and b, and return Phi_q, Phi, dPhi/dt, Q, M, and f_q with f_v behind
    it if forces use velocities. Values of matrices stand on the patterns B of Phi_q and K of all
    others. t is the time of a run plus `start`.
    """

    lists: tuple[OperationList, ...]
    b: Array
    weights: Array
    inverse_weights: Array
    B: Csr
    K: Csr
    velocity: bool
    start: float = 0.0

    def joint_factors(self, t: Array, orders: int) -> Array:
        """Return times, which the functions take where scenes have factors; (orders, k, 1)."""
        return np.stack([self.start + t[:, None]] * orders)

    def load_factors(self, t: Array) -> Array:
        """Return times, which the functions take where scenes have factors; (k, 1)."""
        return self.start + t[:, None]


@final
class CalledPlan(NamedTuple):
    """A system whose equations Python evaluates, for `Model` and `ComplexModel`.

    The functions return M(q), Phi_q(t, q), Phi(t, q) or its rate Phi(t, q, v), and Q(t, q, v). Two
    more return (f_q, f_v or None) of (t, q, v, a, lam), and (P, P_q) of (t, q), the loads that turn
    with the motion. Values of matrices have the patterns B of Phi_q and K of all others.
    """

    functions: tuple[Callable[..., Any], ...]
    weights: Array
    inverse_weights: Array
    B: Csr
    K: Csr
    velocity: bool

    def joint_factors(self, t: Array, orders: int) -> Array:
        """Return times, which the functions take where scenes have factors; (orders, k, 1)."""
        return np.stack([t[:, None]] * orders)

    def load_factors(self, t: Array) -> Array:
        """Return times, which the functions take where scenes have factors; (k, 1)."""
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


@final
class March(IntEnum):
    """Why `march` ends: all steps are taken, or what the next one needs, or why it is not solved.

    It may need factors at Gauss points or a band for its matrix, and the time may be used up. Under
    error control no step may be accurate, the step before the first one may have to be repeated,
    or the run must begin anew.
    """

    ALL_TAKEN = 0
    NEEDS_GAUSS = 1
    INDEFINITE = 2
    OUT_OF_TIME = 3
    NO_CONVERGENCE = 4
    NOT_FINITE = 5
    SINGULAR = 6
    INACCURATE = 7
    STEP_BEFORE = 8
    BEGIN_ANEW = 9


#: Whether `plan_step` plans a step: else the run is finished, or has taken too many steps.
PLANNED, FINISHED, USED_UP = range(3)
#: Why no step helps, as a result of `judge_step`.
NEVER_SOLVED, NEVER_ACCURATE = -1, -2
#: Numbers of a filter, of which those in this range change in a run and continue it.
FILTER, CHANGING = 24, slice(4, 12)

#: Factorises a matrix for `Model`: of terms, each a number and values of K, whose sum counts, and
#: of B it makes a function of a right side and whether the matrix is transposed; None if the matrix
#: is singular.
Factorise: TypeAlias = Callable[
    [tuple[tuple[float, Array], ...], Array], Callable[[Array, bool], Array] | None
]

#: The coupled matrix of stages: order and scale of the unknowns, places of blocks (i, j) in its K,
#: and a band (half, flat, factors) as for `band_factor`, or what factorises.
CoupledArrays: TypeAlias = tuple[
    Array, Array, Array, tuple[int, Array, Array] | None, Factorise | None
]

#: How an evaluation or a step of DOP853 ends.
EVALUATED, NOT_FINITE, SINGULAR, ERROR_TEST = range(4)

#: How Newton's method for the stages of a step ends.
STAGES_SOLVED, STAGES_DIVERGED, STAGES_NOT_FINITE, STAGES_SINGULAR = range(4)

#: Numbers among the rules of a `Model`.
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


def real_part(plan: Any) -> Any:
    """Return a plan, or a part of one, with the real parts of its numbers, for `Model`."""
    if isinstance(plan, np.ndarray):
        return plan.real
    if isinstance(plan, tuple):
        return tuple(map(real_part, plan))
    if isinstance(plan, ConstraintPlan | LoadPlan):
        kind, arguments = plan.__reduce__()
        return kind(*real_part(arguments))
    return plan
