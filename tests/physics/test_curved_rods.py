"""Curved, pretwisted and off-axis beams against linear rods (`oracle.plain_rod`), closed forms."""

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    CurvedBeam,
    Material,
    Moment,
    PointForce,
    Scene,
    assemble,
    equilibrium,
    modes,
)
from ancfdae.sections import ISection, QuadratureSection, Rectangle
from ancfdae.sensitivity.observables.observable import observe
from ancfdae.sensitivity.observables.sections import shear_force, torsional_moment
from tests.support.oracle import plain_rod

E, NU = 2e11, 0.3
G = E / (2 * (1 + NU))
STEEL = Material(7800.0, E, NU)


def rectangle_points(height, width, y, z, **properties):
    """A rectangle with its centre at y and z, with the properties of one on the axis."""
    (k_y,), (k_z,), (J,) = Rectangle(height, width).properties(
        np.array([[height, width]]), np.array([NU])
    )
    nodes, weights = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]) / 2, np.array([5, 8, 5]) / 18
    places = [(y + height * a, z + width * b) for a in nodes for b in nodes]
    areas = height * width * np.outer(weights, weights).ravel()
    given = {"shear_factors": (k_y, k_z), "torsion_constant": float(J)} | properties
    return QuadratureSection(places=places, areas=areas, **given)


def helix(n, section, rates, length=1.0):
    motions = [plain_rod.helix(rates, length * k / n) for k in range(n + 1)]
    places, frames = (np.array(part) for part in zip(*motions, strict=True))
    return CurvedBeam("rod", places, frames.swapaxes(1, 2), section, STEEL)


def properties(section):
    sizes = np.array([section.sizes()])
    y, z, dA = (x[0] for x in section.points(sizes, True))
    k_y, k_z, J = (x[0] for x in section.properties(sizes, np.array([NU])))
    A = dA.sum()
    centre = np.array([dA @ y, dA @ z]) / A
    I_y, I_z = dA @ (y - centre[0]) ** 2, dA @ (z - centre[1]) ** 2
    return A, I_y, I_z, J, (k_y, k_z), centre


def at_rest(rod, load):
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[load])
    found = equilibrium(scene)
    assert found.outcome.success
    return found.solution, assemble(scene)


OFF = rectangle_points(0.02, 0.03, 0.01, 0.05)
RODS = {
    "arc": (Rectangle(0.02, 0.01), (0.0, 0.0, 1.5)),
    "I arc": (ISection(0.04, 0.03, 0.002, 0.003), (0.0, 1.5, 0.0)),
    "pretwisted": (Rectangle(0.02, 0.01), (1.0, 0.0, 0.0)),
    "helix": (Rectangle(0.01, 0.015), (0.7, 1.0, -1.0)),
    "off the axis": (OFF, (0.0, 0.0, 0.0)),
    "off the axis, arc": (OFF, (0.0, 0.0, 1.0)),
}


@pytest.mark.parametrize("name", RODS)
def test_the_tip_of_a_rod_moves_as_by_virtual_forces(name):
    section, rates = RODS[name]
    A, I_y, I_z, J, factors, centre = properties(section)
    C = plain_rod.compliance(E, NU, A, I_y, I_z, J, factors, rates, centre)
    for force, moment in (((0.6, 0.8, -0.5), np.zeros(3)), (np.zeros(3), (0.5, -0.3, 0.7))):
        rod = helix(32, section, rates)
        load = PointForce(rod.at_end, force) if np.any(force) else Moment(rod.at_end, moment)
        solution, _ = at_rest(rod, load)
        expected, turn = plain_rod.tip(rates, 1.0, C, np.array(force), np.array(moment), 20)
        moved = solution.position(rod.at_end)[0] - plain_rod.helix(rates, 1.0)[0]
        # The limit asked for; elements turn by 0.05 rad.
        assert np.linalg.norm(moved - expected) < 1e-2 * np.linalg.norm(expected)
        # Half of the turn of each axis of the section is the turn; free ends shear in their plane,
        # too, by what the torsion constant knows nothing of: the normal alone.
        before = plain_rod.helix(rates, 1.0)[1].T
        y, z = (solution.slope(rod.at_end, axis)[0] for axis in (1, 2))
        normal = np.cross(y, z) / np.linalg.norm(np.cross(y, z))
        tilt = np.cross(turn, before[0])
        assert np.linalg.norm(normal - before[0] - tilt) < 1e-2 * np.linalg.norm(turn)


