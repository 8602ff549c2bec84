"""Planar gradient-deficient cable, 8 coordinates (Berzeri & Shabana 2000).

Node vectors X = [r_1, r_x1, r_2, r_x2]: a centre line that stretches and bends,
without shear and without deformation of the section. Beam law, no Poisson effect:

    U = int 1/2 E A eps^2 + 1/2 E I r_xx . r_xx dx,   eps = (r_x . r_x - 1)/2.

|r_xx| is the curvature where the axial strain is small. r_xx . r_xx is linear in
the Gram matrix and vanishes in a straight reference: it is the linear term p_o.
All invariants are integrals over xi times moments of the section and powers of l.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.model.elements.element import (
    Batch,
    BeamElement,
    ElementParameter,
    Integrals,
    Quantity,
    SectionLaw,
    SectionPlace,
)
from ancfdae.model.elements.hermite import (
    curvature_weights,
    end_weight,
    end_weight_xi,
    slope_weights,
    slope_weights_xi,
)
from ancfdae.model.elements.packing import upper_triangle
from ancfdae.model.elements.stresses import scaled
from ancfdae.model.elements.volume import change
from ancfdae.model.sections.section import central_moments
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule

# Powers of l in s_a and in the tangent; one more of 1/l in the second derivative.
_S_POWER, _N_POWER = np.array([0, 1, 0, 1]), np.array([-1, 0, 0])


@final
@dataclass(frozen=True)
class Cable2D(BeamElement):
    """The planar cable."""

    name = "CABLE_2D"
    d = 2

    quantities = (Quantity.POSITION, Quantity.SLOPE_X)
    default_energy = None

    def vector_weights(
        self, quantity: Quantity, xi: float, y: float, z: float
    ) -> tuple[Array, Array]:
        """Cubic Hermite polynomials, the same at every y, and their tangent."""
        if quantity is Quantity.POSITION:
            return _shape(np.array(xi)), _S_POWER
        chord, first, second = _tangent(np.array(xi))
        return np.array([-chord, first, chord, second]), np.array([-1, 0, -1, 0])

    def integrals(self, own: Batch, owners: Array) -> Integrals:
        """Integrals times E A, rho A and E I."""
        if not own.kind.straight:
            raise InvalidInput(
                str(owners[0]),
                "a cable must be straight in its reference configuration",
                "a curved one",
                "Use Beam, or another element.",
            )
        return _CableIntegrals(own)

    def section_law(self, own: Batch, place: SectionPlace) -> SectionLaw:
        """Return forces of the beam law."""
        return _CableSectionLaw(own, place)

    def stress_map(self, own: Batch, xi: Array, places: tuple[Array, Array]) -> Array:
        """Refuse: the law knows forces of a section, no stresses in it."""
        raise InvalidInput(
            "stress",
            "needs an element with a section, whose strains vary over it",
            self.name,
            "Divide axial_force and bending_moment by area and section modulus.",
        )


@final
class _CableIntegrals(Integrals):
    """A, m and p_o of unit moduli, times those of each element."""

    def __init__(self, own: Batch) -> None:
        self._own, self._moduli, self._units = own, _moduli(own), _integrals()
        of_g = _N_POWER[list(upper_triangle(3))].sum(axis=0)
        self.powers = of_g[:, None] + of_g + 1, _S_POWER[:, None] + _S_POWER + 1, of_g - 1
        self.values = self._times(self._moduli)

    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Product rule: moduli alone depend on parameters."""
        moved, step = _moduli(self._own.moved(which)), self._own.step(which)
        return self._times(change(x, at, step) for x, at in zip(moved, self._moduli, strict=True))

    def _times(self, moduli: Iterable[Array]) -> tuple[Array, ...]:
        """One number per element times an array."""
        pairs = zip(moduli, self._units, strict=True)
        return tuple(np.multiply.outer(modulus, unit) for modulus, unit in pairs)


