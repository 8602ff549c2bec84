"""
3. Derivatives of a motion
==========================

How does the whole motion change with the design? `differentiate` answers for every instant,
`gradient` for one number.
"""

import numpy as np

from ancfdae import (
    HHT, Beam, Integral, Material, Pin, Scene, assemble, differentiate, gradient, taylor_test,
)
from ancfdae.observables import deflection
from ancfdae.sections import Rectangle
from ancfdae.plotting import history, save

rubber = Material(density=1100, youngs_modulus=5e6, poisson_ratio=0.45)
beam = Beam("beam", (0, 0), (0.4, 0), 4, Rectangle(0.02, 0.02), rubber)
scene = Scene([beam], [Pin(beam.at_start)], gravity=(0, -9.81))
design = ["beam.height", "beam.youngs_modulus"]
solution = differentiate(scene, 0.5, HHT(2**-9), design=design)

# %%
# ``derivative`` takes a point, or any function of a solution; without the name of a variable its
# last axis counts them. Times one per cent of the height, it says how far the tip moves if the
# height is one per cent larger.

r_b = solution.derivative(beam.at_end, "beam.height")
change = 0.01 * 0.02 * r_b[:, 1]
print(f"one per cent of height moves the tip by up to {1e3 * abs(change).max():.2f} mm")

# %%
# `history` draws observables with bands: their change if a variable changes by `percent` per cent.

system = assemble(scene, design)
bending = {"deflection of the tip [m]": deflection(beam.at_end, beam.at_start)}
save(history(system, solution, bending, percent=10), "step_3")

# %%
# An objective is one number of a run: here how much the beam bends, the root of the mean square
# of the tip's deflection from the tangent at the hinge. Observables combine by arithmetic.

bent = np.sqrt(Integral(deflection(beam.at_end, beam.at_start) ** 2) / 0.5)
result = gradient(scene, bent, 0.5, HHT(2**-9), design=design)
print(f"bends by {1e3 * result.value:.3f} mm")
for name, slope in zip(result.names, result.gradient, strict=True):
    print(f"d/d({name}) = {slope: .4e}")

# %%
# `taylor_test` verifies a gradient by runs at changed designs. The
# remainder must decrease with the square of the change: its order is 2.

tested = taylor_test(scene, bent, 0.5, HHT(2**-9), design=design)
print(f"order of the remainder: {tested.order:.3f}")
