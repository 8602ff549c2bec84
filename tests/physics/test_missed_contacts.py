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
    Switch,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.numerics.enclosures import Interval, enclosed, values
from ancfdae.numerics.operations import Listed, Operations
from ancfdae.numerics.vector_formulas import positive, step
from ancfdae.observables import elapsed_time, position, velocity
from ancfdae.results import Verdict
from ancfdae.sensitivity.method import UnfinishedRunError
from tests.support.contacts import falling


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
@pytest.mark.parametrize("integrator", [Radau(rtol=1e-6), DOP853(1e-8)])
def test_pairs_out_of_reach_are_found_or_end_a_run_that_brings_them_together(
    reach, away, integrator
):
    bodies = [
        RigidBody(name, (away + x, away, 0), mass=1.0, inertia=(0.004,) * 3)
        for name, x in (("a", 0.0), ("b", 0.3), ("c", 1.0))
    ]
    law = {"stiffness": 1e5, "restitution": 0.8, "impact_speed": 1.0, "reach": reach}
    touch = SphereContacts(["a", "b", "c"], [0.1, 0.1, 0.1], **law)
    # b flies to c, out of the reach of 0.3 m.
    start = [InitialVelocity("b", (0, 0, 0), (0, 0, 0), (1.0, 0, 0))]
    run = simulate(Scene([], [], bodies=bodies, loads=[touch], start=start), 0.8, integrator)
    if reach == 0.3 and isinstance(integrator, DOP853):
        assert run.outcome.verdict is Verdict.LEFT_OUT
        assert "reach" in str(run.outcome)
        assert run.outcome.time == pytest.approx(0.5, abs=0.1)
    else:
        assert run.outcome.success
        speeds = run.v.reshape(len(run.t), 3, 4, 3)[-1, :, 0, 0]
        np.testing.assert_allclose(speeds, [0.0, 0.1, 0.9], atol=1e-5)


def test_a_contact_of_two_steps_is_not_resolved_even_if_its_impulse_fits():
    # Some 6 ms in steps of 5 ms: the trapezoidal rule misses 2 % of the impulse, and the speed
    # after the impact is wrong by 11 %.
    scene, _ = falling(1.0, restitution=0.7, impact_speed=1.0)
    assert simulate(scene, 0.06, HHT(5e-3)).outcome.verdict is Verdict.MISSED_CONTACT
    assert simulate(scene, 0.06, HHT(5e-4)).outcome.success


@pytest.mark.parametrize(("step", "resolved"), [(1.7e-4, False), (4e-6, True)])
def test_a_contact_that_an_event_cuts_is_judged_as_a_whole(step, resolved):
    ball = RigidBody("ball", (0, 0, 0.11), mass=0.01, inertia=(1e-5,) * 3)
    law = {"stiffness": 1e8, "radius": 0.01, "restitution": 0.7, "impact_speed": 20.0}
    floor = Contact(ball.origin, Plane((0, 0, 0), (0, 0, 1)), name="floor", **law)
    start = [InitialVelocity("ball", (0, 0, 0), (0, 0, 0), (0, 0, -20.0))]
    scene = Scene([], [], bodies=[ball], loads=[floor], start=start)
    # The contact lasts from 5.00 to 5.16 ms.
    switch = Switch(elapsed_time() - 5.016e-3, to="start", name="switch")
    speed = Terminal(velocity(ball.origin, 2))
    call = scene, speed, 0.01, HHT(step)
    if resolved:
        found = gradient(*call, design=["floor.restitution"], events=[switch])
        assert found.value == pytest.approx(14.0, rel=1e-2)
        assert found.gradient[0] == pytest.approx(20.0, rel=1e-2)
        return
    run = simulate(scene, 0.01, HHT(step), events=[switch])
    assert run.outcome.verdict is Verdict.MISSED_CONTACT
    with pytest.raises(UnfinishedRunError, match="do not resolve a contact"):
        gradient(*call, design=["floor.restitution"], events=[switch])


def test_rates_of_what_is_positive_are_one_or_zero():
    operations = Operations(2)
    x = Listed(operations, np.arange(2))
    outputs = (3.0 * positive(x) + step(x)).at
    (rates,) = operations.along(outputs, {0: operations.constant(1.0), 1: operations.constant(1.0)})
    for value, slope in ((-2.0, 0.0), (0.0, 0.0), (1e-300, 3.0), (2.0, 3.0)):
        rows = np.concatenate([outputs, rates])
        inputs = {0: np.array([value]), 1: np.array([-1.0])}
        found = values(operations, rows, inputs)[:, 0]
        whole = 3 * max(value, 0.0) + (value > 0)
        np.testing.assert_array_equal(found, [whole, 0.0, slope, 0.0])
        box = Interval(np.array([value - 1.0]), np.array([value + 1.0]))
        low, high = enclosed(operations, rows, {0: box, 1: box})
        assert low[0, 0] <= whole <= high[0, 0]
        assert low[2, 0] <= slope <= high[2, 0]
