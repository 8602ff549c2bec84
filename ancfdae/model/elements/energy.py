"""Strain energies of continuum beams: how stress follows from strain, and where strains count.

Every energy is 1/2 int eps^T C eps dV, plus for some 1/2 int A eps^T C_axis eps dx with the strains
of the line of centroids; E and nu enter C only. Derivations: docs/theory/02-strain-energy.md.
"""

import abc
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.errors import require_kind
from ancfdae.numerics.arrays import Array


@dataclass(frozen=True)
class StrainEnergy(abc.ABC):
    """How a beam resists strain.

    Parameters
    ----------
    assumed_strains : bool
        Whether strains that lock are replaced by interpolations that do not: thickness strains and
        shears linear between their values at the nodes, curvatures to match. Thin beams and large
        rotations then need far fewer elements, at the same price.

    Attributes
    ----------
    dimensions : tuple of int
        Dimensions of space that it is meant for.
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
        """Return the stress across the plane over S_xx + S_yy, shape (n,); none in plane stress."""
        return 0 * nu

    @abc.abstractmethod
    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """Return C in the volume, and C on the axis where there is such a part.

        Shape (n, n_v, n_v) each: normal strains first, then engineering shears.
        """


@final
@dataclass(frozen=True)
class SaintVenantKirchhoff(StrainEnergy):
    """Full three-dimensional elasticity; plane strain in the plane (the source paper's).

    Sections stay flat, but Poisson's effect requires them to be curved in bending: a beam of
    Poisson's ratio 0.3 bends 1.35 times too stiffly however many elements it has. Right at nu = 0.
    Parameters are those of `StrainEnergy`.
    """

    def stress_across(self, d: int, nu: Array) -> Array:
        """Return that of plane strain."""
        return nu if d == 2 else 0 * nu

    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """Lame's law."""
        return (_isotropic(d, E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))),)


@final
@dataclass(frozen=True)
class PlaneStress(StrainEnergy):
    """Plane stress, for planar beams that are free to contract across the plane.

    Bends 1/(1 - nu^2) times too stiffly, 1.10 at nu = 0.3, for the reason that holds for
    `SaintVenantKirchhoff`. Parameters are those of `StrainEnergy`.
    """

    dimensions = (2,)

    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """Lame's law without stress across the plane."""
        return (_isotropic(2, E * nu / (1 - nu**2), E / (2 * (1 + nu))),)


@final
@dataclass(frozen=True)
class EnhancedContinuum(StrainEnergy):
    """The split of Gerstmayr, Matikainen and Mikkola (2008), with section properties; the default.

    Poisson's effect counts on the axis only, where sections can follow it, so that beams bend with
    E I and stretch with E A; shears take the section's shear factors, torsion its torsion constant.
    Plane stress in the plane.

    Parameters
    ----------
    assumed_strains : bool
        As in `StrainEnergy`; here true by default.
    """

    assumed_strains: bool = True

    corrected = True

    def stiffness(self, d: int, E: Array, nu: Array) -> tuple[Array, ...]:
        """E and G without Poisson's effect; on the axis what is missing to the full law."""
        uncoupled = _isotropic(d, 0 * E, E / (2 * (1 + nu)))
        normal = np.arange(d)
        uncoupled[:, normal, normal] = E[:, None]
        (full,) = (SaintVenantKirchhoff() if d == 3 else PlaneStress()).stiffness(d, E, nu)
        return uncoupled, full - uncoupled


def _isotropic(d: int, kappa: Array, G: Array) -> Array:
    n_v = d * (d + 1) // 2
    normal, shear = np.arange(d), np.arange(d, n_v)
    C = np.zeros((len(G), n_v, n_v), dtype=np.result_type(kappa, G))
    C[:, :d, :d] = kappa[:, None, None]
    C[:, normal, normal] += 2 * G[:, None]
    C[:, shear, shear] = G[:, None]
    return C
