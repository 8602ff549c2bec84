"""Calls to a tolerance where runs agree with each other on a wrong number: nothing is silent.

The truth is a closed form, or minimal coordinates that SciPy integrates.
"""

import math
import warnings

import numpy as np
import pytest
import scipy

from ancfdae import (
    DOP853,
    HHT,
    AdaptiveSteps,
    Integral,
    Pin,
    PointForce,
    PointOnLine,
    Radau,
    RigidBody,
    Scene,
    SpringDamper,
    Terminal,
    TranslationalFriction,
    assemble,
    gradient,
    simulate,
)
from ancfdae.errors import InvalidInputError, StabilityWarning, ToleranceWarning
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.laws import UserLaw
from ancfdae.observables import custom, observe, position, velocity
from ancfdae.studies.accuracy.bars import Estimate, spread
from ancfdae.studies.accuracy.features import RESOLVED, Transition, _Path, features, passed_over
from ancfdae.studies.accuracy.hht_runs import HHTRuns
from ancfdae.studies.accuracy.high_order_runs import DOP853Runs
from ancfdae.studies.accuracy.runs import Prices
from ancfdae.studies.accuracy.search import _wanted, observed_within
from ancfdae.studies.accuracy.waves import Wave, fades, missed, radius, unresolved, waves_of
from validation.tolerance.generator import FAMILIES, case

SOFT, STIFF, HEAVY, LIGHT, STRETCH = 90.0, 1.089e6, 10.0, 0.1, 1e-4


def ringing():
    """Two masses, a soft and a stiff spring of 3 and 3,300 rad/s, the stiff one pre-stretched."""
    a, b = (
        RigidBody(name, (x, 0), mass=mass, inertia=0.01)
        for name, x, mass in (("a", 0.5, HEAVY), ("b", 1.0, LIGHT))
    )
    springs = [
        SpringDamper(a.at(0), SOFT, 0, 0.4, ground=(0.0, 0.0), name="s"),
        SpringDamper(b.at(0), STIFF, 0, 0.5 - STRETCH, a.at(0), name="m"),
    ]
    rails = [PointOnLine(x.at(0), direction=(1, 0)) for x in (a, b)]
    return Scene([], rails, loads=springs, bodies=[a, b]), b


def of_ringing(t, soft, stiff):
    """Return position and velocity of the light mass: modes of two coordinates, exact."""
    M = np.diag([HEAVY, LIGHT])
    K = np.array([[soft + stiff, -stiff], [-stiff, stiff]])
    squares, X = scipy.linalg.eigh(K, M)
    rest = np.array([0.4, 0.9 - STRETCH])
    share = X.T @ M @ (np.array([0.5, 1.0]) - rest)
    speed = np.sqrt(squares)
    cos, sin = np.cos(speed * t), np.sin(speed * t)
    return (rest + X @ (share * cos))[1], (-X @ (share * speed * sin))[1]


@pytest.mark.parametrize("tolerance", [1e-1])
def test_a_wave_that_numerical_damping_eats_is_not_forgotten(tolerance):
    """HHT at 64 and 128 steps agrees with itself to 1e-5 and misses the whole derivative."""
    scene, b = ringing()
    t_end, h, design = 0.05, 1e-5, ["s.stiffness", "m.stiffness"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ToleranceWarning)
        found = gradient(
            scene, Terminal(position(b.at(0), 0)), t_end, tolerance=tolerance, design=design
        )
    value = of_ringing(t_end, SOFT, STIFF)[0]
    # Central differences, relative to the variables: errors (omega t h)^2 = 3e-6.
    moves = ((SOFT * h, 0.0), (0.0, STIFF * h))
    slope = [
        (of_ringing(t_end, SOFT + x, STIFF + y)[0] - of_ringing(t_end, SOFT - x, STIFF - y)[0])
        / (2 * h)
        for x, y in moves
    ]
    wrong = found.gradient * np.array([SOFT, STIFF]) - slope
    assert abs(found.value - value) <= found.accuracy.value_bar + 1e-9
    if found.accuracy.reached:
        assert np.linalg.norm(wrong) <= tolerance * np.linalg.norm(slope)
    assert np.all(np.abs(wrong) <= found.accuracy.gradient_bar * [SOFT, STIFF] + 1e-9)


