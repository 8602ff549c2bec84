"""
A rope that is let go
=====================

A rope of cable elements hangs between two hooks; one lets go. Where it hangs is an equilibrium,
from which the motion starts.
"""

import numpy as np

from ancfdae import (
    CABLE_2D, HHT, Beam, EquilibriumStart, Material, Pin, PointForce, Scene, Terminal, equilibrium,
    gradient, simulate,
)
from ancfdae.observables import position
from ancfdae.sections import Circle
from ancfdae.plotting import AxialForce, save, snapshots

nylon = Material(density=1150, youngs_modulus=2e8, poisson_ratio=0.4, damping_time=2e-3)
rope = Beam("rope", (0, 0), (2, 0), 16, Circle(0.006), nylon, element=CABLE_2D)
hook = Pin(rope.at_start, name="hook")
weight = 1150 * np.pi * 0.006**2 * 2 * 9.81  # N, of the rope
hand = PointForce(rope.at_end, (0.5 * weight, 0.5 * weight), name="hand")

# %%
# Held by a hand that carries half the weight and pulls as much to the side.

held = Scene([rope], [hook], (0, -9.81), loads=[hand])
rest = equilibrium(held)
print(rest.outcome)
save(snapshots(held, rest.solution, colour=AxialForce(), title="A rope, held"), "rope_held")

# %%
# Let go: ``EquilibriumStart(loads=[hand])`` says what held it before the motion.

free = Scene([rope], [hook], (0, -9.81), start=[EquilibriumStart(loads=[hand])])
solution = simulate(free, 0.75, HHT(2**-9))
print(solution.outcome)
save(snapshots(free, solution, title="Let go"), "rope_free")

# %%
# How low is the end after 0.5 s, and what would a thicker rope, or a stronger pull, change?

end = Terminal(position(rope.at_end, 1))
result = gradient(free, end, 0.5, HHT(2**-9), design=["rope.radius", "hand.force_x"])
print(f"{result.value:.4f} m;", *result.names, result.gradient, "m per m, m per N")
