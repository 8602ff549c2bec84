"""
Error against number of elements
================================

A cantilever, 1 m long and 2 mm thick, with 1 to 64 elements: both beam elements and the cable,
every strain energy. Tip deflection under a small force against Timoshenko's beam, first frequency
against that of Euler's beam. :doc:`/howto/elements` says what follows;
:doc:`/reports/elements/report` has other slendernesses and large bending.
"""

import numpy as np

from ancfdae import (
    CABLE_2D, Beam, Clamp, EnhancedContinuum, Material, PlaneStress, PointForce,
    SaintVenantKirchhoff, Scene, equilibrium, modes,
)
from ancfdae.sections import Rectangle
from ancfdae.plotting import Panel, Series, draw, save

L, h, E, rho, nu = 1.0, 0.002, 2.1e11, 7850.0, 0.3
counts = [1, 2, 4, 8, 16, 32, 64]
bar, steel = Rectangle(h, h), Material(rho, E, nu)


def cantilever(n, dimension, **choice):
    """A clamped beam of n elements, and a load of 1e-6 N at its tip."""
    origin = np.zeros(dimension)
    along, up = np.eye(dimension)[:2]
    beam = Beam("beam", origin, L * along, n, bar, steel, **choice)
    force = PointForce(beam.at_end, -1e-6 * up)
    clamp = Clamp(beam.at_start)
    return beam, Scene([beam], [clamp]), Scene([beam], [clamp], loads=[force])


# %%
# Theory: the deflection of Timoshenko's beam, F L³/(3 E I) + F L/(k G A) with Cowper's k, and ω =
# 1.8751² √(E I/(ρ A L⁴)). At this thickness shear and the turn of the sections change either by
# some 3e-6; the frequency leaves them out.

area, inertia = h**2, h**4 / 12
k, G = 10 * (1 + nu) / (12 + 11 * nu), E / (2 * (1 + nu))
sag = 1e-6 * (L**3 / (3 * E * inertia) + L / (k * G * area))
omega = 1.8751040687**2 * np.sqrt(E * inertia / (rho * area * L**4))
print(f"theory: {1e6 * sag:.6f} um under 1e-6 N, {omega / (2 * np.pi):.5f} Hz")

cases = {
    "enhanced (default)": {},
    "enhanced, exact strains": {"energy": EnhancedContinuum(assumed_strains=False)},
    "plane stress": {"energy": PlaneStress()},
    "full law": {"energy": SaintVenantKirchhoff()},
    "cable": {"element": CABLE_2D},
}


def errors(n, dimension, choice):
    """Relative errors of deflection and frequency."""
    beam, free, loaded = cantilever(n, dimension, **choice)
    computed = -equilibrium(loaded).solution.position(beam.at_end)[0, 1]
    return computed / sag - 1, modes(free, 1).natural_frequencies[0] / omega - 1


# %%
# Relative errors, deflection and frequency. In space the frequency is that of the lower of two
# equal ones.

table = {}
for dimension in (2, 3):
    for name, choice in cases.items():
        if dimension == 3 and name in ("plane stress", "cable"):
            continue  # planar only
        table[name, dimension] = np.array([errors(n, dimension, choice) for n in counts])

for what, column in (("deflection", 0), ("first frequency", 1)):
    print(f"\n{what:30s}" + "".join(f"{n:>10d}" for n in counts))
    for (name, dimension), ratios in table.items():
        words = f"{name}, {'plane' if dimension == 2 else 'space'}"
        print(f"{words:30s}" + "".join(f"{x:10.1e}" for x in ratios[:, column]))

# %%
# A law that locks does not improve with the number of elements: it converges to a beam that is
# too stiff.

panels = [
    Panel(
        f"Error of the {what}",
        "number of elements",
        "relative error",
        [Series(name, counts, np.maximum(abs(table[name, 2][:, column]), 1e-12)) for name in cases],
        x_scale="log",
        y_scale="log",
    )
    for what, column in (("deflection", 0), ("first frequency", 1))
]
save(draw(panels, columns=2), "elements")
