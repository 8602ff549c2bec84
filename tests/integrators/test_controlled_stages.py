"""Steps of Radau IIA that the kernel takes and controls are those of dense matrices in Python."""

import numpy as np
import pytest

from ancfdae import (
    AdaptiveSteps,
    Beam,
    Material,
    Pin,
    Radau,
    Scene,
    assemble,
)
from ancfdae.sections import Rectangle
from tests.integrators.test_controlled_march import (
    called_pendulum,
    driven_crank,
    kicked_pendulum,
    soft_pendulum,
)
from tests.support.mechanisms import GuidedDoublePendulum
from tests.support.radau_reference import dense_run


def listed_pendulum():
    return GuidedDoublePendulum(), 0.5


def damped_rope():
    """A rope of rubber, whose forces depend on velocities, driven by nothing."""
    rubber = Material(1100.0, 5e4, 0.3, damping_time=0.1)
    rod = Beam("rod", (0, 0), (1.0, 0.2), 2, Rectangle(0.02, 0.02), rubber)
    scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81), project_start=True)
    return assemble(scene, ["rod.height"]), 0.3


SYSTEMS = [
    soft_pendulum,
    driven_crank,
    kicked_pendulum,
    damped_rope,
    called_pendulum,
    listed_pendulum,
]


@pytest.mark.parametrize("rtol", [1e-2, 1e-3])
@pytest.mark.parametrize("made", SYSTEMS)
def test_the_kernel_takes_the_steps_of_dense_matrices(made, rtol):
    system, t_end = made()
    ours, theirs = (
        run(system, t_end, AdaptiveSteps(rtol))
        for run in (lambda *_: Radau(AdaptiveSteps(rtol)).integrate(system, t_end), dense_run)
    )
    assert ours.outcome.success
    for name in ("steps", "rejected"):
        assert getattr(ours.statistics, name) == getattr(theirs.statistics, name)
    # The round-off of stages is amplified in the estimate of an error, and the filter follows it.
    np.testing.assert_allclose(ours.t, theirs.t, rtol=0, atol=1e-8 * t_end)
    for name, share in (("q", 1e-8), ("v", 1e-7), ("a", 1e-6), ("lam", 1e-6)):
        x, y = getattr(ours, name), getattr(theirs, name)
        np.testing.assert_allclose(x, y, rtol=0, atol=share * np.max(np.abs(y)), err_msg=name)
