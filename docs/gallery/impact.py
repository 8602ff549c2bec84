"""
A rod that falls on a stop
==========================

Impacts end phases of the motion; velocities jump, and derivatives pass them exactly. The time of
the first impact and the height after it depend on the design.
"""

from ancfdae import (
    HHT, Beam, Impact, Material, Pin, PointMass, Scene, Terminal, differentiate, gradient,
)
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series, draw, save
from ancfdae.sections import Rectangle

rubber = Material(density=1000, youngs_modulus=2e8, poisson_ratio=0.3, damping_time=1e-3)
rod = Beam("rod", (0, 0), (1, 0), 4, Rectangle(0.03, 0.03), rubber)
mass = PointMass(rod.at_end, 1.0, name="tip")
scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81), bodies=[mass])
stop = Impact(position(rod.at_end, 1) + 0.3, restitution=0.7, name="stop")

# %%
# What happened, and how the times of impact move with the design.

design = ["rod.height", "tip.mass"]
run = differentiate(scene, 0.55, HHT(1e-3), design=design, events=[stop])
print(run)
first = run.events[0]
print(f"{first.name} at {first.time:.6f} s;", *design, first.time_b, "s per m, s per kg")
height = Terminal(position(rod.at_end, 1))
print(gradient(scene, height, 0.55, HHT(1e-3), design=design, events=[stop]))

# %%
# Height of the tip and of the middle of the rod.

points = {"tip": rod.at_end, "middle": rod.at(0.5)}
lines = [Series(name, run.t, run.position(point)[:, 1]) for name, point in points.items()]
lines.append(Series("stop", [0.0, run.t[-1]], [-0.3, -0.3], dashed=True))
save(draw([Panel("A rod on a stop", "t [s]", "height [m]", lines)]), "impact.png")