def test_a_damped_wave_has_the_amplitude_and_frequency_that_it_began_with():
    scene, _ = ringing()
    system = assemble(scene, ["m.stiffness"])
    run = simulate(system, 0.5, HHT(0.5 / 128, -0.05))
    wave = waves_of(InitialValueProblem.of(system, 0.5), run)[-1]
    # omega = sqrt(STIFF (1/HEAVY + 1/LIGHT)), less the soft motion that second differences also
    # hold, less than 1 % of them.
    assert wave.speed == pytest.approx(math.sqrt(STIFF * (1 / HEAVY + 1 / LIGHT)), rel=0.01)
    # The light mass moves by STRETCH HEAVY / (HEAVY + LIGHT). Twice what second differences say is
    # assumed; the first steps, in which the recurrence takes up the start, leave half of it.
    assert 0.8 * STRETCH < np.abs(wave.q).max() < 2.0 * STRETCH


def test_hht_damps_as_its_recurrence_says():
    """A mass on a spring in steps of 10 and 0.7 radians: the amplitude falls by rho a step."""
    a = RigidBody("a", (0.5, 0), mass=1.0, inertia=0.01)
    spring = SpringDamper(a.at(0), 1.0, 0.0, 0.499, ground=(0.0, 0.0), name="s")
    scene = Scene([], [PointOnLine(a.at(0), direction=(1, 0))], loads=[spring], bodies=[a])
    for angle, begin, end, window in ((0.7, 20, 320, 60), (10.0, 5, 35, 10)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)
            run = simulate(scene, 400 * angle, HHT(angle, -0.2))
        x = run.q[:, 0] - 0.499
        early, late = (np.abs(x[n : n + window]).max() for n in (begin, end))
        # The largest of a window lies within 1 % of the amplitude at 0.7 radians, or at another
        # place within its last period: 2e-3 of rho over the 30 steps at least.
        assert (late / early) ** (1 / (end - begin)) == pytest.approx(radius(angle, -0.2), rel=2e-3)


@pytest.mark.parametrize(("angle", "damped"), [(0.7, 0.05), (10.0, 0.4), (0.7, 3.0)])
def test_a_damped_wave_decays_in_a_run_as_the_recurrence_says(angle, damped):
    """A mass on a spring with a damper, 2 c h = `damped`: two windows of a run."""
    a = RigidBody("a", (0.5, 0), mass=1.0, inertia=0.01)
    spring = SpringDamper(a.at(0), 1.0, damped / angle, 0.499, ground=(0.0, 0.0), name="s")
    scene = Scene([], [PointOnLine(a.at(0), direction=(1, 0))], loads=[spring], bodies=[a])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        run = simulate(scene, 120 * angle, HHT(angle, -0.2))
    x = np.abs(run.q[:, 0] - 0.499)
    early, late = (x[n : n + 10].max() for n in (10, 50))
    wave = Wave(0.0, np.ones(1), np.ones(0), 1.0, damped / (2 * angle))
    # The largest of a window is off the amplitude by a phase of half a step: 6 % of 40 steps' log.
    assert math.log(early / late) == pytest.approx(40 * angle * wave.kept(angle, -0.2), rel=0.06)


def test_an_overdamped_wave_decays_at_the_slower_of_its_rates():
    """s^2 + 2 c s + omega^2 = 0."""
    for c in (0.3, 1.0, 1.001, 5.0, 1e4):
        roots = np.roots([1.0, 2 * c, 1.0])
        wave = Wave(0.0, np.ones(1), np.ones(0), 1.0, c)
        assert wave.decay == pytest.approx(-roots.real.max(), rel=1e-6)


def test_a_wave_that_fades_is_not_followed_to_the_end():
    """Steps that lose all of an undamped wave miss little of one that fades at once."""
    still, fading = (Wave(0.0, np.ones(1), np.ones(0), 300.0, c) for c in (0.0, 60.0))
    # 300 rad/s in steps of 1/512 s: HHT-I3 itself damps by 0.29 /s, 60 /s are physical.
    assert still.missed(10.0, 5120, -0.05) > 0.9
    assert fading.missed(10.0, 5120, -0.05) < 0.05
    # Its phase is off all the same, as long as it lasts: 300/60 rad times (300/512)^2 / 10.
    assert fading.turned(10.0, 5120) == pytest.approx(5 * (300 / 512) ** 2 / 10)


def stiff_pair(damping):
    """Two masses of 9 and 1 kg on a rail, 1,000 rad/s between them, with a damper."""
    a, b = (
        RigidBody(name, (x, 0), mass=m, inertia=0.01) for name, x, m in (("a", 0.5, 9), ("b", 1, 1))
    )
    loads = [
        SpringDamper(a.at(0), 9.0, 0.0, 0.4, ground=(0.0, 0.0), name="s"),
        SpringDamper(b.at(0), 9e5, damping, 0.4999, a.at(0), name="m"),
    ]
    rails = [PointOnLine(x.at(0), direction=(1, 0)) for x in (a, b)]
    system = assemble(Scene([], rails, loads=loads, bodies=[a, b]), ["m.stiffness"])
    return system, simulate(system, 1.0, HHT(1 / 128, -0.05))


