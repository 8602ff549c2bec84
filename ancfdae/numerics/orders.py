"""Orders of the unknowns of a saddle-point matrix in which its factors stay small.

The graph of the coordinates is that of K + B^T B, as if multipliers were eliminated. Each
multiplier follows its last coordinate: these are then eliminated first, by pivots of K, and
a constraint is satisfied to the round-off of its own row, not to that of a stiff body's. (Those
of a clamp at the end of the band would widen it less behind all coordinates; frequencies of stiff
linkages then lose three digits.)
"""

from __future__ import annotations

import numpy as np
import scipy

from ancfdae.kernels import narrow_order
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern


def narrow_band(pattern: Pattern, constraint_pattern: Pattern) -> Array:
    """Return the order of reverse Cuthill and McKee, or the scene's own where that is better."""
    return narrow_order(*pattern.places, *constraint_pattern.places)


def little_fill(pattern: Pattern, constraint_pattern: Pattern) -> Array:
    """Return the order of minimum degree: SuperLU's, found where it factorises a made-up matrix."""
    graph = _graph(pattern, constraint_pattern).astype(float)
    # Diagonal pivots need no exchange.
    diagonal = scipy.sparse.diags_array(1.0 + graph.sum(axis=1))
    made_up = (diagonal - 0.5 * graph).tocsc()
    symmetric = {"SymmetricMode": True}
    lu = scipy.sparse.linalg.splu(
        made_up, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric
    )
    return _with_multipliers(np.argsort(lu.perm_c), constraint_pattern)


def _graph(pattern: Pattern, constraint_pattern: Pattern) -> scipy.sparse.csr_array:
    """Return K + B^T B with logical values."""
    K, B = (each.csr(np.ones(each.size, dtype=bool)) for each in (pattern, constraint_pattern))
    return (K + B.T @ B).tocsr() if B.nnz else K


def _with_multipliers(order: Array, constraint_pattern: Pattern) -> Array:
    """Insert each multiplier behind its last coordinate."""
    n = len(order)
    place = np.zeros(n + constraint_pattern.shape[0], dtype=np.int32)
    place[order] = np.arange(n)
    rows, columns = constraint_pattern.rows, constraint_pattern.columns
    np.maximum.at(place, n + rows, place[columns])
    # Coordinates come before multipliers of the same place.
    return np.argsort(place, kind="stable")
