"""Runs whose steps pass over a contact end in words, and pairs that are left out are noticed."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Contact,
    InitialVelocity,
    Plane,
    Radau,
    RigidBody,
    Scene,
    Sphere,
    SphereContacts,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.observables import position
from ancfdae.results import Verdict
from ancfdae.sensitivity.method import UnfinishedRunError


def shot(obstacle, speed=10.0, **law):
    """A ball of 0.1 m that flies along x without gravity."""
    ball = RigidBody("ball", (0, 0, 0), mass=1.0, inertia=(0.004,) * 3)
    touch = Contact(ball.at(0, 0, 0), obstacle, stiffness=1e8, radius=0.1, name="wall", **law)
    start = [InitialVelocity("ball", (0, 0, 0), (0, 0, 0), (speed, 0, 0))]
    return Scene([], [], bodies=[ball], loads=[touch], start=start), ball


THIN = Sphere((1.0, 0.05, 0.0), 0.2)
WALL = Plane((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))


@pytest.mark.parametrize("obstacle", [THIN, WALL], ids=["sphere", "wall"])
@pytest.mark.parametrize("integrator", [HHT(0.05), HHT(0.02), Radau(0.07), Radau(0.03)])
def test_a_step_that_jumps_over_a_contact_does_not_succeed(obstacle, integrator):
    scene, ball = shot(obstacle)
    run = simulate(scene, 0.2, integrator)
    assert not run.outcome.success
    if run.outcome.verdict is Verdict.MISSED_CONTACT:
        assert "'wall'" in str(run.outcome)
        assert run.outcome.time <= 0.09  # it touches at 0.07 to 0.09 s
    with pytest.raises(UnfinishedRunError):
        gradient(
            scene, Terminal(position(ball.at(0, 0, 0), 0)), 0.2, integrator, design=["ball.mass"]
        )


@pytest.mark.parametrize("integrator", [HHT(2e-5), Radau(rtol=1e-6), IDA(1e-7), DOP853(1e-7)])
def test_steps_that_resolve_a_contact_succeed(integrator):
    scene, _ = shot(WALL, restitution=0.7, impact_speed=10.0)
    run = simulate(scene, 0.2, integrator)
    assert run.outcome.success
    assert run.v[-1, 0] == pytest.approx(-7.0, rel=1e-3)


@pytest.mark.parametrize("away", [0.0, 1e3])
@pytest.mark.parametrize("reach", [None, 1.0, 0.3])
def test_pairs_out_of_reach_end_a_run_that_brings_them_together(reach, away):
    bodies = [
        RigidBody(name, (away + x, away, 0), mass=1.0, inertia=(0.004,) * 3)
        for name, x in (("a", 0.0), ("b", 0.3), ("c", 1.0))
    ]
    law = {"stiffness": 1e5, "restitution": 0.8, "impact_speed": 1.0, "reach": reach}
    touch = SphereContacts(["a", "b", "c"], [0.1, 0.1, 0.1], **law)
    # b flies to c, out of the reach of 0.3 m.
    start = [InitialVelocity("b", (0, 0, 0), (0, 0, 0), (1.0, 0, 0))]
    run = simulate(Scene([], [], bodies=bodies, loads=[touch], start=start), 0.8, Radau(rtol=1e-6))
    if reach == 0.3:
        assert run.outcome.verdict is Verdict.MISSED_CONTACT
        assert "reach" in str(run.outcome)
        assert run.outcome.time == pytest.approx(0.5, abs=0.1)
    else:
        assert run.outcome.success
        speeds = run.v.reshape(len(run.t), 3, 4, 3)[-1, :, 0, 0]
        np.testing.assert_allclose(speeds, [0.0, 0.1, 0.9], atol=1e-5)
