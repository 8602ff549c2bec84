"""Invariant matrices of a block of elements and their exact design derivatives.

With Y the relative node vectors, g the packed Y Y^T and g_o its value in the
reference configuration, every element states

    U = 1/2 (g - g_o)^T A (g - g_o) + p_o^T (g - g_o),
    m_ab = int rho s_a s_b dV_o            (eq. 10; M_e = m (x) I_d).

A (15 x 15 planar, 28 x 28 spatial) and m carry everything that eqs. (15), (18)
and (10) carry. The linear term p_o exists only for elements with a strain
measure that is no difference to the reference; the reference must be in
balance under it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ancfdae.elements.element import (
    BeamElement,
    ElementParameter,
    ElementType,
    InvariantPartial,
    Invariants,
)
from ancfdae.numerics.arrays import Array

# Elements handled at once, so that the preparation of 10,000 of them stays within memory; curved
# ones have more points.
_STRAIGHT_CHUNK, _CURVED_CHUNK = 256, 32


def prepare(
    element: BeamElement,
    kind: ElementType,
    parameters: Array,
    Y_unit: Array,
    wanted: Iterable[ElementParameter] = (),
    owners: Array | None = None,
) -> Invariants:
    """Integrate the invariants and the derivatives asked for.

    Parameters
    ----------
    element : BeamElement
    kind : ElementType
        What all these elements share.
    parameters : array, shape (n, 9)
        Columns as in `ElementParameter`; real or complex.
    Y_unit : array, shape (n, n_y, d)
        Relative node vectors of the reference configuration, the first one, r_2 - r_1,
        divided by the element length.
    wanted : iterable of ElementParameter
        Parameters whose derivatives are prepared.
    owners : array of str, shape (n,), optional
        What each element belongs to, for the error.

    Raises
    ------
    InvalidInput
        If the reference configuration folds (det dr_o/dx <= 0 somewhere).
    """
    wanted = tuple(wanted)
    if owners is None:
        owners = np.full(len(parameters), "reference configuration")
    count = _STRAIGHT_CHUNK if kind.straight else _CURVED_CHUNK
    chunks = [slice(k, k + count) for k in range(0, len(parameters), count)]
    pieces = [element.invariants(kind, parameters[k], Y_unit[k], wanted, owners[k]) for k in chunks]
    return joined(pieces)


def joined(pieces: Sequence[Invariants], order: Array | None = None) -> Invariants:
    """Put the invariants of several blocks of one element into one, optionally reordered."""

    def together(arrays: list[Array]) -> Array:
        whole = np.concatenate(arrays)
        return whole if order is None else whole[order]

    def fields(parts: Sequence[Invariants | InvariantPartial], *names: str) -> dict[str, Array]:
        return {name: together([getattr(part, name) for part in parts]) for name in names}

    partials = {
        which: InvariantPartial(
            **fields([piece.partials[which] for piece in pieces], "A", "g_o", "c", "m")
        )
        for which in pieces[0].partials
    }
    linear = [piece.p_o for piece in pieces if piece.p_o is not None]
    return Invariants(
        **fields(pieces, "A", "g_o", "m"),
        p_o=together(linear) if linear else None,
        partials=partials,
    )
