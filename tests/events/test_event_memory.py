"""Runs with events that keep a part of their states: `simulate(keep=)`, `gradient(memory=)`."""

import tracemalloc

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    AtTimes,
    DirectDifferentiation,
    Impact,
    InitialVelocity,
    Integral,
    Radau,
    RigidBody,
    Scene,
    SmoothMaximum,
    Terminal,
    gradient,
    load_event_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.events import adjoint
from ancfdae.observables import position, rotation_angle, slope_angle
from tests.support.balls import BOUNCE, HEIGHT, Ball, ball_by_hand, slopes_by_hand
from tests.support.rods_on_stops import rod_on_a_stop

INTEGRATORS = (HHT(0.01), Radau(0.05), DOP853(1e-10), IDA(1e-9))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_kept_times_have_the_height_of_the_closed_form(integrator):
    times = np.linspace(0.0, 3.2, 9)
    once = simulate(Ball(), 3.2, integrator, events=[BOUNCE])
    run = simulate(Ball(), 3.2, integrator, events=[BOUNCE], keep=times)
    # Each of the three phases keeps its ends, two of which are the ends of the run.
    assert len(run.t) == len(times) + 4
    assert set(times) <= set(run.t)
    assert np.all(np.diff(run.t) >= 0)
    exact = [ball_by_hand(t, Ball().b) for t in run.t]
    np.testing.assert_allclose(run.q[:, 0], exact, atol=1e-9)
    assert [x.time for x in run.events] == [x.time for x in once.events]
    assert str(run.outcome) == str(once.outcome)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_every_kth_step_of_each_phase_is_kept(integrator):
    once = simulate(Ball(), 3.2, integrator, events=[BOUNCE])
    run = simulate(Ball(), 3.2, integrator, events=[BOUNCE], keep=3)
    for phase, all_of_it in zip(run.phases, once.phases, strict=True):
        stride, last = 3 * all_of_it.degree, len(all_of_it.t) - 1
        rows = [*range(0, last, stride), last]
        for name in ("t", "q", "v", "a", "lam"):
            kept, known = getattr(phase, name), getattr(all_of_it, name)
            np.testing.assert_array_equal(kept, known[rows])


def test_run_goes_on_after_one_that_kept_the_ends_of_phases(tmp_path):
    once = simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE], keep=100)
    part = simulate(Ball(), 2.9, HHT(0.05), events=[BOUNCE], keep=100)
    assert len(part.t) == 2 * len(part.phases) == 6
    read = load_event_solution(part.save(tmp_path / "part.npz"))
    run = simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE], keep=100, after=read)
    np.testing.assert_allclose(run.q, once.q, atol=1e-13)
    np.testing.assert_allclose(run.t, once.t, rtol=1e-14)


def test_states_that_are_not_kept_take_no_memory():
    def held(**settings):
        tracemalloc.start()
        ball = Ball((5.0, 0.0, 10.0, 1.0))
        run = simulate(ball, 200.0, HHT(2e-3), events=[BOUNCE], **settings)
        size, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(run.events) == 100
        return size, peak

    # A flight takes 2 s of the 200 s, and the first window 25 s.
    (thin, peak), (full, _) = held(keep=1000), held()
    assert thin < 0.15 * full
    assert peak < full


def test_numbers_and_times_that_cannot_be_kept_are_refused_in_words():
    for keep, text in ((0, "positive integer"), ([0.0, 4.0], "lie in"), ([1.0, 1.0], "ascending")):
        with pytest.raises(InvalidInputError, match=text):
            simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE], keep=keep)


# -- the adjoint within a limit of memory ----------------------------------------------------------


@pytest.fixture
def repeated(monkeypatch):
    """Durations of the phases that a backward pass integrates again."""
    durations = []

    def noted(phase, own=adjoint.integrated):
        durations.append(phase.duration)
        return own(phase)

    monkeypatch.setattr(adjoint, "integrated", noted)
    return durations


