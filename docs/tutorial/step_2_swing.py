"""
2. Let it swing
===============

The clamp becomes a pin, and the beam falls as a flexible pendulum. `simulate` integrates the
motion. HHT is the integrator to start with; its step is chosen in step 4.
"""

from ancfdae import HHT, Beam, Material, Pin, Scene, assemble, simulate
from ancfdae.observables import kinetic_energy, observe, strain_energy
from ancfdae.sections import Rectangle
from ancfdae.plotting import Panel, Series, Speed, draw, save, snapshots

rubber = Material(density=1100, youngs_modulus=5e6, poisson_ratio=0.45)
beam = Beam("beam", (0, 0), (0.4, 0), 4, Rectangle(0.02, 0.02), rubber)
scene = Scene([beam], [Pin(beam.at_start, name="hinge")], gravity=(0, -9.81))
solution = simulate(scene, t_end=0.5, integrator=HHT(step=2**-9))
print(solution.outcome)

# %%
# A solution has the instants ``t`` and answers by points and names: positions, velocities, the
# force in a joint. An array has one row for each instant.

tip = solution.position(beam.at_end)
force = solution.reaction("hinge")
print(tip.shape, f"lowest point {tip[:, 1].min():.4f} m, largest force {abs(force).max():.3f} N")

# %%
# The motion in one picture; earlier instants are fainter.

save(snapshots(scene, solution, colour=Speed(), title="A rubber pendulum"), "step_2_motion")

# %%
# What can be observed can be plotted: here the energies, which add up to the work of gravity.

system = assemble(scene)
moving = observe(kinetic_energy(), solution, system)
strained = observe(strain_energy(), solution, system)
places = [Series("x", solution.t, tip[:, 0]), Series("y", solution.t, tip[:, 1])]
energies = [Series("kinetic", solution.t, moving), Series("strain", solution.t, strained)]
panels = [
    Panel("The tip falls", "time [s]", "place [m]", places),
    Panel("Energy of motion and of strain", "time [s]", "energy [J]", energies),
]
save(draw(panels, columns=2), "step_2_energy")

# %%
# A solution is written to a file by ``solution.save("swing.npz")`` and read back by
# ``load_solution("swing.npz")``. If a run cannot be finished, ``solution.outcome`` says when and
# why, and what was computed up to there is kept.
