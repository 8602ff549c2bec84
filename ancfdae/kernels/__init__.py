"""Compiled inner loops: element forces and tangents, sparse products, banded solutions.

Real and complex numbers go through the same formulas, each of which stands once, in C: those of
elements in `elements.h`, their sums over a scene in `blocks.h`. `_kernels.pyi` says what each
function computes. Why this is compiled, and by what: docs/measurements.md, section 10.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy.typing as npt

from ancfdae.kernels._kernels import (
    band_factor,
    band_solve,
    csr_rows,
    csr_rows_transposed,
    forces,
    forces_along,
    gram,
    lifted,
    norm,
    relative,
    strain,
    stressed,
    tangents,
)

__all__ = [
    "Block",
    "band_factor",
    "band_solve",
    "csr_rows",
    "csr_rows_transposed",
    "forces",
    "forces_along",
    "gram",
    "lifted",
    "norm",
    "relative",
    "strain",
    "stressed",
    "tangents",
]

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