@pytest.mark.parametrize(("damping", "dies"), [(0.0, False), (1.0, False), (40.0, True)])
def test_unresolved_motions_fade_by_the_spectrum_of_the_start(damping, dies):
    """e^(-22) is left at the end with 40 N s/m, e^(-0.56) with 1: decay c (1/m + 1/M) / 2.

    The motion of 0.95 rad/s, which has no damper, is resolved.
    """
    assert fades(*stiff_pair(damping)) is dies


@pytest.mark.parametrize(("damping", "eaten"), [(0.0, True), (400.0, False)])
def test_waves_that_physics_takes_away_ask_for_no_steps(damping, eaten):
    """Numerical damping takes 0.1 a step of 1/128 s at most, 12.8 /s; physics 0 or 222 /s."""
    system, run = stiff_pair(damping)
    x = system.n_q // 2  # Of the light mass.
    problem = InitialValueProblem.of(system, 1.0)
    waves = unresolved(problem, run, -0.05, True)
    assert any(wave.damped for wave in waves) is eaten
    found = missed(problem, run, waves, (lambda states: [states.q[-1:, x]], [False], None))
    # The end has lost the wave, of 0.9 times the stretch of 1e-4 at the light mass, or had none
    # left. Twice the amplitude is assumed, of which the first steps leave half; two phases are
    # tried, of which one has cos^2 >= 1/2.
    size = 0.9e-4 if eaten else 0.0
    assert size / math.sqrt(2) <= found.parts[0].value[0] <= 2.5 * size + 1e-12


def struck(width, at, push=0.5):
    """A mass of 1 kg on a spring that a Gaussian pulse of a force hits."""
    a = RigidBody("a", (0.5, 0), mass=1.0, inertia=0.01)
    law = UserLaw(lambda t: np.exp(-np.square((t - at) / width)))
    loads = [
        PointForce(a.at(0), (push / width, 0.0), law=law, name="f"),
        SpringDamper(a.at(0), 100.0, 0.0, 0.5, ground=(0.0, 0.0), name="s"),
    ]
    rail = PointOnLine(a.at(0), direction=(1, 0))
    return Scene([], [rail], loads=loads, bodies=[a]), a


@pytest.mark.parametrize("width", [2e-3])
def test_a_pulse_of_a_law_is_not_stepped_over(width):
    """Duhamel's integral of the pulse; runs of 64 and 128 steps in 2 s see nothing of it."""
    at, push, t_end = 1.2371, 0.5, 2.0
    scene, a = struck(width, at, push)
    found = gradient(
        scene, Terminal(velocity(a.at(0), 0)), t_end, tolerance=1e-3, design=["f.force_x"]
    )
    # int exp(-(s/w)^2) cos(10 (T - at - s)) ds = sqrt(pi) w exp(-(10 w)^2 / 4) cos(10 (T - at)).
    value = push * math.sqrt(math.pi) * math.exp(-((10 * width) ** 2) / 4)
    value *= math.cos(10 * (t_end - at))
    assert found.value == pytest.approx(value, rel=1e-3)
    assert found.gradient[0] * push / width == pytest.approx(value, rel=1e-3)
    seen = simulate(scene, t_end, tolerance=1e-3, observables=[velocity(a.at(0), 0)], at=[2.0])
    assert seen.values[0, 0] == pytest.approx(value, rel=1e-3)


def test_a_pulse_of_an_objective_is_not_stepped_over():
    width, at, t_end = 1e-3, 1.2371, 2.0
    a = RigidBody("a", (0.5, 0), mass=1.0, inertia=0.01)
    spring = SpringDamper(a.at(0), 100.0, 0.0, 0.4, ground=(0.0, 0.0), name="s")
    scene = Scene([], [PointOnLine(a.at(0), direction=(1, 0))], loads=[spring], bodies=[a])

    def window(t, q, v, lam, b):
        return np.exp(-np.square((t - at) / width)) * q[:, 0]

    objective = Integral(custom(window, "window"))
    found = gradient(scene, objective, t_end, tolerance=1e-3, design=["s.free_length"])
    # x = l + (0.5 - l) cos(10 t), and the window's transform at 10 rad/s.
    size = math.sqrt(math.pi) * width
    swing = math.exp(-((10 * width) ** 2) / 4) * math.cos(10 * at)
    assert found.value == pytest.approx(size * (0.4 + 0.1 * swing), rel=1e-3)
    assert found.gradient[0] == pytest.approx(size * (1 - swing), rel=1e-3)


