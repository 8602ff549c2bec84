"""Strain energies of continuum beams: elasticity matrices of the volume and of the axis.

Every energy is 1/2 int eps^T C eps dV, for some plus 1/2 int A eps^T C_axis eps dx with the strains
of the line of centroids; E and nu enter C only. Derivations: docs/theory/02-strain-energy.md.
"""

import abc
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_kind
from ancfdae.numerics.arrays import Array

# Value of 1 - 2 nu below which `_nearly_incompressible` bounds the bulk stiffness of sections.
_COMPRESSIBLE = 0.02


@dataclass(frozen=True)
class StrainEnergyFunction(abc.ABC):
    """Strain energy of a beam as a function of its strains.

    Parameters
    ----------
    assumed_strains : bool
        Whether strains that lock are replaced by interpolations that do not: thickness strains and
        shears linear between their values at the nodes, curvatures to match. Thin beams and large
        rotations then need far fewer elements, at the same cost per element.

    Attributes
    ----------
    dimensions : tuple of int
        Dimensions of space in which the energy can be used.
    corrected : bool
        Whether shear factors and torsion constants of the section count.
    """

    assumed_strains: bool = False

    dimensions: ClassVar[tuple[int, ...]] = (2, 3)
    corrected: ClassVar[bool] = False

    def __post_init__(self) -> None:
        where = f"{type(self).__name__}.assumed_strains"
        require_kind(where, self.assumed_strains, (bool,), "Use True or False.")

    def stress_across(self, d: int, nu: Array) -> Array:
        """Return the stress normal to the plane over S_xx + S_yy, shape (n,); 0 in plane stress."""
        return 0 * nu

    @abc.abstractmethod
    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """Return the elasticity matrix C in the volume, and, if the energy has one, C on the axis.

        Shape (n, n_v, n_v) each, Pa: normal strains first, then engineering shears.
        """


@final
@dataclass(frozen=True)
class SaintVenantKirchhoff(StrainEnergyFunction):
    """Full three-dimensional elasticity; plane strain in the plane (the source paper's).

    Sections stay flat, but Poisson's effect requires them to be curved in bending: a beam of
    Poisson's ratio 0.3 bends 1.35 times too stiffly however many elements it has. Right at nu = 0.
    Parameters are those of `StrainEnergyFunction`.
    """

    def stress_across(self, d: int, nu: Array) -> Array:
        """Return the stress normal to the plane over S_xx + S_yy, shape (n,): nu; zero in space."""
        return nu if d == 2 else 0 * nu

    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """Return the elasticity matrix of Lame's law, shape (n, n_v, n_v); Pa."""
        return (_isotropic(d, E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))),)


@final
@dataclass(frozen=True)
class PlaneStress(StrainEnergyFunction):
    """Plane stress, for planar beams that are free to contract across the plane.

    Bends 1/(1 - nu^2) times too stiffly, 1.10 at nu = 0.3, for the reason that holds for
    `SaintVenantKirchhoff`. Parameters are those of `StrainEnergyFunction`.
    """

    dimensions = (2,)

    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """Return the elasticity matrix of Lame's law in plane stress, shape (n, 3, 3); Pa."""
        return (_isotropic(2, E * nu / (1 - nu**2), E / (2 * (1 + nu))),)


@final
@dataclass(frozen=True)
class EnhancedContinuum(StrainEnergyFunction):
    """The split of Gerstmayr, Matikainen and Mikkola (2008), with section properties; the default.

    Poisson's effect counts on the axis only, where sections can follow it, so that beams bend with
    E I and stretch with E A; shears take the section's shear factors, torsion its torsion constant.
    In the plane it is plane stress. Above nu = 0.49 sections still contract by nu, but the
    stiffness that enforces it is at most 1.11 times its value at 0.49, instead of growing without
    bound: a beam needs E, G and nu, and no bulk stiffness.

    Parameters
    ----------
    assumed_strains : bool
        As in `StrainEnergyFunction`; here true by default.
    """

    assumed_strains: bool = True

    corrected = True

    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """Return C without Poisson's effect in the volume; on the axis the rest of Lame's law."""
        uncoupled = _isotropic(d, 0 * E, E / (2 * (1 + nu)))
        normal = np.arange(d)
        uncoupled[:, normal, normal] = E[:, None]
        (full,) = (SaintVenantKirchhoff() if d == 3 else PlaneStress()).stiffness(d, E, nu)
        if d == 3:
            soft = np.real(1 - 2 * nu) < _COMPRESSIBLE
            full[soft] = _nearly_incompressible(E[soft], nu[soft])
        return uncoupled, full - uncoupled


def _nearly_incompressible(E: Array, nu: Array) -> Array:
    """Return C of Lame's law with the bulk stiffness of sections bounded near nu = 1/2.

    For normal strains Lame's energy is 1/2 E e_x^2 + 1/2 K (e_y + e_z + 2 nu e_x)^2 + 1/2 G (e_y -
    e_z)^2 with K = E/(2 (1 + nu)(1 - 2 nu)). Uniaxial stress along x gives E and nu for any K. In K
    the compressibility u = 1 - 2 nu is replaced below u_o by u_o - w (1 - exp((u - u_o)/w)) with w
    = u_o/10, which continues u with its slope.
    """
    w = 0.1 * _COMPRESSIBLE
    u = _COMPRESSIBLE - w * (1 - np.exp((1 - 2 * nu - _COMPRESSIBLE) / w))
    G = E / (2 * (1 + nu))
    C = _isotropic(3, 0 * E, G)
    one, none = np.ones_like(nu), np.zeros_like(nu)
    C[:, :3, :3] = 0
    squares = (E, (one, none, none)), (G / u, (2 * nu, one, one)), (G, (none, one, -one))
    for stiffness, form in squares:
        row = np.stack(form, axis=1)
        C[:, :3, :3] += stiffness[:, None, None] * row[:, :, None] * row[:, None, :]
    return C


def _isotropic(d: int, kappa: Array, G: Array) -> Array:
    n_v = d * (d + 1) // 2
    normal, shear = np.arange(d), np.arange(d, n_v)
    C = np.zeros((len(G), n_v, n_v), dtype=np.result_type(kappa, G))
    C[:, :d, :d] = kappa[:, None, None]
    C[:, normal, normal] += 2 * G[:, None]
    C[:, shear, shear] = G[:, None]
    return C
