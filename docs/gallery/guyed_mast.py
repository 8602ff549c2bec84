"""
A mast and its guys
===================

A mast of beam elements stands in the wind, held by three guys of cable elements that sag under
their weight. Beams, cables and rigid bodies share a scene.
"""

import numpy as np

from ancfdae import (
    CABLE_3D, Beam, Clamp, DistributedForce, Material, Pin, Scene, equilibrium,
    equilibrium_gradient, modes,
)
from ancfdae.observables import axial_force, maximum_von_mises, position
from ancfdae.sections import Circle, Tube
from ancfdae.plotting import AxialForce, save, snapshots

steel = Material(density=7850, youngs_modulus=2.1e11, poisson_ratio=0.3)
rope = Material(density=7850, youngs_modulus=1.2e11, poisson_ratio=0.3)
mast = Beam("mast", (0, 0, 0), (0, 0, 30), 6, Tube(radius=0.06, thickness=0.006), steel)
guys, joints = [], [Clamp(mast.at_start, name="foot")]
for name, angle in zip("abc", np.radians([0, 120, 240]), strict=True):
    anchor = (18 * np.cos(angle), 18 * np.sin(angle), 0)
    guy = Beam(f"guy_{name}", anchor, (0, 0, 25), 8, Circle(0.007), rope, element=CABLE_3D)
    guys.append(guy)
    joints += [Pin(guy.at_start), Pin(guy.at_end, mast.at(5 / 6), name=f"collar_{name}")]
wind = DistributedForce("mast", (120, 40, 0), name="wind")  # N/m
scene = Scene([mast, *guys], joints, gravity=(0, 0, -9.81), loads=[wind])

# %%
# Where it stands, how each guy pulls, and how far it hangs below the straight line.

rest = equilibrium(scene)
print(rest.outcome)
for guy in guys:
    pull = equilibrium_gradient(scene, axial_force(guy.at(0.5)), design=["wind.force_x"])
    end, middle = (rest.solution.position(guy.at(x))[0, 2] for x in (1, 0.5))
    print(f"{guy.name}: {pull.value:.0f} N, {pull.gradient[0]:+.1f} N per N/m of wind")
    print(f"it hangs {end / 2 - middle:.3f} m below its chord")
save(snapshots(scene, rest.solution, colour=AxialForce(), title="A mast and its guys"), "mast")

# %%
# How it vibrates there: guys first, each in and across its plane.

print(modes(scene, 8, at=rest))

# %%
# What thicker guys or a thicker mast would change, at the top and in the stress of a guy.

design = ["mast.radius", "guy_a.radius", "guy_b.radius", "guy_c.radius"]
for observable in (position(mast.at_end, 0), maximum_von_mises("guy_b", 1e-6)):
    found = equilibrium_gradient(scene, observable, design=design)
    print(f"{found.value:.6g};", *found.names, found.gradient)