def test_slow_laws_have_no_features_and_pulses_have_stops():
    slow = features(InitialValueProblem.of(assemble(struck(0.3, 1.0)[0]), 2.0), [], 2.0)
    fast = features(InitialValueProblem.of(assemble(struck(1e-3, 1.0)[0]), 2.0), [], 2.0)
    assert slow == (0, ())
    # Thirty steps of 64 in 2 s are the width; more than 2 / 1e-3 steps follow it to a fifth.
    assert fast.steps >= 1024
    assert 0.98 < min(fast.stops) < 0.9985
    assert 1.0015 < max(fast.stops) < 1.02


def test_a_long_run_of_a_pendulum_keeps_the_tolerance():
    """DOP853 errs by hundreds of its tolerances after 40 s; SciPy has one coordinate."""
    length, t_end, tolerance = 1.0, 40.0, 1e-4
    bar = RigidBody("a", (length / 2, 0), mass=1.0, inertia=1 / 12)
    scene = Scene([], [Pin(bar.at(-length / 2))], (0, -9.81), bodies=[bar])
    found = gradient(
        scene,
        Terminal(position(bar.at(length / 2), 0)),
        t_end,
        tolerance=tolerance,
        design=["a.inertia"],
    )

    def end(inertia):
        pull = 9.81 * length / 2 / (inertia + length**2 / 4)
        run = scipy.integrate.solve_ivp(
            lambda t, y: [y[1], -pull * np.cos(y[0])],
            (0, t_end),
            [0.0, 0.0],
            "DOP853",
            rtol=1e-13,
            atol=1e-13,
        )
        return length * math.cos(run.y[0, -1])

    h = 1e-5
    slope = (end(1 / 12 + h) - end(1 / 12 - h)) / (2 * h)
    assert found.accuracy.reached
    size = max(abs(slope) / 12, abs(end(1 / 12)))
    assert abs(found.value - end(1 / 12)) <= tolerance * size
    assert abs(found.gradient[0] - slope) <= 3 * tolerance * abs(slope)


STRETCHED, RUB = 0.5, 100.0


def rubbing(coulomb, smooth_speed):
    """A kilogram on a spring, let go half a metre from rest, against dry friction."""
    a = RigidBody("a", (0.0, 0), mass=1.0, inertia=1.0)
    spring = SpringDamper(a.at(0), RUB, 0.0, 1 + STRETCHED, ground=(-1.0, 0.0), name="s")
    dry = TranslationalFriction(a.at(0), (1, 0), coulomb, smooth_speed, name="f")
    return Scene([], [PointOnLine(a.at(0), direction=(1, 0))], loads=[spring, dry], bodies=[a]), a


def of_rubbing(coulomb, smooth_speed, at):
    """Return the positions and their scaled derivatives: variational equations, SciPy."""

    def rates(t, y):
        (x, x_k, x_c), (v, v_k, v_c) = y.reshape(2, 3)
        level = np.tanh(v / smooth_speed)
        slope = (1 - level**2) * coulomb / smooth_speed
        a = -RUB * (x - STRETCHED) - coulomb * level
        a_k = -RUB * x_k - (x - STRETCHED) - slope * v_k
        return [v, v_k, v_c, a, a_k, -RUB * x_c - level - slope * v_c]

    known = {"t_eval": at, "rtol": 1e-11, "atol": 1e-13, "max_step": 0.01}
    # Friction that turns within 1e-5 m/s is stiff.
    x, x_k, x_c = scipy.integrate.solve_ivp(rates, (0, at[-1]), np.zeros(6), "LSODA", **known).y[:3]
    return x, x_k * RUB, x_c * coulomb


