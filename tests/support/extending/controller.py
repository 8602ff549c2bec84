"""A controller: proportional and derivative action with a filter, and a torque that saturates."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ancfdae import HHT, Beam, Material, Pin, Scene
from ancfdae.extend import (
    LAW_FIELD,
    Controller,
    ControllerInput,
    Law,
    MaterialPoint,
    RotationAxis,
    design_numbers,
    require_law,
)
from ancfdae.laws import Harmonic
from ancfdae.observables import position
from ancfdae.sections import Rectangle


@dataclass(frozen=True)
class FilteredPD(Controller):
    """T = T_m tanh((P e + D (e - x) / tau) / T_m) with x' = (e - x) / tau, e the error."""

    point: MaterialPoint
    reference: Law
    proportional: float
    derivative: float
    filter_time: float
    largest_torque: float

    kind = "filtered-pd"
    states = ("filtered",)
    design_fields = (
        ("reference", require_law),
        *design_numbers("proportional", "derivative", "filter_time", "largest_torque"),
        LAW_FIELD,
    )

    def axes(self, p) -> tuple[RotationAxis, ...]:
        return (RotationAxis(self.point),)

    def start(self, p) -> Sequence[Any]:
        return [self.reference.derivative(self.split(p)[0], 0.0, 0)]

    def equations(self, at: ControllerInput, p) -> tuple[Sequence[Any], Sequence[Any]]:
        _, P, D, tau, most, _ = self.split(p)
        error = at.laws[0] - at.coordinates[0]
        rate = (error - at.states[0]) / tau
        return [rate], [most * np.tanh((P * error + D * rate) / most)]


arm = Beam(
    "arm", (0, 0), (0.4, 0), 2, Rectangle(0.01, 0.02), Material(2700, 7e8, 0.3, damping_time=2e-3)
)
servo = FilteredPD(arm.at_start, Harmonic(0.4, 9.0, 1.0), 6.0, 0.4, 0.02, 0.8, name="servo")
SCENE = Scene([arm], [Pin(arm.at_start)], loads=[servo])
DESIGN = ["servo.proportional", "servo.derivative", "servo.filter_time", "servo.amplitude"]
DESIGN += ["servo.largest_torque", "arm.height"]
OBSERVABLE, END, INTEGRATOR = position(arm.at_end, 1), 2.0**-4, HHT(2.0**-11)
