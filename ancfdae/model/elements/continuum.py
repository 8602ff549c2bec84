"""Beams that are a continuum, and the invariant matrices of a block of elements.

With Y the relative node vectors, g the packed Y Y^T and g_o its value where the element is free of
stress, which is the reference configuration less the initial strain, every element states

    U = 1/2 (g - g_o)^T A (g - g_o),
    m_ab = int rho s_a s_b dV_o            (eq. 10; M_e = m (x) I_d).

A (15 x 15 planar, 28 x 28 spatial) and m carry everything that eqs. (15), (18)
and (10) carry. Cables have the energy of bending in addition (`cable`): a flexural stiffness,
and the length of the element.

In a continuum every strain of the section counts. The strains of a section are s = beta g, and
those of a fibre R (s - s_o), with R and beta independent of the coordinates (`strains`), so that
A = int beta^T (int R^T C R dA) beta dx and there is no linear term.

Derivatives. With the chord divided by the length l, and y and z by it, parameters enter through the
points and areas of the section, its factors, C and powers of l only. Points, areas, factors and C
depend on one or two numbers each and are differentiated by complex steps, and so is R; the product
rule does the rest.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import strain
from ancfdae.model.elements.element import (
    Batch,
    BeamElement,
    ElementIntegrals,
    ElementParameter,
    InvariantPartial,
    Invariants,
    Partials,
    Quantity,
    SectionLaw,
    SectionPlace,
    StressLaw,
    shape_weights,
)
from ancfdae.model.elements.energy import EnhancedContinuum
from ancfdae.model.elements.section_results import ContinuumSectionLaw, ContinuumStressLaw
from ancfdae.model.elements.strains import (
    AXIS_POINTS,
    Fibres,
    Region,
    change,
    fibres,
    gauss_rule,
    packed_gram,
    section_stiffness,
    upper_triangle,
)
from ancfdae.model.sections.section import Section
from ancfdae.numerics.arrays import Array

# Elements handled at once, so that the preparation of 10,000 of them stays within memory; curved
# ones have more points.
_STRAIGHT_CHUNK, _CURVED_CHUNK = 256, 32


def prepare(
    element: BeamElement,
    batch: Batch,
    owners: Array | None = None,
) -> Invariants:
    """Integrate the invariants of a batch of elements; their derivatives are computed on demand.

    InvalidInputError, naming the owner of the element, if the reference configuration folds (det
    dr_o/dx <= 0 somewhere).
    """
    n = len(batch.parameters)
    if owners is None:
        owners = np.full(n, "reference configuration")
    count = _STRAIGHT_CHUNK if batch.kind.straight else _CURVED_CHUNK
    chunks = [slice(k, k + count) for k in range(0, n, count)]
    return joined([_invariants(element, batch[k], owners[k], keep=n <= count) for k in chunks])


def _invariants(element: BeamElement, batch: Batch, owners: Array, *, keep: bool) -> Invariants:
    """Return the invariants of a batch: its integrals times powers of the length.

    Unless `keep`, the integrals are computed again for derivatives: points of many curved elements
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
    """Return invariants from integrals at unit length, and the powers of the length in them."""
    lengths = (batch.lengths.reshape(-1, *[1] * power.ndim) for power in integrals.powers)
    sizes = [l**power for l, power in zip(lengths, integrals.powers, strict=True)]
    return [x * size for x, size in zip(integrals.values, sizes, strict=True)], sizes


def _free(batch: Batch) -> Array:
    """Return the relative node vectors of elements free of stress, shape (n, n_y, d)."""
    Y = batch.Y_free
    return np.concatenate([batch.lengths[:, None, None] * Y[:, :1], Y[:, 1:]], axis=1)


def joined(pieces: Sequence[Invariants], order: Array | None = None) -> Invariants:
    """Return the invariants of several blocks of one element as one, optionally reordered."""
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
    """Return the indices, (n_y,), of an element's relative node vectors among those of `wider`."""
    at, n_s = element.places_in(wider), element.n_s
    return np.concatenate([[0], at[1:n_s], at[n_s + 1 :] - 1])


def widened(narrow: Invariants, element: BeamElement, wider: BeamElement) -> Invariants:
    """Return invariants of `element` with the size of `wider`, zero for vectors it lacks."""
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


# -- elements ----------------------------------------------------------------------------------


# Straight reference: the integrand of A has degree 8 in xi, that of m degree 6; 5 Gauss points are
# exact. Curved reference: it is rational; 12 points leave 3e-15 when the element turns by 0.5 rad,
# 4e-13 at 1 rad and 3e-9 at a right angle.
_STRAIGHT_POINTS, _CURVED_POINTS = 5, 12