# Steps of HHT that see no transition agree at 64 to 512; so do loose tolerances of DOP853; the
# third sticks.
@pytest.mark.parametrize(
    ("coulomb", "smooth_speed", "tolerance"),
    [(3.0, 1e-3, 1e-3), (3.0, 1e-3, 1e-1), (5.0, 1e-3, 1e-2)],
)
def test_transitions_of_friction_are_not_stepped_over(coulomb, smooth_speed, tolerance):
    """d/dk was three times too large, with bars of a thousandth of the error."""
    scene, a = rubbing(coulomb, smooth_speed)
    end, design = Terminal(position(a.at(0), 0)), ["s.stiffness", "f.coulomb"]
    found = gradient(scene, end, 2.0, tolerance=tolerance, design=design)
    (value,), *slopes = of_rubbing(coulomb, smooth_speed, np.array([2.0]))
    exact, b = np.ravel(slopes), np.array([RUB, coulomb])
    size, off = np.linalg.norm(exact), np.abs(found.gradient * b - exact)
    assert found.accuracy.reached
    assert np.linalg.norm(off) <= tolerance * size
    assert abs(found.value - value) <= tolerance * max(size, abs(value))
    assert np.all(off <= 2 * found.accuracy.gradient_bar * b + 1e-9 * size)


def test_a_slider_that_sticks_is_refused_with_the_way_that_gets_there():
    """Friction turns within 1e-7 m/s of 5 m/s: equal steps that meet its slope take years.

    DOP853 takes 62,000 stable steps for 1e-5 m/s, three seconds, and 100 times as many for 1e-7.
    """
    (scene, a), (wider, _) = rubbing(6.0, 1e-7), rubbing(6.0, 1e-5)
    end, design = Terminal(position(a.at(0), 0)), ["s.stiffness", "f.coulomb"]
    with pytest.raises(
        InvalidInputError, match="a force jumps while the state changes by"
    ) as refused:
        gradient(scene, end, 2.0, tolerance=1e-2, design=design)
    assert "Radau(AdaptiveSteps(0.0001, sensitivities=True))" in str(refused.value)
    _, *slopes = of_rubbing(6.0, 1e-5, np.array([2.0]))
    exact, b = np.ravel(slopes), np.array([RUB, 6.0])
    found = gradient(wider, end, 2.0, Radau(AdaptiveSteps(1e-4, sensitivities=True)), design=design)
    assert found.solution.outcome.success
    # Found 1.6e-5: a hundredth of the tolerance asked for is more than is needed.
    assert np.linalg.norm(found.gradient * b - exact) <= 1e-3 * np.linalg.norm(exact)


@pytest.mark.parametrize(("coulomb", "smooth_speed"), [(2.0, 1e-4), (4.0, 3e-3), (6.0, 1e-3)])
def test_motions_with_transitions_of_friction_keep_their_bars(coulomb, smooth_speed):
    """Errors of runs that pass over transitions have no order: 40 to 60 % of bars did not hold."""
    scene, a = rubbing(coulomb, smooth_speed)
    at = np.linspace(0, 1.7, 33)[1:]
    exact = of_rubbing(coulomb, smooth_speed, at)[0]
    found = simulate(scene, 1.7, tolerance=1e-2, observables=[position(a.at(0), 0)], at=at)
    off = np.abs(found.values[:, 0] - exact)
    assert found.reached
    assert np.linalg.norm(off) <= 1e-2 * np.linalg.norm(exact)
    assert np.mean(off > found.bars[:, 0]) <= 0.05


def test_explicit_knows_states_more_closely_than_transitions_are_wide():
    """Where HHT saw a transition of a thousandth of the speed, rtol is below a ten-thousandth."""
    scene, _ = rubbing(3.0, 1e-3)
    wanted = _wanted(assemble(scene, ["f.coulomb"]), [], 2.0, 1e-1)
    seer = HHTRuns(wanted)
    sequence = DOP853Runs(seer, 4, wanted)
    loose = sequence.setting.rtol
    seer.transitions = Transition(10_000, 1e-3)
    assert loose == pytest.approx(1e-2)
    assert sequence.setting.rtol == pytest.approx(1e-4)
    # Values need no derivative: error control alone decides.
    of_values = wanted._replace(partials=None)
    assert DOP853Runs(seer, 4, of_values).setting.rtol == pytest.approx(1e-2)


