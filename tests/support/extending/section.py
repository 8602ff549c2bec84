"""A cross-section: an ellipse."""

from dataclasses import dataclass

import numpy as np

from ancfdae import HHT, Beam, Clamp, Material, PointForce, Scene
from ancfdae.extend import Section, box_rule
from ancfdae.observables import position


@dataclass(frozen=True)
class Ellipse(Section):
    """A solid ellipse of a height and a width."""

    height: float
    width: float

    @property
    def half_extents(self):
        return self.height / 2, self.width / 2

    def points(self, sizes, fine):
        # Gauss points in the squared radius, equal angles: exact to degree 5 (fine: 11).
        radial, angular = (6, 12) if fine else (3, 6)
        corner, rule = box_rule((radial,))
        angle = 2 * np.pi * (np.arange(angular) + 0.5) / angular
        across, up = (np.outer(corner[:, 0] ** 0.5, f(angle)).ravel() for f in (np.sin, np.cos))
        area = np.pi / 4 * np.prod(sizes, axis=1)
        dA = np.outer(area, np.repeat(rule / angular, angular))
        return np.outer(sizes[:, 0] / 2, up), np.outer(sizes[:, 1] / 2, across), dA

    def outline(self, sizes):
        angle = 2 * np.pi * np.arange(16) / 16
        return np.outer(sizes[:, 0] / 2, np.cos(angle)), np.outer(sizes[:, 1] / 2, np.sin(angle))

    def shear(self, sizes, nu):
        factor = 6 * (1 + nu) / (7 + 6 * nu)  # That of a circle.
        return factor, factor

    def torsion(self, sizes):
        a, b = sizes.T / 2
        return np.pi * a**3 * b**3 / (a**2 + b**2)


mast = Beam("mast", (0, 0, 0), (0, 0, 1), 2, Ellipse(0.03, 0.02), Material(2700, 7e8, 0.3))
gale = PointForce(mast.at_end, (3.0, 1.0, 0.0), name="gale")
SCENE = Scene([mast], [Clamp(mast.at_start)], (0, 0, -9.81), loads=[gale])
DESIGN = ["mast.height", "mast.width", "mast.length", "gale.force_x"]
OBSERVABLE, END, INTEGRATOR = position(mast.at_end, 0), 0.0625, HHT(2.0**-7)
