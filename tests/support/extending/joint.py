"""A joint: a pantograph, by which a point copies the path of another one."""

from dataclasses import dataclass

import numpy as np

from ancfdae import HHT, Beam, Material, Pin, RigidBody, Scene
from ancfdae.extend import Joint, JointEquations, MaterialPoint, design_numbers, empty_equations
from ancfdae.observables import position
from ancfdae.sections import Rectangle


@dataclass(frozen=True)
class Pantograph(Joint):
    """The displacement of the other point is `ratio` times that of the point."""

    point: MaterialPoint
    other: MaterialPoint
    ratio: float = 1.0

    kind = "pantograph"
    design_fields = design_numbers("ratio")

    def coefficients(self, p, reference) -> JointEquations:
        (ratio,) = self.split(p)
        axes = np.arange(reference.shape[1])
        c = empty_equations(len(axes), p, reference)
        c.linear[axes, 0, axes] = ratio
        c.linear[axes, 1, axes] = -1.0
        c.offset[axes] = ratio * reference[0] - reference[1]
        return c


rod = Beam("rod", (0, 0), (0.8, 0.1), 2, Rectangle(0.04, 0.03), Material(2000, 1e7, 0.3))
pen = RigidBody("pen", (1, 1), mass=0.5, inertia=0.01)
copier = Pantograph(rod.at(0.7), pen.at(0.1, 0.0), ratio=1.5, name="copier")
SCENE = Scene([rod], [Pin(rod.at_start), copier], (0, -9.81), bodies=[pen])
DESIGN = ["copier.ratio", "pen.mass", "rod.height", "rod.length"]
OBSERVABLE, END, INTEGRATOR = position(rod.at_end, 1), 0.125, HHT(2.0**-7)