@pytest.mark.parametrize(("coulomb", "smooth_speed"), [(3.0, 1e-3), (0.3, 1e-5)])
def test_a_transition_of_friction_is_as_wide_as_its_speed(coulomb, smooth_speed):
    """Forces change by 2 c with the slope c/w_0: two w_0, which the largest acceleration passes."""
    scene, _ = rubbing(coulomb, smooth_speed)
    system = assemble(scene, ["f.coulomb"])
    runs = [simulate(system, 0.5, HHT(0.5 / n, hht_alpha=-0.05)) for n in (64, 512)]
    speed, pull = np.abs(runs[-1].v).max(), np.abs(runs[-1].a).max()
    for run in runs:
        found = passed_over(InitialValueProblem.of(system, 0.5), run, 1e-3)
        assert found.narrow == pytest.approx(2 * smooth_speed / np.ptp(runs[-1].v[:, 0]), rel=0.5)
        assert found.steps == pytest.approx(4 * 0.5 * pull / (2 * smooth_speed), rel=0.5)
        assert speed < 10
    smooth, _ = rubbing(coulomb, 2.0)
    run = simulate(smooth, 0.5, HHT(0.5 / 256, hht_alpha=-0.05))
    problem = InitialValueProblem.of(assemble(smooth, ["f.coulomb"]), 0.5)
    assert passed_over(problem, run, 1e-3) == RESOLVED


@pytest.mark.parametrize(
    ("force", "width"),
    [
        (lambda x: np.tanh((x - 1.37) / 1e-6), 2e-6),
        (lambda x: np.tanh((x - 1.37) / 0.1), 0.2),
        (lambda x: 5 * np.sin(0.4 * x) + 0.05 * np.tanh((x - 1.63) / 1e-4), 2e-4),
        (lambda x: np.maximum(x - 1.4, 0.0), None),
        (np.sin, None),
    ],
)
def test_widths_of_jumps_are_found_and_kinks_are_none(force, width):
    """A path through the states 0 to 3, one a step, of forces that are written down."""
    states = np.arange(4.0)[:, None, None] * np.ones((1, 2, 1))
    path = _Path(lambda x, t: force(x[:, 0]), states, 0.0)
    seen, left, right = path.narrowest(1e-2)
    if width is None:
        assert not path.seems_narrow(1e-2) or seen >= 0.5
    else:
        assert path.seems_narrow(1e-2)
        assert seen == pytest.approx(width, rel=0.5)
        assert left <= 1.37 <= right or left <= 1.63 <= right
        # Positions alone make the force jump here.
        assert np.diff(path.jumps(left, right)) <= 0


# Masses, inertias, length, angles at the start and end time; an
# extrapolation of the second from 512 and 1,024 steps missed it by eight bars.
LEVEL = (1.0, 1.0, 0.02, 0.03, 1.0, 0.0, 0.0, 3.0)
SLANTED = (1.18866, 1.73112, 0.08732, 0.01149, 0.84013, 0.37355, -0.49473, 3.33863)


@pytest.mark.parametrize(
    ("pendulum", "tolerance"), [(LEVEL, 1e-2), (LEVEL, 1e-3), (SLANTED, 1e-2), (SLANTED, 1e-3)]
)
def test_a_coarse_run_of_a_double_pendulum_is_no_order(pendulum, tolerance):
    """At 256 steps it is another motion; by chance its differences fell with the order.

    SciPy integrates two angles with complex design values: the derivative of its own steps.
    """
    *given, I_a, I_b, length, x_0, z_0, t_end = pendulum
    gravity, given = 9.81, np.array([*given, I_b])

    def end(design):
        m_a, m_b, I_b = design

        def rates(t, y):
            (x, z), spin = y[:2], y[2:]
            cos, sin, half = np.cos(x - z), np.sin(x - z), m_b * length**2 / 2
            top = I_a + m_a * length**2 / 4 + m_b * length**2
            M = np.array([[top, half * cos], [half * cos, I_b + m_b * length**2 / 4]])
            weight = gravity * length * np.array([(m_a / 2 + m_b) * np.cos(x), m_b / 2 * np.cos(z)])
            turned = half * sin * np.array([-(spin[1] ** 2), spin[0] ** 2])
            return np.concatenate([spin, np.linalg.solve(M, turned - weight)])

        start = np.array([x_0, z_0, 0, 0], dtype=complex)
        known = {"rtol": 1e-11, "atol": 1e-13, "max_step": 0.01}
        y = scipy.integrate.solve_ivp(rates, (0, t_end), start, "DOP853", **known).y[:, -1]
        return length * (np.cos(y[0]) + np.cos(y[1]))

    exact = np.array([end(given * (1 + 1e-20j * e)).imag for e in np.eye(3)]) / 1e-20
    joint = length * math.cos(x_0), length * math.sin(x_0)
    bars = [
        RigidBody(name, at, mass=mass, inertia=inertia, centre=(length / 2, 0), turn=turn)
        for name, at, mass, inertia, turn in (
            ("a", (0, 0), given[0], I_a, x_0),
            ("b", joint, given[1], I_b, z_0),
        )
    ]
    a, b = bars
    pins = [Pin(a.at(0, 0)), Pin(a.at(length, 0), b.at(0, 0))]
    scene = Scene([], pins, (0, -gravity), bodies=bars)
    goal, design = Terminal(position(b.at(length, 0), 0)), ["a.mass", "b.mass", "b.inertia"]
    found = gradient(scene, goal, t_end, tolerance=tolerance, design=design)
    off = np.abs(found.gradient * given - exact)
    assert found.accuracy.reached
    assert np.linalg.norm(off) <= tolerance * np.linalg.norm(exact)
    assert np.all(off <= 3 * found.accuracy.gradient_bar * given)


