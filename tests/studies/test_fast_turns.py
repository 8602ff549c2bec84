"""Runs warn of rigid bodies whose steps alias their rotation, and of no others."""

import warnings

import numpy as np
import pytest

from ancfdae import (
    HHT,
    InitialVelocity,
    Pin,
    PointOnLine,
    Radau,
    RigidBody,
    RigidBox,
    RotationDriver,
    Scene,
    assemble,
    simulate,
)
from ancfdae.errors import StabilityWarning
from ancfdae.laws import ConstantAcceleration
from ancfdae.observables import observe, rotation_angle

STEP = 0.01


def wheel(turn, driven=False):
    """A balanced wheel on a long train of carriages that turns freely, `turn` rad in a step.

    The train hides errors of the wheel from the estimate, which is a mean over coordinates. If
    `driven`, a motor on the ground turns the wheel.
    """
    a = RigidBody("wheel", (0, 0), mass=1.0, inertia=0.1)
    train = [RigidBody(f"c{k}", (k, 0), mass=100.0, inertia=10.0) for k in range(8)]
    joints = [PointOnLine(x.at(s), direction=(1, 0)) for x in train for s in (0, 1)]
    joints.append(Pin(a.at(0, 0), train[0].at(0, 0)))
    if driven:
        joints.append(RotationDriver(a.at(0, 0), ConstantAcceleration(speed=turn / STEP), name="m"))
    start = [InitialVelocity("wheel", turn / STEP, (0, 0))]
    return Scene([], joints, bodies=[a, *train], start=start)


def said(scene, t_end, integrator):
    """Return the run, and the words of its StabilityWarnings."""
    with warnings.catch_warnings(record=True) as all_of_them:
        warnings.simplefilter("always")
        run = simulate(scene, t_end, integrator)
    return run, [str(x.message) for x in all_of_them if x.category is StabilityWarning]


@pytest.mark.parametrize(
    ("turn", "steps", "integrator"),
    [
        (0.5, 100, HHT(STEP)),
        (0.25, 500, HHT(STEP)),
        (1.25, 100, HHT(STEP)),
        (5.0, 100, HHT(STEP)),
        (5.0, 100, HHT(STEP, hht_alpha=-0.05)),
        (1.57, 100, Radau(STEP)),
        (2.0, 100, Radau(STEP)),
    ],
)
def test_a_rotation_that_is_off_by_radians_is_said(turn, steps, integrator):
    """The wheel turns uniformly; the estimated errors are below 0.4."""
    scene = wheel(turn)
    run, words = said(scene, steps * STEP, integrator)
    angle = observe(rotation_angle(scene.bodies[0].at(0, 0)), run, assemble(scene, []))
    assert run.outcome.success
    assert abs(angle[-1] - angle[0] - turn * steps) > 2
    assert len(words) == 1
    assert "body 'wheel' turns by up to" in words[0]


@pytest.mark.parametrize(
    ("turn", "integrator"),
    [(0.25, HHT(STEP)), (0.1, HHT(STEP, hht_alpha=-0.05)), (1.25, Radau(STEP))],
)
def test_a_rotation_that_is_followed_is_not_blamed(turn, integrator):
    """The wheel is off by 0.3 rad of 25, 2e-3 of 10 and 0.8 of 125."""
    scene = wheel(turn)
    run, words = said(scene, 1.0, integrator)
    angle = observe(rotation_angle(scene.bodies[0].at(0, 0)), run, assemble(scene, []))
    assert abs(angle[-1] - angle[0] - turn * 100) < 1
    assert not words


@pytest.mark.parametrize("integrator", [HHT(STEP), Radau(STEP)])
def test_a_driven_rotation_is_not_blamed_for_its_velocity(integrator):
    """A motor turns the wheel by 250 rad, 0.25 in a step; HHT's velocity is 0.7 % off."""
    run, words = said(wheel(0.25, driven=True), 10.0, integrator)
    assert not words
    np.testing.assert_allclose(run.q[-1, 2:4], [np.cos(250), np.sin(250)], atol=1e-6)


def test_a_body_that_tumbles_in_space_is_not_blamed():
    """The angular velocity swings: its integral needs its derivatives at the ends of a step."""
    a = RigidBody("a", (0, 0, 0), shape=RigidBox(0.3, 0.2, 0.1), density=1000.0)
    start = [InitialVelocity("a", (9.0, 21.0, 19.5), (0, 0, 0))]
    scene = Scene([], [], bodies=[a], start=start)
    run, words = said(scene, 10.0, Radau(STEP))
    assert run.outcome.success
    assert not words
    _, words = said(scene, 10.0, HHT(STEP))
    assert "turns by up to" in words[0] or "errors of this run" in words[0]
