"""Runs that creep: steady steps so short that the end time is far out of reach end in words."""

import warnings

import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    EndEvent,
    InitialVelocity,
    Radau,
    RigidBody,
    Scene,
    simulate,
)
from ancfdae.errors import ManyStepsWarning
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.step_control.steps import Pace
from ancfdae.observables import position


def spinning(omega):
    """Return a free body that spins at omega, rad/s."""
    body = RigidBody("body", (1.0, 0.0), mass=1.0, inertia=0.1)
    start = [InitialVelocity("body", omega, about=(1.0, 0.0), velocity=(0.0, 0.0))]
    return Scene([], [], (0.0, 0.0), bodies=[body], start=start)


@pytest.mark.parametrize("ends", [False, True], ids=["plain", "with an event"])
@pytest.mark.parametrize(
    ("integrator", "omega"),
    [(HHT(rtol=1e-4), 1e8), (Radau(rtol=1e-5), 1e10), (DOP853(1e-6), 1e10), (IDA(1e-6), 1e10)],
    ids=["HHT", "Radau", "DOP853", "IDA"],
)
def test_a_run_that_follows_1e8_rad_per_s_or_more_ends_in_words(integrator, omega, ends):
    """In 1 s the body would turn 1e7 times or more, each turn in a hundred steps or more."""
    scene = spinning(omega)
    given = {"events": [EndEvent(position(scene.bodies[0].origin, 0) - 3.0)]} if ends else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ManyStepsWarning)
        run = simulate(scene, 1.0, integrator, **given)
    assert run.outcome.verdict is Verdict.STEPS_TOO_SHORT
    assert 4999 <= run.outcome.step < 5200
    text = str(run.outcome)
    assert "the steps became too short to reach the end time" in text
    assert "The last 5000 steps, up to t = " in text
    assert "HHT(step" in text
    assert "max_steps" in text


def ended_after(h, max_steps=10**6, t_end=1.0):
    """Return after how many steps h, s, (at most 6000) a run ends for its pace, and how."""
    pace, t = Pace(t_end, 10**12, "Give up.", max_steps), 0.0
    for k in range(1, 6001):
        t += h(k)
        if (verdict := pace.ends_run(t)) is not None:
            return k, verdict, pace.advice
    return None, None, pace.advice


def test_a_run_creeps_where_5000_steps_predict_more_than_100_times_max_steps():
    k, verdict, advice = ended_after(lambda k: 0.98e-8)
    assert (k, verdict) == (5000, Verdict.STEPS_TOO_SHORT)
    assert advice == (
        "The last 5000 steps, up to t = 4.9e-05, advance by 4.9e-05 s, and 1e+08 like them are to "
        "come: Give up. If the motion becomes slower later, give a larger max_steps."
    )
    assert ended_after(lambda k: 1.01e-8) == (None, None, "")
    # The limit follows `max_steps` and the end time.
    assert ended_after(lambda k: 0.98e-8, 2 * 10**6)[0] is None
    assert ended_after(lambda k: 1.01e-8, t_end=1.1)[0] == 5000


def test_a_hundred_longer_steps_or_a_finished_transient_do_not_creep():
    # A hundred steps of 5.1e-7 s among 5,000 of 1e-10 s.
    assert ended_after(lambda k: 5.1e-7 if 2000 < k <= 2100 else 1e-10)[0] is None
    # Without them the run would end; so it does 5,000 steps after they are over.
    assert ended_after(lambda k: 5.1e-7 if k <= 100 else 1e-10)[0] == 5100
    # No progress at all ends a run after a hundred steps, as before.
    assert ended_after(lambda k: 1e-15)[:2] == (100, Verdict.ERROR_TEST)


def test_a_run_with_events_warns_of_many_steps_of_the_whole_run():
    """The first window, 1/8 of the run, has too few steps for a warning of its own."""
    scene = spinning(2e4)
    events = [EndEvent(position(scene.bodies[0].origin, 0) - 3.0)]
    with warnings.catch_warnings():
        warnings.simplefilter("error", ManyStepsWarning)
        with pytest.raises(ManyStepsWarning) as told:
            simulate(scene, 1.0, DOP853(1e-6), events=events)
    count = float(str(told.value).split()[1])
    steps = simulate(scene, 0.05, DOP853(1e-6)).statistics.steps
    assert count == pytest.approx(steps * 0.875 / 0.05, rel=0.1)
    assert "up to t = 0.125" in str(told.value)


@pytest.mark.parametrize(
    ("omega", "integrator"), [(1e3, Radau(rtol=1e-5)), (1.0, HHT(1 / 12_000))], ids=["few", "given"]
)
def test_few_steps_and_given_steps_do_not_warn(omega, integrator, recwarn):
    scene = spinning(omega)
    events = [EndEvent(position(scene.bodies[0].origin, 0) - 3.0)]
    assert simulate(scene, 1.0, integrator, events=events).outcome.success
    assert not recwarn
