"""Compiled inner loops: element forces and tangents, sparse products, banded solutions.

Real and complex numbers go through the same formulas, each of which stands once, in C: those of
elements in `elements.h`, their sums over a scene in `blocks.h`. `_kernels.pyi` says what each
function computes, of what fits together; all else is a ValueError or a TypeError. Why this is
compiled, and by what: docs/measurements.md, section 11.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy.typing as npt

try:
    from ancfdae.kernels import _kernels
except ImportError as error:  # a checkout that was updated since it was installed
    raise ImportError(
        "the kernels of ancfdae are not compiled; run `python -m pip install -e .` in the checkout"
    ) from error

Array = npt.NDArray[Any]


class Block(NamedTuple):
    """Elements of one kind: their law, (n or 1, ...), and their node vectors, (n, n_a).

    Vector k has the coordinates d k to d k + d - 1 of n_q; tau, (n,), is None without damping.
    """

    A: Array
    g_o: Array
    p_o: Array | None
    tau: Array | None
    vectors: Array
    d: int
    n_q: int


#: A matrix in compressed sparse rows: where rows begin, columns, values.
Csr: TypeAlias = tuple[Array, Array, Array]


class Joints(NamedTuple):
    """Constraints as polynomials of vectors L q (`constraints.h`), and what to make of them.

    The raw Jacobian is mapped to values of Phi_q on its pattern, that of `B`; multipliers times
    bilinear coefficients are mapped to values of (Phi_q^T lam)_q. Coefficients have one row for
    each factor of time, the first of which is one.
    """

    L: Csr
    a_row: Array
    a_at: Array
    s_row: Array
    s_i: Array
    s_j: Array
    a: Array
    s: Array
    offset: Array
    to_values: Csr
    B: Csr
    curvature: Csr


class Plan(NamedTuple):
    """A system of elements, joints and loads that the state does not change, for `march`.

    `places` are those of the elements' tangents on the system's pattern, `mass` the values of M
    there. `loads` are rows of forces. Factors of time are functions of instants, (k,): those of
    joints, and their derivative of an order, (k, n_parts), and those of loads, (k, n_loads).
    """

    block: Block
    places: Array
    M: Csr
    mass: Array
    gravity: Array
    loads: Array
    weights: Array
    inverse_weights: Array
    joints: Joints
    joint_factors: Callable[[Array, int], Array]
    load_factors: Callable[[Array], Array]


class Layout(NamedTuple):
    """Order and scale of the unknowns, and where values stand in an envelope or in a band.

    The envelope is (first, chosen, places, signs) as for `ldl_factor`, and the band (half, flat,
    factors) as for `band_factor`.
    """

    order: Array
    scale: Array
    envelope: tuple[Array, Array, Array, Array] | None
    band: tuple[int, Array, Array] | None


#: Why a march ends: with all steps, or before one that it does not solve, that needs factors at
#: Gauss points, whose matrix needs a band, or that no time is left for.
ALL_TAKEN, NOT_SOLVED, NEEDS_GAUSS, INDEFINITE, OUT_OF_TIME = range(5)

add_scaled = _kernels.add_scaled
balance = _kernels.balance
band_factor = _kernels.band_factor
band_solve = _kernels.band_solve
csr_rows = _kernels.csr_rows
csr_rows_transposed = _kernels.csr_rows_transposed
csr_subtract = _kernels.csr_subtract
finite = _kernels.finite
force_totals = _kernels.force_totals
forces = _kernels.forces
forces_along = _kernels.forces_along
gram = _kernels.gram
ldl_factor = _kernels.ldl_factor
ldl_solve = _kernels.ldl_solve
lifted = _kernels.lifted
march = _kernels.march
norm = _kernels.norm
prepare = _kernels.prepare
recombine = _kernels.recombine
relative = _kernels.relative
strain = _kernels.strain
stressed = _kernels.stressed
tangents = _kernels.tangents
