"""Elements much shorter than high: the default energy takes the steps that plain strains take."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    Beam,
    Clamp,
    EnhancedContinuum,
    Material,
    Pin,
    PointForce,
    Scene,
    equilibrium,
    simulate,
)
from ancfdae.sections import Rectangle

E, HEIGHT, LENGTH = 1e7, 0.05, 1.2


def beam(d, elements, assumed, length=LENGTH):
    end, energy = (length, *(d - 1) * [0.0]), EnhancedContinuum(assumed)
    section, material = Rectangle(HEIGHT, HEIGHT), Material(4000, E, 0.3)
    return Beam("b", d * (0.0,), end, elements, section, material, energy=energy)


# h/l = 8.3 and 50. Without the limits: 2.6 and 10.8 iterations a step of 200
# elements, 30 steps by way of shorter ones; no end at h/l = 50.
@pytest.mark.parametrize(
    ("d", "elements", "length", "t"),
    [(2, 200, LENGTH, 0.25), (3, 200, LENGTH, 0.25), (2, 1200, LENGTH, 0.25)],
)
def test_refined_beams_fall_in_as_many_iterations_as_with_plain_strains(d, elements, length, t):
    counts, tips = [], []
    for assumed in (True, False):
        rod = beam(d, elements, assumed, length)
        scene = Scene([rod], [Pin(rod.at_start)], gravity=(0.0, -9.81, 0.0)[:d])
        run = simulate(scene, t, HHT(2**-10))
        assert run.outcome.success
        assert run.statistics.continued == 0
        counts.append(run.statistics.iterations)
        tips.append(run.position(rod.at_end)[-1])
    assert counts[0] <= 1.2 * counts[1]
    # Both err by (r kappa)^2 at most, with h kappa = 0.05 where it bends most: 2e-4 of the length.
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=2e-4 * length)


@pytest.mark.parametrize(("d", "elements"), [(2, 200), (2, 4000), (3, 200), (3, 1000)])
def test_refined_beams_rest_in_as_many_iterations_as_with_plain_strains(d, elements):
    # h/l = 10, 50 and 200; the last took 55 iterations for 28, with a path of its own.
    counts = []
    for assumed in (True, False):
        rod = beam(d, elements, assumed, 1.0)
        force = E * HEIGHT**4 / 12 * np.array([0.0, -3.0, 1.0])[:d]
        loads = [PointForce(rod.at_end, tuple(force))]
        rest = equilibrium(Scene([rod], [Clamp(rod.at_start)], loads=loads))
        assert rest.outcome.success
        counts.append(rest.solution.statistics.iterations)
    assert counts[0] <= 1.2 * counts[1]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("elements", [1, 5, 50, 500])
def test_short_and_long_elements_bend_as_timoshenko_beam(d, elements):
    # From l = 4 h to h/l = 125; the condition number of the matrices times round-off: 1e-6.
    rod = beam(d, elements, True, 0.2)
    A, I, k, F = HEIGHT**2, HEIGHT**4 / 12, 13 / 15.3, 1e-6
    loads = [PointForce(rod.at_end, (0.0, F, 0.0)[:d])]
    rest = equilibrium(Scene([rod], [Clamp(rod.at_start)], loads=loads))
    expected = F * 0.2**3 / (3 * E * I) + F * 0.2 / (k * E / 2.6 * A)
    assert rest.solution.position(rod.at_end)[0][1] == pytest.approx(expected, rel=1e-6)
