"""Beams that are a continuum: every strain of the section counts.

With Y the relative node vectors, g the packed Y Y^T and g_o its value in the
reference configuration, every Green-Lagrange strain component is P (g - g_o)
with P independent of the coordinates, so that A = int P^T C P dV_o and there is
no linear term.

Derivation of P. With D = N J_o^{-1}, J_o = Y_o^T N = d r_o/dx (eq. 16), the
deformation gradient is F = Y^T D and 2 E_ij = sum_yz D_yi D_zj Y_y . Y_z - delta_ij.
The derivative of A in a parameter b follows from the product rule:
d(J_o^{-1}) = -J_o^{-1} dJ_o J_o^{-1}, d(det J_o) = det J_o tr(J_o^{-1} dJ_o).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.elements.element import (
    GEOMETRIC,
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

# Straight reference: the integrand of A has degree 8 in xi and 4 across the section, that
# of m degree 6 and 2; 5 and 3 Gauss points are exact.
_STRAIGHT_POINTS = (5, 3)
# Curved reference: the integrand is rational. With a radius of curvature R the error of A falls
# like (height / 4R)^(2 n) across the section: measured with 6 points, 1e-15 at height = R / 10,
# 6e-14 at R / 5, 4e-9 at R / 2. Along it, 12 points leave 3e-15 when the element turns by 0.5 rad,
# 4e-13 at 1 rad and 3e-9 at a right angle.
_CURVED_POINTS = (12, 6)


@final
@dataclass(frozen=True)
class ContinuumBeam(BeamElement):
    """A beam of St. Venant-Kirchhoff material with linearly interpolated section slopes.

    Attributes
    ----------
    name : str
    d : int
        Dimension of space.
    voigt : tuple of (int, int)
        Index pairs of the strain components, normal components first.
    """

    name: str
    d: int
    voigt: tuple[tuple[int, int], ...]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Position and d slopes."""
        return tuple(Quantity)[: self.d + 1]

    def shape(self, points: Array, parameters: Array) -> Array:
        """Eq. (8), and in space with the terms of the width (docs/theory.md, section 1)."""
        xi, l = points[:, 0], parameters[:, ElementParameter.LENGTH, None]
        s5, (p2, p6), one = end_weight(xi), slope_weights(xi), np.ones_like(l)
        offsets = self._offsets(points, parameters)
        first = [one * (1 - s5), l * p2, *(y * (1 - xi) for y in offsets)]
        second = [one * s5, l * p6, *(y * xi for y in offsets)]
        return np.stack(first + second, axis=-1)

    def shape_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative of `shape`."""
        xi, second = points[:, 0], self.n_s
        partial = np.zeros((1, len(points), self.n_a))
        if which is ElementParameter.LENGTH:
            partial[..., 1], partial[..., second + 1] = slope_weights(xi)
        elif which in self._extents:
            k = 2 + self._extents.index(which)
            eta = points[:, k - 1]
            partial[..., k], partial[..., second + k] = eta * (1 - xi), eta * xi
        return np.repeat(partial, len(parameters), axis=0)

    def gradient(self, points: Array, parameters: Array) -> Array:
        """Gradient of `shape` in x, y(, z)."""
        xi, l, second = points[:, 0], parameters[:, ElementParameter.LENGTH, None], self.n_s - 1
        N = np.zeros((len(parameters), len(points), self.n_y, self.d), dtype=parameters.dtype)
        N[..., 0, 0] = end_weight_xi(xi) / l
        N[..., 1, 0], N[..., second + 1, 0] = slope_weights_xi(xi)
        for k, y in enumerate(self._offsets(points, parameters), start=2):
            N[..., k, 0], N[..., second + k, 0] = -y / l, y / l
            N[..., k, k - 1], N[..., second + k, k - 1] = 1 - xi, xi
        return N

    def gradient_partial(self, points: Array, parameters: Array, which: ElementParameter) -> Array:
        """Return the derivative of `gradient`; only the x column depends on the parameters."""
        l, second = parameters[:, ElementParameter.LENGTH, None], self.n_s - 1
        shape = (len(parameters), len(points), self.n_y, self.d)
        partial = np.zeros(shape, dtype=parameters.dtype)
        if which is ElementParameter.LENGTH:
            partial[..., 0, 0] = -end_weight_xi(points[:, 0]) / l**2
            for k, y in enumerate(self._offsets(points, parameters), start=2):
                partial[..., k, 0], partial[..., second + k, 0] = y / l**2, -y / l**2
        elif which in self._extents:
            k = 2 + self._extents.index(which)
            eta = points[:, k - 1]
            partial[..., k, 0], partial[..., second + k, 0] = -eta / l, eta / l
        return partial

    @property
    def _extents(self) -> list[ElementParameter]:
        """What the section extends over in y(, z)."""
        return [ElementParameter.HEIGHT, ElementParameter.WIDTH][: self.d - 1]

    def _offsets(self, points: Array, parameters: Array) -> list[Array]:
        """y(, z) at the points, shape (n, n_p) each."""
        extents = enumerate(self._extents, start=1)
        return [parameters[:, extent, None] * points[:, k] for k, extent in extents]

    def invariants(
        self,
        parameters: Array,
        Y_unit: Array,
        straight: bool,
        wanted: tuple[ElementParameter, ...],
        owners: Array,
    ) -> Invariants:
        """Gauss quadrature over the volume."""
        E, nu, rho, h, w, l = parameters.T[:6]
        along, across = _STRAIGHT_POINTS if straight else _CURVED_POINTS
        points, rule = box_rule((along,) + (across,) * (self.d - 1))
        N, s = self.gradient(points, parameters), self.shape(points, parameters)
        Y_o = Y_unit.astype(np.result_type(Y_unit, parameters))
        Y_o[:, 0] *= l[:, None]
        J_inv, det_J = _reference_gradient(Y_o, N, owners)
        C, D = constitutive_matrix(self, E, nu), N @ J_inv
        P = _strain_operator(self, D, D)
        dV = rule * det_J * (l * h * w)[:, None]
        A, m = _quadratic(P, C, dV, P), _mass(rho, dV, s, s)
        partials = {}
        for which in wanted:
            A_b, m_b = np.zeros_like(A), np.zeros_like(m)
            Y_ob = np.zeros_like(Y_o)
            if which is ElementParameter.DENSITY:
                m_b = m / rho[:, None, None]
            elif which not in GEOMETRIC:
                A_b = _quadratic(P, _constitutive_partial(self, E, nu, which), dV, P)
            else:
                if which is ElementParameter.LENGTH:
                    Y_ob[:, 0] = Y_unit[:, 0]
                N_b = self.gradient_partial(points, parameters, which)
                s_b = self.shape_partial(points, parameters, which)
                J_b = Y_ob.transpose(0, 2, 1)[:, None] @ N + Y_o.transpose(0, 2, 1)[:, None] @ N_b
                D_b = (N_b - D @ J_b) @ J_inv
                P_b = _strain_operator(self, D_b, D) + _strain_operator(self, D, D_b)
                trace = np.einsum("npij,npji->np", J_inv, J_b)
                dV_b = dV * (trace + 1.0 / parameters[:, which, None])
                cross, cross_m = _quadratic(P_b, C, dV, P), _mass(rho, dV, s_b, s)
                A_b = _quadratic(P, C, dV_b, P) + cross + cross.transpose(0, 2, 1)
                m_b = _mass(rho, dV_b, s, s) + cross_m + cross_m.transpose(0, 2, 1)
            g_ob = packed_gram_direction(Y_o, Y_ob)
            c_b = np.einsum("nij,nj->ni", A, g_ob)
            partials[which] = InvariantPartial(A=A_b, g_o=g_ob, c=c_b, m=m_b)
        return Invariants(A=A, g_o=packed_gram(Y_o), m=m, p_o=None, partials=partials)


def constitutive_matrix(element: ContinuumBeam, E: Array, nu: Array) -> Array:
    """St. Venant-Kirchhoff C, shape (n, n_v, n_v), engineering shear strains."""
    kappa = E * nu / ((1 + nu) * (1 - 2 * nu))
    G = E / (2 * (1 + nu))
    return _isotropic(element, kappa, G)


def _isotropic(element: ContinuumBeam, kappa: Array, G: Array) -> Array:
    d, n_v = element.d, len(element.voigt)
    normal, shear = np.arange(d), np.arange(d, n_v)
    C = np.zeros((len(kappa), n_v, n_v), dtype=np.result_type(kappa, G))
    C[:, :d, :d] = kappa[:, None, None]
    C[:, normal, normal] += 2 * G[:, None]
    C[:, shear, shear] = G[:, None]
    return C


def _constitutive_partial(
    element: ContinuumBeam, E: Array, nu: Array, which: ElementParameter
) -> Array:
    if which is ElementParameter.YOUNGS_MODULUS:
        return constitutive_matrix(element, np.ones_like(E), nu)
    kappa_nu = E * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu)) ** 2
    return _isotropic(element, kappa_nu, -E / (2 * (1 + nu) ** 2))


def _reference_gradient(Y_o: Array, N: Array, owners: Array) -> tuple[Array, Array]:
    """Inverse and determinant of dr_o/dx (eq. 16), shapes (n, n_p, d, d) and (n, n_p)."""
    J = Y_o.transpose(0, 2, 1)[:, None] @ N
    det_J = np.linalg.det(J)
    worst = np.min(det_J.real, axis=1)
    if not np.all(worst > 0):
        k = int(np.argmin(worst))
        raise InvalidInput(
            str(owners[k]),
            "dr_o/dx of the reference configuration must have a positive determinant everywhere",
            f"{float(worst[k]):.3g} at the worst point",
            "Use right-handed node frames, more elements along the curve or a thinner section.",
        )
    return np.linalg.inv(J), det_J


def _strain_operator(element: ContinuumBeam, D_1: Array, D_2: Array) -> Array:
    """Coefficients of the strains in g, bilinear in (D_1, D_2), shape (n, n_p, n_v, n_g)."""
    rows, columns = upper_triangle(element.n_y)
    i = np.array([pair[0] for pair in element.voigt])[:, None]
    j = np.array([pair[1] for pair in element.voigt])[:, None]
    product = D_1[..., rows, i] * D_2[..., columns, j] + D_1[..., columns, i] * D_2[..., rows, j]
    # 1/2 from 2 E = ..., doubled for engineering shear, halved where both terms are one entry.
    shear = np.where(i == j, 0.5, 1.0)
    twice = np.where(rows == columns, 0.5, 1.0)
    # Gram is symmetric: only the part symmetric in (i, j) counts.
    swapped = D_1[..., rows, j] * D_2[..., columns, i] + D_1[..., columns, j] * D_2[..., rows, i]
    P: Array = 0.5 * (product + swapped) * (shear * twice)
    return P


def _quadratic(P_1: Array, C: Array, dV: Array, P_2: Array) -> Array:
    """Integral of P_1^T C P_2 over the reference volume."""
    n, n_p, n_v, n_g = P_1.shape
    weighted = dV[..., None, None] * (C[:, None] @ P_2)
    left = P_1.reshape(n, n_p * n_v, n_g).transpose(0, 2, 1)
    return np.asarray(left @ weighted.reshape(n, n_p * n_v, n_g))


def _mass(rho: Array, dV: Array, s_1: Array, s_2: Array) -> Array:
    """Integral of rho s_1 s_2^T (eq. 10)."""
    weighted = (rho[:, None] * dV)[..., None] * s_2
    return np.asarray(s_1.transpose(0, 2, 1) @ weighted)
