"""Directions that bodies carry along, and angles of bodies and joints in space."""

import numpy as np
import pytest

from ancfdae import (
    CABLE_3D,
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DirectDifferentiation,
    InitialVelocity,
    Integral,
    Material,
    Moment,
    Pin,
    Revolute,
    RigidBody,
    RotationDriver,
    Scene,
    Terminal,
    assemble,
    equilibrium,
    gradients,
    simulate,
)
from ancfdae.errors import InvalidInputError
from ancfdae.laws import SmoothStep
from ancfdae.observables import observe, orientation, rotation_angle, slope_angle
from ancfdae.sections import Circle, Rectangle

RUBBER = Material(1000, 1e7, 0.3)
STEEL = Material(7850, 2.1e11, 0.3)
AXIS = np.array([1.0, -2.0, 2.0]) / 3
SPIN = 7.0
BALL = RigidBody("ball", (0.1, 0.2, 0.3), mass=1.0, inertia=(0.4, 0.4, 0.4, 0, 0, 0))
TUMBLING = Scene([], bodies=[BALL], start=[InitialVelocity("ball", SPIN * AXIS, about=(0, 0, 0))])


def rotation(angle):
    """Rodrigues' formula."""
    K = np.cross(np.eye(3), AXIS)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


@pytest.fixture(scope="module")
def tumbling():
    return assemble(TUMBLING), simulate(TUMBLING, 2.0, HHT(1 / 256))


def test_the_angle_of_a_free_ball_grows_over_full_turns(tumbling):
    system, run = tumbling
    angle = observe(rotation_angle(BALL.origin, tuple(AXIS)), run, system)
    assert angle[-1] > 4 * np.pi
    np.testing.assert_allclose(angle, SPIN * run.t, atol=2e-3)
    back = observe(rotation_angle(BALL.origin, tuple(-3 * AXIS)), run, system)
    np.testing.assert_allclose(back, -angle, atol=1e-9)


def test_directions_are_the_columns_of_the_rotation_matrix(tumbling):
    system, run = tumbling
    angle = observe(rotation_angle(BALL.origin, tuple(AXIS)), run, system)
    for j, direction in enumerate(np.eye(3)):
        for i in range(3):
            found = observe(orientation(BALL.origin, tuple(5 * direction), i), run, system)
            exact = [rotation(x)[i, j] for x in angle]
            np.testing.assert_allclose(found, exact, atol=1e-7)


def arm(rigid):
    """A crank that turns about y and carries a hinge about a tilted axis, which a motor turns."""
    crank = Beam("crank", (0, 0, 0), (0.4, 0, 0), 2, Rectangle(0.02, 0.03), STEEL, rigid=rigid)
    rod = Beam("rod", (0.4, 0, 0), (0.7, 0.1, 0), 2, Rectangle(0.02, 0.03), STEEL, rigid=rigid)
    hinge = (0.2, -0.3, 0.9)
    law = SmoothStep(0.0, 4.3, duration=0.5)
    joints = [
        Revolute(crank.at_start, axis=(0, 1, 0), name="bearing"),
        RotationDriver(crank.at_start, SmoothStep(0.0, -2.0, duration=0.5), axis=(0, 1, 0)),
        Revolute(rod.at_start, axis=hinge, other=crank.at_end, name="hinge"),
        RotationDriver(rod.at_start, law, axis=hinge, other=crank.at_end, name="motor"),
    ]
    scene = Scene([crank, rod], joints)
    return scene, rotation_angle(rod.at_start, hinge, crank.at_end)


@pytest.mark.parametrize("rigid", [True, False])
def test_the_angle_of_a_driven_joint_is_its_law_whatever_carries_it(rigid):
    scene, angle = arm(rigid)
    run = simulate(scene, 0.5, HHT(1 / 512))
    s = np.clip(run.t / 0.5, 0, 1)
    expected = 4.3 * s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
    found = observe(angle, run, assemble(scene))
    np.testing.assert_allclose(found, expected, atol=1e-9 if rigid else 1e-4)