def test_bars_over_time_have_the_size_of_errors_nearby():
    """An error that grows and swings is small by chance at many instants, and its bar is not."""
    t = np.linspace(0, 1, 65)
    d = t * np.sin(40 * t)
    bars = spread(d, along=True)
    # The swing has a half period of 0.08, and the largest within 1/16 to either side counts.
    assert np.all(bars >= 0.9 * t - 0.1)
    assert np.all(bars <= np.maximum(t + 1 / 16, np.linalg.norm(d) / 16))


def test_kinds_of_runs_that_contradict_each_other_are_not_believed():
    """A run ten bars from what the other kind knows tells nothing; one within two bars agrees."""

    class Known:
        """What HHT knows: one to a hundredth."""

        error = 0.01
        estimates = (Estimate(np.array([1.0]), np.array([0.01])),)

    run = object.__new__(HHTRuns)
    run._tolerance, run._sizes = 1e-6, lambda vectors: [float(np.linalg.norm(x)) for x in vectors]
    for far, agrees in ((0.02, True), (0.1, False)):
        run.samples = [type("Sample", (), {"vectors": [np.array([1.0 + far])]})()]
        assert run.agrees(Known()) is agrees


# Families whose answer takes a second or two; seeds in which calls were certain and wrong once,
# or whose bars did not hold.
# In "ringing" 9 physical and numerical damping of an unresolved wave are equal by chance; waves of
# "slider" 3 and "damped rod" 1004 fade, and were followed to the end, or out of reach; the
# spring of "pulse" 8 turns over when its ends meet, where forces jump. In "springs" 7001 the phase
# of a wave is off by 1.5 and 0.4 rad in two runs that are near each other; in "stiff rod" 5003
# finer runs find waves that coarser ones do not have.
@pytest.mark.parametrize(
    ("family", "seed", "tolerance"),
    [
        ("pendulum", 0, 1e-3),
        ("pulse", 1, 1e-3),
        ("pulse", 8, 1e-4),
        ("window", 1, 1e-3),
        ("cable", 0, 1e-3),
        ("damped rod", 1004, 1e-2),
        ("ringing", 9, 1e-2),
        ("slider", 3, 1e-2),
        ("springs", 7001, 1e-2),
        ("stiff rod", 5003, 1e-3),
    ],
)
def test_no_random_scene_errs_without_a_word(family, seed, tolerance):
    given = case(family, seed)
    exact = gradient(given.told, given.objective, given.t_end, given.reference)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ToleranceWarning)
        found = gradient(given.system, given.objective, given.t_end, tolerance=tolerance)
    scale = np.where(given.system.b == 0, 1.0, np.abs(given.system.b))
    size = np.linalg.norm(exact.gradient * scale)
    errors = (
        abs(found.value - exact.value) / max(size, abs(exact.value)),
        np.linalg.norm((found.gradient - exact.gradient) * scale) / size,
    )
    assert not found.accuracy.reached or max(errors) <= tolerance
    assert sum(trial.steps for trial in found.accuracy.trials) < 20_000


def of_random(family, seed, tolerance):
    """Return a search for values over time of a random scene, and the values by DOP853."""
    draft = FAMILIES[family](np.random.default_rng([seed, *map(ord, family)]))
    system = assemble(draft.scene, draft.design)
    axis = 0 if draft.straight else 1
    seen = [position(draft.point, axis), velocity(draft.point, 0), *draft.others]
    at = np.linspace(0, draft.t_end, 65)
    found = observed_within(system, seen, at, draft.t_end, tolerance, False)
    runs = (simulate(system, draft.t_end, DOP853(r, intervals=64)) for r in (1e-9, 1e-10))
    near, exact = (np.stack([observe(x, y, system)[::8] for x in seen], axis=1) for y in runs)
    return found, exact, np.sqrt(np.mean((near - exact) ** 2, axis=0))


