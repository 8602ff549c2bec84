"""Beams that are a continuum: every strain of the section counts.

With Y the relative node vectors, g the packed Y Y^T and g_o its value in the
reference configuration, every Green-Lagrange strain component is P (g - g_o)
with P independent of the coordinates, so that A = int P^T C P dV_o and there is
no linear term.

Derivation of P. In axes of the beam, 2 E = B - B_o with the metric B of `strain_fields`. In
Cartesian ones, E = J_o^-T E J_o^-1 with J_o = dr_o/dx (eq. 16), which is T E in vectors of the
components: P = T B. For a straight reference J_o = 1.

Derivatives. With the chord divided by the length l, and y and z by it, parameters enter through the
points and areas of the section, its factors, C and powers of l only. The former, all of them of one
or two numbers, are differentiated by complex steps; the product rule does the rest.
d(J_o^-1) = -J_o^-1 dJ_o J_o^-1, d(det J_o) = det J_o tr(J_o^-1 dJ_o).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.elements.element import (
    Batch,
    BeamElement,
    ElementParameter,
    Integrals,
    Quantity,
    SectionLaw,
)
from ancfdae.elements.energy import EnhancedContinuum
from ancfdae.elements.hermite import shape_weights
from ancfdae.elements.packing import upper_triangle
from ancfdae.elements.strain_fields import turn_stiffness
from ancfdae.elements.stresses import ContinuumSectionLaw, spread_stresses
from ancfdae.elements.volume import (
    AXIS_POINTS,
    Region,
    along,
    change,
    fibres,
    fibres_partial,
    gauss_rule,
)
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
        """Position and d slopes."""
        return tuple(Quantity)[: self.d + 1]

    def vector_weights(
        self, quantity: Quantity, xi: float, y: float, z: float
    ) -> tuple[Array, Array]:
        """Return `shape_weights`."""
        powers = np.zeros((2, self.n_s), dtype=int)
        if quantity is Quantity.POSITION:
            powers[:, 1] = 1
        elif quantity is Quantity.SLOPE_X:
            powers[:] = -1
            powers[:, 1] = 0
        return shape_weights(self.d, quantity, xi, y, z), powers.ravel()

    def integrals(self, own: Batch, owners: Array) -> Integrals:
        """Gauss quadrature over the volume, and for some energies along the axis."""
        return _ContinuumIntegrals(own, owners)

    def section_law(self, own: Batch, xi: float) -> SectionLaw:
        """Integrals of stresses over the section."""
        return ContinuumSectionLaw(own, xi)

    def stress_map(self, own: Batch, xi: Array, places: tuple[Array, Array]) -> Array:
        """C times strains, shears and radial stresses spread as the section says."""
        return spread_stresses(own, xi, places)


@final
class _ContinuumIntegrals(Integrals):
    """A and m of scaled vectors."""

    def __init__(self, own: Batch, owners: Array) -> None:
        self._own, self._fibres, self._C = own, fibres(own), _stiffness(own)
        count = _STRAIGHT_POINTS if own.kind.straight else _CURVED_POINTS
        self._regions = [Region(own, self._fibres, gauss_rule(count), owners)]
        if len(self._C) > 1:
            axis = self._fibres.axis()
            self._regions.append(Region(own, axis, gauss_rule(AXIS_POINTS), owners))
        self._rho = own.of(ElementParameter.DENSITY)
        self._s = self._regions[0].shape(self._fibres.offsets)
        A: Array = np.sum(
            [_quadratic(r.P, C, r.dV, r.P) for r, C in zip(self._regions, self._C, strict=True)],
            axis=0,
        )
        self.values = A, _mass(self._rho, self._regions[0].dV, self._s, self._s)
        # What the scaling took out of g, with its squares of the chord, and of s_a.
        rows, columns = upper_triangle(2 * own.d + 1)
        of_g = -(rows == 0).astype(int) - (columns == 0)
        of_s = np.array(2 * ([0] + own.d * [1]))
        self.powers = of_g[:, None] + of_g, of_s[:, None] + of_s

    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Return A_b and m_b."""
        A_b, m_b = (np.zeros_like(x) for x in self.values)
        if which is ElementParameter.DENSITY:
            return A_b, self.values[1] / self._rho[:, None, None]
        own = self._own
        if which in (ElementParameter.YOUNGS_MODULUS, ElementParameter.POISSON_RATIO):
            step, moved = own.step(which), _stiffness(own.moved(which))
            for r, C, C_moved in zip(self._regions, self._C, moved, strict=True):
                A_b += _quadratic(r.P, change(C_moved, C, step), r.dV, r.P)
        fibres_b = fibres_partial(own, which)
        if not fibres_b.any():
            return A_b, m_b
        moves = [fibres_b, fibres_b.axis()][: len(self._regions)]
        for r, C, move in zip(self._regions, self._C, moves, strict=True):
            P_b, dV_b = r.partial(move)
            cross = _quadratic(P_b, C, r.dV, r.P)
            A_b += _quadratic(r.P, C, dV_b, r.P) + cross + cross.transpose(0, 2, 1)
        volume, s = self._regions[0], self._s
        dV_b = volume.partial(fibres_b)[1]
        s_b = along(volume.shape, (self._fibres.offsets,), (fibres_b.offsets,))
        cross = _mass(self._rho, volume.dV, s_b, s)
        m_b += _mass(self._rho, dV_b, s, s) + cross + cross.transpose(0, 2, 1)
        return A_b, m_b


def _stiffness(own: Batch) -> tuple[Array, ...]:
    C = own.stiffness
    if not own.energy.assumed_strains:
        return C
    turns = turn_stiffness(own.d, *own.moduli, own.kind.straight)
    return tuple(_with_diagonal(x, turns * k) for x, k in zip(C, (1.0, 0.0), strict=False))


def _with_diagonal(C: Array, more: Array) -> Array:
    """Add rows and columns with a diagonal, shape (n, n_more), to C."""
    n_v, size = C.shape[1], C.shape[1] + more.shape[1]
    whole = np.zeros((len(C), size, size), dtype=C.dtype)
    whole[:, :n_v, :n_v] = C
    rows = np.arange(n_v, size)
    whole[:, rows, rows] = more
    return whole


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


# Planar shear-deformable beam, 12 coordinates (Omar & Shabana 2001; eqs. 7-8), with the node
# vectors X = [r_1, r_x1, r_y1, r_2, r_x2, r_y2]. The section extends over `height` in y.
BEAM_2D = ContinuumBeam("BEAM_2D", 2)
# Spatial fully parameterised beam, 24 coordinates (Yakoub & Shabana 2001), with the node vectors
# X = [r_1, r_x1, r_y1, r_z1, r_2, r_x2, r_y2, r_z2].
BEAM_3D = ContinuumBeam("BEAM_3D", 3)
