"""
5. A mechanism of your own
==========================

A crank turns, a soft connecting rod drives a slider: two beams, a pin to ground, a pin between the
beams, a line for the slider and a motor. ``start=crank.at_end`` puts the rod on the crank's end,
``assemble=True`` lets the scene put itself together.
"""

import numpy as np

from ancfdae import (
    HHT, Beam, Material, Pin, PointMass, PointOnLine, RotationDriver, Scene, assemble, simulate,
)
from ancfdae.laws import ConstantAcceleration
from ancfdae.observables import driver_torque, maximum_von_mises, observe
from ancfdae.sections import Rectangle
from ancfdae.plotting import Panel, Series, VonMisesStress, animate, draw, save, snapshots

nylon = Material(density=1150, youngs_modulus=2.5e9, poisson_ratio=0.4, damping_time=1e-4)
crank = Beam("crank", (0, 0), (0.15, 0), 1, Rectangle(0.03, 0.02), nylon, rigid=True)
rod = Beam("rod", crank.at_end, (0.4, 0), 4, Rectangle(0.012, 0.01), nylon)
joints = [
    Pin(crank.at_start, name="bearing"),
    RotationDriver(crank.at_start, ConstantAcceleration(speed=60.0), name="motor"),  # rad/s
    Pin(crank.at_end, rod.at_start, name="elbow"),
    PointOnLine(rod.at_end, direction=(1, 0), name="slot"),
]
scene = Scene(
    [crank, rod],
    joints,
    bodies=[PointMass(rod.at_end, 0.1, name="slider")],
    assemble=True,
)
solution = simulate(scene, 0.21, HHT(5e-4))  # two turns
print(solution.outcome)

# %%
# Look at it before anything else. A scene without a solution is drawn as declared, which shows
# joints that do not meet; with a solution, at several instants.

times = np.linspace(0, 0.084, 5)
save(snapshots(scene, solution, times, VonMisesStress(), "A slider-crank"), "step_5_motion")

# %%
# The film is a GIF, an MP4 where ffmpeg is installed, or a page that needs nothing but a browser.

animate(scene, solution, "step_5.gif", VonMisesStress(), frames=36, dpi=60)
animate(scene, solution, "step_5.html", VonMisesStress())

# %%
# What the slider does, what the motor must do, and what the rod suffers.

system = assemble(scene)
slider = solution.position(rod.at_end)[:, 0]
rigid = 0.15 * np.cos(60 * solution.t) + np.sqrt(0.4**2 - (0.15 * np.sin(60 * solution.t)) ** 2)
torque = observe(driver_torque("motor"), solution, system)
stress = observe(maximum_von_mises("rod", sharpness=1e-5), solution, system)
print(f"the slider strays by up to {1e3 * abs(slider - rigid).max():.2f} mm from a rigid rod's")
print(f"the motor needs up to {abs(torque).max():.2f} N m; stress {stress.max() / 1e6:.1f} MPa")
strays = Series("deviation", solution.t, 1e3 * (slider - rigid))
loaded = Series("stress", solution.t, stress / 1e6)
panels = [
    Panel("Slider against that of a rigid rod", "time [s]", "deviation [mm]", [strays]),
    Panel("Largest stress in the rod", "time [s]", "stress [MPa]", [loaded]),
]
save(draw(panels, columns=2), "step_5_curves")
