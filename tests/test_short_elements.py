"""Elements much shorter than high: the default energy takes the steps that plain strains take."""

import numpy as np
import pytest

from ancfdae import HHT, Beam, EnhancedContinuum, Material, Pin, Rectangle, Scene, simulate

E, HEIGHT, LENGTH = 1e7, 0.05, 1.2


def beam(d, elements, assumed):
    end, energy = (LENGTH, *(d - 1) * [0.0]), EnhancedContinuum(assumed)
    section, material = Rectangle(HEIGHT, HEIGHT), Material(4000, E, 0.3)
    return Beam("b", d * (0.0,), end, elements, section, material, energy=energy)


@pytest.mark.parametrize("d", [2, 3])
def test_refined_beams_fall_in_as_many_iterations_as_with_plain_strains(d):
    # h/l = 8.3. Squares of the kinks that shear makes in the axis, times (r/l)^2: 2.6 (planar) and
    # 10.8 iterations a step, 30 steps in 256 by way of shorter ones.
    counts, tips = [], []
    for assumed in (True, False):
        rod = beam(d, 200, assumed)
        scene = Scene([rod], [Pin(rod.at_start)], gravity=(0.0, -9.81, 0.0)[:d])
        run = simulate(scene, 0.25, HHT(2**-10))
        assert run.outcome.success
        assert run.statistics.continued == 0
        counts.append(run.statistics.iterations)
        tips.append(run.position(rod.at_end)[-1])
    assert counts[0] <= 1.2 * counts[1]
    # Both err by (r kappa)^2 at most, with h kappa = 0.05 where it bends most: 2e-4 of the length.
    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=2e-4 * LENGTH)
