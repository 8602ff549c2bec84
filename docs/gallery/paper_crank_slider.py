"""
The paper's crank-slider
========================

Section 4.2 of the source paper by library calls: a spatial crank-slider of shear-deformable ANCF
beams falls under its weight. How does the position of its slider depend on the six numbers of
Table 1? The report :doc:`/reports/crank-slider/report` compares it with the paper.
"""

from ancfdae import (
    HHT, Adjoint, Beam, DirectDifferentiation, Integral, Material, PointOnLine, Revolute,
    SaintVenantKirchhoff, Scene, Spherical, differentiate, gradient,
)
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series, draw, save
from ancfdae.sections import Rectangle

section, law = Rectangle(0.05, 0.05), SaintVenantKirchhoff()
stiff, soft = Material(2770, 1e9, 0.3), Material(2770, 1e8, 0.3)
crank = Beam("crank", (0, 0, 0), (0.9, 0, 0), 2, section, stiff, energy=law)
rod = Beam("rod", (0.9, 0, 0), (2.7, 0, 0), 4, section, soft, energy=law)
joints = [
    Revolute(crank.at_start, axis=(0, 0, 1)), Spherical(crank.at_end, rod.at_start),
    PointOnLine(rod.at_end, direction=(1, 0, 0)),
]
scene = Scene([crank, rod], joints, gravity=(0, -9.81, 0))
design = [f"{x}.{y}" for x in ("crank", "rod") for y in ("height", "density", "youngs_modulus")]

# %%
# Eq. (43): the integral of the squared distance of the slider from the middle of its travel. Direct
# differentiation and the discrete adjoint give the same digits.

psi = Integral((position(rod.at_end, 0) - 1.8) ** 2)
for method in (DirectDifferentiation(), Adjoint()):
    print(gradient(scene, psi, 1.0, HHT(2**-8), design=design, method=method))

# %%
# How the position of the slider changes in time, for each variable times its value.

solution = differentiate(scene, 1.0, HHT(2**-8), design=design)
lines = [
    Series(name, solution.t, solution.derivative(rod.at_end, name)[:, 0] * value)
    for name, value in zip(design, solution.sensitivities.values, strict=True)
]
panel = Panel("Derivatives of the slider's position", "t [s]", "b dx/db [m]", lines)
save(draw([panel]), "paper_crank_slider.png")
