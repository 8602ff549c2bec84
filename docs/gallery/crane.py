"""
A crane that sets its load down at rest
=======================================

A trolley moves by 4 m while the winch lifts the load by 1 m, and the load swings on. Both are
B-splines whose values are design variables: with other values the load hangs still on arrival.
"""

import numpy as np
from scipy.optimize import least_squares

from ancfdae import (
    HHT, Prismatic, Pulley, Responses, RigidBody, Rope, Scene, Terminal, TranslationDriver,
    simulate,
)
from ancfdae.laws import BSpline
from ancfdae.observables import position, velocity
from ancfdae.plotting import Panel, Series, draw, save

t_end, count, arrival = 4.0, 10, 4.0  # s, values, m
s = np.linspace(0, 1, count)
rise = s**2 * (3 - 2 * s)
travel, payout = (BSpline(0.0, t_end, tuple(x * rise)) for x in (arrival, -1.0))  # m
trolley = RigidBody("trolley", (0, 0), mass=50.0, inertia=5.0)
load = RigidBody("load", (0.1, -3), mass=200.0, inertia=20.0)
sheave, winch = Pulley(trolley.origin, 0.1, clockwise=True), trolley.at(-0.5, 0)
rope = Rope(winch, load.origin, [sheave], stiffness=1e6, damping=5e4, payout=payout, name="rope")
way = TranslationDriver(trolley.origin, (1, 0), travel, name="way")
rails = [Prismatic(trolley.origin, (1, 0)), way]
scene = Scene([], rails, (0, -9.81), loads=[rope], bodies=[trolley, load])

# %%
# The speed of the load, and its distance from the place below the sheave, all at the end.

off = 1.8 * (position(load.origin, 0) - (arrival + 0.1))  # m/s: times the frequency of the swing
left = {"x": velocity(load.origin, 0), "y": velocity(load.origin, 1), "off": off}
design = [f"{x}.value[{k}]" for x in ("way", "rope") for k in range(2, count - 2)]
goals = {name: Terminal(value) for name, value in left.items()}
crane = Responses(scene, goals, t_end, HHT(2**-6), design=design)
bounds = crane.start - 1.0, crane.start + 1.0
found = least_squares(crane.values, crane.start, crane.jacobian, bounds)
before, after = np.linalg.norm(crane.values(crane.start)), np.linalg.norm(found.fun)
print(f"left at the end: {before:.2f} m/s, then {after:.0e} m/s")

# %%
# After the end the load stays where it is.

lines = []
for label, values in (("smooth laws", crane.start), ("best laws", found.x)):
    moved = scene.with_values(dict(zip(design, values, strict=True)))
    run = simulate(moved, 8.0, HHT(2**-6))
    lines.append(Series(label, run.t, run.position(load.origin)[:, 0]))
save(draw([Panel("A load on a crane", "t [s]", "place of the load [m]", lines)]), "crane.png")