@final
class _CableSectionLaw(SectionLaw):
    """E A eps r_x - E I r_xxx and r_x x E I r_xx along tangent and normal.

    The variation of U in r leaves these; eps with tau eps', linear as `_smoothing` has it.
    """

    def __init__(self, run: Batch, place: SectionPlace) -> None:
        self._element = [place.element]
        own = run[np.array(self._element)]
        self._E_A, _, self._E_I = _moduli(own)
        self._l, self._tau = own.lengths, own.of(ElementParameter.DAMPING_TIME)
        self._xi = np.array(place.xi)

    def forces(self, Y: Array, V: Array) -> Array:
        """N, V_y and M_z."""
        l, E_I, xi = self._l[:, None], self._E_I, self._xi
        Y, V = (scaled(x[..., self._element, :, :], self._l) for x in (Y, V))
        places, weights = _smoothing(float(xi))
        along, along_v = (np.einsum("pa,...nad->...pnd", _tangent(places), x) for x in (Y, V))
        strains = 0.5 * (np.sum(along * along, axis=-1) - 1.0)
        strains = strains + self._tau * np.sum(along * along_v, axis=-1)
        r_x, r_xx = _tangent(xi) @ Y, np.stack(curvature_weights(xi)) @ Y / l
        r_xxx = np.array([-12.0, 6.0, 6.0]) @ Y / l**2
        n = (self._E_A * (weights @ strains))[..., None] * r_x - E_I[:, None] * r_xxx
        speed = np.sqrt(np.sum(r_x * r_x, axis=-1))
        forces = np.zeros((*n.shape[:-1], 6), dtype=n.dtype)
        forces[..., 0] = np.sum(n * r_x, axis=-1) / speed
        forces[..., 1] = (r_x[..., 0] * n[..., 1] - r_x[..., 1] * n[..., 0]) / speed
        forces[..., 5] = E_I * (r_x[..., 0] * r_xx[..., 1] - r_x[..., 1] * r_xx[..., 0])
        return forces[..., 0, :]


def _smoothing(xi: float) -> tuple[Array, Array]:
    """Return Gauss points and their weights in the linear force at xi.

    Of all linear forces along an element it is the one that does the same work as the force of the
    law on the chord and on both tangents, which have the weights 6 xi (1 - xi), (1 - xi)(1 - 3 xi)
    and xi (3 xi - 2).
    """
    corner, rule = box_rule((5,))
    places = corner[:, 0]
    weights = rule * (end_weight_xi(places) + 6 * (xi - 0.5) * (2 * places - 1))
    return places, weights


def _moduli(own: Batch) -> tuple[Array, Array, Array]:
    """E A, rho A and E I, shape (n,) each."""
    E, rho = own.moduli[0], own.of(ElementParameter.DENSITY)
    y, z, dA = own.kind.section.points(own.sizes, False)
    _, moments = central_moments(y, z, dA)
    area = dA.sum(axis=1)
    return E * area, rho * area, E * moments[:, 0]


def _shape(xi: Array) -> Array:
    """s_a at unit length, shape (n_p, 4)."""
    s5, (p2, p6) = end_weight(xi), slope_weights(xi)
    return np.stack([1 - s5, p2, s5, p6], axis=-1)


def _tangent(xi: Array) -> Array:
    """N_y at unit length, shape (..., 3)."""
    return np.stack([end_weight_xi(xi), *slope_weights_xi(xi)], axis=-1)


def _integrals() -> tuple[Array, Array, Array]:
    """Return A, m and p_o of unit parameters; of degree 8, 6 and 2, five Gauss points are exact."""
    points, rule = box_rule((5,))
    xi = points[:, 0]
    s, N = _shape(xi), _tangent(xi)
    H = np.stack(curvature_weights(xi), axis=-1)
    rows, columns = upper_triangle(3)
    twice = np.where(rows == columns, 1.0, 2.0)
    P = 0.5 * twice * N[:, rows] * N[:, columns]
    kappa_squared = twice * H[:, rows] * H[:, columns]
    return (rule * P.T) @ P, (rule * s.T) @ s, 0.5 * rule @ kappa_squared


CABLE_2D = Cable2D()
