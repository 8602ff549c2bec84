"""A contact law: a bumper whose force grows with the depth and its square."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ancfdae import HHT, Beam, Clamp, Material, Scene
from ancfdae.extend import LAW_FIELD, Load, MaterialPoint, Quantity, design_numbers, positive
from ancfdae.observables import position
from ancfdae.sections import Rectangle


@dataclass(frozen=True)
class Bumper(Load):
    """F_y = k d + k d^2 / w on a point at the depth d below a height; k in N/m, w in m."""

    point: MaterialPoint
    height: float
    stiffness: float
    width: float

    kind = "bumper"
    elastic = True
    touches = True
    design_fields = (*design_numbers("height", "stiffness", "width"), LAW_FIELD)

    def vectors(self, elements) -> tuple[tuple[MaterialPoint, Quantity], ...]:
        return ((self.point, Quantity.POSITION),)

    def force(self, U: Any, V: Any, p, U_o) -> Any:
        height, k, w, _ = self.split(p)
        d = positive(height - U[..., :, 1:2])
        return k * (d + d * d / w) * np.array([0.0, 1.0])


reed = Beam("reed", (0, 0), (0.3, 0), 2, Rectangle(0.004, 0.01), Material(7800, 2e10, 0.3))
# It is pressed onto the stop at the start, and leaves it.
stop = Bumper(reed.at_end, 1e-4, 2e3, 1e-3, name="stop")
SCENE = Scene([reed], [Clamp(reed.at_start)], loads=[stop])
DESIGN = ["stop.height", "stop.stiffness", "stop.width", "reed.height"]
OBSERVABLE, END, INTEGRATOR = position(reed.at_end, 1), 2.0**-6, HHT(2.0**-10)
