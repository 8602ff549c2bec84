"""
A controller tuned with its arm
===============================

A PID turns a flexible arm up by one radian, against its weight. The gains are design variables;
the gradient goes through mechanism and controller alike.
"""

import numpy as np
from scipy.optimize import minimize

from ancfdae import (
    HHT, PID, Beam, Integral, Material, Pin, PointMass, Responses, Scene, assemble, simulate,
)
from ancfdae.laws import SmoothStep
from ancfdae.observables import effort, observe, position
from ancfdae.plotting import Panel, Series, draw, save
from ancfdae.sections import Rectangle

alloy = Material(2700, 7e10, 0.33, damping_time=1e-4)
arm = Beam("arm", (0, 0), (1, 0), 4, Rectangle(height=0.006, width=0.04), alloy)
servo = PID(arm.at_start, SmoothStep(0.0, 1.0, duration=0.3), 30.0, 60.0, 6.0, name="servo")
bodies = [PointMass(arm.at_end, 0.3)]
scene = Scene([arm], [Pin(arm.at_start)], (0, -9.81), loads=[servo], bodies=bodies)

# %%
# Cost: deviation of the tip from its target, and 1e-5 of the square of the torque.

x, y = position(arm.at_end, 0), position(arm.at_end, 1)
cost = Integral((x - np.cos(1)) ** 2 + (y - np.sin(1)) ** 2) + 1e-5 * Integral(effort("servo") ** 2)
gains = ["servo.proportional", "servo.integral", "servo.derivative"]
system = assemble(scene, gains)
model = Responses(system, {"cost": cost}, 1.5, HHT(2**-8), scale=system.b)
found = minimize(model["cost"], model.start, jac=model["cost"].gradient, method="SLSQP",
                 bounds=[(0.1, 10.0)] * 3, options={"ftol": 1e-5})
print(f"{found.fun / model['cost'](model.start):.3f} of the cost at gains", system.b * found.x)

# %%
# Height of the tip, and the torque, before and after.

panels = {"height [m]": [], "torque [N m]": []}
for label, b in (("before", system.b), ("tuned", system.b * found.x)):
    at = system.with_values(b)
    run = simulate(at, 1.5, HHT(2**-8))
    panels["height [m]"].append(Series(label, run.t, observe(y, run, at)))
    panels["torque [N m]"].append(Series(label, run.t, observe(effort("servo"), run, at)))
drawn = [Panel(label.split(" [")[0], "t [s]", label, lines) for label, lines in panels.items()]
save(draw(drawn, columns=2), "controller.png")
