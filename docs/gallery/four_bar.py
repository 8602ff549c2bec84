"""
A four-bar sized for stress
===========================

A crank at a constant rate drives a coupler and a rocker that bend. How light may they be if the
stress stays below 60 MPa? SciPy asks for value and gradient; the bound of the stress is smooth.
"""

import numpy as np
from scipy.optimize import minimize

from ancfdae import (
    HHT, Beam, Material, Pin, Responses, RotationDriver, Scene, SmoothUpperBound, Terminal,
    assemble, simulate,
)
from ancfdae.laws import RunUp
from ancfdae.observables import mass, maximum_von_mises
from ancfdae.plotting import VonMisesStress, save, snapshots
from ancfdae.sections import Rectangle

alloy, bar = Material(2700, 7e10, 0.33, damping_time=2e-4), Rectangle(height=0.02, width=0.02)
crank = Beam("crank", (0, 0), (0.1, 0.1), 1, bar, alloy, rigid=True)
coupler = Beam("coupler", (0.1, 0.1), (0.8, 0.5), 4, bar, alloy)
rocker = Beam("rocker", (0.8, 0.5), (0.8, 0.0), 4, bar, alloy)
joints = [
    Pin(crank.at_start), RotationDriver(crank.at_start, RunUp(30.0, duration=0.1)),
    Pin(crank.at_end, coupler.at_start), Pin(coupler.at_end, rocker.at_start), Pin(rocker.at_end),
]
scene = Scene([crank, coupler, rocker], joints)

# %%
# Stress is a function of the state; its largest value over a beam and over time is bounded from
# above, so that the optimum is safe.

names = ("coupler", "rocker")
stress = {x: SmoothUpperBound(maximum_von_mises(x, 1e-7) / 60e6, 40.0) for x in names}
functions = stress | {"mass": Terminal(mass("coupler") + mass("rocker"))}
system = assemble(scene, [f"{x}.height" for x in names])
model = Responses(system, functions, 0.35, HHT(2**-10), scale=system.b)
found = minimize(
    model["mass"], model.start, jac=model["mass"].gradient, method="SLSQP",
    bounds=[(0.2, 2.0)] * 2, constraints=[model.constraint(x, upper=1.0) for x in names],
    options={"maxiter": 12, "ftol": 1e-4},
)
print(f"{1e3 * model['mass'](model.start):.0f} g -> {1e3 * found.fun:.0f} g")
print("heights [mm]:", (1e3 * system.b * found.x).round(2))
print("stress [MPa]:", [round(60 * model[x](found.x), 1) for x in names])

# %%
# The mechanism at the optimum, coloured by its stress.

light = scene.with_values(dict(zip(model.design_names, system.b * found.x, strict=True)))
run = simulate(light, 0.35, HHT(2**-10))
times = np.linspace(0.12, 0.3, 5).tolist()
save(snapshots(light, run, times, VonMisesStress(), "Sized for 60 MPa"), "four_bar.png")