@pytest.mark.parametrize("integrator", [HHT(0.04), HHT(rtol=1e-4), Radau(0.4)])
def test_gradient_within_a_limit_of_memory_has_its_closed_form(integrator, repeated):
    ball, settings = Ball((5.0, -0.1, 10.0, 0.99)), {"events": [BOUNCE]}
    run = simulate(ball, 50.0, integrator, **settings)
    durations = [phase.t[-1] - phase.t[0] for phase in run.phases]
    longest, count = max(len(phase.t) for phase in run.phases), len(run.t)
    for objective in (
        Terminal(HEIGHT),
        Integral(HEIGHT**2),
        AtTimes(HEIGHT, [0.4, 9.9]),
        SmoothMaximum(HEIGHT, 2.0),
    ):
        one = gradient(ball, objective, 50.0, integrator, method=Adjoint(), **settings)
        assert not repeated
        # Rows of 4 numbers; the longest phase counts three times. The ends of phases, times and
        # values are stored, too, and ten of the phases whole.
        limit = 8 * 4 * 13 * longest + 8 * 2 * count + 64 * len(run.phases)
        other = gradient(ball, objective, 50.0, integrator, memory=limit, **settings)
        again = len(repeated)
        assert 10 < again <= len(durations) - 10
        np.testing.assert_allclose(repeated[::-1], durations[-again:], rtol=1e-12)
        repeated.clear()
        assert other.value == one.value
        np.testing.assert_allclose(other.gradient, one.gradient, rtol=1e-11)
        assert [x.time for x in other.event_solution.events] == [x.time for x in run.events]
        if isinstance(objective, Terminal):
            exact = slopes_by_hand(50.0, ball.b)
            assert other.value == pytest.approx(ball_by_hand(50.0, ball.b), abs=1e-7)
            np.testing.assert_allclose(other.gradient, exact, rtol=1e-6)


def test_gradient_of_the_issue_within_the_least_memory():
    # z0 = 5, v0 = -0.1, g = 10, e = 0.8 at t = 3.2, after two impacts.
    slopes = (0.311880018998, -0.033280796140, 0.048092789540, 9.155137855557)
    with pytest.raises(InvalidInputError, match=r"memory: must be .* MB or more") as refused:
        gradient(Ball(), Terminal(HEIGHT), 3.2, HHT(0.01), events=[BOUNCE], memory=8000)
    assert "t = 0.99" in str(refused.value)
    found = gradient(Ball(), Terminal(HEIGHT), 3.2, HHT(0.01), events=[BOUNCE], memory="50 kB")
    assert found.value == pytest.approx(2.043656070001, abs=1e-9)
    np.testing.assert_allclose(found.gradient, slopes, rtol=0, atol=1e-9)


def test_modes_turns_and_the_end_time_keep_within_the_limit(repeated):
    rod, scene, events, modes = rod_on_a_stop()
    objective = Terminal(position(rod.at_end, 1)) + Integral(slope_angle(rod.at(0.5)))
    settings = {"events": events, "modes": modes, "design": ["rod.height", "t_end"]}
    direct, limited = (
        gradient(scene, objective, 0.32, HHT(1e-3), method=method, **settings)
        for method in (DirectDifferentiation(), Adjoint(memory="340 kB"))
    )
    assert repeated
    assert limited.value == pytest.approx(direct.value, rel=1e-13)
    np.testing.assert_allclose(limited.gradient, direct.gradient, rtol=1e-9)


def test_angle_keeps_its_turns_from_phase_to_phase(repeated):
    # omega t counts turns: the integral of its square is omega^2 T^3 / 3.
    body = RigidBody("body", (0, 1), mass=1.0, inertia=0.1)
    spins = InitialVelocity("body", 8.0, about=(0, 1))
    scene = Scene(bodies=[body], gravity=(0, -10.0), start=[spins])
    settings = {"design": ["body.angular_velocity"], "events": [
        Impact(position(body.at(0, 0), 1) - 0.2, 0.9, "floor")
    ]}  # fmt: skip
    objective = Integral(rotation_angle(body.at(0, 0)) ** 2)
    for limit in ({}, {"memory": "100 kB"}):
        found = gradient(scene, objective, 2.5, Radau(0.02), **settings, **limit)
        assert found.value == pytest.approx(64 * 2.5**3 / 3, rel=1e-6)
        np.testing.assert_allclose(found.gradient, [16 * 2.5**3 / 3], rtol=1e-6)
    assert len(found.event_solution.events) > 2
    assert repeated


def test_memory_is_a_limit_of_the_adjoint_only():
    with pytest.raises(InvalidInputError, match="limits the adjoint method only"):
        gradient(
            Ball(), Terminal(HEIGHT), 3.2, HHT(0.05), events=[BOUNCE], memory="1 MB",
            method=DirectDifferentiation(),
        )  # fmt: skip
