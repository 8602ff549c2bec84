"""What a beam is made of."""

from dataclasses import dataclass
from typing import final

from ancfdae.errors import InvalidInput, require_finite, require_positive


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
    InvalidInput
        If density or modulus is not finite and positive, or nu lies outside (-1, 0.5).
    """

    density: float
    youngs_modulus: float
    poisson_ratio: float
    damping_time: float = 0.0

    def __post_init__(self) -> None:
        require_positive("Material.density", self.density)
        require_positive("Material.youngs_modulus", self.youngs_modulus)
        require_finite("Material.poisson_ratio", self.poisson_ratio)
        if not -1.0 < self.poisson_ratio < 0.5:
            raise InvalidInput(
                "Material.poisson_ratio",
                "must lie in the open interval (-1, 0.5)",
                self.poisson_ratio,
                "At 0.5 the material is incompressible and the elastic moduli are infinite.",
            )
        require_finite("Material.damping_time", self.damping_time)
        if self.damping_time < 0:
            raise InvalidInput(
                "Material.damping_time",
                "must not be negative",
                self.damping_time,
                "Zero is undamped; a negative value would feed energy in.",
            )
