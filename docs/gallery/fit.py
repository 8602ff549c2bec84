"""
Modulus and damping from a film
===============================

A rubber strip swings; a camera saw its tip with noise of 1 mm, and a scale its sag at rest. A fit
finds modulus and retardation time, with confidence intervals.
"""

import numpy as np
from scipy.optimize import least_squares

from ancfdae import (
    HHT, Beam, Clamp, EquilibriumStart, Material, Misfit, PointForce, Scene, StaticMisfit,
    equilibrium, simulate,
)
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series, draw, save
from ancfdae.sections import Rectangle


def strip(modulus, damping_time):
    """A strip that hangs to one side and is let go by a hand."""
    rubber = Material(1100, modulus, 0.45, damping_time=damping_time)
    beam = Beam("strip", (0, 0), (0.3, 0), 8, Rectangle(0.01, 0.03), rubber)
    hand = PointForce(beam.at_end, (0.0, 0.3), name="hand")
    clamp, down = [Clamp(beam.at_start)], (0, -9.81)
    start = [EquilibriumStart(loads=[hand])]
    return beam, Scene([beam], clamp, down, start), Scene([beam], clamp, down)


# %%
# What was seen: a run with the true values, and noise.

random, times = np.random.default_rng(1), np.linspace(0.02, 0.6, 40)
beam, moving, hanging = strip(6e6, 8e-3)
tip = [position(beam.at_end, 0), position(beam.at_end, 1)]
seen = simulate(moving, 0.6, HHT(2**-9)).at(times).position(beam.at_end).T
seen = seen + 1e-3 * random.standard_normal(seen.shape)
sag = equilibrium(hanging).solution.position(beam.at_end)[0, 1] + 1e-3 * random.standard_normal()

# %%
# The fit starts from half the modulus and a fifth of the damping. It knows that both are positive.

_, guess, resting = strip(3e6, 1.6e-3)
design = ["strip.youngs_modulus", "strip.damping_time"]
fit = Misfit(tip, times, seen, 1e3).fit(guess, 0.6, HHT(2**-9), design=design)
fit = fit + StaticMisfit(tip[1:], [sag], 1e3).fit(resting, design=design)
found = least_squares(fit.residuals, fit.start, fit.jacobian, fit.bounds, x_scale="jac", gtol=None)
for name, limits in fit.intervals(found.x).items():
    print(f"{name}: {limits[0]:.4g} to {limits[1]:.4g}")

# %%
# Height of the tip: seen, at the start of the fit, and fitted.

lines = [Series("seen", times, seen[1], line=False, marker=True)]
for label, b in (("start", fit.start), ("fitted", found.x)):
    run = simulate(guess.with_values(dict(zip(design, b, strict=True))), 0.6, HHT(2**-9))
    lines.append(Series(label, run.t, run.position(beam.at_end)[:, 1]))
save(draw([Panel("Tip of the strip", "t [s]", "height [m]", lines)]), "fit.png")
