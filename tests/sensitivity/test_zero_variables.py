"""Finite differences of design variables that are 0, whose size the user gives."""

import numpy as np
import pytest

from ancfdae import (
    HHT,
    FiniteDifference,
    PointForce,
    RigidBody,
    Scene,
    Terminal,
    assemble,
    differentiate,
    gradient,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.observables import position

BLOCK = RigidBody("block", (0, 0), mass=2.0, inertia=1.0)
PUSH = PointForce(BLOCK.origin, (0.0, 3.0), name="push")
SCENE = Scene([], bodies=[BLOCK], loads=[PUSH])
X, Y = (Terminal(position(BLOCK.origin, axis)) for axis in (0, 1))
DESIGN = ["push.force_x", "push.force_y"]


@pytest.mark.parametrize("central", [False, True])
@pytest.mark.parametrize("size", [1e-3, 5.0])
def test_a_force_of_zero_moves_a_block_by_t_squared_over_two_masses(central, size):
    """X = F t^2/(2 m) is linear in F, so that differences of any size give 1/(2 m) at t = 1."""
    method = FiniteDifference(0.01, central, sizes={"push.force_x": size})
    found = gradient(SCENE, X, 1.0, HHT(1 / 16), design=DESIGN, method=method)
    np.testing.assert_allclose(found.gradient, [0.25, 0.0], rtol=1e-8, atol=1e-12)
    assert found.value == pytest.approx(0.0, abs=1e-15)


def test_a_size_replaces_the_value_of_a_variable_that_is_not_zero():
    """A forward difference of F^2 errs by its step, a hundredth of the size given."""
    system = assemble(SCENE, ["push.force_y"])
    squared = Terminal(position(BLOCK.origin, 1) ** 2)
    exact = 2 * 3.0 / 16  # Y^2 = (F/4)^2
    for size in (3.0, 30.0):
        method = FiniteDifference(0.01, sizes={"push.force_y": size})
        found = gradient(system, squared, 1.0, HHT(1 / 16), method=method).gradient[0]
        assert found - exact == pytest.approx(0.01 * size / 16, rel=1e-6)


def test_trajectories_are_differentiated_with_the_same_sizes():
    method = FiniteDifference(sizes={"push.force_x": 2.0})
    run = differentiate(SCENE, 0.5, HHT(1 / 16), design=["push.force_x"], method=method)
    np.testing.assert_allclose(run.sensitivities.q_b[:, 0, 0], run.t**2 / 4, atol=1e-9)


def test_a_variable_of_zero_without_a_size_is_told_by_name():
    with pytest.raises(
        InvalidInputError, match=r"FiniteDifference\(sizes=\{'push.force_x': ...\}\)"
    ):
        gradient(SCENE, X, 1.0, HHT(1 / 16), design=DESIGN, method=FiniteDifference())
    method = FiniteDifference(sizes={"push.forze_x": 1.0})
    with pytest.raises(UnknownNameError, match=r"push\.force_x"):
        gradient(SCENE, X, 1.0, HHT(1 / 16), design=DESIGN, method=method)
    for wrong in ({"push.force_x": 0.0}, {"push.force_x": -1.0}, ["push.force_x"]):
        with pytest.raises(InvalidInputError, match="sizes"):
            FiniteDifference(sizes=wrong)
