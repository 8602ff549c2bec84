"""Gradients to a tolerance: errors below it, bars that hold, words where it is out of reach."""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    Beam,
    DirectDifferentiation,
    InitialVelocity,
    Material,
    Pin,
    PointOnLine,
    RigidBody,
    RigidBox,
    RotationDriver,
    Scene,
    SpringDamper,
    Terminal,
    assemble,
    gradient,
    gradients,
)
from ancfdae.errors import InvalidInputError, ToleranceWarning
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.laws import ConstantAcceleration
from ancfdae.modes.analysis import fastest
from ancfdae.modes.linearised import LinearisationPoint
from ancfdae.observables import custom, position
from ancfdae.sections import Rectangle
from ancfdae.studies.accuracy import search
from ancfdae.studies.accuracy.bars import refined, tightened, unresolved
from validation.external.slider_crank import SliderCrank, kinetic_energy_integral

ANGLE = Terminal(custom(lambda t, q, v, lam, b: q[:, 0], "angle"))


def rod(length=1.0, mass=1.0, time=1.0):
    """A soft rod that turns and falls, with waves, in units of its own."""
    force = mass * length / time**2
    soft = Material(1100 * mass / length**3, 5e6 * force / length**2, 0.4)
    beam = Beam("rod", (0, 0), (0.8 * length, 0), 2, Rectangle(0.04 * length, 0.04 * length), soft)
    start = [InitialVelocity("rod", 6.0 / time, (0, 0))]
    scene = Scene([beam], [Pin(beam.at_start)], (0, -9.81 * length / time**2), start)
    return scene, Terminal(position(beam.at_end, 0)), 0.1 * time


def relative_error(result, exact, b):
    """Return the errors of value and gradient as the tolerance measures them."""
    slope = exact.gradient * b
    size = np.linalg.norm(slope)
    errors = abs(result.value - exact.value), np.linalg.norm(result.gradient * b - slope)
    return errors[0] / max(size, abs(exact.value)), errors[1] / size


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_errors_are_below_the_tolerance_and_bars_hold(tolerance):
    system = SliderCrank()
    objectives = [kinetic_energy_integral(), ANGLE]
    found = gradients(system, objectives, 2.0, tolerance=tolerance)
    exact = gradients(system, objectives, 2.0, DOP853(1e-12))
    for result, truth in zip(found, exact, strict=True):
        assert result.accuracy.reached
        assert max(relative_error(result, truth, system.b)) < tolerance
        assert abs(result.value - truth.value) <= result.accuracy.value_bar
        assert np.all(np.abs(result.gradient - truth.gradient) <= result.accuracy.gradient_bar)


def test_units_do_not_change_digits():
    design = ["rod.height", "rod.density"]
    scenes = rod(), rod(length=1e3, mass=1e-3, time=1e3)
    one, other = (gradient(*each, tolerance=1e-3, design=design) for each in scenes)
    assert other.value / 1e3 == pytest.approx(one.value, rel=1e-10)
    steps = [[trial.steps for trial in each.accuracy.trials] for each in (one, other)]
    assert steps[0] == steps[1]


def test_waves_are_followed_where_the_objective_sees_them():
    scene, end, t_end = rod()
    design = ["rod.height", "rod.density"]
    found = gradient(scene, end, t_end, tolerance=1e-4, design=design)
    truth = gradient(scene, end, t_end, DOP853(1e-11), design=design)
    assert max(relative_error(found, truth, np.array([0.04, 1100.0]))) < 1e-4
    assert found.accuracy.reached
    assert "+-" in repr(found)


def test_out_of_reach_is_said_with_the_price(monkeypatch):
    monkeypatch.setattr(search, "_MOST", 1e4)
    scene, end, t_end = rod()
    design = ["rod.height", "rod.density"]
    with pytest.warns(ToleranceWarning, match=r"To the tolerance: HHT .* more"):
        found = gradient(scene, end, t_end, tolerance=1e-8, design=design)
    truth = gradient(scene, end, t_end, DOP853(1e-11), design=design)
    assert not found.accuracy.reached
    assert np.all(np.abs(found.gradient - truth.gradient) <= found.accuracy.gradient_bar)


def test_many_variables_take_the_adjoint():
    scene, end, t_end = rod()
    parts = ("height", "width", "density", "youngs_modulus")
    design = [f"rod.{part}[{k}]" for part in parts for k in (0, 1)]
    found = gradient(scene, end, t_end, tolerance=1e-3, design=design)
    truth = gradient(
        scene, end, t_end, DOP853(1e-10), design=design, method=DirectDifferentiation()
    )
    error = np.abs(found.gradient - truth.gradient)
    assert np.all(error <= found.accuracy.gradient_bar)


def test_either_an_integrator_or_a_tolerance():
    with pytest.raises(InvalidInputError, match="tolerance: must be given without `integrator`"):
        gradient(SliderCrank(), ANGLE, 1.0, HHT(0.1), tolerance=1e-3)
    with pytest.raises(InvalidInputError, match="integrator: must be of type Integrator"):
        gradient(SliderCrank(), ANGLE, 1.0)
    for wrong in (0.0, -1.0, 1.0, 1e-13, float("nan")):
        with pytest.raises(InvalidInputError, match="tolerance"):
            gradient(SliderCrank(), ANGLE, 1.0, tolerance=wrong)


