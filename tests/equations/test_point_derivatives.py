"""`Solution.derivative` of a point, and in one variable."""

import numpy as np
import pytest

from ancfdae import HHT, Beam, Material, Pin, RigidBody, Scene, differentiate
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.sections import Rectangle

ROD = Beam("rod", (0, 0), (1.2, 0), 2, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3))
BALL = RigidBody("ball", (0, 2), mass=3.0, inertia=1.0)
SCENE = Scene([ROD], [Pin(ROD.at_start)], (0, -9.81), bodies=[BALL])
DESIGN = ["rod.height", "scene.gravity_y", "ball.position_x"]


@pytest.fixture(scope="module")
def run():
    return differentiate(SCENE, 0.25, HHT(1 / 64), design=DESIGN)


def test_a_falling_ball_moves_by_half_t_squared_for_each_unit_of_gravity(run):
    found = run.derivative(BALL.origin, "scene.gravity_y")
    np.testing.assert_allclose(found[:, 1], run.t**2 / 2, atol=1e-12)
    np.testing.assert_allclose(found[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(
        run.derivative(BALL.origin, "ball.position_x"), [[1, 0]] * len(run.t)
    )


def test_a_point_is_short_for_its_position_and_a_variable_for_its_column(run):
    tip = ROD.at(0.8, y=0.02)
    by_function = run.derivative(lambda solution: solution.position(tip))
    np.testing.assert_array_equal(run.derivative(tip), by_function)
    for i, name in enumerate(DESIGN):
        np.testing.assert_array_equal(run.derivative(tip, name), by_function[..., i])
        energy = run.derivative(lambda solution: solution.v[:, 0] ** 2, name)
        assert energy.shape == run.t.shape


def test_what_is_no_point_and_no_variable_is_told(run):
    with pytest.raises(UnknownNameError, match=r"rod\.width"):
        run.derivative(ROD.at_end, "rod.width")
    with pytest.raises(InvalidInputError, match="MaterialPoint"):
        run.derivative("rod")
