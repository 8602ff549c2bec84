"""
A system of one's own: a bead on a turning hoop
===============================================

Mass, force and constraint as formulas: no beams, no bodies. The bead leaves the bottom where the
hoop turns faster than the root of g/R; derivatives are exact.
"""

import numpy as np

from ancfdae import HHT, Terminal, check_system, gradient, simulate
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom
from ancfdae.plotting import Panel, Series, draw, save


class Bead(FormulaSystem):
    """A bead of 1 kg on a hoop of radius R that turns at the rate w about the vertical."""

    n_q, n_lam = 2, 1  # distance from the axis and height, in the frame of the hoop; m
    design_names = ("R", "w", "c")

    def __init__(self, b=(0.5, 6.0, 0.3)):
        super().__init__(b)

    def with_values(self, b):
        return Bead(b)

    def start(self):
        R = self.b[0]
        return R * np.array([np.sin(0.1), -np.cos(0.1)]), np.zeros(2)

    def mass_matrix(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        _, w, c = self.b
        return np.array([w**2 * q[0], -9.81]) - c * v

    def position_constraint(self, t, q):
        return np.array([(q @ q - self.b[0] ** 2) / 2])


# %%
# Every member is checked against differences; then the angle at the end, in equilibrium:
# cos(angle) = g/(w^2 R).

check_system(Bead(), samples=1).raise_if_wrong()
angle = custom(lambda t, q, v, lam, b: np.arctan2(q[:, 0], -q[:, 1]))
print(gradient(Bead(), Terminal(angle), 30.0, HHT(2**-6)))
print(f"in equilibrium: {np.arccos(9.81 / (6.0**2 * 0.5)):.6f}")

# %%
# Below and above the critical rate of 4.43 rad/s.

lines = []
for rate in (4.0, 5.0, 6.0, 8.0):
    run = simulate(Bead((0.5, rate, 0.3)), 12.0, HHT(2**-7))
    turned = np.degrees(np.arctan2(run.q[:, 0], -run.q[:, 1]))
    lines.append(Series(f"{rate:g} rad/s", run.t, turned))
save(draw([Panel("Bead on a hoop", "t [s]", "angle from the bottom [deg]", lines)]), "bead.png")
