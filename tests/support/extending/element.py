"""An element: a strand of loose wires, which bends a quarter as stiffly as a solid cable."""

from ancfdae import CABLE_2D, HHT, Beam, Clamp, Material, Scene
from ancfdae.extend import BeamElement, ElementIntegrals
from ancfdae.observables import position
from ancfdae.sections import Rectangle

LOOSE = 0.25


class StrandIntegrals(ElementIntegrals):
    """Quadratic invariant, mass and linear invariant of the cable, a quarter of the last one."""

    def __init__(self, batch, owners):
        self._cable = CABLE_2D.integrals(batch, owners)
        self.powers = self._cable.powers
        self.values = self._loosened(self._cable.values)

    def partial(self, which):
        return self._loosened(self._cable.partial(which))

    def _loosened(self, values):
        A, m, bending = values
        return A, m, LOOSE * bending


class Strand(BeamElement):
    name, d = "STRAND_2D", 2
    quantities, default_energy = CABLE_2D.quantities, None

    def vector_weights(self, quantity, xi, y, z):
        return CABLE_2D.vector_weights(quantity, xi, y, z)

    def integrals(self, batch, owners):
        return StrandIntegrals(batch, owners)

    def section_law(self, batch, xi):
        return CABLE_2D.section_law(batch, xi)

    def stress_law(self, batch, xi, places):
        return CABLE_2D.stress_law(batch, xi, places)


STRAND = Strand()
rope = Beam(
    "rope", (0, 0), (1, 0.2), 4, Rectangle(0.02, 0.02), Material(3000, 1e8, 0.3), element=STRAND
)
SCENE = Scene([rope], [Clamp(rope.at_start)], (0, -9.81))
DESIGN = ["rope.height", "rope.length", "rope.youngs_modulus", "rope.density"]
OBSERVABLE, END, INTEGRATOR = position(rope.at_end, 1), 0.125, HHT(2.0**-7)
