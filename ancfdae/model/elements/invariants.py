"""Invariant matrices of a block of elements and their exact design derivatives.

With Y the relative node vectors, g the packed Y Y^T and g_o its value where the element is free of
stress, which is the reference configuration less the initial strain, every element states

    U = 1/2 (g - g_o)^T A (g - g_o),
    m_ab = int rho s_a s_b dV_o            (eq. 10; M_e = m (x) I_d).

A (15 x 15 planar, 28 x 28 spatial) and m carry everything that eqs. (15), (18)
and (10) carry. Cables have the energy of bending in addition (`curvature`): a flexural stiffness,
and the length of the element.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from ancfdae.errors.checks import require_kind
from ancfdae.kernels import strain
from ancfdae.model.elements.element import (
    Batch,
    BeamElement,
    ElementIntegrals,
    ElementParameter,
    InvariantPartial,
    Invariants,
    Partials,
)
from ancfdae.model.elements.strain_fields import packed_gram, upper_triangle
from ancfdae.model.elements.volume import change
from ancfdae.numerics.arrays import Array

# Elements handled at once, so that the preparation of 10,000 of them stays within memory; curved
# ones have more points.
_STRAIGHT_CHUNK, _CURVED_CHUNK = 256, 32


def prepare(
    element: BeamElement,
    batch: Batch,
    owners: Array | None = None,
) -> Invariants:
    """Integrate the invariants of a batch of elements; their derivatives follow when asked for.

    InvalidInputError, with what each element belongs to, if the reference configuration folds (det
    dr_o/dx <= 0 somewhere).
    """
    n = len(batch.parameters)
    if owners is None:
        owners = np.full(n, "reference configuration")
    count = _STRAIGHT_CHUNK if batch.kind.straight else _CURVED_CHUNK
    chunks = [slice(k, k + count) for k in range(0, n, count)]
    return joined([_invariants(element, batch[k], owners[k], keep=n <= count) for k in chunks])


def _invariants(element: BeamElement, batch: Batch, owners: Array, *, keep: bool) -> Invariants:
    """Multiply the integrals by powers of the length; the product rule.

    Integrals that are not kept are taken again for derivatives: points of many curved elements
    would fill the memory.
    """
    integrals = element.integrals(batch, owners)
    where, repair = (
        f"integrals of the element {element.name}",
        "Return an object of the class `Integrals`.",
    )
    require_kind(where, integrals, (ElementIntegrals,), repair)
    (A, m, *flexural), kept = _scaled(integrals, batch)[0], integrals if keep else None

    def partials(wanted: Iterable[ElementParameter]) -> Partials:
        its, found = kept or element.integrals(batch, owners), Partials()
        whole, sizes, Y_o = *_scaled(its, batch), _free(batch)
        for which in wanted:
            changes = [x * size for x, size in zip(its.partial(which), sizes, strict=True)]
            Y_b = change(_free(batch.moved(which)), Y_o, batch.step(which))
            if which is ElementParameter.LENGTH:
                by_l = zip(whole, its.powers, strict=True)
                changes = [
                    x_b + x * k / batch.lengths.reshape(-1, *[1] * k.ndim)
                    for x_b, (x, k) in zip(changes, by_l, strict=True)
                ]
            A_b, m_b, *flexural_b = changes
            g_ob = strain(None, Y_o, Y_b, None)
            bending_b = np.zeros((len(A_b), 2), dtype=A_b.dtype)
            if flexural_b:
                bending_b = np.insert(flexural_b[0], 1, which is ElementParameter.LENGTH, axis=1)
            c = np.einsum("nij,nj->ni", whole[0], g_ob)
            found[which] = InvariantPartial(A_b, g_ob, bending_b, c, m_b)
        return found

    bending = None
    if flexural:
        bending = np.concatenate([flexural[0], batch.lengths[:, None]], axis=1)
    return Invariants(A, packed_gram(_free(batch)), m, bending, partials)


def _scaled(integrals: ElementIntegrals, batch: Batch) -> tuple[list[Array], list[Array]]:
    """Return the integrals times the powers of the length, and these powers."""
    lengths = (batch.lengths.reshape(-1, *[1] * power.ndim) for power in integrals.powers)
    sizes = [l**power for l, power in zip(lengths, integrals.powers, strict=True)]
    return [x * size for x, size in zip(integrals.values, sizes, strict=True)], sizes


def _free(batch: Batch) -> Array:
    """Relative node vectors of the elements free of stress, shape (n, n_y, d)."""
    Y = batch.Y_free
    return np.concatenate([batch.lengths[:, None, None] * Y[:, :1], Y[:, 1:]], axis=1)


def joined(pieces: Sequence[Invariants], order: Array | None = None) -> Invariants:
    """Put the invariants of several blocks of one element into one, optionally reordered."""
    if len(pieces) == 1 and order is None:
        return pieces[0]

    def together(arrays: list[Array]) -> Array:
        whole = np.concatenate(arrays)
        return whole if order is None else whole[order]

    def fields(parts: Sequence[Invariants | InvariantPartial], *names: str) -> dict[str, Array]:
        return {name: together([getattr(part, name) for part in parts]) for name in names}

    of_pieces = [piece.partials for piece in pieces]

    def partials(wanted: Iterable[ElementParameter]) -> Partials:
        wanted, names = tuple(wanted), ("A", "g_o", "bending", "c", "m")
        parts = [derivatives(wanted) for derivatives in of_pieces]
        return {
            which: InvariantPartial(**fields([part[which] for part in parts], *names))
            for which in wanted
        }

    none = all(piece.bending is None for piece in pieces)
    bending = [
        np.zeros_like(piece.g_o[:, :2]) if piece.bending is None else piece.bending
        for piece in pieces
    ]
    return Invariants(
        **fields(pieces, "A", "g_o", "m"),
        bending=None if none else together(bending),
        partials=partials,
    )


def relative_places(element: BeamElement, wider: BeamElement) -> Array:
    """Return the places of its relative node vectors among those of an element that has them."""
    at, n_s = element.places_in(wider), element.n_s
    return np.concatenate([[0], at[1:n_s], at[n_s + 1 :] - 1])


def widened(narrow: Invariants, element: BeamElement, wider: BeamElement) -> Invariants:
    """Return invariants of the size of another element, zero for vectors that are not there."""
    n_y, at = wider.n_y, element.places_in(wider)
    packed = np.zeros((n_y, n_y), dtype=np.int64)
    packed[upper_triangle(n_y)] = np.arange(n_y * (n_y + 1) // 2)
    rows, columns = (relative_places(element, wider)[k] for k in upper_triangle(element.n_y))
    of_g, n_g = packed[rows, columns], n_y * (n_y + 1) // 2

    def placed(x: Array, places: Array, size: int) -> Array:
        wide = np.zeros((len(x), *[size] * (x.ndim - 1)), dtype=x.dtype)
        wide[np.ix_(np.arange(len(x)), *[places] * (x.ndim - 1))] = x
        return wide

    def fields(part: Invariants | InvariantPartial, *names: str) -> dict[str, Array]:
        wide = {name: placed(getattr(part, name), of_g, n_g) for name in names}
        return {**wide, "m": placed(part.m, at, wider.n_a)}

    of_narrow = narrow.partials

    def partials(wanted: Iterable[ElementParameter]) -> Partials:
        return {
            which: InvariantPartial(**fields(part, "A", "g_o", "c"), bending=part.bending)
            for which, part in of_narrow(wanted).items()
        }

    return Invariants(**fields(narrow, "A", "g_o"), bending=narrow.bending, partials=partials)
