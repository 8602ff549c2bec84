"""Gradient-deficient cables of the plane (8 coordinates) and of space (12).

Node vectors X = [r_1, r_x1, r_2, r_x2] (Berzeri & Shabana 2000; Gerstmayr & Shabana 2006): a centre
line that stretches and bends, without shear, torsion and deformation of the section. Beam law, no
Poisson effect:

    U = int 1/2 E A eps^2 + 1/2 (E I/lambda) kappa^2 dx,   eps = (r_x . r_x - 1)/2 + eps_i,

with the curvature kappa of the material (`curvature`) and the initial strain eps_i, free of which a
reference length dx is lambda dx, lambda^2 = 1 - 2 eps_i. The stretch makes A, an integral over xi
times E A and powers of l; bending has the flexural stiffness E I/lambda, which is
E I for the length and the curvature of the cable free of stress.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.elements.cable_forces import CableSectionLaw, CableStressLaw
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
from ancfdae.model.elements.hermite import end_weight, slope_weights, tangent_weights
from ancfdae.model.elements.strain_fields import upper_triangle
from ancfdae.model.elements.volume import change
from ancfdae.model.sections.section import Section, central_moments
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule

# Powers of l in s_a, in the tangent, and in the flexural stiffness.
_S_POWER, _N_POWER = np.array([0, 1, 0, 1]), np.array([-1, 0, 0])
_NO_POWER = np.zeros(1, dtype=int)
# Share of the second moments by which those of a round section may differ: round-off.
_ROUND = 1e-9


@final
@dataclass(frozen=True)
class Cable(BeamElement):
    """The cable element in d dimensions: positions and tangents at the nodes, no section."""

    name: str
    d: int

    quantities = (Quantity.POSITION, Quantity.SLOPE_X)
    default_energy = None

    def check_section(self, where: str, section: Section) -> None:
        """Refuse sections that bend more easily one way than another, in space."""
        (yy, yz), (_, zz) = section.second_moments()
        if self.d == 3 and max(abs(yy - zz), 2 * abs(yz)) > _ROUND * (yy + zz):
            raise InvalidInputError(
                f"{where}, section",
                "must bend as easily about every axis: a cable in space has no axes across it",
                repr(section),
                "Use a Circle, or the element BEAM_3D.",
            )

    def vector_weights(
        self, quantity: Quantity, xi: float, y: float, z: float
    ) -> tuple[Array, Array]:
        """Cubic Hermite polynomials, the same at every y, and their tangent."""
        if quantity is Quantity.POSITION:
            return _shape(np.array(xi)), _S_POWER
        chord, first, second = tangent_weights(np.array(xi))
        return np.array([-chord, first, chord, second]), np.array([-1, 0, -1, 0])

    def integrals(self, batch: Batch, owners: Array) -> ElementIntegrals:
        """Integrals times E A, rho A and E I."""
        if not batch.kind.straight:
            raise InvalidInputError(
                str(owners[0]),
                "a cable must be straight in its reference configuration",
                "a curved one",
                "Use Beam, or another element.",
            )
        return _CableIntegrals(batch)

    def section_law(self, batch: Batch, place: SectionPlace) -> SectionLaw:
        """Return forces of the beam law."""
        return CableSectionLaw(batch, place, _moduli(batch)[::2])

    def stress_law(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> StressLaw:
        """Return stresses of the axial force and the bending moment."""
        return CableStressLaw(batch, xi, places)


@final
class _CableIntegrals(ElementIntegrals):
    """A and m of unit moduli, times those of each element, and the flexural stiffness."""

    def __init__(self, batch: Batch) -> None:
        self._batch, self._moduli, self._units = batch, _moduli(batch), _integrals()
        self.powers = _powers()
        self.values = self._times(self._moduli)

    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Product rule: moduli alone depend on parameters."""
        moved, step = _moduli(self._batch.moved(which)), self._batch.step(which)
        return self._times(change(x, at, step) for x, at in zip(moved, self._moduli, strict=True))

    def _times(self, moduli: Iterable[Array]) -> tuple[Array, ...]:
        """One number per element times an array."""
        pairs = zip(moduli, self._units, strict=True)
        return tuple(np.multiply.outer(modulus, unit) for modulus, unit in pairs)


def _moduli(batch: Batch) -> tuple[Array, Array, Array]:
    """E A, rho A and E I/lambda, shape (n,) each; in space I is the mean, as all are alike."""
    E, rho = batch.moduli[0], batch.of(ElementParameter.DENSITY)
    y, z, dA = batch.kind.section.points(batch.sizes, False)
    _, moments = central_moments(y, z, dA)
    area = dA.sum(axis=1)
    free = np.sqrt(1 - 2 * batch.of(ElementParameter.INITIAL_STRAIN))
    return E * area, rho * area, E / free * np.mean(moments[:, : batch.d - 1], axis=1)


def _shape(xi: Array) -> Array:
    """s_a at unit length, shape (n_p, 4)."""
    s5, (p2, p6) = end_weight(xi), slope_weights(xi)
    return np.stack([1 - s5, p2, s5, p6], axis=-1)


@cache
def _powers() -> tuple[Array, Array, Array]:
    """Return the powers of the length in A, m and the flexural stiffness."""
    of_g = _N_POWER[list(upper_triangle(3))].sum(axis=0)
    return of_g[:, None] + of_g + 1, _S_POWER[:, None] + _S_POWER + 1, _NO_POWER


@cache
def _integrals() -> tuple[Array, Array, Array]:
    """Return A and m of unit parameters; of degree 8 and 6, five Gauss points are exact."""
    points, rule = box_rule((5,))
    xi = points[:, 0]
    s, N = _shape(xi), tangent_weights(xi)
    rows, columns = upper_triangle(3)
    twice = np.where(rows == columns, 1.0, 2.0)
    P = 0.5 * twice * N[:, rows] * N[:, columns]
    return (rule * P.T) @ P, (rule * s.T) @ s, np.ones(1)


CABLE_2D, CABLE_3D = Cable("CABLE_2D", 2), Cable("CABLE_3D", 3)
