"""
6. What matters in the design
=============================

Every number of a mechanism is a design variable by name: sections, materials, lengths, places of
joints, the motor's speed. One run gives the gradient with respect to all of them.
"""

import numpy as np

from ancfdae import (
    HHT, Adjoint, Beam, DesignVariable, Integral, Material, Pin, PointMass, PointOnLine,
    RotationDriver, Scene, SmoothMaximum, distributed_variables, gradients,
)
from ancfdae.laws import ConstantAcceleration
from ancfdae.observables import design_value, elapsed_time, maximum_von_mises, position
from ancfdae.sections import Rectangle
from ancfdae.plotting import gradient_bars, save

nylon = Material(1150, 2.5e9, 0.4, damping_time=1e-4)
crank = Beam("crank", (0, 0), (0.15, 0), 1, Rectangle(0.03, 0.02), nylon, rigid=True)
rod = Beam("rod", crank.at_end, (0.4, 0), 4, Rectangle(0.012, 0.01), nylon)
joints = [
    Pin(crank.at_start, name="bearing"),
    RotationDriver(crank.at_start, ConstantAcceleration(60.0), name="motor"),
    Pin(crank.at_end, rod.at_start, name="elbow"),
    PointOnLine(rod.at_end, direction=(1, 0), name="slot"),
]
slider = PointMass(rod.at_end, 0.1, name="slider")
scene = Scene([crank, rod], joints, bodies=[slider], assemble=True)

# %%
# Two objectives: how far the slider strays from that of a rigid rod, and the largest stress.
# `SmoothMaximum` is a maximum over time that has a derivative. `design_value` lets the ideal know
# the speed.

turned = design_value("motor.speed") * elapsed_time()
ideal = 0.15 * np.cos(turned) + np.sqrt(0.4**2 - (0.15 * np.sin(turned)) ** 2)
strays = np.sqrt(Integral((position(rod.at_end, 0) - ideal) ** 2) / 0.105)
stress = SmoothMaximum(maximum_von_mises("rod", sharpness=1e-5) / 1e6, sharpness=10.0)  # MPa

design = ["rod.height", "rod.density", "rod.youngs_modulus", "slider.mass", "motor.speed"]
results = gradients(scene, [strays, stress], 0.105, HHT(5e-4), design=design)
print(f"strays by {1e3 * results[0].value:.3f} mm; largest stress {results[1].value:.2f} MPa")

# %%
# Numbers of different units are compared by what one per cent of each changes.

values = np.array([0.012, 1150, 2.5e9, 0.1, 60.0])
for name, value, a, b in zip(design, values, results[0].gradient, results[1].gradient, strict=True):
    print(f"1 % of {name:20s} {1e6 * 0.01 * value * a: .2f} um {0.01 * value * b: .3f} MPa")

# %%
# `distributed_variables` makes one variable for each element. With many variables the adjoint is
# the cheaper way to the same numbers: one pass backward for each objective, however many variables
# there are.

heights = distributed_variables("rod.height", 4)
profile = gradients(scene, [stress], 0.105, HHT(5e-4), design=heights, method=Adjoint())
title = "Where height raises the stress (up) and where it lowers it (down)"
save(gradient_bars(scene, profile[0], "rod.height", time=0.03, title=title), "step_6")

# %%
# One variable may drive several numbers: a size that changes height and width together.

size = DesignVariable("size", {"rod.height": 1.0, "rod.width": 1.0})
print(gradients(scene, [stress], 0.105, HHT(5e-4), design=[size])[0].gradient, "MPa per m")