@pytest.mark.parametrize(
    ("family", "seed", "tolerance"),
    [("rod", 1001, 1e-3), ("rod", 1002, 1e-3), ("ringing", 1000, 1e-2)],
)
def test_bars_over_time_hold_at_single_instants(family, seed, tolerance):
    """Undamped rods whose velocity and reaction swing; DOP853 knows them. 23 to 34 % were out.

    The horizontal reaction of rod 1002 is a strain of 1e-9: round-off of coordinates is 4e-6 of its
    square in all runs (DOP853 at 1e-7 to 1e-11, 4,096 steps of Radau). What DOP853 at 1e-9 and
    1e-10 differ by is therefore no error of the search.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ToleranceWarning)
        found, exact, unsure = of_random(family, seed, tolerance)
    off = np.abs(found.values - exact) > found.bars + 2 * unsure
    assert off.mean(axis=0).max() <= 0.05


@pytest.mark.parametrize("seed", [1001, 1002])
def test_two_runs_of_radau_show_no_order_of_reactions(seed, monkeypatch):
    """Radau's reactions have a lower order than its motion: they erred by three tolerances."""
    monkeypatch.setattr(Prices, "of", staticmethod(lambda system: Prices(10.0, 0.0, 150.0, 30.0)))
    found, exact, _ = of_random("rod", seed, 1e-4)
    errors = np.linalg.norm(found.values - exact, axis=0)
    assert sum(isinstance(x.integrator, Radau) for x in found.trials) >= 2
    assert found.reached
    assert (errors <= 1e-4 * np.linalg.norm(exact, axis=0)).all()


@pytest.mark.parametrize(("family", "seed"), [("springs", 1000), ("rod", 1003)])
def test_values_over_time_with_damped_waves_need_no_derivatives(family, seed):
    """The foreseen work divided by zero where a run without derivatives damped waves."""
    found, exact, _ = of_random(family, seed, 1e-4)
    errors = np.linalg.norm(found.values - exact, axis=0)
    assert found.reached
    assert (errors <= 1e-4 * np.linalg.norm(exact, axis=0)).all()


def test_two_time_scales_are_answered_within_a_few_runs():
    """Waves of 3,300 rad/s beside 3 rad/s, seen in a velocity: steps that cost more were taken."""
    scene, b = ringing()
    t_end, h = 0.1, 1e-5
    end = Terminal(velocity(b.at(0), 0))
    found = gradient(scene, end, t_end, tolerance=1e-2, design=["m.stiffness"])
    up, down = (of_ringing(t_end, SOFT, STIFF * (1 + x))[1] for x in (h, -h))
    slope = (up - down) / (2 * h)
    # Central differences err by (omega t h)^2 / 6 = 2e-6.
    assert found.accuracy.reached
    assert found.gradient[0] * STIFF == pytest.approx(slope, rel=1e-2)
    # Runs of HHT follow the waves with 4,000 steps, those of DOP853 with 108 to 400.
    assert sum(trial.steps for trial in found.accuracy.trials) < 12_000


def test_instants_of_explicit_are_no_error_that_all_runs_share():
    """A mass swings 40 times: panels of 64 leave an error between instants that runs share."""
    a = RigidBody("a", (0.5, 0), mass=1.0, inertia=0.01)
    spring = SpringDamper(a.at(0), 100.0, 0.0, 0.4, ground=(0.0, 0.0), name="s")
    scene = Scene([], [PointOnLine(a.at(0), direction=(1, 0))], loads=[spring], bodies=[a])
    system = assemble(scene, ["s.free_length"])
    wanted = _wanted(system, [], 25.0, 1e-4)
    sequence = DOP853Runs(HHTRuns(wanted), 64, wanted)
    first = sequence.setting
    sequence._taken.append(1e-5)
    assert (first.intervals, sequence.setting.intervals) == (64, 128)


def test_an_observable_that_underflows_is_differentiable():
    """exp(-676) is a number, and a complex step of 1e-40 of it is none."""
    a = RigidBody("a", (0.5, 0), mass=1.0, inertia=0.01)
    spring = SpringDamper(a.at(0), 100.0, 0.0, 0.4, ground=(0.0, 0.0), name="s")
    scene = Scene([], [PointOnLine(a.at(0), direction=(1, 0))], loads=[spring], bodies=[a])
    seen = custom(lambda t, q, v, lam, b: 3e-294 * q[:, 0], "small")
    found = gradient(scene, Integral(seen), 0.1, HHT(0.01), design=["s.free_length"])
    # The mass is within (0.3, 0.5) all the time.
    assert 0.3 * 3e-295 < found.value < 0.5 * 3e-295
