"""
An arm that follows a path
==========================

Two flexible links, a torque in each hinge. The torques are B-splines whose values are design
variables, so that bounds of the values bound the torque; least squares brings the tip to its path.
"""

import numpy as np
from scipy.optimize import least_squares

from ancfdae import (
    HHT, Beam, DesignVariable, Material, Misfit, MotorTorque, Pin, PointMass, Scene, simulate,
)
from ancfdae.laws import BSpline
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series, draw, save
from ancfdae.sections import Rectangle

t_end, count = 1.0, 8
alloy, bar = Material(2700, 7e10, 0.33, damping_time=1e-3), Rectangle(height=0.006, width=0.03)
lower = Beam("lower", (0, 0), (0.5, 0), 3, bar, alloy)
upper = Beam("upper", (0.5, 0), (1.0, 0), 3, bar, alloy)
joints = [Pin(lower.at_start), Pin(lower.at_end, upper.at_start)]
still = BSpline(0.0, t_end, (0.0,) * count)
motors = [
    MotorTorque(lower.at_start, 1.0, law=still, name="shoulder"),
    MotorTorque(upper.at_start, 1.0, other=lower.at_end, law=still, name="elbow"),
]
bodies = [PointMass(lower.at_end, 0.2), PointMass(upper.at_end, 0.1)]
scene = Scene([lower, upper], joints, loads=motors, bodies=bodies)

# %%
# The path: from the outstretched arm half way round a circle.

times = np.linspace(0.05, t_end, 16)
s = times / t_end
turned = np.pi / 2 * s**3 * (10 - 15 * s + 6 * s**2)
path = np.array([1.0 - 0.25 * (1 - np.cos(turned)), 0.5 * np.sin(turned)])
limits = (-1.5, 1.5)  # N m
design = [
    DesignVariable(f"{m.name}.value[{k}]", [f"{m.name}.value[{k}]"], limits)
    for m in motors for k in range(count)
]
misfit = Misfit([position(upper.at_end, i) for i in (0, 1)], times, path)
fit = misfit.fit(scene, t_end, HHT(2**-8), design=design)
found = least_squares(fit.residuals, fit.start, fit.jacobian, fit.bounds, gtol=None, max_nfev=25)
miss = np.linalg.norm(found.fun.reshape(2, -1), axis=0)
print(f"the tip misses its path by {1e3 * miss.max():.2f} mm at most")

# %%
# Where the tip goes.

moved = scene.with_values(dict(zip(fit.design_names, found.x, strict=True)))
tip = simulate(moved, t_end, HHT(2**-8)).position(upper.at_end)
lines = [Series("path", *path, line=False, marker=True), Series("tip", *tip.T)]
save(draw([Panel("Path of the tip", "x [m]", "y [m]", lines)]), "tracked_arm.png")