def test_a_bar_that_is_twisted_shows_its_angle_of_twist():
    """phi = M x/(G J) at x (Saint-Venant), for a round bar."""
    bar = Beam("bar", (0, 0, 0), (1, 0, 0), 4, Circle(0.02), RUBBER)
    loaded = Scene([bar], [Clamp(bar.at_start)], loads=[Moment(bar.at_end, (0.2, 0, 0))])
    rest = equilibrium(loaded).solution
    G, J = 1e7 / 2.6, np.pi / 2 * 0.02**4
    for x in (0.25, 0.6, 1.0):
        found = observe(rotation_angle(bar.at(x), (1, 0, 0)), rest, assemble(loaded))[0]
        assert found == pytest.approx(0.2 * x / (G * J), rel=2e-3)
    against = rotation_angle(bar.at(1.0), (1, 0, 0), bar.at(0.5))
    assert observe(against, rest, assemble(loaded))[0] == pytest.approx(0.1 / (G * J), rel=2e-3)


def test_in_the_plane_it_is_the_angle_of_the_tangent_of_a_rigid_rod():
    rod = Beam("rod", (0, 0), (0.6, 0.8), 1, Rectangle(0.02, 0.02), RUBBER, rigid=True)
    spun = Scene(
        [rod],
        [Pin(rod.at_start)],
        (0, -9.81),
        start=[InitialVelocity("rod", 9.0, about=(0, 0))],
    )
    run, system = simulate(spun, 1.0, HHT(1 / 128)), assemble(spun)
    turned = observe(rotation_angle(rod.at_end), run, system)
    tangent = observe(slope_angle(rod.at_start), run, system)
    np.testing.assert_allclose(turned, tangent - np.arctan2(0.8, 0.6), atol=1e-12)
    assert abs(turned[-1]) > 2 * np.pi


def test_gradients_follow_the_reference_and_the_motion():
    """The angle at the end and a direction over the run, in a size, a density and an angle."""
    rod = Beam("rod", (0, 0, 0), (0.5, 0.1, 0), 2, Rectangle(0.02, 0.04), RUBBER)
    box = RigidBody("box", (1, 0, 0), mass=0.2, inertia=(1e-3, 2e-3, 2e-3, 0, 0, 0))
    scene = Scene(
        [rod],
        [Revolute(rod.at_start, axis=(0, 0, 1)), Revolute(box.origin, (0, 1, 1), rod.at_end)],
        (0, -9.81, -3.0),
        bodies=[box],
        assemble=True,
    )
    angle = rotation_angle(box.origin, (0, 1, 1), rod.at_end)
    direction = orientation(rod.at(0.7), (1.0, 0.3, 0.0), 1)
    objectives = [Terminal(angle), Integral(direction**2), Terminal(angle * direction)]
    design = ["rod.height", "rod.density", "rod.turn_z", "rod.length"]
    system, step = assemble(scene, design), HHT(1 / 64)
    found = [
        [x.gradient for x in gradients(system, objectives, 0.25, step, method=m)]
        for m in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    sizes = np.abs(found[0]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found[1] / sizes, found[0] / sizes, atol=1e-9)
    np.testing.assert_allclose(found[2] / sizes, found[0] / sizes, atol=1e-8)
    assert np.all(np.abs(found[0][1]) > 0)


def test_points_whose_sections_do_not_turn_and_axes_out_of_the_plane_are_refused():
    rope = Beam("rope", (0, 0, 0), (1, 0, 0), 2, Circle(0.01), RUBBER, element=CABLE_3D)
    hanging = assemble(Scene([rope], [Pin(rope.at_start)]))
    with pytest.raises(InvalidInputError, match="slope_angle or slope"):
        rotation_angle(rope.at_end).check(hanging)
    rod = Beam("rod", (0, 0), (1, 0), 1, Rectangle(0.02, 0.02), RUBBER)
    plane = assemble(Scene([rod], [Pin(rod.at_start)]))
    with pytest.raises(InvalidInputError, match="along z in the plane"):
        rotation_angle(rod.at_end, (1, 0, 0)).check(plane)
    with pytest.raises(InvalidInputError, match="direction"):
        orientation(rod.at_end, (1, 0, 1), 0).check(plane)
    with pytest.raises(InvalidInputError, match="axis"):
        rotation_angle(rod.at_end, (0, 0, 0))
