"""
An arch that snaps through
==========================

A shallow arch, pinned at both ends, carries a force at its crown. Beyond a limit point there is no
equilibrium near. How large is that force, and what would raise it?
"""

import numpy as np

from ancfdae import CurvedBeam, Material, Pin, PointForce, Scene, critical_load, equilibrium
from ancfdae.plotting import BendingMoment, Panel, Series, draw, save, snapshots
from ancfdae.sections import Rectangle

steel = Material(density=7850, youngs_modulus=2.1e11, poisson_ratio=0.3)
bar = Rectangle(height=0.01, width=0.02)
arch = CurvedBeam.arc("arch", (-1, 0), (0, 0.06), (1, 0), 16, bar, steel)
supports = [Pin(arch.at_start), Pin(arch.at_end)]
crown = PointForce(arch.at(0.5), (0.0, 0.0), name="crown")
scene = Scene([arch], supports, loads=[crown])

# %%
# A limit point, or before it a bifurcation, where the arch gives way to one side.

snap = critical_load(scene, "crown.force_y", to=-20000.0, design=["arch.height", "arch.length"])
print(snap)

# %%
# The path up to there, and the arch beside the critical load.

loads = snap.value * np.linspace(0.0, 0.999, 15)
states = [equilibrium(scene.with_values({"crown.force_y": force})) for force in loads]
sag = [arch.positions[8, 1] - x.solution.position(arch.at(0.5))[0, 1] for x in states]
panel = Panel("Force at the crown", "sag [m]", "force [N]", [Series("arch", sag, -loads)])
save(draw([panel]), "arch_path.png")
bent = scene.with_values({"crown.force_y": loads[-1]})
before = states[-1].solution
save(snapshots(bent, before, colour=BendingMoment(), title="Before it snaps"), "arch.png")
