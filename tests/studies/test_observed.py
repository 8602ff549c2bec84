"""Observables to a tolerance: formulas met, bars that hold, words where it is out of reach."""

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from ancfdae import (
    DOP853,
    HHT,
    Beam,
    Integral,
    Material,
    Pin,
    PointOnLine,
    Radau,
    RigidBody,
    Scene,
    SpringDamper,
    simulate,
)
from ancfdae.errors import InvalidInputError, ToleranceWarning, UnknownNameError
from ancfdae.integrators.integrator import Integrator
from ancfdae.observables import observe, position, reaction
from ancfdae.sections import Rectangle
from ancfdae.studies.accuracy import search


def pendulum(length=1.0, time=1.0):
    """A rigid pendulum let go level, its centre's x, and the formula: m = 2, J = 1/2, r = 0.8."""
    bob = RigidBody("bob", (0.8 * length, 0.0), 2.0, 0.5 * length**2)
    joint = Pin(bob.at(-0.8 * length), name="pin")
    rate = np.sqrt(2.0 * 9.81 * 0.8 / (0.5 + 2.0 * 0.8**2)) / time
    k = np.sin(np.pi / 4)

    def x(t):
        return (
            1.6
            * length
            * k
            * (sn := ellipj(ellipk(k**2) - rate * t, k**2)[0])
            * np.sqrt(1 - (k * sn) ** 2)
        )

    scene = Scene([], [joint], (0.0, -9.81 * length / time**2), bodies=[bob])
    return scene, position(bob.at(0), 0), x


def bouncing():
    """A mass on a spring: x = 1 + 0.2 cos(10 t)."""
    ball = RigidBody("ball", (1.2, 0), 2.0, 1e-3)
    spring = SpringDamper(ball.at(0), 200.0, 0.0, 1.0, ground=(0.0, 0.0))
    line = PointOnLine(ball.at(0), direction=(1, 0))
    return Scene([], [line], (0.0, 0.0), loads=[spring], bodies=[ball]), position(ball.at(0), 0)


def rod(damping):
    """A stiff rod that falls about a pin."""
    steel = Material(4000, 1e9, 0.3, damping)
    beam = Beam("rod", (0, 0), (1.2, 0), 2, Rectangle(0.02, 0.02), steel)
    return Scene([beam], [Pin(beam.at_start, name="pin")], (0, -9.81)), beam


def error(found, exact):
    """Return the relative errors as the tolerance measures them."""
    return np.linalg.norm(found.values - exact, axis=0) / np.linalg.norm(exact, axis=0)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-9])
def test_a_pendulum_follows_its_elliptic_function(tolerance):
    scene, centre, x = pendulum()
    found = simulate(scene, 3.0, tolerance=tolerance, observables=[centre])
    exact = x(found.t)[:, None]
    assert found.reached
    assert found.t[-1] == found.solution.t[-1] == 3.0
    assert error(found, exact) < tolerance
    assert np.linalg.norm(found.values - exact) <= np.linalg.norm(found.bars)
    assert np.linalg.norm(found.bars) <= tolerance * np.linalg.norm(found.values)


def test_a_mass_on_a_spring_at_instants_between_the_steps():
    scene, x = bouncing()
    times = [0.1, 0.35, 0.777, 1.0]
    found = simulate(scene, 1.0, tolerance=1e-6, observables=[x, x - 1.0], at=times)
    exact = 1.0 + 0.2 * np.cos(10.0 * found.t)
    np.testing.assert_array_equal(found.t, times)
    assert found.reached
    assert np.all(error(found, np.stack([exact, exact - 1.0], axis=1)) < 1e-6)
    assert np.all(np.abs(found.values[:, 0] - exact) <= found.bars[:, 0])


def test_a_stiff_damped_rod_and_the_force_of_its_pin():
    scene, beam = rod(1e-3)
    wanted = [position(beam.at_end, 1), reaction("pin", 1)]
    found = simulate(scene, 0.3, tolerance=1e-4, observables=wanted, at=[0.11, 0.2, 0.3])
    truth = simulate(scene, 0.3, Radau(rtol=1e-9)).at(found.t)
    exact = np.stack([observe(each, truth) for each in wanted], axis=1)
    assert found.reached
    # What the reference leaves is far below.
    assert np.all(error(found, exact) < 1e-4)


def test_units_do_not_change_digits():
    found = []
    for length, time in ((1.0, 1.0), (1e3, 1e-2)):
        scene, centre, _ = pendulum(length, time)
        found.append(simulate(scene, 3.0 * time, tolerance=1e-4, observables=[centre]))
    np.testing.assert_allclose(found[1].values / 1e3, found[0].values, rtol=0, atol=1e-10)
    assert [x.steps for x in found[0].trials] == [x.steps for x in found[1].trials]


def test_out_of_reach_is_said_with_the_price(monkeypatch):
    monkeypatch.setattr(search, "_MOST", 1e5)
    scene, beam = rod(0.0)
    with pytest.warns(ToleranceWarning, match=r"To the tolerance: HHT .* more"):
        found = simulate(scene, 0.3, tolerance=1e-9, observables=[position(beam.at_end, 1)])
    truth = simulate(scene, 0.3, DOP853(1e-10))
    exact = observe(position(beam.at_end, 1), truth.at(found.t))
    assert not found.reached
    assert "NOT reached" in repr(found)
    assert "+-" in repr(found)
    assert np.linalg.norm(found.values[:, 0] - exact) <= np.linalg.norm(found.bars)


def test_wrong_input_is_refused_before_a_run(monkeypatch):
    scene, centre, _ = pendulum()
    good = {"tolerance": 1e-3, "observables": [centre]}

    def refused(match, kind=InvalidInputError, **changes):
        with pytest.raises(kind, match=match):
            simulate(scene, 1.0, **{**good, **changes})

    for each in (HHT, Radau, DOP853):
        assert issubclass(each, Integrator)
        monkeypatch.setattr(each, "integrate", None)
    refused("tolerance: must be given without `integrator`", integrator=HHT(0.1))
    refused("without `keep`", keep=10)
    refused("tolerance", tolerance=1.0)
    refused("observables", observables=None)
    refused("observables", observables=[Integral(centre)])
    refused("gone", UnknownNameError, observables=[reaction("gone", 0)])
    refused("at: must be ascending times", at=[0.5, 0.2])
    refused("at: must lie in", at=[0.5, 2.0])
    with pytest.raises(InvalidInputError, match="observables, at: need `tolerance`"):
        simulate(scene, 1.0, HHT(0.1), observables=[centre])
    with pytest.raises(InvalidInputError, match="integrator: must be of type Integrator"):
        simulate(scene, 1.0)
    with pytest.raises(InvalidInputError, match="t_end"):
        simulate(scene, -1.0, **good)