def runs(order, waves, count=5):
    """Vectors whose error falls with an order, with what waves add by chance, and steps."""
    noise = np.random.default_rng(1).normal(size=(count, 3)) * waves
    steps = 2 ** np.arange(count)
    h = 1.0 / steps[:, None]
    error = np.array([1.0, -0.5, 2.0]) * h**order * (1 + 0.3 * h)
    return error + noise, steps


def test_an_order_that_is_seen_is_used():
    rows, steps = runs(2, 0.0)
    for count in (2, 3):
        estimate = refined(rows[-count:], steps[-count:], 2, resolved=True)
        assert np.all(np.abs(estimate.x) <= estimate.bar)
        assert np.linalg.norm(estimate.x) < 0.1 * np.linalg.norm(rows[-1])
    rows, steps = runs(5, 0.0)
    high = refined(rows[-3:], steps[-3:], 5, resolved=True)
    assert np.all(np.abs(high.x) <= high.bar)
    assert np.all(high.bar <= 20 * np.max(np.abs(high.x)))


def test_steps_need_not_be_halved():
    steps = np.array([10, 17, 60])
    rows = np.array([1.0, -0.5]) * (1 / steps[:, None] ** 2 + 2 / steps[:, None] ** 3)
    estimate = refined(rows, steps, 2, resolved=True)
    # Extrapolating from 17 to 60 leaves 2 (60^-3 - (17^-3 - 60^-3)/(60^2/17^2 - 1)) of the third
    # order, 4e-5; without, 60^-2 = 3e-4 is left.
    assert np.max(np.abs(estimate.x)) < 5e-5
    assert np.all(np.abs(estimate.x) <= estimate.bar)
    assert np.all(estimate.bar < 1.5e-4)


def test_a_fall_by_chance_is_not_believed():
    # The last two runs agree to 1e-6; by the order, from the difference before, they err by 0.01.
    rows, steps = np.array([[1.16], [0.04], [0.04 + 1e-6]]), np.array([1, 2, 4])
    estimate = refined(rows, steps, 2, resolved=True)
    assert estimate.bar[0] >= 1.12 / 3 / 4


def test_without_an_order_the_bar_is_that_of_the_differences():
    rows, steps = runs(2, 1.0)
    estimate = refined(rows[-3:], steps[-3:], 2, resolved=False)
    np.testing.assert_array_equal(estimate.x, rows[-1])
    assert np.all(np.abs(estimate.x) <= estimate.bar)


def test_an_order_that_waves_hide_is_not_believed():
    # Runs may fall by four by chance; without resolved waves that says nothing.
    rows, steps = runs(2, 0.0)
    estimate = refined(rows[-3:], steps[-3:], 2, resolved=False)
    assert np.all(estimate.bar >= 3 * np.abs(rows[-1] - rows[-2]))


def test_no_component_is_sure_by_chance():
    bar = tightened(np.array([1.0, 1.0]), np.array([1.0, 1.1]))
    # 1.5 times the difference, or half the root mean square of both for the first component.
    np.testing.assert_allclose(bar, [0.15 / np.sqrt(2) / 2, 0.15])
    # Without waves resolved no component is below the root mean square; nor is the last difference
    # below a quarter of the one before.
    np.testing.assert_allclose(unresolved(np.array([[0.0, 1.0]])), 4.1 * np.array([0.5**0.5, 1]))
    np.testing.assert_allclose(unresolved(np.array([[8.0], [1.0]])), [6.0])


def test_fast_motion_is_foreseen():
    # sqrt(k/m) without damping; with c far above critical the fast one of two exponents.
    body = RigidBody("a", (0.5, 0), shape=RigidBox(0.1, 0.1, 0.1), density=1000.0)
    for damping, expected in ((0.0, 20.0), (100.0, 50 + np.sqrt(2100))):
        spring = SpringDamper(body.at(0), 400.0, damping, 0.5, ground=(0.0, 0.0), name="s")
        rail = PointOnLine(body.at(0), direction=(1, 0))
        held = RotationDriver(body.at(0), ConstantAcceleration(speed=0.0), name="d")
        scene = Scene([], [rail, held], loads=[spring], bodies=[body])
        system = assemble(scene, ["s.stiffness"])
        start = InitialValueProblem.of(system, 1.0).initial
        speed = fastest(system, LinearisationPoint(start.q, start.lam, t=0.0))
        assert speed == pytest.approx(expected, rel=1e-6)


def test_explicit_takes_the_steps_that_are_foreseen_to_a_tight_tolerance():
    (scene, end, _), design = rod(), ["rod.height", "rod.density"]
    found = gradient(scene, end, 0.2, tolerance=1e-6, design=design)
    truth = gradient(scene, end, 0.2, DOP853(1e-12), design=design)
    assert found.accuracy.reached
    assert max(relative_error(found, truth, np.array([0.04, 1100.0]))) < 1e-6
    assert abs(found.value - truth.value) <= found.accuracy.value_bar
    assert np.all(np.abs(found.gradient - truth.gradient) <= found.accuracy.gradient_bar)
    last = found.accuracy.trials[-1]
    assert isinstance(last.integrator, DOP853)
    # Three times the steps foreseen are allowed; within a factor of two they are met.
    assert 0.5 < 3 * last.steps / last.integrator.max_steps < 2.0
