"""Runs with events to a tolerance, and their error bars."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    DirectDifferentiation,
    EndEvent,
    Impact,
    Integral,
    Radau,
    Terminal,
    error_bars,
    gradient,
    gradients,
    simulate,
)
from ancfdae.equations.event_solution import EventRecord, EventSolution
from ancfdae.errors import InvalidInputError, ToleranceWarning
from ancfdae.events.calls import EventRun
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom, elapsed_time, position
from ancfdae.studies.accuracy import event_search
from tests.support.balls import BOUNCE, HEIGHT, Ball, ball_by_hand, slopes_by_hand
from tests.support.rods_on_stops import rod_on_a_stop

# z0 = 5, v0 = -0.1, g = 10, e = 0.8 at t = 3.2, after two impacts.
VALUE = 2.043656070001
SLOPES = np.array([0.311880018998, -0.033280796140, 0.048092789540, 9.155137855557])


class Spring(FormulaSystem):
    """A mass on a spring that hits a wall at x = 0 in every period: steps err, events move."""

    n_q, n_lam = 1, 0
    design_names = ("x0", "k", "e")

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return self.b[:1] * 1, 0 * self.b[:1]

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return -self.b[1] * q

    def position_constraint(self, t, q):
        return np.zeros(0)


PLACE = custom(lambda t, q, v, lam, b: q[:, 0], "x")
WALL = Impact(PLACE, custom(lambda t, q, v, lam, b: b[2] + 0 * t, "e"), "wall")
SPRING = np.array([1.0, 9.0, 0.7])


def spring_by_hand(t, b):
    """x = x0 cos w t until pi/(2 w), then e^n x0 |cos w t|, since every half period has one hit."""
    x0, k, e = b
    w = k**0.5
    hits = int(np.floor((w * t).real / np.pi + 0.5))
    return x0 * e**hits * np.cos(w * t) * (-1) ** hits


def spring_slopes(t, b):
    return np.array([spring_by_hand(t, b + 1e-30j * x).imag / 1e-30 for x in np.eye(3)])


@pytest.mark.parametrize("method", [None, DirectDifferentiation(), Adjoint()])
def test_gradient_of_the_bouncing_ball_reaches_a_tolerance(method):
    found = gradient(Ball(), Terminal(HEIGHT), 3.2, tolerance=1e-9, method=method, events=[BOUNCE])
    assert found.accuracy.reached
    assert len(found.event_solution.events) == 2
    assert found.value == pytest.approx(VALUE, rel=1e-9)
    np.testing.assert_allclose(found.gradient, SLOPES, rtol=0, atol=1e-9)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-7])
def test_bars_hold_the_error_of_a_spring_that_hits_a_wall(tolerance):
    t_end, scale = 4.0, SPRING
    found = gradient(Spring(SPRING), Terminal(PLACE), t_end, tolerance=tolerance, events=[WALL])
    assert found.accuracy.reached
    exact, slopes = spring_by_hand(t_end, SPRING), spring_slopes(t_end, SPRING)
    assert abs(found.value - exact) <= found.accuracy.value_bar
    error, bar = found.gradient - slopes, found.accuracy.gradient_bar
    assert np.all(np.abs(error) <= bar)
    size = np.linalg.norm(slopes * scale)
    assert np.linalg.norm(bar * scale) <= tolerance * size
    assert np.linalg.norm(error * scale) <= tolerance * size
    # Looser tolerances take fewer steps.
    assert {type(trial.integrator) for trial in found.accuracy.trials} == {HHT, Radau}


def test_objectives_and_a_free_end_reach_a_tolerance():
    objectives = [Integral(HEIGHT), Terminal(HEIGHT)]
    settings = {"events": [BOUNCE], "design": ["t_end"], "tolerance": 1e-6}
    found = gradients(Ball(), objectives, 3.2, **settings)
    assert found[0].names == (*Ball.design_names, "t_end")
    assert found[0].gradient[-1] == pytest.approx(VALUE, rel=1e-6)
    step = (ball_by_hand(3.2 + 1e-6, Ball().b) - ball_by_hand(3.2 - 1e-6, Ball().b)) / 2e-6
    assert found[1].gradient[-1] == pytest.approx(step, rel=1e-6)
    assert all(each.accuracy.gradient_bar.shape == (5,) for each in found)


def test_time_of_an_end_event_reaches_a_tolerance():
    end = EndEvent(PLACE - 0.3, -1)
    found = gradient(
        Spring(SPRING), Terminal(elapsed_time()), 4.0, tolerance=1e-6, events=[end, WALL]
    )
    assert abs(found.value - np.arccos(0.3) / 3) <= found.accuracy.value_bar + 1e-12
    assert found.value == pytest.approx(np.arccos(0.3) / 3, rel=1e-6)


def test_observables_at_times_reach_a_tolerance():
    times = np.linspace(0.0, 4.0, 17)
    found = simulate(
        Spring(SPRING), 4.0, tolerance=1e-5, observables=[PLACE, PLACE**2], at=times, events=[WALL]
    )
    exact = np.array([spring_by_hand(t, SPRING) for t in times])
    exact = np.column_stack([exact, exact**2])
    assert found.reached
    np.testing.assert_array_equal(found.t, times)
    assert np.all(np.abs(found.values - exact) <= found.bars + 1e-13)
    for own, size in zip((found.values - exact).T, exact.T, strict=True):
        assert np.linalg.norm(own) <= 1e-5 * np.linalg.norm(size)
    assert len(found.solution.events) == 4


def test_rod_on_a_stop_reaches_a_tolerance_with_its_modes():
    rod, scene, events, modes = rod_on_a_stop()
    end, settings = Terminal(position(rod.at_end, 1)), {"events": events, "modes": modes}
    found = gradient(scene, end, 0.3, tolerance=1e-2, design=["rod.height"], **settings)
    assert found.accuracy.reached
    # Runs of Radau at 5e-5 s and 2.5e-5 s differ by 7e-11 m and 1.1e-7.
    assert abs(found.value + 0.29971362600) <= found.accuracy.value_bar
    assert abs(found.gradient[0] - 0.6396054) <= found.accuracy.gradient_bar[0]


def test_tolerance_beyond_all_work_is_a_warning():
    # The impacts of a ball that has come to rest accumulate before the end: no run is finished.
    ball = Ball((5.0, 0.0, 10.0, 0.5))
    with pytest.raises(InvalidInputError, match="no three runs"):
        gradient(ball, Terminal(HEIGHT), 3.2, tolerance=1e-3, events=[BOUNCE])
    # A force like a wave of 3e5 rad/s needs more steps than a search takes.
    fast = custom(lambda t, q, v, lam, b: np.cos(3e5 * t) * q[:, 0], "fast")
    with pytest.warns(ToleranceWarning, match="work of a search is used up") as told:
        found = gradient(Spring(SPRING), Integral(fast), 4.0, tolerance=1e-10, events=[WALL])
    assert told[0].filename == __file__
    assert not found.accuracy.reached


def test_settings_beside_a_tolerance_are_refused_in_words():
    settings = {"events": [BOUNCE], "tolerance": 1e-3}
    for more in ({"integrator": HHT(0.1)}, {"memory": "1 MB"}):
        with pytest.raises(InvalidInputError, match="tolerance: must be given without"):
            gradient(Ball(), Terminal(HEIGHT), 3.2, **settings, **more)
    with pytest.raises(InvalidInputError, match="tolerance: must be given without"):
        simulate(Ball(), 3.2, observables=[HEIGHT], keep=2, **settings)
    with pytest.raises(InvalidInputError, match="must be named for a tolerance"):
        simulate(Ball(), 3.2, **settings)
    with pytest.raises(InvalidInputError, match="must be given without `observables`"):
        simulate(Ball(), 3.2, HHT(0.1), observables=[HEIGHT], events=[BOUNCE])


# -- error bars ------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", [HHT(0.02), Radau(0.1), DOP853(1e-6), IDA(1e-6)])
@pytest.mark.parametrize("levels", [2, 3])
def test_error_bars_hold_across_events(integrator, levels):
    bars = error_bars(
        Spring(SPRING), Terminal(PLACE), 4.0, integrator, levels=levels, events=[WALL]
    )
    # Errors of DOP853 and IDA do not follow their tolerance exactly.
    factor = 1 if isinstance(integrator, HHT | Radau) else 3
    assert abs(bars.value - spring_by_hand(4.0, SPRING)) <= factor * bars.value_bar
    errors = np.abs(bars.gradient - spring_slopes(4.0, SPRING))
    assert np.all(errors <= factor * bars.gradient_bar)
    assert bars.resolved is None
    steps = [sum(x.statistics.steps for x in run.event_solution.phases) for run in bars.runs]
    assert len(steps) == levels
    if isinstance(integrator, HHT | Radau):
        np.testing.assert_allclose(np.divide(steps[1:], steps[:-1]), 2, rtol=0.1)
        # Bars that are useful, too.
        assert bars.value_bar < 0.05


def test_bars_of_the_bouncing_ball_are_round_off():
    bars = error_bars(Ball(), Terminal(HEIGHT), 3.2, HHT(0.1), events=[BOUNCE])
    assert bars.value == pytest.approx(VALUE, abs=1e-9)
    np.testing.assert_allclose(bars.gradient, slopes_by_hand(3.2, Ball().b), atol=1e-9)
    assert bars.value_bar < 1e-9


def test_runs_that_cannot_be_compared_are_refused_in_words():
    with pytest.raises(InvalidInputError, match="must be fixed with events"):
        error_bars(Ball(), Terminal(HEIGHT), 3.2, HHT(rtol=1e-4), events=[BOUNCE])
    with pytest.raises(InvalidInputError, match="must be 1 with events"):
        error_bars(Ball(), Terminal(HEIGHT), 3.2, HHT(0.1), meshes=2, events=[BOUNCE])
    # The spring hits the wall at 3.665 s; the coarse run is later than 3.685 s.
    late = (np.pi / 2 + 3 * np.pi) / 3 + 0.02
    with pytest.raises(InvalidInputError, match="must meet the same events"):
        error_bars(Spring(SPRING), Terminal(PLACE), late, HHT(0.2), levels=3, events=[WALL])


def test_runs_that_meet_other_events_are_not_compared():
    run = EventRun.of(Ball(), 3.2, HHT(0.05), [BOUNCE], None, None, False)
    met = iter([1, 1, 1, 2, 2, 2])

    def measure(run):
        record, steps = EventRecord("wall", 1.0, "start"), run.integrator.steps.step
        solution = EventSolution((), (record,) * next(met), None)
        return [np.array([1.0 + steps**2])], solution, None

    task = event_search._Task(run, measure, event_search.norms, False)
    halvings = event_search._Halvings("HHT", HHT, 2, 64, 1.0)
    finite = [np.isfinite(halvings.take(task).error) for _ in range(6)]
    assert finite == [False, False, True, False, False, True]
