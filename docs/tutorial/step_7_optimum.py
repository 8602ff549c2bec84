"""
7. The optimum under constraints
================================

The lightest rod whose slider strays by 0.1 mm at most (root mean square) and whose stress stays
below 4.3 MPa. Its height may vary from element to element. SciPy searches; values and exact
gradients come from one run for each design.
"""

import numpy as np
from scipy.optimize import minimize

from ancfdae import (
    HHT, Beam, Integral, Material, Pin, PointMass, PointOnLine, Responses, RotationDriver, Scene,
    SmoothUpperBound, Terminal, assemble, distributed_variables, simulate,
)
from ancfdae.laws import ConstantAcceleration
from ancfdae.observables import elapsed_time, mass, maximum_von_mises, observe, position
from ancfdae.sections import Rectangle
from ancfdae.plotting import VonMisesStress, save, snapshots

nylon = Material(1150, 2.5e9, 0.4, damping_time=1e-4)
crank = Beam("crank", (0, 0), (0.15, 0), 1, Rectangle(0.03, 0.02), nylon, rigid=True)
rod = Beam("rod", crank.at_end, (0.4, 0), 4, Rectangle(0.012, 0.01), nylon)
joints = [
    Pin(crank.at_start, name="bearing"),
    RotationDriver(crank.at_start, ConstantAcceleration(60.0), name="motor"),
    Pin(crank.at_end, rod.at_start, name="elbow"),
    PointOnLine(rod.at_end, direction=(1, 0), name="slot"),
]
slider = PointMass(rod.at_end, 0.1, name="slider")
scene = Scene([crank, rod], joints, bodies=[slider], assemble=True)
turned = 60 * elapsed_time()
ideal = 0.15 * np.cos(turned) + np.sqrt(0.4**2 - (0.15 * np.sin(turned)) ** 2)
strays = np.sqrt(Integral((position(rod.at_end, 0) - ideal) ** 2) / 0.105)
stress = SmoothUpperBound(maximum_von_mises("rod", sharpness=5e-5) / 1e6, sharpness=50.0)  # MPa

# %%
# `Responses` makes functions of the design: the first question about a design runs it, and all
# others share that run. ``scale`` divides the variables, and every function is divided by its
# limit, so that the search sees numbers of order one.

system = assemble(scene, distributed_variables("rod.height", 4))
functions = {"mass": Terminal(mass("rod")) / 0.05, "strays": strays / 1e-4, "stress": stress / 4.3}
design = Responses(system, functions, 0.105, HHT(5e-4), scale=system.b)
print("uniform:", *functions, design.values(design.start).round(3))

# %%
# SciPy searches. Two constraints, both at most 1.

optimum = minimize(
    design["mass"],
    design.start,
    jac=design["mass"].gradient,
    method="SLSQP",
    bounds=[(0.4, 2.0)] * 4,
    constraints=[design.constraint("strays", upper=1.0), design.constraint("stress", upper=1.0)],
    options={"maxiter": 15, "ftol": 1e-4},
)
print(optimum.message, "in", optimum.nit, "steps")
print("optimum:", *functions, design.values(optimum.x).round(3))
print("heights:", (1e3 * optimum.x * system.b).round(2), "mm")
assert design["mass"](optimum.x) < 0.95 * design["mass"](design.start)
assert design["strays"](optimum.x) < 1.01 and design["stress"](optimum.x) < 1.01

# %%
# The rod is thick where it bends, in its middle, and thin at its pins. `SmoothUpperBound` lies
# above the stress at every instant, so that the limit is kept; `SmoothMaximum` lies below the
# largest.

heights = {f"rod.height[{k}]": h for k, h in enumerate(optimum.x * system.b)}
best = scene.with_values(heights)
solution = simulate(best, 0.105, HHT(5e-4))
largest = observe(maximum_von_mises("rod", sharpness=5e-5), solution, assemble(best)).max()
print(f"largest stress: {largest / 1e6:.2f} MPa")
assert largest < 4.3e6
picture = snapshots(best, solution, [0.0, 0.03], VonMisesStress(), "The optimum")
save(picture, "step_7")

# %%
# Next: :doc:`/howto/index` for choices, :doc:`/other-tools` for OpenMDAO, JAX and PyTorch,
# :doc:`/geometry` for places and lengths as variables.