@final
@dataclass(frozen=True)
class ContinuumBeam(BeamElement):
    """Fully parameterised ANCF beam of hyperelastic material with linear section slopes."""

    name: str
    d: int

    default_energy = EnhancedContinuum()

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Vectors of a node: its position and d slope vectors."""
        return tuple(Quantity)[: self.d + 1]

    def check_section(self, where: str, section: Section) -> None:
        """Raise InvalidInputError unless the area of the section spreads along each of its axes."""
        y, z, dA = (x[0] for x in section.points(np.array([section.sizes()]), False))
        places = np.stack([y, z][: self.d - 1])
        moments = section.second_moments()[: self.d - 1, : self.d - 1]
        squares = np.diag(moments)
        # Of points on a line round-off leaves eps^2 = 5e-32 of the first, and eps of the second.
        flat = bool(np.any(squares <= 1e-24 * (places**2 @ np.abs(dA))))
        if flat or not np.linalg.det(moments / np.sqrt(np.outer(squares, squares))) > 1e-12:
            raise InvalidInputError(
                f"{where}, section",
                "the area of a section must spread along y, in space not along one line only",
                repr(section),
                "Give points that lie apart.",
            )

    def vector_weights(
        self, quantity: Quantity, xi: float, y: float, z: float
    ) -> tuple[Array, Array]:
        """Return the weights of the node vectors in a position or slope; see `shape_weights`."""
        powers = np.zeros((2, self.n_s), dtype=int)
        if quantity is Quantity.POSITION:
            powers[:, 1] = 1
        elif quantity is Quantity.SLOPE_X:
            powers[:] = -1
            powers[:, 1] = 0
        return shape_weights(self.d, quantity, xi, y, z), powers.ravel()

    def integrals(self, batch: Batch, owners: Array) -> ElementIntegrals:
        """Return A and m by quadrature over the volume, for some energies also along the axis."""
        return _ContinuumIntegrals(batch, owners)

    def section_law(self, batch: Batch, place: SectionPlace) -> SectionLaw:
        """Return the evaluator of section forces, which elements transmit from node to node."""
        A = _ContinuumIntegrals(batch, np.full(len(batch.parameters), "section force")).values[0]
        return ContinuumSectionLaw(batch, A, place)

    def stress_law(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> StressLaw:
        """Return the evaluator of stresses, C times the strains, at xi and points of the section.

        Shear and radial stresses are distributed over the section by `Section.shares`.
        """
        return ContinuumStressLaw(batch, xi, places)


@final
class _ContinuumIntegrals(ElementIntegrals):
    """A and m of node vectors scaled by the length; A is zero for rigid beams."""

    def __init__(self, batch: Batch, owners: Array) -> None:
        self._batch, self._fibres = batch, fibres(batch)
        self._C = () if batch.kind.energy is None else section_stiffness(batch)
        count = _STRAIGHT_POINTS if batch.kind.straight else _CURVED_POINTS
        self._regions = [Region(batch, self._fibres, gauss_rule(count), owners)]
        if len(self._C) > 1:
            axis = self._fibres.axis()
            self._regions.append(Region(batch, axis, gauss_rule(AXIS_POINTS), owners))
        self._rho = batch.of(ElementParameter.DENSITY)
        # Exponents of l that scaling removed from g (squares of the chord) and from s_a.
        rows, columns = upper_triangle(2 * batch.d + 1)
        A = np.zeros((len(self._rho), len(rows), len(rows)), dtype=self._rho.dtype)
        for region, C in zip(self._regions, self._C, strict=False):
            A = A + region.total(region.stiffness(C))
        self.values = A, self._regions[0].mass(self._rho)
        of_g = -(rows == 0).astype(int) - (columns == 0)
        of_s = np.array(2 * ([0] + batch.d * [1]))
        self.powers = of_g[:, None] + of_g, of_s[:, None] + of_s

    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Return the derivatives of A and m in a parameter of the elements."""
        A_b, m_b = (np.zeros_like(x) for x in self.values)
        if which is ElementParameter.DENSITY:
            return A_b, self.values[1] / self._rho[:, None, None]
        step, moved = self._batch.step(which), self._batch.moved(which)
        if self._C and which in (ElementParameter.YOUNGS_MODULUS, ElementParameter.POISSON_RATIO):
            for r, C, C_moved in zip(self._regions, self._C, section_stiffness(moved), strict=True):
                A_b += r.total(r.stiffness(change(C_moved, C, step)))
        pairs = zip(vars(fibres(moved)).values(), vars(self._fibres).values(), strict=True)
        fibres_b = Fibres(*(change(*pair, step) for pair in pairs))
        if not fibres_b.any():
            return A_b, m_b
        moves = [fibres_b, fibres_b.axis()][: len(self._regions)]
        for r, C, move in zip(self._regions, self._C, moves, strict=False):
            A_b += r.total(r.stiffness_partial(C, move))
        m_b += self._regions[0].mass_partial(self._rho, fibres_b)
        return A_b, m_b


# Planar shear-deformable beam, 12 coordinates (Omar & Shabana 2001; eqs. 7-8), with the node
# vectors X = [r_1, r_x1, r_y1, r_2, r_x2, r_y2]. The section extends over `height` in y.
BEAM_2D = ContinuumBeam("BEAM_2D", 2)
# Spatial fully parameterised beam, 24 coordinates (Yakoub & Shabana 2001), with the node vectors
# X = [r_1, r_x1, r_y1, r_z1, r_2, r_x2, r_y2, r_z2].
BEAM_3D = ContinuumBeam("BEAM_3D", 3)


def default_element(dimension: int) -> ContinuumBeam:
    """Return the shear-deformable beam element, BEAM_2D or BEAM_3D, of a dimension of space."""
    return BEAM_2D if dimension == 2 else BEAM_3D
