"""
A part of one's own: a magnet
=============================

A magnet on a leaf spring is drawn to another one on the wall: a load in twenty lines. Tangents,
design derivatives and targets follow from its formula.
"""

from dataclasses import dataclass

import numpy as np

from ancfdae import (
    HHT, Beam, Clamp, Integral, Material, PointMass, Scene, gradient, simulate,
)
from ancfdae.extend import LAW_FIELD, Load, MaterialPoint, Quantity, design_numbers, dot
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series, draw, save
from ancfdae.sections import Rectangle


@dataclass(frozen=True)
class Magnet(Load):
    """F = k d / (|d|^2 + a^2)^2 along d, from the point to a place on the wall; k in N m^3."""

    point: MaterialPoint
    x: float
    y: float
    strength: float
    size: float = 0.03

    kind = "magnet"
    design_fields = (*design_numbers("x", "y", "strength", "size"), LAW_FIELD)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION),)

    def force(self, U, V, p, U_o):
        x, y, k, a, _ = self.split(p)
        d = np.stack([x - U[0, 0], y - U[0, 1]])
        return np.stack([k * d / (dot(d, d) + a**2) ** 2])


# %%
# A leaf spring that hangs with its magnet, and starts from where gravity alone holds it.

steel = Material(7850, 2.1e11, 0.3, damping_time=1e-3)
leaf = Beam("leaf", (0, 0), (0, -0.4), 4, Rectangle(0.001, 0.02), steel)
pull = Magnet(leaf.at_end, 0.12, -0.4, 2e-4, name="magnet")
tip = PointMass(leaf.at_end, 0.05)
scene = Scene([leaf], [Clamp(leaf.at_start)], (0, -9.81), loads=[pull], bodies=[tip])
design = ["magnet.strength", "magnet.x", "leaf.height"]
print(gradient(scene, Integral(position(leaf.at_end, 0)), 2.0, HHT(2**-8), design=design))

# %%
# Weaker magnets let it swing, stronger ones catch it.

lines = []
for strength in (2e-4, 4e-4, 6e-4):
    run = simulate(scene.with_values({"magnet.strength": strength}), 2.0, HHT(2**-9))
    x = run.position(leaf.at_end)[:, 0]
    lines.append(Series(f"k = {strength:g}", run.t, x))
save(draw([Panel("Tip beside a magnet", "t [s]", "x [m]", lines)]), "magnet.png")
