"""Events at the start of a phase, at double zeros, at one time, and too many of them."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Adjoint,
    AtTimes,
    ComplexStep,
    DirectDifferentiation,
    EndEvent,
    Impact,
    Mode,
    RigidBody,
    Scene,
    SpringDamper,
    Switch,
    Terminal,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.errors import InvalidInputError, ManyStepsWarning, UnlikelyValueWarning
from ancfdae.observables import elapsed_time, position, velocity
from tests.support.balls import HEIGHT, Ball

EXACT = (DirectDifferentiation(), Adjoint(), ComplexStep())


@pytest.mark.parametrize("ahead", [1e-13, 1e-11, 1e-9, 1e-6])
def test_zero_just_after_the_start_is_an_event_and_one_just_before_is_none(ahead):
    # The ball falls at 1 m/s from a distance above, or below, the height of the event.
    event = EndEvent(HEIGHT - 5.0, 0)
    above = simulate(Ball((5.0 + ahead, -1.0, 10.0, 0.8)), 0.5, HHT(0.05), events=[event])
    assert above.events[0].time == pytest.approx(ahead, abs=4e-15, rel=1e-5)
    below = simulate(Ball((5.0 - ahead, -1.0, 10.0, 0.8)), 0.5, HHT(0.05), events=[event])
    assert not below.events


@pytest.mark.parametrize("t_end", [1e-3, 0.5, 20.0])
def test_round_off_at_the_start_is_no_event_however_long_the_run(t_end):
    # 0.1 + 0.2 lies 6e-17 above 0.3.
    ball, event = Ball((0.1 + 0.2, -1.0, 1e-3, 0.8)), EndEvent(HEIGHT - 0.3, 0)
    assert not simulate(ball, t_end, HHT(t_end / 20), events=[event]).events


def test_mode_with_a_negative_gap_is_refused_and_one_with_a_closed_gap_strikes():
    ball = Ball((5.0, 0.0, 10.0, 0.5))
    low = Switch(HEIGHT - 2.0, "low", -1)

    def run(floor):
        modes = {"low": Mode(ball, [Impact(HEIGHT - floor, 0.5, "floor")])}
        return simulate(ball, 1.0, HHT(0.05), events=[low], modes=modes)

    with pytest.raises(InvalidInputError, match="where mode 'low' begins"):
        run(2.5)
    # At 2 m the speed is sqrt(60), and half of it after the impact.
    solution = run(2.0)
    assert [event.name for event in solution.events[:2]] == ["floor", "switch"]
    assert solution.phases[1].v[0, 0] == pytest.approx(0.5 * np.sqrt(60), rel=1e-12)


def test_derivatives_pass_an_impact_of_the_mode_that_begins():
    ball = Ball((5.0, 0.0, 10.0, 0.5))
    low = Switch(HEIGHT - 2.0, "low", -1)
    modes = {"low": Mode(ball, [Impact(HEIGHT - 2.0, 0.5, "floor")])}
    # z = 2 + e u s - g s^2 / 2 with u = sqrt(2 g (z0 - 2)), s = T - u / g.
    fall, u, s = np.sqrt(0.6), np.sqrt(60.0), 0.9 - np.sqrt(0.6)
    exact = 0.5 * (10 / u) * s - (0.5 * u - 10 * s) / (10 * fall)
    for method in EXACT:
        found = gradient(
            ball, Terminal(HEIGHT), 0.9, HHT(0.05), events=[low], modes=modes, method=method
        )
        assert found.gradient[0] == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("direction", [-1, 0, 1])
@pytest.mark.parametrize("power", [2, 4])
def test_function_that_only_touches_zero_ends_the_run_in_words(direction, power):
    event = EndEvent((HEIGHT - 4.7) ** power, direction)
    solution = simulate(Ball((5.0, -1.0, 10.0, 0.8)), 0.5, HHT(0.05), events=[event])
    assert "touches zero" in str(solution.outcome)


def test_triple_zero_is_located_and_has_no_derivative():
    ball, event = Ball((5.0, -1.0, 10.0, 0.8)), EndEvent((HEIGHT - 4.7) ** 3, 0)
    # 5 - t - 5 t^2 = 4.7
    time = (-1 + np.sqrt(7.0)) / 10
    assert simulate(ball, 0.5, HHT(0.05), events=[event]).events[0].time == pytest.approx(
        time, rel=1e-9
    )
    with pytest.raises(InvalidInputError, match="must cross zero"):
        gradient(ball, Terminal(HEIGHT), 0.5, HHT(0.05), events=[event])


def test_more_events_than_the_limit_are_foreseen():
    # 3 kg hit the floor, then 1 kg above them, and bounce with 1e-5 s between impacts.
    bodies = [RigidBody(x, (0, y), mass=m, inertia=0.01) for x, y, m in (("a", 1, 3), ("b", 2, 1))]
    low, high = (position(body.at(0, 0), 1) for body in bodies)
    events = [Impact(low - 0.5, 1.0, "floor"), Impact(high - low - 1.0 + 1e-9, 1.0, "both")]
    solution = simulate(Scene(bodies=bodies, gravity=(0, -10.0)), 3.0, HHT(0.01), events=events)
    assert "limit of events" in str(solution.outcome)
    assert "At the rate" in str(solution.outcome)
    assert len(solution.events) < 1000


def test_a_run_with_very_many_events_warns_once_how_many_are_to_come():
    # A ball of e = 1 starts upwards at 1 m/s, under 1000 m/s^2: a bounce takes 2 ms.
    ball, floor = Ball((1.0, 1.0, 1000.0, 1.0)), Impact(HEIGHT - 1.0 + 1e-9, 1.0, "floor")
    events = [floor, EndEvent(elapsed_time() - 0.8205, 1)]
    # 400 bounces are over at 0.8 s.
    with pytest.warns(ManyStepsWarning, match=r"about 6.1e\+03 events .* 0.002 s apart") as told:
        solution = simulate(ball, 13.0, HHT(0.1), events=events)
    assert len(told) == 1
    assert len(solution.events) == 411
    # Without a warning, which would be an error of this test:
    assert len(simulate(ball, 9.0, HHT(0.1), events=events).events) == 411


def test_bounces_below_the_round_off_of_coordinates_are_rest():
    # Gravity of 1e-6 m/s^2 at 1 m: bounces get lower than 1e-15 m while they still take 1e-4 s.
    ball = Ball((1.0 + 1e-11, 0.0, 1e-6, 0.9))
    solution = simulate(ball, 10.0, HHT(1.0), events=[Impact(HEIGHT - 1.0, 0.9, "floor")])
    assert "follow each other" in str(solution.outcome)
    assert len(solution.events) < 80


def two_balls(damping=0.0):
    bodies = [RigidBody(f"ball{n}", (3 * n, 1.0), mass=1.0 + n, inertia=0.3) for n in (0, 1)]
    gaps = [position(body.at(0, 0), 1) for body in bodies]
    damper = SpringDamper(bodies[0].at(0, 0), 0.0, damping, 1.0, other=bodies[1].at(0, 2))
    loads = [damper] if damping else []
    events = [Impact(gap, 0.5, f"floor {n}") for n, gap in enumerate(gaps)]
    return Scene(bodies=bodies, loads=loads, gravity=(0, -10.0)), gaps, events


DESIGN = ["ball0.position_y", "ball1.position_y"]


@pytest.mark.parametrize("method", EXACT)
def test_impacts_of_independent_bodies_at_one_time_have_their_own_derivatives(method):
    scene, (low, high), events = two_balls()
    # y = 5 t_f (T - t_f) - 5 (T - t_f)^2 with 5 t_f^2 = h and e = 0.5.
    fall, after = np.sqrt(0.2), 0.6 - np.sqrt(0.2)
    own = (5 * after - 5 * fall + 10 * after) / (10 * fall)
    y = 5 * fall * after - 5 * after**2
    found = gradient(
        scene, Terminal(low * high), 0.6, HHT(0.01), design=DESIGN, events=events, method=method
    )
    np.testing.assert_allclose(found.gradient, [own * y, own * y], rtol=1e-9)


def test_times_and_impulses_of_impacts_at_one_time_have_their_own_derivatives():
    scene, _, events = two_balls()
    found = differentiate(scene, 0.6, HHT(0.01), design=DESIGN, events=events).events
    # t = sqrt(h / 5), P = 1.5 m sqrt(2 g h)
    by_height, speed = 1 / np.sqrt(20.0), 10 / np.sqrt(20.0)
    np.testing.assert_allclose([x.time_b for x in found], np.eye(2) * by_height, atol=1e-9)
    slopes = np.diag([1.5 * speed, 3.0 * speed])
    np.testing.assert_allclose([x.impulse_b for x in found], slopes, atol=1e-9)


def test_impacts_at_one_time_whose_order_matters_have_no_derivative():
    # After one impact the damper changes the acceleration of the other ball.
    scene, (_, high), events = two_balls(damping=50.0)
    with pytest.raises(InvalidInputError, match="happen together with the other event"):
        gradient(scene, Terminal(high), 0.6, HHT(0.01), design=["ball1.position_y"], events=events)


def test_time_of_an_event_is_an_objective():
    up = EndEvent(HEIGHT - 1.0, 1, "up")
    floor = Impact(HEIGHT, 0.5, "floor")
    ball = Ball((5.0, 0.0, 10.0, 0.5))
    found = gradient(ball, Terminal(elapsed_time()), 3.0, HHT(0.05), events=[floor, up])
    # u t - 5 t^2 = 1 with u = 5: t = 0.5 - sqrt(0.05), after a fall of 1 s.
    assert found.value == pytest.approx(1.5 - np.sqrt(0.05), rel=1e-12)


@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint()])
def test_value_at_the_time_of_an_impact_is_that_before_it_and_warned_of(method) -> None:
    """A ball that falls from rest at 1 m strikes at sqrt(2 h/g), and bounces by half its speed."""
    gravity, height = 10.0, 1.0
    ball = RigidBody("ball", (0.0, height), mass=2.0, inertia=0.01)
    scene = Scene(bodies=[ball], gravity=(0.0, -gravity))
    floor = Impact(position(ball.origin, 1), restitution=0.5, name="floor")
    strike, speed = np.sqrt(2 * height / gravity), velocity(ball.origin, 1)

    def at(time):
        objective = AtTimes(speed, [time])
        given = {"design": ["scene.gravity_y"], "events": [floor], "method": method}
        return gradient(scene, objective, 0.8, HHT(0.01), **given)

    with pytest.warns(UnlikelyValueWarning, match=r"event happens at the time 0\.447213595 s"):
        found = at(strike)
    assert found.value == pytest.approx(-gravity * strike, rel=1e-9)
    np.testing.assert_allclose(found.gradient, [strike], rtol=1e-6)
    # Beside it there is no warning: v = -g t before, and e g t_1 - g (t - t_1) after the impact.
    assert at(strike - 1e-6).value == pytest.approx(-gravity * (strike - 1e-6), rel=1e-9)
    after = at(strike + 1e-6)
    assert after.value == pytest.approx(0.5 * gravity * strike - gravity * 1e-6, rel=1e-9)
