"""Gradient-deficient cables of the plane (8 coordinates) and of space (12).

Node vectors X = [r_1, r_x1, r_2, r_x2] (Berzeri & Shabana 2000; Gerstmayr & Shabana 2006): a centre
line that stretches and bends, without shear, torsion and deformation of the section. Beam law, no
Poisson effect:

    U = int 1/2 E A eps^2 + 1/2 E I r_xx . r_xx dx,   eps = (r_x . r_x - 1)/2.

|r_xx| is the curvature where the axial strain is small. r_xx . r_xx is linear in
the Gram matrix and vanishes in a straight reference: it is the linear term p_o.
All invariants are integrals over xi times moments of the section and powers of l.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.model.elements.cable_forces import CableSectionLaw, CableStressLaw
from ancfdae.model.elements.element import (
    Batch,
    BeamElement,
    ElementParameter,
    Integrals,
    Quantity,
    SectionLaw,
    SectionPlace,
    StressLaw,
)
from ancfdae.model.elements.hermite import (
    curvature_weights,
    end_weight,
    slope_weights,
    tangent_weights,
)
from ancfdae.model.elements.strain_fields import upper_triangle
from ancfdae.model.elements.volume import change
from ancfdae.model.sections import Section
from ancfdae.model.sections.section import central_moments
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule

# Powers of l in s_a and in the tangent; one more of 1/l in the second derivative.
_S_POWER, _N_POWER = np.array([0, 1, 0, 1]), np.array([-1, 0, 0])
# Share of the second moments by which those of a round section may differ: round-off.
_ROUND = 1e-9


@final
@dataclass(frozen=True)
class Cable(BeamElement):
    """The cable of d dimensions."""

    name: str
    d: int

    quantities = (Quantity.POSITION, Quantity.SLOPE_X)
    default_energy = None

    def check_section(self, where: str, section: Section) -> None:
        """Refuse sections that bend more easily one way than another, in space."""
        (yy, yz), (_, zz) = section.second_moments()
        if self.d == 3 and max(abs(yy - zz), 2 * abs(yz)) > _ROUND * (yy + zz):
            raise InvalidInput(
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

    def integrals(self, batch: Batch, owners: Array) -> Integrals:
        """Integrals times E A, rho A and E I."""
        if not batch.kind.straight:
            raise InvalidInput(
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
class _CableIntegrals(Integrals):
    """A, m and p_o of unit moduli, times those of each element."""

    def __init__(self, batch: Batch) -> None:
        self._batch, self._moduli, self._units = batch, _moduli(batch), _integrals()
        of_g = _N_POWER[list(upper_triangle(3))].sum(axis=0)
        self.powers = of_g[:, None] + of_g + 1, _S_POWER[:, None] + _S_POWER + 1, of_g - 1
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
    """E A, rho A and E I, shape (n,) each; in space I is the mean, as all are alike."""
    E, rho = batch.moduli[0], batch.of(ElementParameter.DENSITY)
    y, z, dA = batch.kind.section.points(batch.sizes, False)
    _, moments = central_moments(y, z, dA)
    area = dA.sum(axis=1)
    return E * area, rho * area, E * np.mean(moments[:, : batch.d - 1], axis=1)


def _shape(xi: Array) -> Array:
    """s_a at unit length, shape (n_p, 4)."""
    s5, (p2, p6) = end_weight(xi), slope_weights(xi)
    return np.stack([1 - s5, p2, s5, p6], axis=-1)


def _integrals() -> tuple[Array, Array, Array]:
    """Return A, m and p_o of unit parameters; of degree 8, 6 and 2, five Gauss points are exact."""
    points, rule = box_rule((5,))
    xi = points[:, 0]
    s, N = _shape(xi), tangent_weights(xi)
    H = np.stack(curvature_weights(xi), axis=-1)
    rows, columns = upper_triangle(3)
    twice = np.where(rows == columns, 1.0, 2.0)
    P = 0.5 * twice * N[:, rows] * N[:, columns]
    kappa_squared = twice * H[:, rows] * H[:, columns]
    return (rule * P.T) @ P, (rule * s.T) @ s, 0.5 * rule @ kappa_squared


CABLE_2D, CABLE_3D = Cable("CABLE_2D", 2), Cable("CABLE_3D", 3)
