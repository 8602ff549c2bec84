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
    HHT, Beam, Drive, Integral, Material, Pin, PointMass, PointOnLine, Rectangle, Scene,
    SmoothMaximum, Terminal, Uniform, assemble, distribution, gradients, mass, maximum_stress,
    position, time,
)

nylon = Material(1150, 2.5e9, 0.4, damping_time=1e-4)
crank = Beam("crank", (0, 0), (0.15, 0), 1, Rectangle(0.03, 0.02), nylon, rigid=True)
rod = Beam("rod", crank.at_end, (0.4, 0), 4, Rectangle(0.012, 0.01), nylon)
joints = [
    Pin(crank.at_start, name="bearing"),
    Drive(crank.at_start, Uniform(60.0), name="motor"),
    Pin(crank.at_end, rod.at_start, name="elbow"),
    PointOnLine(rod.at_end, direction=(1, 0), name="slot"),
]
slider = PointMass(rod.at_end, 0.1, name="slider")
scene = Scene([crank, rod], joints, bodies=[slider], assemble=True)
ideal = 0.15 * np.cos(60 * time()) + np.sqrt(0.4**2 - (0.15 * np.sin(60 * time())) ** 2)
strays = np.sqrt(Integral((position(rod.at_end, 0) - ideal) ** 2) / 0.105)
stress = SmoothMaximum(maximum_stress("rod", sharpness=1e-5) / 1e6, sharpness=10.0)  # MPa

system = assemble(scene, distribution("rod.height", 4))


# %%
# The variables are heights divided by their first value, so that all numbers the search sees are
# of order one. The last result is kept: objective and constraints ask for the same design.

kept = {}


def at(x):
    """Mass, what the slider strays and stress with their gradients; kg, m, MPa."""
    if kept.get("x") != x.tolist():
        found = gradients(
            system.with_values(0.012 * x), [Terminal(mass("rod")), strays, stress], 0.105, HHT(5e-4)
        )
        kept.update(x=x.tolist(), found=[(f.value, 0.012 * f.gradient) for f in found])
    return kept["found"]


uniform = np.ones(4)
(heavy, _), (strayed, _), (stressed, _) = at(uniform)
print(f"uniform: {1e3 * heavy:.1f} g, strays by {1e3 * strayed:.3f} mm, {stressed:.2f} MPa")
allowed, limit = 1e-4, 4.3  # m, MPa

found = minimize(
    lambda x: tuple(part / heavy for part in at(x)[0]),
    uniform,
    jac=True,
    method="SLSQP",
    bounds=[(0.4, 2.0)] * 4,
    constraints=[
        {
            "type": "ineq",
            "fun": lambda x: 1 - np.array([at(x)[1][0] / allowed, at(x)[2][0] / limit]),
            "jac": lambda x: -np.array([at(x)[1][1] / allowed, at(x)[2][1] / limit]),
        }
    ],
    options={"maxiter": 15, "ftol": 1e-4},
)
(light, _), (strayed, _), (stressed, _) = at(found.x)
print(found.message, "in", found.nit, "steps")
print(f"optimum: {1e3 * light:.1f} g, strays by {1e3 * strayed:.3f} mm, {stressed:.2f} MPa")
print("heights", (12 * found.x).round(2), "mm")
assert light < heavy and strayed < 1.01 * allowed and stressed < 1.01 * limit
