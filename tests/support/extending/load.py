"""A load: two magnets that attract each other."""

from dataclasses import dataclass
from typing import Any

from ancfdae import HHT, Beam, Clamp, Material, RigidBody, Scene
from ancfdae.extend import (
    LAW_FIELD,
    Load,
    MaterialPoint,
    Quantity,
    concatenate,
    design_numbers,
    dot,
)
from ancfdae.observables import position
from ancfdae.sections import Rectangle


@dataclass(frozen=True)
class Magnet(Load):
    """F = -k e / (e^2 + gap^2)^2 on the point, e from the other one to it; k in N m3."""

    point: MaterialPoint
    other: MaterialPoint
    strength: float
    gap: float

    kind = "magnet"
    elastic = True
    design_fields = (*design_numbers("strength", "gap"), LAW_FIELD)

    def vectors(self, elements) -> tuple[tuple[MaterialPoint, Quantity], ...]:
        return tuple((point, Quantity.POSITION) for point in self.points)

    def force(self, U: Any, V: Any, p, U_o) -> Any:
        k, gap, _ = self.split(p)
        e = U[..., :1, :] - U[..., 1:, :]
        F = -k * e * (dot(e, e) + gap**2) ** -2.0
        return concatenate([F, -F])


reed = Beam("reed", (0, 0), (0.3, 0), 2, Rectangle(0.004, 0.01), Material(7800, 2e10, 0.3))
yoke = RigidBody("yoke", (0.3, -0.05), mass=0.2, inertia=1e-4)
coil = Magnet(reed.at_end, yoke.at(0.0, 0.01), 1e-3, 0.05, name="coil")
SCENE = Scene([reed], [Clamp(reed.at_start)], loads=[coil], bodies=[yoke])
DESIGN = ["coil.strength", "coil.gap", "yoke.mass", "reed.height"]
OBSERVABLE, END, INTEGRATOR = position(reed.at_end, 1), 2.0**-6, HHT(2.0**-10)
