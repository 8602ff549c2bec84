"""A ground that was left out: it is a design target at the place of the point in the reference."""

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    HHT,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    CurvedBeam,
    Cylindrical,
    DirectDifferentiation,
    Integral,
    Material,
    Pin,
    PlanarJoint,
    Revolute,
    RigidBody,
    Scene,
    SpringDamper,
    Universal,
    assemble,
    gradient,
    simulate,
)
from ancfdae.model.elements import Quantity
from ancfdae.observables import position
from ancfdae.sections import Rectangle

FLAT = Rectangle(0.05, 0.04)
SOFT = Material(1000.0, 1e6, 0.3)


def straight(d, **given):
    end = (0.9, 0.2, 0.1)[:d]
    return Beam("rod", (0.0,) * d, end, 3, FLAT, SOFT, **given)


def curved(d, **given):
    """An arc about the origin that does not begin there, turned as a whole."""
    angle, turn = np.linspace(0.0, 1.2, 4), 0.3 if d == 2 else (0.1, 0.0, 0.3)
    outward = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    tangent = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    axes = [tangent, -outward, np.cross(tangent, -outward)][:d]
    frames = np.stack(axes, axis=1)[..., :d]
    return CurvedBeam("rod", outward[:, :d], frames, FLAT, SOFT, turn=turn, **given)


def off_axis(rod, d):
    return rod.at(0.3, 0.015, -0.01) if d == 3 else rod.at(0.3, 0.015)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("beam", [straight, curved])
@pytest.mark.parametrize("rigid", [False, True])
def test_a_scene_knows_the_place_of_every_point_as_its_system_does(d, beam, rigid):
    rod = beam(d, rigid=rigid)
    rod = rod.with_values([("start_x", None, 0.4)])
    box = RigidBody("box", (0.3, 0.2, 0.1)[:d], 1.0, 0.02 if d == 2 else (0.02,) * 3, turn=rod.turn)
    branch = Beam("branch", off_axis(rod, d), (0.1, 0.3, -0.2)[:d], 2, FLAT, SOFT)
    scene = Scene([rod, branch], bodies=[box])
    points = [rod.at_start, rod.at_end, rod.at(1 / 3), rod.at(1 / 3, before=True)]
    points += [off_axis(rod, d), branch.at(0.7, 0.01), box.at(0.1, -0.2, 0.05 * (d == 3))]
    inputs = assemble(scene).inputs
    for point in points:
        place, _ = inputs.in_reference(point, Quantity.POSITION)
        np.testing.assert_allclose(scene.place_of(point), place, atol=1e-14)


def test_a_cable_knows_its_places_too():
    wire = Beam("wire", (0.1, 0.2), (0.9, 0.5), 3, FLAT, SOFT, element=CABLE_2D)
    place = Scene([wire]).place_of(wire.at(0.4))
    np.testing.assert_allclose(place, [0.1 + 0.4 * 0.8, 0.2 + 0.4 * 0.3], atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("beam", [straight, curved])
@pytest.mark.parametrize("at", [lambda rod, d: rod.at_start, off_axis])
def test_the_gradient_is_the_limit_of_differences_of_the_users_call(d, beam, at):
    """A pendulum on a spring whose other end stays: its pin moves, and the beam goes with it."""
    rod = beam(d)
    pin = Pin(at(rod, d), name="base")
    spring = SpringDamper(rod.at_end, ground=(1.5, -0.4, 0.2)[:d], stiffness=80.0, free_length=0.5)
    scene = Scene([rod], [pin], (0.0, -9.81, 1.0)[:d], loads=[spring])
    method, objective = HHT(0.005), Integral(position(rod.at_end, 0) ** 2)
    names = [f"base.ground_{axis}" for axis in "xyz"[:d]]
    found = [
        gradient(scene, objective, 0.025, method, design=names, method=by).gradient
        for by in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-8, atol=1e-10)
    held = assemble(scene, names).b
    h, differences = 1e-4, []
    for name, x in zip(names, held, strict=True):
        moved = [scene.with_values({name: x + step}) for step in (h, -h)]
        up, down = (
            gradient(other, objective, 0.025, method, design=["scene.gravity_x"]).value
            for other in moved
        )
        differences.append((up - down) / (2 * h))
    # Newton's tolerance over h, and h^2.
    np.testing.assert_allclose(found[0], differences, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("d", [2, 3])
def test_the_scene_stays_the_same_until_the_ground_moves(d):
    rod = curved(d)
    scene = Scene([rod], [Clamp(rod.at_start, name="base")], (0.0, -9.81, 1.0)[:d])
    x = scene.place_of(rod.at_start)
    value = scene.numbers("base")["ground_x"]
    assert value == x[0]
    plain = simulate(scene, 0.05, HHT(0.01))
    named = simulate(scene.with_values({"base.ground_x": value}), 0.05, HHT(0.01))
    np.testing.assert_allclose(named.q, plain.q, atol=1e-12)
    carried = scene.with_values({"base.ground_x": value + 0.5})
    assert carried.joints[0].ground == (x[0] + 0.5, *x[1:])


@pytest.mark.parametrize(
    "joint",
    [
        lambda p: Revolute(p, (0, 0, 1), name="base"),
        lambda p: Cylindrical(p, (0, 0, 1), name="base"),
        lambda p: PlanarJoint(p, (0, 0, 1), name="base"),
        lambda p: Universal(p, (0, 1, 0), (0, 0, 1), name="base"),
    ],
)
def test_every_joint_with_a_ground_has_the_target(joint):
    rod = straight(3)
    scene = Scene([rod], [joint(off_axis(rod, 3))])
    written = scene.with_grounds(["base.ground_z"])
    values = [assemble(x, ["base.ground_z"]).b for x in (scene, written)]
    assert values[0] == values[1] == scene.place_of(off_axis(rod, 3))[2]


def test_ground_written_stays_where_another_target_moves_the_beam():
    """With the ground among the targets it is a number of its own; else it goes with the beam."""
    rod = straight(2)
    scene = Scene([rod], [Pin(rod.at_end, name="base")])
    follows = scene.with_values({"rod.length": 2.0})
    stays = scene.with_values({"rod.length": 2.0, "base.ground_x": 0.9})
    assert follows.joints[0].ground is None
    assert stays.joints[0].ground == pytest.approx((0.9, 0.2), abs=1e-15)
