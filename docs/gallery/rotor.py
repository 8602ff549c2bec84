"""
A rotor: Campbell diagram and critical speeds
=============================================

A shaft with a disc beside its middle. In the rotating frame modes of whirl part as it turns; where
one stands still in the frame, an unbalance excites it.
"""

import numpy as np

from ancfdae import (
    Beam, Clamp, Material, PointOnLine, RigidBody, RigidCylinder, RotatingFrame, Scene, Weld,
    campbell,
)
from ancfdae.sections import Circle

steel = Material(density=7850, youngs_modulus=2.1e11, poisson_ratio=0.3)
left = Beam("left", (0, 0, 0), (0, 0, 0.3), 3, Circle(0.012), steel)
right = Beam("right", (0, 0, 0.3), (0, 0, 1.0), 6, Circle(0.012), steel)
disc = RigidBody("disc", (0, 0, 0.3), shape=RigidCylinder(0.15, 0.02), density=7850)
hub = disc.at(0, 0, 0)
joints = [
    Clamp(left.at_start), Weld(left.at_end, hub), Weld(right.at_start, hub),
    PointOnLine(right.at_end, direction=(0, 0, 1)),
]
scene = Scene([left, right], joints, bodies=[disc], frame=RotatingFrame(0.0))

# %%
# Frequencies in the frame, and the rates at which a mode stands still there.

diagram = campbell(scene, np.arange(0.0, 1201.0, 100.0), 4)
print(diagram)
print("critical speeds [rad/s]:", diagram.critical_speeds.round(1))

# %%
# Seen at rest: lines of whirl that cross the rate are critical.

diagram.plot("rotor.png")
