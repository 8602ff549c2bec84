"""A search by tolerance does not trust a result that round-off of coordinates makes."""

import warnings

import numpy as np
import pytest

from ancfdae import (
    Integral,
    PointForce,
    PointOnLine,
    RigidBody,
    Scene,
    SpringDamper,
    gradient,
    simulate,
)
from ancfdae.errors import ToleranceWarning
from ancfdae.observables import velocity

# Stiffness, N/m, of a spring on a mass of 1 kg, and length of the run, s.
STIFFNESS, T_END = 1e4, 0.1
SPEED = np.sqrt(STIFFNESS)


def pushed(place, force):
    """A kilogram at rest on a spring, `place` metres from the origin, that a force acts on."""
    a = RigidBody("a", (place, 0), mass=1.0, inertia=1.0)
    spring = SpringDamper(a.at(0), STIFFNESS, 0.0, 1.0, ground=(place - 1.0, 0.0))
    push = PointForce(a.at(0), (force, 0), name="f")
    rail = PointOnLine(a.at(0), direction=(1, 0))
    return Scene([], [rail], loads=[spring, push], bodies=[a]), velocity(a.at(0), 0)


# The mass swings by 2e-4 m per newton; coordinates have 16 digits.
SCENES = [(1.0, 1e-12, False), (1.0, 1e-8, False), (300.0, 1e-8, False), (1.0, 1.0, True)]


@pytest.mark.parametrize(("place", "force", "reached"), SCENES)
def test_a_gradient_of_a_motion_below_round_off_is_not_reached(place, force, reached):
    """Two runs of DOP853 agree where displacements per step are lost: 70 times the integral."""
    scene, v = pushed(place, force)
    exact = (force / SPEED) ** 2 * (T_END / 2 - np.sin(2 * SPEED * T_END) / (4 * SPEED))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = gradient(scene, Integral(v**2), T_END, tolerance=1e-4, design=["f.force_x"])
    assert found.accuracy.reached is reached
    words = [str(x.message) for x in said if x.category is ToleranceWarning]
    assert reached or "round-off of coordinates changes the result" in words[0]
    wrong, slope = abs(found.value - exact), abs(found.gradient[0] - 2 * exact / force)
    assert wrong <= found.accuracy.value_bar
    assert slope <= found.accuracy.gradient_bar[0]
    assert not reached or max(wrong, slope * force / 2) <= 1e-4 * exact


@pytest.mark.parametrize(("place", "force", "reached"), SCENES)
def test_values_of_a_motion_below_round_off_are_not_reached(place, force, reached):
    scene, v = pushed(place, force)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ToleranceWarning)
        found = simulate(scene, T_END, tolerance=1e-4, observables=[v])
    exact = force / SPEED * np.sin(SPEED * found.t)
    assert found.reached is reached
    off = np.linalg.norm(found.values[:, 0] - exact)
    assert off <= np.linalg.norm(found.bars[:, 0])
    assert not reached or off <= 1e-4 * np.linalg.norm(exact)
