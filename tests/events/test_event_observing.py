"""Observables, objectives and studies of runs with events, beside motions by hand."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    Adjoint,
    AtTimes,
    EndEvent,
    Impact,
    InitialVelocity,
    Integral,
    Radau,
    RigidBody,
    Scene,
    SmoothMaximum,
    Terminal,
    assemble,
    evaluate,
    gradient,
    load_event_solution,
    record_observables,
    simulate,
    taylor_test,
    work_precision,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.observables import (
    custom,
    gravitational_energy,
    kinetic_energy,
    observe,
    position,
    slope_angle,
    strain_energy,
)
from tests.support.balls import BOUNCE, HEIGHT, Ball, ball_by_hand, slopes_by_hand
from tests.support.rods_on_stops import rod_on_a_stop

B = (5.0, -0.1, 10.0, 0.8)
SPEED = custom(lambda t, q, v, lam, b: v[:, 0], "speed")
TIME = custom(lambda t, q, v, lam, b: t + 0.0 * q[:, 0], "time")


@pytest.fixture(scope="module")
def bounces():
    return simulate(Ball(), 3.2, HHT(0.05), events=[BOUNCE])


def test_observe_has_the_value_before_an_event_and_then_the_value_after_it(bounces):
    """Speed before the first impact: -sqrt(v0^2 + 2 g z0); after it -e times that."""
    twice = np.flatnonzero(np.diff(bounces.t) == 0)
    assert len(twice) == len(bounces.events) == 2
    speed = observe(SPEED, bounces, Ball())
    landing = np.sqrt(0.1**2 + 2 * 10 * 5)
    np.testing.assert_allclose(speed[twice], [-landing, -0.8 * landing], rtol=1e-10)
    np.testing.assert_allclose(speed[twice + 1], -0.8 * speed[twice], rtol=1e-12)
    by_hand = [ball_by_hand(t, B) for t in bounces.t]
    np.testing.assert_allclose(observe(HEIGHT, bounces, Ball()), by_hand, atol=1e-10)
    np.testing.assert_array_equal(observe(TIME, bounces, Ball()), bounces.t)


def test_a_run_that_passes_modes_is_observed_with_the_systems_of_its_modes(tmp_path):
    rod, scene, events, modes = rod_on_a_stop()
    run = simulate(scene, 0.32, HHT(5e-3), events=events, modes=modes)
    systems = {"start": assemble(scene), "held": assemble(modes["held"].model)}
    energy = kinetic_energy() + strain_energy() + gravitational_energy()
    found = observe(energy, run, systems)
    # Each phase as a solution of its own.
    alone = [
        observe(energy, phase, systems[mode])
        for phase, mode in zip(run.phases, run.modes, strict=True)
    ]
    np.testing.assert_array_equal(found, np.concatenate(alone))
    assert set(run.modes) == {"start", "held"}
    np.testing.assert_array_equal(
        observe(position(rod.at_end, 1), run), run.position(rod.at_end)[:, 1]
    )
    assert load_event_solution(run.save(tmp_path / "run.npz")).modes == run.modes
    with pytest.raises(InvalidInputError, match=r"must be a mapping .* got one system and 'held'"):
        observe(energy, run, systems["start"])
    with pytest.raises(UnknownNameError, match="held"):
        observe(energy, run, {"start": systems["start"]})
    with pytest.raises(InvalidInputError, match="multipliers"):
        observe(energy, run, {"start": systems["start"], "held": systems["start"]})


def spinner():
    """A body that turns at 10 rad/s while its centre falls on a floor below."""
    disc = RigidBody("disc", (0, 0), mass=1.0, inertia=0.1)
    start = [InitialVelocity("disc", 10.0, about=(0, 0))]
    scene = Scene([], [], (0, -9.81), bodies=[disc], start=start)
    return disc, scene, [Impact(position(disc.origin, 1) + 0.5, 0.9, "floor")]


@pytest.mark.parametrize("keep", [7, np.linspace(0, 2, 9)])
def test_turns_are_counted_through_impacts(keep):
    disc, scene, events = spinner()
    angle = slope_angle(disc.origin)
    run = simulate(scene, 2.0, DOP853(1e-10), events=events)
    assert len(run.events) > 2
    np.testing.assert_allclose(observe(angle, run, assemble(scene)), 10 * run.t, atol=1e-7)
    record = record_observables(scene, [angle], 2.0, DOP853(1e-10), keep=keep, events=events)
    np.testing.assert_allclose(record.values[:, 0], 10 * record.t, atol=1e-7)


def test_records_have_both_sides_of_an_event_or_the_times_asked_for(tmp_path):
    settings = 3.2, HHT(0.05)
    record = record_observables(Ball(), [HEIGHT, SPEED], *settings, keep=10, events=[BOUNCE])
    twice = np.flatnonzero(np.diff(record.t) == 0)
    assert [x.time for x in record.events] == record.t[twice].tolist()
    np.testing.assert_allclose(record.values[twice + 1, 1], -0.8 * record.values[twice, 1])
    by_hand = [ball_by_hand(t, B) for t in record.t]
    np.testing.assert_allclose(record.values[:, 0], by_hand, atol=1e-10)
    # The state before an event stands at its time.
    times = [0.0, record.events[0].time, 1.9, 3.2]
    file, asked = tmp_path / "rows.npy", [HEIGHT, SPEED]
    record = record_observables(Ball(), asked, *settings, keep=times, file=file, events=[BOUNCE])
    np.testing.assert_array_equal(record.t, times)
    assert record.values[1, 1] < 0 < record.values[3, 0]
    by_hand = [ball_by_hand(t, B) for t in times]
    np.testing.assert_allclose(record.values[:, 0], by_hand, atol=1e-10)
    np.testing.assert_array_equal(np.load(file)[:, 1:], record.values)
    with pytest.raises(InvalidInputError, match="must be a sequence of times with a file"):
        record_observables(Ball(), asked, *settings, keep=2, file=file, events=[BOUNCE])


def test_records_of_a_run_that_stops_hold_what_it_reached(tmp_path):
    """Restitution of 0.1: impacts accumulate, and the run ends there without `rest`."""
    times, file = np.linspace(0, 3, 31), tmp_path / "rows.npy"
    ball = Ball((5.0, -0.1, 10.0, 0.1))
    record = record_observables(
        ball, [HEIGHT], 3.0, HHT(0.05), keep=times, file=file, events=[BOUNCE]
    )
    assert not record.outcome.success
    end = record.outcome.time
    np.testing.assert_array_equal(record.t, times[times <= end])
    assert np.all(np.isnan(np.load(file)[len(record.t) :]))


OBJECTIVES = {
    "end": Terminal(HEIGHT),
    "mean": Integral(HEIGHT**2),
    "times": AtTimes(HEIGHT, [0.4, 1.9, 2.7]),
    "largest": SmoothMaximum(SPEED, 5.0),
}


@pytest.mark.parametrize("name", OBJECTIVES)
@pytest.mark.parametrize(
    "integrator", [HHT(0.05), Radau(0.1), DOP853(1e-9)], ids=["HHT", "Radau", "DOP853"]
)
def test_evaluate_has_the_value_of_the_gradient(name, integrator):
    settings = 3.2, integrator
    run = simulate(Ball(), *settings, events=[BOUNCE])
    expected = gradient(Ball(), OBJECTIVES[name], *settings, events=[BOUNCE]).value
    assert evaluate(OBJECTIVES[name], run, Ball()) == pytest.approx(expected, rel=1e-13)


def test_evaluate_takes_the_modes_of_the_run():
    rod, scene, events, modes = rod_on_a_stop()
    given = {"events": events, "modes": modes}
    run = simulate(scene, 0.32, HHT(5e-3), **given)
    energy = Integral(kinetic_energy() + position(rod.at_end, 0))
    expected = gradient(scene, energy, 0.32, HHT(5e-3), design=["rod.height"], **given).value
    assert evaluate(energy, run, scene, modes=modes) == pytest.approx(expected, rel=1e-13)
    with pytest.raises(UnknownNameError, match="held"):
        evaluate(energy, run, scene)
    end = EndEvent(position(rod.at_end, 1) + 0.1)
    early = simulate(scene, 0.32, HHT(5e-3), events=[*events, end], modes=modes)
    assert evaluate(Terminal(position(rod.at_end, 1)), early, scene) == pytest.approx(-0.1)
    with pytest.raises(InvalidInputError, match="modes: must be left out"):
        evaluate(energy, simulate(scene, 0.01, HHT(5e-3)), scene, modes=modes)


@pytest.mark.parametrize("method", [None, Adjoint()])
def test_taylor_tests_move_the_events(method):
    """The remainder is the second derivative along b of the flight by hand."""
    given = {"events": [BOUNCE], "method": method, "direction": (0.1, 0.2, -0.1, 0.05)}
    test = taylor_test(Ball(), Terminal(HEIGHT), 3.2, HHT(0.05), **given)
    assert abs(test.order - 2) < 0.02
    db = np.array(given["direction"]) * np.abs(B)
    moved = np.array([ball_by_hand(3.2, B + s * db) for s in test.sizes])
    rest = np.abs(moved - ball_by_hand(3.2, B) - test.sizes * (slopes_by_hand(3.2, B) @ db))
    np.testing.assert_allclose(test.first, rest, rtol=1e-4)


def test_taylor_tests_take_the_end_time():
    """A spinner turns by w t: the second derivative of its height vanishes only at w t = 0."""
    disc, scene, _ = spinner()
    height = Terminal(position(disc.at(1.0, 0.0), 1))
    design = ["disc.inertia", "t_end"]
    test = taylor_test(scene, height, 0.31, HHT(0.02), design=design, direction=(0.0, 1.0))
    assert test.gradient.names[-1] == "t_end"
    assert abs(test.order - 2) < 0.05


def test_work_precision_compares_runs_with_events():
    rod, scene, events, modes = rod_on_a_stop()
    settings = [HHT(rtol=1e-3), HHT(rtol=1e-5)]
    found = work_precision(
        scene, Terminal(position(rod.at_end, 1)), 0.3, settings, design=["rod.height"],
        reference=Radau(5e-4), events=events, modes=modes,
    )  # fmt: skip
    loose, tight = found.rows
    for name in ("states", "objective", "gradient"):
        assert getattr(tight, name) < 0.3 * getattr(loose, name)
    assert tight.multipliers is None is tight.drift is tight.energy
    with pytest.raises(InvalidInputError, match="models: must be left out with events"):
        work_precision(
            scene, Terminal(position(rod.at_end, 1)), 0.3, settings, design=["rod.height"],
            events=events, modes=modes, models={"other": scene},
        )  # fmt: skip
