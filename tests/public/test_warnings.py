"""Settings that do not suit a scene are told in words, and the run goes on."""

import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Moment,
    Revolute,
    RigidBody,
    Scene,
    Terminal,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.errors import ManyStepsWarning, StabilityWarning
from ancfdae.integrators.high_order import pace
from ancfdae.observables import rotation_angle
from ancfdae.results import Verdict
from validation.scenes import pendulum

# Its fastest wave has a period of 1e-6 s: a second takes about a million steps.
STEEL = pendulum(elements=2, youngs_modulus=2.1e11)


@pytest.mark.parametrize("kind", [DOP853, IDA])
def test_high_order_on_a_stiff_scene_says_how_many_steps_are_to_come(kind):
    with pytest.warns(ManyStepsWarning, match=r"about \S+e\+0[5-9] steps .* HHT") as told:
        run = simulate(STEEL, 100.0, kind(rtol=1e-6, max_steps=250))
    assert len(told) == 1  # once, though there were 250 steps
    assert run.outcome.verdict is Verdict.STEP_LIMIT


@pytest.mark.parametrize(("steps", "warned"), [(90_000, False), (110_000, True)])
def test_the_estimate_is_that_of_steps_as_the_last_ones(steps, warned, recwarn):
    """After first steps that grow, all have the size 1/steps."""
    watch, t = pace(1.0, 10**6), 0.0
    for k in range(300):
        t += min(1.0, 2.0 ** (k - 40)) / steps
        assert not watch.ends_run(t)
    assert [w.category for w in recwarn] == [ManyStepsWarning] * warned
    if warned:
        # All steps of the size, less what the first forty lack: 1.1e5 in two digits.
        assert "about 1.1e+05 steps" in str(recwarn[0].message)


def test_steps_that_shrink_before_a_jump_tell_nothing(recwarn):
    """At the hundredth step of a run that stalls behind its fortieth."""
    watch = pace(1.0, 10**6)
    behind = (0.3 + 1e-3 * (1 - 0.7 ** (k - 39)) for k in range(40, 300))
    times = [0.3 * (k + 1) / 40 for k in range(40)] + list(behind)
    taken = next(k for k, t in enumerate(times, 1) if watch.ends_run(t))
    assert taken == 200
    assert not recwarn


def test_steps_too_long_for_the_motion_are_told():
    with pytest.warns(StabilityWarning, match="steps are too long to follow the motion"):
        assert simulate(pendulum(), 1.0, HHT(1.0)).outcome.success


@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint(), ComplexStep()])
@pytest.mark.parametrize("long", [True, False])
def test_gradients_of_runs_whose_steps_are_too_long_are_told_once(method, long, recwarn):
    # A body turns on its axis by a constant moment: by M t^2 / (2 I) = 375 rad in 5 s.
    body = RigidBody("body", (0, 0, 0), mass=1.0, inertia=(0.1, 0.1, 0.1))
    pin = Revolute(body.at(0, 0, 0), axis=(0, 0, 1.0))
    turn = Moment(body.at(0, 0, 0), (0, 0, 3.0), name="turn")
    scene = Scene([], [pin], (0, 0, 0), bodies=[body], loads=[turn])
    end, integrator = Terminal(rotation_angle(body.at(0, 0, 0))), HHT(1e-2 if long else 2e-3)
    t_end = 5.0 if long else 1.0
    gradient(scene, end, t_end, integrator, design=["turn.moment_z"], method=method)
    assert [x.category for x in recwarn] == [StabilityWarning] * long
    if long:
        assert recwarn[0].filename == __file__
    if method == ComplexStep():
        recwarn.clear()
        differentiate(scene, t_end, integrator, design=["turn.moment_z"], method=method)
        assert [x.category for x in recwarn] == [StabilityWarning] * long
