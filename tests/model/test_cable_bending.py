"""Cables bend by their material's curvature: circles under a moment, whatever the stretch."""

import dataclasses

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
    Beam,
    Clamp,
    Material,
    Moment,
    PointForce,
    Scene,
    assemble,
    equilibrium,
    equilibrium_gradient,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import maximum_von_mises, observe, position
from ancfdae.sections import Circle, QuadratureSection, Rectangle

# Half a circle of a strip of 1 m with a fibre strain of 13 %, as in GXBeam's example.
HEIGHT = 0.26 / np.pi
E, STRIP = 1e6, Rectangle(HEIGHT, 0.1)
BENDING = E * STRIP.width * HEIGHT**3 / 12
SOFT = Material(1000.0, E, 0.3)


def strip(n, moment=0.0, force=(0.0, 0.0), strain=0.0):
    rod = Beam("rod", (0, 0), (1, 0), n, STRIP, SOFT, element=CABLE_2D, initial_strain=strain)
    loads = [Moment(rod.at_end, moment, name="turn"), PointForce(rod.at_end, force)]
    return Scene([rod], [Clamp(rod.at_start)], loads=loads), rod.at_end


def circle(angle):
    """Tip of an arc of unit length that turns by an angle, and its derivative in the angle."""
    s, c = np.sin(angle), np.cos(angle)
    slope = np.array([c / angle - s / angle**2, s / angle - (1 - c) / angle**2])
    return np.array([s / angle, (1 - c) / angle]), slope


def test_an_end_moment_makes_half_a_circle_with_its_gradient():
    """theta = M L/(E I) exactly: no stretch, no part of the fibre strain. Fourth order."""
    tip, slope = circle(np.pi)
    errors = []
    for n in (16, 32, 64):
        scene, end = strip(n, np.pi * BENDING)
        found = equilibrium(scene).solution.position(end)[0] - tip
        moved = [
            equilibrium_gradient(scene, position(end, k), design=["rod.youngs_modulus"]).gradient[0]
            * E
            for k in (0, 1)
        ]
        errors.append([np.hypot(*found), np.hypot(*(moved + np.pi * slope))])
    errors = np.array(errors)
    # (kappa l)^4/720 of a turn of pi, 5e-8 with 64 elements; the gradient has theta times that.
    assert np.all(errors[2] < [1e-7, 1e-6])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(np.full((2, 2), 4.0), abs=0.1)


@pytest.mark.parametrize("strain", [-0.05, 0.05])
def test_a_released_cable_bends_with_its_own_length_and_stiffness(strain):
    """theta = M L_o/(E I), w = F L_o^3/(3 E I) with the length L_o free of stress."""
    free = np.sqrt(1 - 2 * strain)
    scene, end = strip(16, 1.0 * BENDING / free, strain=strain)
    found = equilibrium(scene).solution.position(end)[0]
    # The mesh leaves (kappa l)^4/720 = 2e-8.
    assert found == pytest.approx(free * circle(1.0)[0], abs=1e-7)
    F = 1e-6 * BENDING
    scene, end = strip(2, force=(0.0, F), strain=strain)
    deflection = equilibrium(scene).solution.position(end)[0, 1]
    # Squares of rotations are 1e-12; the condition number of 2 elements is 1e4 at most.
    assert deflection == pytest.approx(F * free**3 / (3 * BENDING), rel=1e-9)


def test_the_cable_of_space_bends_as_that_of_the_plane():
    """A cantilever under a tip force across it, out of both axes: a deflection of 0.4."""
    radius = 0.02
    inertia, forces = np.pi * radius**4 / 4, []
    for element in (CABLE_2D, CABLE_3D):
        d = element.d
        height = (12 * inertia / (np.pi * radius**2)) ** 0.5
        flat = Rectangle(height, np.pi * radius**2 / height)
        across = np.array([0.0, 1.0] if d == 2 else [0.0, 0.6, 0.8])
        rod = Beam(
            "rod", (0,) * d, (1,) + (0,) * (d - 1), 4, flat if d == 2 else Circle(radius), SOFT,
            element=element,
        )  # fmt: skip
        load = PointForce(rod.at_end, tuple(1.5 * E * inertia * across))
        found = equilibrium(Scene([rod], [Clamp(rod.at_start)], loads=[load])).solution
        tip = found.position(rod.at_end)[0]
        forces.append([tip[0], tip @ across])
    # The same equations: what Newton's method leaves.
    assert forces[0][1] > 0.35
    assert forces[1] == pytest.approx(forces[0], rel=1e-9)


def test_a_section_with_a_product_of_inertia_is_refused_in_space():
    """Points on a diagonal: both second moments are equal, the product of inertia is not zero."""
    diagonal = QuadratureSection(places=[(-0.01, -0.01), (0.01, 0.01)], areas=[1e-4, 1e-4])
    moments = diagonal.second_moments()
    assert moments[0, 0] == moments[1, 1]
    assert moments[0, 1] != 0
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 1, Circle(0.01), SOFT, element=CABLE_3D)
    with pytest.raises(InvalidInputError, match="about every axis"):
        dataclasses.replace(rod, section=diagonal)


def test_stress_of_a_planar_cable_counts_from_the_centroid():
    """Pure bending: sigma = E kappa |y - y_c| at the outer point, y_c = 0.005 off the axis."""
    places, areas = [(0.0, 0.0), (0.02, 0.0)], [3e-4, 1e-4]
    section = QuadratureSection(places=places, areas=areas)
    rod = Beam("rod", (0, 0), (1, 0), 4, section, SOFT, element=CABLE_2D)
    inertia, kappa = 3e-4 * 0.005**2 + 1e-4 * 0.015**2, 0.1
    turn = Moment(rod.at_end, E * inertia * kappa)
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[turn])
    found, system = equilibrium(scene).solution, assemble(scene)
    largest = observe(maximum_von_mises("rod", 1e-2 * E * kappa * 0.015), found, system)[0]
    # The aggregate lies above by the logarithm of 24 points, 3.2e-2, at most.
    assert largest == pytest.approx(E * kappa * 0.015, rel=0.04)
