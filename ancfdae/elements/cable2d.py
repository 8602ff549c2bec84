"""Planar gradient-deficient cable, 8 coordinates (Berzeri & Shabana 2000).

Node vectors X = [r_1, r_x1, r_2, r_x2]: a centre line that stretches and bends,
without shear and without deformation of the section. Beam law, no Poisson effect:

    U = int 1/2 E h w eps^2 + 1/2 E (w h^3/12) r_xx . r_xx dx,   eps = (r_x . r_x - 1)/2.

|r_xx| is the curvature where the axial strain is small. r_xx . r_xx is linear in
the Gram matrix and vanishes in a straight reference: it is the linear term p_o.
All invariants are integrals over xi times monomials of the parameters.
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.elements.element import (
    BeamElement,
    ElementParameter,
    InvariantPartial,
    Invariants,
    Quantity,
)
from ancfdae.elements.hermite import (
    end_weight,
    end_weight_xi,
    slope_weights,
    slope_weights_xi,
)
from ancfdae.elements.packing import packed_gram, packed_gram_direction, upper_triangle
from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule

# Powers of l in s_a and in N_y; one more of 1/l in the second derivative.
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

    def shape(self, points: Array, parameters: Array) -> Array:
        """Cubic Hermite polynomials; the same at every y."""
        l = parameters[:, ElementParameter.LENGTH, None, None]
        shape: Array = _shape(points[:, 0]) * l**_S_POWER
        return shape

    def shape_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative in the length."""
        moves = _S_POWER * (which is ElementParameter.LENGTH)
        l = parameters[:, ElementParameter.LENGTH, None, None]
        partial: Array = self.shape(points, parameters) * moves / l
        return partial

    def gradient(self, points: Array, parameters: Array) -> Array:
        """Tangent; there is no slope along y."""
        l = parameters[:, ElementParameter.LENGTH, None, None]
        N_x = _tangent(points[:, 0]) * l**_N_POWER
        return np.stack([N_x, np.zeros_like(N_x)], axis=-1)

    def gradient_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative in the length."""
        moves = _N_POWER[:, None] * (which is ElementParameter.LENGTH)
        l = parameters[:, ElementParameter.LENGTH, None, None, None]
        partial: Array = self.gradient(points, parameters) * moves / l
        return partial

    def invariants(
        self,
        parameters: Array,
        Y_unit: Array,
        straight: bool,
        wanted: tuple[ElementParameter, ...],
        owners: Array,
    ) -> Invariants:
        """Integrals times monomials: A of E h w, p_o of E w h^3 / 12, m of rho h w; powers of l."""
        if not straight:
            raise InvalidInput(
                str(owners[0]),
                "a cable must be straight in its reference configuration",
                "a curved one",
                "Use Beam, or another element.",
            )
        E, _, rho, h, w, l = parameters.T[:6, :, None]
        A_1, p_1, m_1 = _integrals()
        of_g = _N_POWER[list(upper_triangle(self.n_y))].sum(axis=0)
        powers = of_g[:, None] + of_g + 1, of_g - 1, _S_POWER[:, None] + _S_POWER + 1
        l_A, l_p, l_m = ((l.reshape(-1, *[1] * k.ndim) ** k) for k in powers)
        A, p_o = (E * h * w)[..., None] * A_1 * l_A, E * w * h**3 / 12 * p_1 * l_p
        m = (rho * h * w)[..., None] * m_1 * l_m
        Y_o, Y_l = Y_unit.astype(A.dtype), np.zeros_like(Y_unit)
        Y_o[:, 0], Y_l[:, 0] = Y_o[:, 0] * l, Y_unit[:, 0]
        partials = {}
        for which in wanted:
            is_length = which is ElementParameter.LENGTH
            # Exponents of this parameter in A, p_o and m.
            k_A, k_p, k_m = powers if is_length else _EXPONENTS[which]
            g_ob = packed_gram_direction(Y_o, Y_l * is_length)
            # Nothing depends on Poisson's ratio, which may be zero.
            nothing = which is ElementParameter.POISSON_RATIO
            value = np.ones_like(l) if nothing else parameters[:, which, None]
            c = np.einsum("nij,nj->ni", A, g_ob) - p_o * k_p / value
            value = value[..., None]
            partials[which] = InvariantPartial(A * k_A / value, g_ob, c, m * k_m / value)
        return Invariants(A, packed_gram(Y_o), m, p_o, partials)


_EXPONENTS = {
    ElementParameter.YOUNGS_MODULUS: (1, 1, 0),
    ElementParameter.POISSON_RATIO: (0, 0, 0),
    ElementParameter.DENSITY: (0, 0, 1),
    ElementParameter.HEIGHT: (1, 3, 1),
    ElementParameter.WIDTH: (1, 1, 1),
}


def _shape(xi: Array) -> Array:
    """s_a at unit length, shape (n_p, 4)."""
    s5, (p2, p6) = end_weight(xi), slope_weights(xi)
    return np.stack([1 - s5, p2, s5, p6], axis=-1)


def _tangent(xi: Array) -> Array:
    """N_y at unit length, shape (n_p, 3)."""
    return np.stack([end_weight_xi(xi), *slope_weights_xi(xi)], axis=-1)


def _integrals() -> tuple[Array, Array, Array]:
    """Return A, p_o and m of unit parameters; of degree 8, 2 and 6, five Gauss points are exact."""
    points, rule = box_rule((5,))
    xi = points[:, 0]
    s, N = _shape(xi), _tangent(xi)
    H = np.stack([6 - 12 * xi, 6 * xi - 4, 6 * xi - 2], axis=-1)
    rows, columns = upper_triangle(3)
    twice = np.where(rows == columns, 1.0, 2.0)
    P = 0.5 * twice * N[:, rows] * N[:, columns]
    kappa_squared = twice * H[:, rows] * H[:, columns]
    return (rule * P.T) @ P, 0.5 * rule @ kappa_squared, (rule * s.T) @ s


CABLE_2D = Cable2D()
