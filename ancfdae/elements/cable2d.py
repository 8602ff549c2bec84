"""Planar gradient-deficient cable, 8 coordinates (Berzeri & Shabana 2000).

Node vectors X = [r_1, r_x1, r_2, r_x2]: a centre line that stretches and bends,
without shear and without deformation of the section. Beam law, no Poisson effect:

    U = int 1/2 E A eps^2 + 1/2 E I r_xx . r_xx dx,   eps = (r_x . r_x - 1)/2.

|r_xx| is the curvature where the axial strain is small. r_xx . r_xx is linear in
the Gram matrix and vanishes in a straight reference: it is the linear term p_o.
All invariants are integrals over xi times moments of the section and powers of l.
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.elements.element import (
    BeamElement,
    ElementParameter,
    ElementType,
    InvariantPartial,
    Invariants,
    Quantity,
    SectionLaw,
)
from ancfdae.elements.hermite import (
    curvature_weights,
    end_weight,
    end_weight_xi,
    slope_weights,
    slope_weights_xi,
)
from ancfdae.elements.packing import packed_gram, upper_triangle
from ancfdae.elements.stresses import scaled, smoothing
from ancfdae.elements.volume import change, shifted, step_of
from ancfdae.errors import InvalidInput
from ancfdae.kernels import gram
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule
from ancfdae.sections.section import central_moments

# Powers of l in s_a and in the tangent; one more of 1/l in the second derivative.
_S_POWER, _N_POWER = np.array([0, 1, 0, 1]), np.array([-1, 0, 0])


@final
class Cable2D(BeamElement):
    """The planar cable."""

    name = "CABLE_2D"
    d = 2

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Position and tangent."""
        return (Quantity.POSITION, Quantity.SLOPE_X)

    def vector_weights(
        self, quantity: Quantity, xi: float, y: float, z: float
    ) -> tuple[Array, Array]:
        """Cubic Hermite polynomials, the same at every y, and their tangent."""
        if quantity is Quantity.POSITION:
            return _shape(np.array(xi)), _S_POWER
        chord, first, second = _tangent(np.array(xi))
        return np.array([-chord, first, chord, second]), np.array([-1, 0, -1, 0])

    @property
    def default_energy(self) -> None:
        """A law of its own."""
        return None

    def invariants(
        self,
        kind: ElementType,
        parameters: Array,
        Y_unit: Array,
        wanted: tuple[ElementParameter, ...],
        owners: Array,
    ) -> Invariants:
        """Integrals times E A, E I and rho A, and powers of l."""
        if not kind.straight:
            raise InvalidInput(
                str(owners[0]),
                "a cable must be straight in its reference configuration",
                "a curved one",
                "Use Beam, or another element.",
            )
        l = parameters[:, ElementParameter.LENGTH]
        A_1, p_1, m_1 = _integrals()
        of_g = _N_POWER[list(upper_triangle(self.n_y))].sum(axis=0)
        powers = of_g[:, None] + of_g + 1, of_g - 1, _S_POWER[:, None] + _S_POWER + 1
        # Integrals at the lengths of the elements, to be multiplied by the numbers of `_moduli`.
        units = [
            x * l.reshape(-1, *[1] * x.ndim) ** k
            for x, k in zip((A_1, p_1, m_1), powers, strict=True)
        ]
        moduli = _moduli(kind, parameters)
        A, p_o, m = (_times(x, unit) for x, unit in zip(moduli, units, strict=True))
        Y_o, Y_l = Y_unit.astype(A.dtype), np.zeros_like(Y_unit)
        Y_o[:, 0], Y_l[:, 0] = Y_o[:, 0] * l[:, None], Y_unit[:, 0]
        partials = {}
        for which in wanted:
            moved = _moduli(kind, shifted(parameters, which))
            step = step_of(parameters, which)
            moduli_b = [change(x, at, step) for x, at in zip(moved, moduli, strict=True)]
            A_b, p_b, m_b = (_times(x, unit) for x, unit in zip(moduli_b, units, strict=True))
            Y_b = np.zeros_like(Y_l)
            if which is ElementParameter.LENGTH:
                A_b, p_b, m_b = (
                    x * k / l.reshape(-1, *[1] * k.ndim)
                    for x, k in zip((A, p_o, m), powers, strict=True)
                )
                Y_b = Y_l
            g_ob = gram(Y_o, Y_b)
            c = np.einsum("nij,nj->ni", A, g_ob) - p_b
            partials[which] = InvariantPartial(A_b, g_ob, c, m_b)
        return Invariants(A, packed_gram(Y_o), m, p_o, partials)

    def section_law(
        self, kind: ElementType, parameters: Array, Y_unit: Array, xi: float
    ) -> SectionLaw:
        """Return forces of the beam law."""
        return _CableSectionLaw(kind, parameters, xi)

    def stress_map(
        self,
        kind: ElementType,
        parameters: Array,
        Y_unit: Array,
        xi: Array,
        places: tuple[Array, Array],
    ) -> Array:
        """Refuse: the law knows forces of a section, no stresses in it."""
        raise InvalidInput(
            "stress",
            "needs an element with a section, whose strains vary over it",
            self.name,
            "Divide axial_force and bending_moment by area and section modulus.",
        )


