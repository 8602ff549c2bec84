"""`simulate(after=)` of runs with events: they go on as a run in one go."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    EndEvent,
    Impact,
    Mode,
    Radau,
    Switch,
    load_event_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.observables import multiplier, position
from tests.support.balls import BOUNCE, HEIGHT, Ball, ball_by_hand
from tests.support.rods_on_stops import falling_rod, rod_on_a_stop
from validation.events.woodpecker import Woodpecker


def same(one, other, atol):
    assert [x.name for x in one.events] == [x.name for x in other.events]
    assert [x.mode for x in one.events] == [x.mode for x in other.events]
    times = ([x.time for x in run.events] for run in (one, other))
    np.testing.assert_allclose(*times, rtol=1e-12)
    np.testing.assert_allclose(one.t, other.t, rtol=1e-12, atol=1e-15)
    for name in ("q", "v"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=atol)
    assert one.outcome.success


@pytest.mark.parametrize("cut", [0.5, 1.2, 2.9])
@pytest.mark.parametrize("integrator", [HHT(0.05), Radau(0.2)])
def test_ball_goes_on_after_no_one_and_two_impacts(integrator, cut):
    once = simulate(Ball(), 3.2, integrator, events=[BOUNCE])
    part = simulate(Ball(), cut, integrator, events=[BOUNCE])
    assert len(part.phases) == 1 + sum(x.time < cut for x in once.events)
    run = simulate(Ball(), 3.2, integrator, events=[BOUNCE], after=part)
    same(run, once, 1e-12)
    assert run.q[-1, 0] == pytest.approx(ball_by_hand(3.2, Ball().b), abs=1e-11)


def test_rod_goes_on_in_the_mode_that_holds_it(tmp_path):
    rod, scene, closed = falling_rod()
    events = [Impact(position(rod.at_end, 1) + 0.3, 0.5, "stop", rest="closed")]
    modes = {"closed": Mode(closed, [Switch(-multiplier("stop", 0), "start", -1, "off")])}
    once = simulate(scene, 0.35, HHT(4e-3), events=events, modes=modes)
    held = next(x.time for x in once.events if x.mode != "start")
    part = simulate(scene, held + 0.02, HHT(4e-3), events=events, modes=modes)
    assert part.events[-1].mode != "start"
    read = load_event_solution(part.save(tmp_path / "part.npz"))
    for earlier in (part, read):
        run = simulate(scene, 0.35, HHT(4e-3), events=events, modes=modes, after=earlier)
        assert [x.mode for x in run.events] == [x.mode for x in once.events]
        np.testing.assert_allclose(run.q[-1], once.q[-1], atol=1e-6)
    with pytest.raises(UnknownNameError, match="mode in which `after` ends"):
        simulate(scene, 0.35, HHT(4e-3), events=[], after=part)


def test_woodpecker_goes_on_while_it_sticks_and_slides():
    toy = Woodpecker()
    once = simulate(toy, 0.16, DOP853(1e-10), events=toy.events(), modes=toy.modes())
    for cut in (0.0105, 0.08, 0.12):
        settings = {"events": toy.events(), "modes": toy.modes()}
        part = simulate(toy, cut, DOP853(1e-10), **settings)
        run = simulate(toy, 0.16, DOP853(1e-10), after=part, **settings)
        assert [x.name for x in run.events] == [x.name for x in once.events]
        np.testing.assert_allclose(
            [x.time for x in run.events], [x.time for x in once.events], atol=1e-9
        )
        np.testing.assert_allclose(run.q[-1], once.q[-1], atol=1e-8)


def test_run_goes_on_after_an_end_event_that_is_left_out():
    stop = EndEvent(HEIGHT - 2.0, 1, "up")
    part = simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE, stop])
    assert part.events[-1].name == "up"
    run = simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE], after=part)
    same(run, simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE]), 1e-12)


def test_earlier_runs_that_do_not_fit_are_refused_in_words():
    part = simulate(Ball(), 2.9, HHT(0.05), events=[BOUNCE])
    with pytest.raises(InvalidInputError, match="after: must not have passed t_end"):
        simulate(Ball(), 1.5, HHT(0.05), events=[BOUNCE], after=part)
    with pytest.raises(InvalidInputError, match="after: must be"):
        simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE], after=part.phases[0])
    _, scene, events, modes = rod_on_a_stop()
    with pytest.raises(InvalidInputError, match="must be a run of this model"):
        simulate(scene, 3.2, HHT(0.05), events=events, modes=modes, after=part)
    with pytest.raises(InvalidInputError, match="after: must be"):
        simulate(Ball(), 3.2, HHT(0.05), after=part)


def test_run_that_goes_on_knows_which_impact_has_just_happened():
    # A flight of less than 1e-8 of the run between two impacts of one event is rest. The earlier
    # run ends within the first flight of this kind.
    ball, settings = Ball((5.0, 0.0, 10.0, 0.5)), {"events": [BOUNCE]}
    once = simulate(ball, 3.2, HHT(0.05), **settings)
    last = once.phases[-1]
    assert 0 < last.t[-1] - last.t[0] < 3.2e-8
    part = simulate(ball, np.mean(last.t[[0, -1]]), HHT(0.05), **settings)
    assert part.outcome.success
    run = simulate(ball, 3.2, HHT(0.05), after=part, **settings)
    assert "follow each other" in str(run.outcome)
    assert len(run.events) == len(once.events)
    assert len(run.phases) == len(once.phases)
