"""A PID controller of an angle."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_direction
from ancfdae.errors.kinds import UnlikelyValueWarning
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.design import design_numbers
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.loads.control_axes import RotationAxis
from ancfdae.model.loads.controller import Controller, ControllerInput
from ancfdae.model.loads.load import LAW_FIELD
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class PID(Controller):
    """A proportional-integral-derivative controller of an angle, by a torque on it.

    theta is the angle of the section at `point`, as a joint turns it, and r its reference. The
    torque is P e + I z + D e' with the error e = r - theta and the state ``integral`` z, z' = e.
    It acts on the section, and its opposite on `other`. The angle counts from the reference
    configuration and lies between -pi and pi. Design targets: ``proportional``, ``integral``,
    ``derivative``, ``axis_x`` ..., and the parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    reference : Law
        r; rad.
    proportional : float
        P; N m/rad.
    integral : float
        I; N m/(rad s).
    derivative : float
        D; N m s/rad.
    axis, other
        As in `MotorTorque`.
    """

    point: MaterialPoint
    reference: Law
    proportional: float
    integral: float = 0.0
    derivative: float = 0.0
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    kind = "pid"
    states = ("integral",)
    design_fields = (
        ("reference", require_law),
        *design_numbers("proportional", "integral", "derivative"),
        ("axis", require_direction),
        LAW_FIELD,
    )

    def axes(self, p: Array) -> tuple[RotationAxis, ...]:
        """Return the angle."""
        return (RotationAxis(self.point, self.split(p)[4], self.other),)

    def equations(self, at: ControllerInput, p: Array) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return z' = e and the torque P e + I z + D e'."""
        _, proportional, integral, derivative, *_ = self.split(p)
        e, e_t = at.laws[0] - at.coordinates[0], at.law_rates[0] - at.rates[0]
        return [e], [proportional * e + integral * at.states[0] + derivative * e_t]

    def check_laws(self, laws: Sequence[Array]) -> None:
        """Warn of a reference that the angle, between -pi and pi, cannot reach."""
        if np.max(np.abs(laws[0]), initial=0.0) > math.pi:
            warnings.warn(
                f"reference of pid {self.name!r} is beyond half a turn, where the angle jumps "
                "from pi to -pi: the controlled section does not follow it and may run away. "
                "Let the reference stay within -pi to pi, or turn it back.",
                UnlikelyValueWarning,
                stacklevel=2,
            )
