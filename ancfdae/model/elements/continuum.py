"""Beams that are a continuum: every strain of the section counts.

With Y the relative node vectors, g the packed Y Y^T and g_o its value in the
reference configuration, the strains of a section are s = beta g, and those of a fibre R (s - s_o),
with R and beta independent of the coordinates (`fibre_strains`, `strain_fields`), so that
A = int beta^T (int R^T C R dA) beta dx and there is no linear term.

Derivatives. With the chord divided by the length l, and y and z by it, parameters enter through the
points and areas of the section, its factors, C and powers of l only. Points, areas, factors and C
depend on one or two numbers each and are differentiated by complex steps, and so is R; the product
rule does the rest.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.elements.element import (
    Batch,
    BeamElement,
    ElementIntegrals,
    ElementParameter,
    Quantity,
    SectionLaw,
    SectionPlace,
    StressLaw,
)
from ancfdae.model.elements.energy import EnhancedContinuum
from ancfdae.model.elements.hermite import shape_weights
from ancfdae.model.elements.section_forces import ContinuumSectionLaw
from ancfdae.model.elements.strain_fields import upper_triangle
from ancfdae.model.elements.stresses import ContinuumStressLaw
from ancfdae.model.elements.volume import (
    AXIS_POINTS,
    Region,
    change,
    fibres,
    fibres_partial,
    gauss_rule,
    section_stiffness,
)
from ancfdae.model.sections.section import Section
from ancfdae.numerics.arrays import Array

# Straight reference: the integrand of A has degree 8 in xi, that of m degree 6; 5 Gauss points are
# exact. Curved reference: it is rational; 12 points leave 3e-15 when the element turns by 0.5 rad,
# 4e-13 at 1 rad and 3e-9 at a right angle.
_STRAIGHT_POINTS, _CURVED_POINTS = 5, 12


@final
@dataclass(frozen=True)
class ContinuumBeam(BeamElement):
    """A beam of hyperelastic material with linearly interpolated section slopes."""

    name: str
    d: int

    default_energy = EnhancedContinuum()

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Vectors of a node: its position and d slopes."""
        return tuple(Quantity)[: self.d + 1]

    def check_section(self, where: str, section: Section) -> None:
        """Refuse sections that do not resist bending about every axis."""
        if not self._is_spread(section):
            raise InvalidInputError(
                f"{where}, section",
                "the area of a section must spread along y, in space not along one line only",
                repr(section),
                "Give points that lie apart.",
            )

    def _is_spread(self, section: Section) -> bool:
        y, z, dA = (x[0] for x in section.points(np.array([section.sizes()]), False))
        places = np.stack([y, z][: self.d - 1])
        moments = section.second_moments()[: self.d - 1, : self.d - 1]
        squares = np.diag(moments)
        # Of points on a line round-off leaves eps^2 = 5e-32 of the first, and eps of the second.
        if np.any(squares <= 1e-24 * (places**2 @ np.abs(dA))):
            return False
        return bool(np.linalg.det(moments / np.sqrt(np.outer(squares, squares))) > 1e-12)

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
        """Gauss quadrature over the volume, and for some energies along the axis."""
        return _ContinuumIntegrals(batch, owners)

    def section_law(self, batch: Batch, place: SectionPlace) -> SectionLaw:
        """Return the law of section forces, which elements transmit from node to node."""
        A = _ContinuumIntegrals(batch, np.full(len(batch.parameters), "section force")).values[0]
        return ContinuumSectionLaw(batch, A, place)

    def stress_law(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> StressLaw:
        """Return the law of stresses at xi and places of the section: C times the strains.

        Shear and radial stresses are distributed over the section by `Section.shares`.
        """
        return ContinuumStressLaw(batch, xi, places)


@final
class _ContinuumIntegrals(ElementIntegrals):
    """A and m of scaled vectors."""

    def __init__(self, batch: Batch, owners: Array) -> None:
        self._batch, self._fibres, self._C = batch, fibres(batch), section_stiffness(batch)
        count = _STRAIGHT_POINTS if batch.kind.straight else _CURVED_POINTS
        self._regions = [Region(batch, self._fibres, gauss_rule(count), owners)]
        if len(self._C) > 1:
            axis = self._fibres.axis()
            self._regions.append(Region(batch, axis, gauss_rule(AXIS_POINTS), owners))
        self._rho = batch.of(ElementParameter.DENSITY)
        parts = zip(self._regions, self._C, strict=True)
        A: Array = np.sum([r.total(r.stiffness(C)) for r, C in parts], axis=0)
        self.values = A, self._regions[0].mass(self._rho)
        # What the scaling took out of g, with its squares of the chord, and of s_a.
        rows, columns = upper_triangle(2 * batch.d + 1)
        of_g = -(rows == 0).astype(int) - (columns == 0)
        of_s = np.array(2 * ([0] + batch.d * [1]))
        self.powers = of_g[:, None] + of_g, of_s[:, None] + of_s

    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Return the derivatives of A and m in a parameter of the elements."""
        A_b, m_b = (np.zeros_like(x) for x in self.values)
        if which is ElementParameter.DENSITY:
            return A_b, self.values[1] / self._rho[:, None, None]
        batch = self._batch
        if which in (ElementParameter.YOUNGS_MODULUS, ElementParameter.POISSON_RATIO):
            step, moved = batch.step(which), section_stiffness(batch.moved(which))
            for r, C, C_moved in zip(self._regions, self._C, moved, strict=True):
                A_b += r.total(r.stiffness(change(C_moved, C, step)))
        fibres_b = fibres_partial(batch, which)
        if not fibres_b.any():
            return A_b, m_b
        moves = [fibres_b, fibres_b.axis()][: len(self._regions)]
        for r, C, move in zip(self._regions, self._C, moves, strict=True):
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
    """Return the beam of a dimension."""
    return BEAM_2D if dimension == 2 else BEAM_3D