@pytest.mark.parametrize("ratio", [1, 2, 10, 40])
def test_a_pretwisted_bar_untwists_under_tension(ratio):
    # N = E A e + c k and 0 = c e + K k with c = E t (I_p - J); fibres that the twist stretches
    # stiffen it by E t^2 (1 - J/I_p)^2 int r^4.
    h, pretwist = 0.04 / ratio, 0.1
    section = Rectangle(0.04, h)
    A, I_y, I_z, J, _, _ = properties(section)
    y, z, dA = (x[0] for x in section.points(np.array([[0.04, h]]), True))
    polar = I_y + I_z
    c, r4 = E * pretwist * (polar - J), dA @ (y * y + z * z) ** 2
    K, N = G * J + E * (pretwist * (1 - J / polar)) ** 2 * r4, 1e-7 * E * A
    twist = np.linalg.solve([[E * A, c], [c, K]], [N, 0.0])[1]
    rod = helix(32, section, (pretwist, 0.0, 0.0))
    solution, _ = at_rest(rod, PointForce(rod.at_end, (N, 0.0, 0.0)))
    y, before = solution.slope(rod.at_end, 1)[0], plain_rod.helix((pretwist, 0, 0), 1.0)[1][:, 1]
    assert np.cross(before, y)[0] / np.linalg.norm(y) == pytest.approx(twist, rel=2e-3)


def test_a_bar_off_its_axis_is_the_same_bar():
    # 30 x 20 mm, its centre at z = 50 mm: a force in the axis twists it by F z/(G J), and V is F.
    off, n = rectangle_points(0.03, 0.02, 0.0, 0.05), 32
    rod = Beam("rod", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), n, off, STEEL)
    solution, system = at_rest(rod, PointForce(rod.at_end, (0.0, 1.0, 0.0)))
    J = off.torsion_constant
    y, z = (solution.slope(rod.at_end, axis)[0] for axis in (1, 2))
    # The free end shears in its plane (see above); both axes turn by the same in the mean.
    assert 0.5 * (y[2] - z[1]) == pytest.approx(0.05 / (G * J), rel=2e-3)
    for place in (0.1, 0.5, 0.93):
        assert observe(shear_force(rod.at(place)), solution, system)[0] == pytest.approx(1.0)
        assert abs(observe(torsional_moment(rod.at(place)), solution, system)[0]) < 1e-6
    # Bending about both axes of the centroid, and torsion about it.
    A, I_y, I_z, _, _, _ = properties(off)
    found = modes(Scene([rod], [Clamp(rod.at_start)]), 10).frequencies
    bending = [1.8751**2 * np.sqrt(E * I / (7800.0 * A)) for I in (I_z, I_y)]
    torsion = np.pi / 2 * np.sqrt(G * J / (7800.0 * (I_y + I_z)))
    # Shear and the turns of sections lower bending by 1e-3.
    assert found[:2] == pytest.approx(bending, rel=3e-3)
    # The axis goes round the centroid by the turn of an element, 2.8e-2 of it at 8 elements.
    assert np.min(np.abs(found / torsion - 1)) < 5e-3


def test_a_force_through_the_shear_centre_does_not_twist():
    # As if the rectangle were open, its shear centre beside it.
    for arm in (-0.01, 0.04):
        section = rectangle_points(0.03, 0.02, 0.0, 0.0, shear_centre=(0.0, 0.04))
        rod = Beam("rod", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 2, section, STEEL)
        # A moment moves the force from the axis to z = arm.
        loads = [PointForce(rod.at_end, (0.0, 1.0, 0.0)), Moment(rod.at_end, (-arm, 0.0, 0.0))]
        found = equilibrium(Scene([rod], [Clamp(rod.at_start)], loads=loads))
        y, z = (found.solution.slope(rod.at_end, axis)[0] for axis in (1, 2))
        expected = (0.04 - arm) / (G * section.torsion_constant)
        assert 0.5 * (y[2] - z[1]) == pytest.approx(expected, rel=2e-3, abs=1e-9)
