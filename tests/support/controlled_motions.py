"""Motions under error control: a soft pendulum, a driven crank, a kicked and a called one."""

from ancfdae import (
    Beam,
    FollowerForce,
    Material,
    Pin,
    PointForce,
    RigidBody,
    RigidBox,
    RotationDriver,
    Scene,
    assemble,
)
from ancfdae.laws import ConstantAcceleration, Harmonic, SmoothStep
from ancfdae.sections import Rectangle
from tests.support.mechanisms import CartesianPendulum


def soft_pendulum():
    rod = Beam("rod", (0, 0), (1.2, 0), 2, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3, 2e-3))
    return assemble(Scene([rod], [Pin(rod.at_start)], gravity=(0, -9.81)), ["rod.height"]), 0.25


def driven_crank():
    crank = RigidBody("crank", (0.1, 0), shape=RigidBox(0.2, 0.04, 0.02), density=2700.0)
    rod = Beam("rod", (0.2, 0), (0.7, 0), 2, Rectangle(0.01, 0.02), Material(1150, 2e7, 0.4))
    joints = [
        Pin(crank.at(-0.1)),
        RotationDriver(crank.at(-0.1), ConstantAcceleration(0.0, acceleration=200.0), name="motor"),
        Pin(crank.at(0.1), rod.at_start),
    ]
    return assemble(Scene([rod], joints, (0, -9.81), bodies=[crank]), ["rod.height"]), 0.08


def kicked_pendulum():
    rod = Beam("rod", (0, 0), (1.2, 0), 2, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3, 2e-3))
    kick = PointForce(rod.at_end, (0, 80.0), law=Harmonic(1.0, 25.0))
    follower = FollowerForce(rod.at_end, (0, 5.0), law=SmoothStep(0.0, 1.0, duration=0.2))
    scene = Scene([rod], [Pin(rod.at_start)], (0, -9.81), loads=[kick, follower])
    return assemble(scene, ["rod.height"]), 0.25


def called_pendulum():
    return CartesianPendulum(0.7, 1.0), 1.0
