"""The material of beams: density, elastic constants and damping."""

import warnings
from dataclasses import dataclass
from typing import final

from ancfdae.errors.checks import require_finite, require_positive
from ancfdae.errors.kinds import InvalidInputError, UnlikelyValueWarning

# A density above _DENSE that exceeds _HEAVY times the modulus is taken for a modulus, unless the
# modulus is above _LIGHT. If the numbers of steel are exchanged, the ratio is 3e7; soft rubber in
# kg and km has 1,000. No solid has a density above 2.3e4 kg/m^3.
_DENSE, _HEAVY, _LIGHT = 1e5, 2e3, 3e4


@final
@dataclass(frozen=True)
class Material:
    """Isotropic St. Venant-Kirchhoff material.

    Parameters
    ----------
    density : float
        Mass density rho; kg/m^3.
    youngs_modulus : float
        Young's modulus E; N/m^2.
    poisson_ratio : float
        Poisson's ratio nu, in the open interval (-1, 0.5).
    damping_time : float
        Retardation time tau of Kelvin-Voigt damping, stress = C (E + tau dE/dt); s. Zero, the
        default, costs nothing.

    Raises
    ------
    InvalidInputError
        If density or modulus is not finite and positive, or nu lies outside (-1, 0.5).

    Warns
    -----
    UnlikelyValueWarning
        If the density looks like a modulus: it is above 1e5 and 2,000 times the modulus, which is
        at most 3e4.
    """

    density: float
    youngs_modulus: float
    poisson_ratio: float
    damping_time: float = 0.0

    def __post_init__(self) -> None:
        require_positive("Material.density", self.density)
        require_positive("Material.youngs_modulus", self.youngs_modulus)
        E = self.youngs_modulus
        if self.density > _DENSE and self.density > _HEAVY * E and E <= _LIGHT:
            warnings.warn(
                f"Material: the density, {self.density:g}, looks like a modulus and Young's "
                f"modulus, {self.youngs_modulus:g}, like a density. The order is Material(density, "
                "youngs_modulus, poisson_ratio).",
                UnlikelyValueWarning,
                stacklevel=3,
            )
        require_finite("Material.poisson_ratio", self.poisson_ratio)
        if not -1.0 < self.poisson_ratio < 0.5:
            raise InvalidInputError(
                "Material.poisson_ratio",
                "must lie in the open interval (-1, 0.5)",
                self.poisson_ratio,
                "At 0.5 the material is incompressible and the elastic moduli are infinite.",
            )
        require_finite("Material.damping_time", self.damping_time)
        if self.damping_time < 0:
            raise InvalidInputError(
                "Material.damping_time",
                "must not be negative",
                self.damping_time,
                "Zero is undamped; a negative value would feed energy in.",
            )