@final
class _CableSectionLaw(SectionLaw):
    """E A eps r_x - E I r_xxx and r_x x E I r_xx along tangent and normal.

    The variation of U in r leaves these; eps with tau eps', linear as `smoothing` has it.
    """

    def __init__(self, kind: ElementType, parameters: Array, xi: float) -> None:
        self._E_A, self._E_I, _ = _moduli(kind, parameters)
        self._l = parameters[:, ElementParameter.LENGTH]
        self._tau, self._xi = parameters[:, ElementParameter.DAMPING_TIME], np.array(xi)

    def forces(self, Y: Array, V: Array) -> Array:
        """N, V_y and M_z."""
        l, E_I, xi = self._l[:, None], self._E_I, self._xi
        Y, V = scaled(Y, self._l), scaled(V, self._l)
        places, weights = smoothing(float(xi))
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
        return forces


def _moduli(kind: ElementType, parameters: Array) -> tuple[Array, Array, Array]:
    """E A, E I and rho A, shape (n,) each."""
    E, rho = parameters[:, [ElementParameter.YOUNGS_MODULUS, ElementParameter.DENSITY]].T
    y, z, dA = kind.section.points(kind.sizes(parameters), False)
    _, moments = central_moments(y, z, dA)
    area = dA.sum(axis=1)
    return E * area, E * moments[:, 0], rho * area


def _times(modulus: Array, unit: Array) -> Array:
    """One number per element times its array."""
    product: Array = modulus.reshape(-1, *[1] * (unit.ndim - 1)) * unit
    return product


def _shape(xi: Array) -> Array:
    """s_a at unit length, shape (n_p, 4)."""
    s5, (p2, p6) = end_weight(xi), slope_weights(xi)
    return np.stack([1 - s5, p2, s5, p6], axis=-1)


def _tangent(xi: Array) -> Array:
    """N_y at unit length, shape (..., 3)."""
    return np.stack([end_weight_xi(xi), *slope_weights_xi(xi)], axis=-1)


def _integrals() -> tuple[Array, Array, Array]:
    """Return A, p_o and m of unit parameters; of degree 8, 2 and 6, five Gauss points are exact."""
    points, rule = box_rule((5,))
    xi = points[:, 0]
    s, N = _shape(xi), _tangent(xi)
    H = np.stack(curvature_weights(xi), axis=-1)
    rows, columns = upper_triangle(3)
    twice = np.where(rows == columns, 1.0, 2.0)
    P = 0.5 * twice * N[:, rows] * N[:, columns]
    kappa_squared = twice * H[:, rows] * H[:, columns]
    return (rule * P.T) @ P, 0.5 * rule @ kappa_squared, (rule * s.T) @ s


CABLE_2D = Cable2D()
