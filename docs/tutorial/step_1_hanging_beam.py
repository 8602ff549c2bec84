"""
1. A hanging beam and its first gradient
========================================

A rubber beam sticks out of a wall and hangs under its own weight. How far does the tip sag, and
what would a millimetre of height change?

A scene is made of beams, joints and gravity. Numbers are in any consistent set of units; here SI:
m, kg, s, N, Pa.
"""

from ancfdae import Beam, Clamp, Material, Scene, equilibrium, equilibrium_gradient
from ancfdae.observables import position
from ancfdae.sections import Rectangle
from ancfdae.plotting import VonMisesStress, save, snapshots

rubber = Material(density=1100, youngs_modulus=5e6, poisson_ratio=0.45)
beam = Beam(
    "beam", start=(0, 0), end=(0.4, 0), elements=4, section=Rectangle(0.02, 0.02), material=rubber
)
scene = Scene([beam], joints=[Clamp(beam.at_start)], gravity=(0, -9.81))

# %%
# `equilibrium` finds the state of rest. Its solution has one instant.

rest = equilibrium(scene)
print(rest.outcome)
sag = rest.solution.position(beam.at_end)[0]
print(f"the tip hangs at x = {sag[0]:.4f} m, y = {sag[1]:.4f} m")

# %%
# Linear beam theory, rho g A L^4 / (8 E I), knows no large rotations. It says:

weight = 1100 * 9.81 * 0.02**2  # N/m
print(f"{-weight * 0.4**4 / (8 * 5e6 * 0.02**4 / 12):.4f} m by linear theory")

# %%
# Any number of the scene can be a design variable, by name: ``beam.height``,
# ``beam.youngs_modulus``, ... The gradient is exact: it costs one linear solve, and no step has
# to be chosen.

names = ["beam.height", "beam.width", "beam.youngs_modulus", "beam.density"]
result = equilibrium_gradient(scene, position(beam.at_end, 1), design=names)
for name, slope in zip(names, result.gradient, strict=True):
    print(f"d(tip)/d({name}) = {slope: .4e}")

# %%
# One millimetre more of height should lift the tip by 0.001 times the first number. Does it?

higher = equilibrium(scene.with_values({"beam.height": 0.021})).solution.position(beam.at_end)[0]
print(f"predicted {0.001 * result.gradient[0]:.4f} m, computed {higher[1] - sag[1]:.4f} m")

# %%
# The width has (almost) no effect: it makes the beam stiffer and heavier alike. Prediction
# and result differ by the curvature of the function, not by an error of the gradient.
#
# `snapshots` draws a scene at rest or in motion, `save` writes the picture as SVG and PNG.

picture = snapshots(scene, rest.solution, colour=VonMisesStress(), title="A rubber beam at rest")
save(picture, "step_1")
