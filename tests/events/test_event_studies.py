"""Runs with events in sweeps, optimisation, fits, and files."""

import numpy as np
import pytest
import scipy

from ancfdae import (
    HHT,
    Evaluator,
    FiniteDifference,
    Impact,
    Misfit,
    Responses,
    Terminal,
    differentiate,
    gradient,
    load_event_solution,
    load_solution,
    sweep,
)
from ancfdae.errors import InvalidInputError
from ancfdae.observables import position
from tests.support.balls import BOUNCE, HEIGHT, Ball, ball_by_hand, slopes_by_hand
from tests.support.rods_on_stops import rod_on_a_stop

FLOOR = Impact(HEIGHT, 0.8, "floor")


def test_responses_run_with_events():
    ball, h = Ball(), HHT(0.05)
    asked = {"height": Terminal(HEIGHT), "square": Terminal(HEIGHT**2)}
    responses = Responses(ball, asked, 3.2, h, events=[BOUNCE])
    x = np.array([4.5, 0.2, 9.5, 0.7])
    assert responses["height"](x) == pytest.approx(ball_by_hand(3.2, x), rel=1e-10)
    np.testing.assert_allclose(responses["height"].gradient(x), slopes_by_hand(3.2, x), rtol=1e-8)
    np.testing.assert_allclose(
        responses.jacobian(x)[1], 2 * ball_by_hand(3.2, x) * slopes_by_hand(3.2, x), rtol=1e-8
    )
    assert len(responses.solution(x).events) == 2
    # Values and derivatives once each.
    assert len(responses.history.rows) == 1


def test_fit_finds_restitution_and_gravity_from_a_bouncing_ball():
    truth, times = np.array([5.0, -0.1, 9.3, 0.74]), np.linspace(0.1, 3.1, 25)
    data = np.array([[ball_by_hand(t, truth) for t in times]])
    fit = Misfit([HEIGHT], times, data).fit(Ball(), 3.2, HHT(0.02), events=[BOUNCE])
    J = [slopes_by_hand(t, fit.start) for t in times]
    np.testing.assert_allclose(fit.jacobian(fit.start), J, atol=1e-8)
    found = scipy.optimize.least_squares(
        fit.residuals, fit.start, fit.jacobian, x_scale="jac", xtol=1e-14, gtol=None
    )
    np.testing.assert_allclose(found.x, truth, atol=1e-7)


def test_sweep_runs_with_events():
    what = Evaluator(Terminal(HEIGHT), 3.2, HHT(0.05), gradient=True, events=[BOUNCE])
    rows = np.array([[5.0, -0.1, 10.0, 0.8], [4.0, 0.0, 9.0, 0.7]])
    for row, b in zip(sweep(Ball(), rows, what).rows, rows, strict=True):
        assert row.result["value"] == pytest.approx(ball_by_hand(3.2, b), rel=1e-10)
        np.testing.assert_allclose(row.result["gradient"], slopes_by_hand(3.2, b), rtol=1e-8)
    along = Evaluator(HEIGHT, 3.2, HHT(0.05), events=[BOUNCE])
    result = sweep(Ball(), rows[1:], along).rows[0].result
    # Impacts stand twice, before and after.
    assert np.count_nonzero(np.diff(result["t"]) == 0) == 3
    exact = [ball_by_hand(t, rows[1]) for t in result["t"]]
    np.testing.assert_allclose(result["value"], exact, atol=1e-10)


def test_sweep_moves_modes_with_the_scene():
    rod, scene, events, modes = rod_on_a_stop()
    settings = {"events": events, "modes": modes}
    what = Evaluator(Terminal(position(rod.at_end, 1)), 0.32, HHT(5e-3), **settings)
    row = sweep(scene, [{"rod.height": 0.033}], what).rows[0]
    assert row.finished
    rod, scene, events, modes = rod_on_a_stop(0.033)
    direct = gradient(
        scene, Terminal(position(rod.at_end, 1)), 0.32, HHT(5e-3), events=events, modes=modes,
        design=["rod.height"], method=FiniteDifference(1e-6),
    )  # fmt: skip
    assert row.result["value"] == pytest.approx(direct.value, rel=1e-9)


@pytest.mark.parametrize("name", ["run.npz", "run.h5"])
def test_runs_with_events_are_saved_and_loaded(tmp_path, name):
    rod, scene, events, modes = rod_on_a_stop()
    run = differentiate(scene, 0.32, HHT(5e-3), design=["rod.height"], events=events, modes=modes)
    read = load_event_solution(run.save(tmp_path / name))
    assert str(read) == str(run)
    assert len(read.phases) == len(run.phases) > 2
    for phase, again in zip(run.phases, read.phases, strict=True):
        np.testing.assert_array_equal(again.q, phase.q)
        np.testing.assert_array_equal(again.sensitivities.q_b, phase.sensitivities.q_b)
    for event, again in zip(run.events, read.events, strict=True):
        assert (again.name, again.time, again.mode) == (event.name, event.time, event.mode)
        np.testing.assert_array_equal(again.time_b, event.time_b)
    np.testing.assert_array_equal(read.position(rod.at_end), run.position(rod.at_end))


def test_files_of_the_two_kinds_are_told_apart(tmp_path):
    run = differentiate(Ball(), 1.0, HHT(0.1), events=[FLOOR])
    with pytest.raises(InvalidInputError, match=r"Solution\.save"):
        load_solution(run.save(tmp_path / "run.npz"))
    with pytest.raises(InvalidInputError, match=r"EventSolution\.save"):
        load_event_solution(run.phases[0].save(tmp_path / "phase.npz"))
