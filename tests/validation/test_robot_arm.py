"""The robot arm of COPS, traced with moments in straight lines, against SciPy."""

import numpy as np

from ancfdae import Radau, gradients
from validation.events.cops import RobotArm, asked, missed


def test_end_conditions_and_derivatives_of_the_robot_arm_equal_those_of_scipy():
    """Moments at random, five intervals: both integrate to 1e-9."""
    b = np.append(np.random.default_rng(3).uniform(-1, 1, 18), 3.0)
    found = gradients(RobotArm(5, b), list(asked().values()), 1.0, Radau(step=0.02))
    values = np.array([x.value for x in found])
    assert np.max(np.abs(values - missed(b))) < 1e-9
    h = 1e-4
    for k in (2, 8, 15, 18):
        slopes = (missed(b + h * np.eye(19)[k]) - missed(b - h * np.eye(19)[k])) / (2 * h)
        assert np.max(np.abs(slopes - [x.gradient[k] for x in found])) < 1e-7
