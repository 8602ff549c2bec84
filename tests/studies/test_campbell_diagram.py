"""Critical speeds and the picture of a Campbell diagram."""

import dataclasses

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    Material,
    RotatingFrame,
    Scene,
    campbell,
    modes,
)
from ancfdae.sections import Circle, Rectangle

STEEL = Material(7850, 2.1e11, 0.3)
#: k L of a clamped beam, cos(k L) cosh(k L) = -1.
WAVES = np.array([1.8751040687, 4.6940911330])


def shaft(section):
    rod = Beam("shaft", (0, 0, 0), (0, 0, 1.0), 8, section, STEEL)
    return Scene([rod], [Clamp(rod.at_start)], frame=RotatingFrame(0.0))


def at_rate(scene, rate):
    return dataclasses.replace(scene, frame=RotatingFrame(rate))


@pytest.fixture(scope="module")
def diagram():
    return campbell(shaft(Circle(0.005)), np.arange(0.0, 351.0, 50.0), 4)


def test_a_round_shaft_is_critical_at_its_frequencies_of_bending(diagram):
    """Rotary and gyroscopic terms raise them by (k r)^2/8: 1e-5 and 7e-5; shear lowers them."""
    euler = WAVES**2 * np.sqrt(2.1e11 * 0.005**2 / 4 / 7850)
    np.testing.assert_allclose(diagram.critical_speeds, euler, rtol=3e-4)


def test_at_a_critical_speed_a_mode_stands_still_in_the_frame(diagram):
    for rate in diagram.critical_speeds:
        there = modes(at_rate(shaft(Circle(0.005)), rate), 4, damped=True)
        assert np.min(there.natural_frequencies) < 2e-4 * rate


def test_a_flat_shaft_has_two_for_each_mode_and_is_unstable_between():
    flat = shaft(Rectangle(0.01, 0.008))
    found = campbell(flat, np.arange(0.0, 351.0, 25.0), 4).critical_speeds
    radii = np.array([0.008, 0.01])[:, None] / np.sqrt(12)
    euler = np.sort((WAVES**2 * np.sqrt(2.1e11 / 7850) * radii).ravel())
    np.testing.assert_allclose(found, euler, rtol=1e-3)
    growth = [
        np.max(modes(at_rate(flat, rate), 4, damped=True).exponents.real)
        for rate in (0.97 * found[0], found[:2].mean(), 1.03 * found[1])
    ]
    assert growth[1] > 1
    assert max(growth[0], growth[2]) < 1e-3


def test_the_picture_shows_a_line_for_each_mode_and_the_rate(diagram, tmp_path):
    (panel,) = diagram.panels()
    assert [x.label for x in panel.series] == [
        *(f"mode {j}" for j in range(4)),
        "rate of the frame",
    ]
    np.testing.assert_array_equal(panel.series[-1].y, diagram.rates)
    crossing = np.interp(diagram.critical_speeds[0], diagram.rates, panel.series[0].y)
    assert crossing == pytest.approx(diagram.critical_speeds[0], rel=1e-3)
    assert [path.name for path in diagram.plot(tmp_path / "campbell.png")] == ["campbell.png"]
