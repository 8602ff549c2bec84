"""Derivatives under error control far from the origin: boxes that creep under friction."""

import numpy as np
import pytest

from ancfdae import (
    AdaptiveSteps,
    Contact,
    Plane,
    PointForce,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    Weld,
    gradient,
)
from ancfdae.observables import velocity
from ancfdae.results import Gradient

G, FORCE, MASS, STIFFNESS, FRICTION, SLIP = 9.81, 4.0, 2.0, 1e6, 0.4, 1e-3
CONTROLLED = Radau(AdaptiveSteps(1e-6, sensitivities=True))


def creeping(place: float, joined: bool) -> Gradient:
    """Return the speed of a pulled box, and its derivative in the pull; `joined` of two parts."""
    # A box rests on two corners, each of which bears half its weight: N = k d^1.5.
    depth = (MASS * G / 2 / STIFFNESS) ** (2 / 3)
    share = MASS / 2 if joined else MASS
    box = RigidBody("box", (place, 0.1 - depth), mass=share, inertia=0.02)
    rider = RigidBody("rider", (place, 0.1 - depth), mass=share, inertia=0.01)
    feet = [
        Contact(
            box.at(side * 0.2, -0.1),
            Plane((0, 0), (0, 1)),
            stiffness=STIFFNESS,
            friction=FRICTION,
            slip_speed=SLIP,
            restitution=0.3,
            impact_speed=0.1,
            name=f"foot {side}",
        )
        for side in (-1, 1)
    ]
    pull = PointForce(box.at(0, -0.1), (FORCE, 0.0), name="pull")
    bodies, joints = ([box, rider], [Weld(box.origin, rider.origin)]) if joined else ([box], [])
    scene = Scene(joints=joints, bodies=bodies, loads=[*feet, pull], gravity=(0, -G))
    goal = Terminal(velocity(box.origin, 0))
    return gradient(scene, goal, 0.5, CONTROLLED, design=["pull.force_x"])


@pytest.mark.parametrize("joined", [False, True])
def test_box_creeps_alike_wherever_it_stands(joined: bool) -> None:
    """Steps, the speed and its derivative are the closed form's at the origin and far from it.

    F = mu N w/(w^4 + s^4)^(1/4) gives w = s x/(1 - x^4)^(1/4) with x = F/(mu N).
    """
    x = FORCE / (FRICTION * MASS * G)
    speed = SLIP * x / (1 - x**4) ** 0.25
    slope = SLIP / (FRICTION * MASS * G) * (1 - x**4) ** -1.25
    near, far = (creeping(place, joined) for place in (0.0, 1e4))
    for found in near, far:
        assert found.value == pytest.approx(speed, rel=1e-6)
        np.testing.assert_allclose(found.gradient, slope, rtol=1e-5)
    assert far.solution.statistics.steps <= 1.1 * near.solution.statistics.steps
