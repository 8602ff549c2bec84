"""A law of time: a gust."""

from dataclasses import dataclass

import numpy as np

from ancfdae import HHT, PointForce, RigidBody, Scene
from ancfdae.extend import Law, design_numbers
from ancfdae.observables import velocity

#: Polynomials by which the derivatives of exp(-x^2) multiply it.
HERMITE = ((1.0,), (-2.0, 0.0), (4.0, 0.0, -2.0), (-8.0, 0.0, 12.0, 0.0))


@dataclass(frozen=True)
class Gust(Law):
    """x = peak exp(-((t - time) / width)^2)."""

    peak: float
    time: float
    width: float

    design_fields = design_numbers("peak", "time", "width")

    def derivative(self, p, t, order):
        peak, time, width = p
        x = (t - time) / width
        return peak * np.polyval(HERMITE[order], x) * np.exp(-x * x) / width**order


leaf = RigidBody("leaf", (0.1, 0), mass=2.0, inertia=0.1)
wind = PointForce(leaf.at(0, 0), (3.0, 1.0), law=Gust(1.5, 0.1, 0.04), name="wind")
SCENE = Scene([], [], (0, -9.81), loads=[wind], bodies=[leaf])
DESIGN = ["wind.peak", "wind.time", "wind.width", "wind.force_x", "leaf.mass"]
OBSERVABLE, END, INTEGRATOR = velocity(leaf.at(0, 0), 0), 0.2, HHT(0.2 / 64)
