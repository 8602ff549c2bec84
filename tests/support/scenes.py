"""Scenes that several tests share: every element, joints, loads, bodies, projected starts."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
    Beam,
    Bushing,
    Clamp,
    CurvedBeam,
    Distance,
    DistributedForce,
    FollowerForce,
    InitialVelocity,
    Material,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Revolute,
    RigidBody,
    RigidBox,
    RigidCylinder,
    RigidSphere,
    RotatingFrame,
    RotationDriver,
    Scene,
    Spherical,
    SpringDamper,
    TranslationDriver,
)
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.model.elements import ALL_ELEMENTS
from ancfdae.sections import Rectangle

STEEL = Material(density=2700.0, youngs_modulus=3e6, poisson_ratio=0.3)
RUBBER = Material(density=1100.0, youngs_modulus=1e6, poisson_ratio=0.41)
FLAT = Rectangle(height=0.06, width=0.04)
THICK = Rectangle(height=0.09, width=0.05)
TALL = Rectangle(height=0.08, width=0.04)
GUM = Material(density=1100.0, youngs_modulus=1e6, poisson_ratio=0.41, damping_time=0.02)


def arc(name, centre, radius, angles, dimension, pitch=0.0, section=FLAT, material=STEEL):
    """Arc (with a pitch: helix) of one element per pair of angles; unit slopes."""
    positions, frames = [], []
    for theta in angles:
        tangent = np.array([np.cos(theta), np.sin(theta), pitch]) / np.sqrt(1 + pitch**2)
        normal = np.array([-np.sin(theta), np.cos(theta), 0.0])
        place = radius * np.array([np.sin(theta), -np.cos(theta), pitch * theta])
        positions.append(np.asarray(centre) + place[:dimension])
        frame = np.array([tangent, normal, np.cross(tangent, normal)])
        frames.append(frame[:dimension, :dimension])
    return CurvedBeam(name, np.array(positions), np.array(frames), section, material)


def clamped(element):
    """An oblique beam of any element, clamped away from its nodes."""
    start, end = ((0.2, 0.1, 0.3)[: element.d], (1.4, 0.6, -0.2)[: element.d])
    # A cable in space takes no other section than one that bends alike about every axis.
    section = Rectangle(0.05, 0.05) if element is CABLE_3D else FLAT
    beam = Beam("rod", start, end, 2, section, STEEL, element=element)
    return Scene([beam], [Clamp(beam.at(0.3))], gravity=(1.3, -9.81, 0.7)[: element.d])


def one_planar_beam():
    beam = Beam("rod", (0.2, 0.1), (1.4, 0.1), 2, FLAT, STEEL)
    return Scene([beam], [Pin(beam.at_start)], gravity=(0.0, -9.81))


def planar_pair():
    """Oblique beams of per-element heights; pins at a y offset and at an interior fraction."""
    heights = [Rectangle(h, 0.05) for h in (0.05, 0.06, 0.08)]
    crank = Beam("crank", (0.0, 0.0), (0.6, 0.8), 3, heights, [STEEL, STEEL, RUBBER])
    rod = Beam("rod", (0.6, 0.8), (1.8, 0.1), 2, FLAT, RUBBER)
    joints = [
        Pin(crank.at(0.0, y=0.02), name="ground"),
        Pin(crank.at_end, rod.at_start, name="elbow"),
        # Off the declared place, so that bodies are assembled, and a guide too many, so that
        # positions are projected, too.
        Pin(rod.at(0.85, y=-0.01), ground=(1.6, 0.25), name="slot"),
        PointOnLine(rod.at(0.3), (1.0, -0.6), through=(0.93, 0.62), name="rail"),
    ]
    start = [InitialVelocity("crank", 1.5, (0.0, 0.0), velocity=(0.1, 0.2))]
    return Scene([crank, rod], joints, gravity=(1.0, -9.81), start=start, project_start=True)


def planar_mixed():
    """A clamped arc that carries a straight beam; clamp away from the nodes."""
    bow = arc("bow", (0.0, 1.0), 1.0, (0.0, 0.5, 0.9), 2, section=[FLAT, TALL])
    tip = bow.positions[-1]
    rod = Beam("rod", tuple(tip), tuple(tip + np.array([0.5, 0.2])), 2, THICK, RUBBER)
    joints = [Clamp(bow.at(0.2)), Pin(bow.at(1.0), rod.at(0.3, y=0.01), name="weld")]
    return Scene([bow, rod], joints, project_start=True)


def planar_cables():
    """A clamped cable that carries another one by its middle."""
    heights = [Rectangle(h, 0.05) for h in (0.05, 0.06)]
    rope = Beam("rope", (0.0, 0.0), (0.6, 0.8), 2, heights, [STEEL, RUBBER], element=CABLE_2D)
    rod = Beam("rod", (0.6, 0.8), (1.8, 0.1), 2, FLAT, RUBBER, element=CABLE_2D)
    joints = [Clamp(rope.at(0.1)), Pin(rope.at_end, rod.at(0.3), name="elbow")]
    return Scene([rope, rod], joints, gravity=(1.0, -9.81), project_start=True)


def one_spatial_beam():
    beam = Beam("rod", (0.0, 0.0, 0.0), (1.2, 0.0, 0.0), 2, FLAT, STEEL)
    return Scene([beam], [Clamp(beam.at_start)], gravity=(0.0, -9.81, 2.0))


def spatial_pair():
    heights = [Rectangle(h, 0.05) for h in (0.05, 0.08)]
    crank = Beam("crank", (0, 0, 0), (0.4, 0.8, 0.3), 2, heights, STEEL, height_axis=(1, 0, 1))
    rod = Beam("rod", (0.4, 0.8, 0.3), (0.4, 0.8, 1.3), 2, FLAT, RUBBER)
    joints = [
        Pin(crank.at(0.15, y=0.02, z=-0.01), name="ground"),
        Pin(crank.at_end, rod.at(0.3, y=0.01), name="elbow"),
        # A little more away from the first one than it is on the beam.
        Pin(crank.at(0.7), ground=(0.3, 0.57, 0.21), name="slot"),
    ]
    start = [InitialVelocity("rod", (0.3, -0.2, 0.5), (0.1, 0.2, 0.0), velocity=(1.0, 0.0, 2.0))]
    return Scene([crank, rod], joints, (0.3, -9.81, 1.0), start, project_start=True)


def spatial_mixed():
    coil = arc("coil", (0.0, 1.0, 0.2), 1.0, (0.0, 0.5, 0.9), 3, pitch=0.3)
    tip = coil.positions[-1]
    rod = Beam("rod", tuple(tip), tuple(tip + np.array([0.5, 0.2, -0.3])), 1, THICK, RUBBER)
    joints = [Clamp(coil.at(0.3, y=0.01)), Pin(coil.at_end, rod.at_start, name="weld")]
    return Scene([coil, rod], joints, gravity=(0.0, 0.0, -9.81))


def planar_machine():
    """A driven crank with a slider, a link and a guided point; one of three beams is damped."""
    crank = Beam("crank", (0.0, 0.0), (0.3, 0.4), 1, THICK, STEEL)
    rod = Beam("rod", (0.3, 0.4), (1.5, 0.1), 2, FLAT, GUM)
    bow = arc("bow", (1.5, 1.1), 1.0, (0.0, 0.4, 0.9), 2)
    law = Harmonic(amplitude=0.4, frequency=3.0, phase=0.2, offset=0.1)
    joints = [
        Pin(crank.at_start, name="bearing"),
        RotationDriver(
            crank.at(0.2, y=0.01), ConstantAcceleration(speed=2.0, acceleration=1.5), name="motor"
        ),
        Pin(crank.at_end, rod.at_start, name="elbow"),
        PointOnLine(rod.at(0.8, y=0.02), direction=(0.9, 0.2), name="slot"),
        Distance(rod.at(0.9, y=-0.02), 1.1, bow.at(0.7, y=0.01), name="link"),
        TranslationDriver(bow.at(0.1), (1.0, 0.5), law, name="shaker"),
        Distance(bow.at_end, 0.7, ground=(1.9, 0.6), name="stay"),
    ]
    loads = [
        PointForce(rod.at(0.4, y=0.01), (3.0, -5.0), name="weight"),
        DistributedForce("bow", (2.0, -4.0), name="snow"),
        FollowerForce(bow.at(0.6, y=-0.02), (4.0, -3.0), name="jet"),
        SpringDamper(rod.at(0.3), 300.0, 5.0, 0.4, bow.at(0.8, y=0.02), name="strut"),
    ]
    start = [InitialVelocity("crank", 1.5, (0.0, 0.0), velocity=(0.1, 0.2))]
    return Scene([crank, rod, bow], joints, (1.0, -9.81), start, loads, project_start=True)


def spatial_machine():
    """A chain of hinges about oblique axes; a slider, a link, a drive and every load."""
    crank = Beam("crank", (0, 0, 0), (0.4, 0.8, 0.3), 1, THICK, GUM, height_axis=(1, 0, 1))
    coil = arc("coil", (0.4, 1.8, 0.3), 1.0, (0.0, 0.5), 3, pitch=0.3)
    joints = [
        Revolute(crank.at(0.1, y=0.02), (0.3, -0.2, 1.0), name="bearing"),
        Revolute(crank.at_end, (0.2, 1.0, 0.4), coil.at(0.15, y=0.01, z=0.01), name="elbow"),
        RotationDriver(crank.at(0.6), Harmonic(0.5, 3.0, 0.2), axis=(0.3, -0.2, 1.0), name="motor"),
        PointOnLine(coil.at(0.8, z=0.01), (0.2, 1.0, 0.3), (0.8, 0.9, 0.3), name="slot"),
    ]
    loads = [
        PointForce(coil.at(0.4, z=0.01), (3.0, -5.0, 1.0), name="weight"),
        DistributedForce("coil", (2.0, -4.0, 1.0), name="snow"),
        FollowerForce(coil.at(0.6, y=-0.02), (4.0, -3.0, 2.0), name="jet"),
        SpringDamper(coil.at(0.9), 300.0, 5.0, 0.4, ground=(0.3, 0.2, 1.5), name="strut"),
    ]
    start = [InitialVelocity("crank", (0.3, -0.2, 0.5), (0.0, 0.0, 0.0), velocity=(1.0, 0.0, 2.0))]
    return Scene([crank, coil], joints, (0.3, -9.81, 1.0), start, loads, project_start=True)


def damped_pair():
    """A damped and an undamped beam without loads: the forces have a path of their own."""
    crank = Beam("crank", (0.0, 0.0), (0.6, 0.8), 2, FLAT, GUM)
    rod = Beam("rod", (0.6, 0.8), (1.8, 0.1), 1, THICK, STEEL)
    joints = [Pin(crank.at_start, name="ground"), Pin(crank.at_end, rod.at_start, name="elbow")]
    return Scene([crank, rod], joints, gravity=(1.0, -9.81))


def planar_bodies():
    """Nothing that bends: two bodies and a point mass, with loads that follow them."""
    frame = ((0.8, 0.6), (-0.6, 0.8))
    arm = RigidBody("arm", (0.1, 0.2), 2.0, 0.05, centre=(0.4, 0.1), frame=frame)
    wheel = RigidBody("wheel", (0.9, 0.8), shape=RigidCylinder(0.2, 0.03), density=2700.0)
    load = PointMass(wheel.at(0.1, 0.05), 0.7, name="load")
    joints = [
        Pin(arm.at(0.0, 0.01), name="ground"),
        Pin(arm.at(1.0), wheel.origin, name="elbow"),
        Distance(wheel.at(0.1, 0.1), 0.7, ground=(1.5, 0.4), name="link"),
    ]
    loads = [
        FollowerForce(wheel.at(0.1, -0.02), (4.0, -3.0), name="jet"),
        SpringDamper(wheel.at(0.3), 30.0, 5.0, 0.4, arm.at(0.2, 0.3), name="strut"),
    ]
    start = [InitialVelocity("wheel", 1.5, (0.9, 0.8), velocity=(0.1, 0.2))]
    bodies = [arm, wheel, load]
    return Scene([], joints, (1.0, -9.81), start, loads, project_start=True, bodies=bodies)


def planar_carriers():
    """A beam that bends, two that do not, a body and point masses on all of them."""
    rod = Beam("rod", (0.0, 0.0), (0.6, 0.8), 2, FLAT, GUM)
    heights = [Rectangle(h, 0.05) for h in (0.05, 0.08)]
    arm = Beam("arm", (0.6, 0.8), (1.8, 0.1), 2, heights, STEEL, rigid=True)
    bow = replace(arc("bow", (1.8, 1.1), 1.0, (0.0, 0.5, 0.9), 2, section=[FLAT, TALL]), rigid=True)
    box = RigidBody("box", tuple(bow.positions[-1]), shape=RigidBox(0.3, 0.2, 0.1), density=900.0)
    bodies = [
        box,
        PointMass(rod.at(0.3, y=0.01), 0.3, name="bead"),
        PointMass(arm.at(0.8, y=0.01), 0.4, name="knot"),
        PointMass(box.at(0.1, -0.1), 0.5, name="load"),
    ]
    joints = [
        Clamp(rod.at(0.1)),
        Pin(rod.at_end, arm.at(0.0), name="elbow"),
        Pin(arm.at_end, bow.at_start, name="knee"),
        Pin(bow.at(0.9, y=0.01), box.at(0.1, 0.05), name="hook"),
    ]
    loads = [
        DistributedForce("bow", (2.0, -4.0), name="snow"),
        SpringDamper(arm.at(0.3), 300.0, 5.0, 0.4, rod.at(0.8, y=0.02), name="strut"),
    ]
    start = [InitialVelocity("arm", 1.5, (0.6, 0.8), velocity=(0.1, 0.2))]
    beams = [rod, arm, bow]
    return Scene(beams, joints, (1.0, -9.81), start, loads, project_start=True, bodies=bodies)


def spatial_carriers():
    """A beam that bends, a rigid coil and a body of any inertia, on joints about axes."""
    rod = Beam("rod", (0, 0, 0), (0.4, 0.8, 0.3), 1, THICK, STEEL, height_axis=(1, 0, 1))
    coil = replace(arc("coil", (0.4, 1.8, 0.3), 1.0, (0.0, 0.5, 0.8), 3, pitch=0.3), rigid=True)
    inertia = (0.05, 0.06, 0.07, 0.01, -0.02, 0.015)
    frame = Rotation.from_rotvec((0.3, -0.5, 0.9)).as_matrix().tolist()
    place = tuple(coil.positions[-1])
    body = RigidBody("body", place, 2.0, inertia, (0.1, 0.2, -0.1), frame=frame)
    ball = RigidBody("ball", (0, 1, 1), shape=RigidSphere(0.1), density=900.0, centre=(0, 0, 0.1))
    bodies = [body, ball, PointMass(coil.at(0.7, z=0.01), 0.4, name="bead")]
    joints = [
        Revolute(rod.at(0.1, y=0.02), (0.3, -0.2, 1.0), name="bearing"),
        Revolute(rod.at_end, (0.2, 1.0, 0.4), coil.at(0.0, y=0.01, z=0.01), name="elbow"),
        Spherical(coil.at_end, body.at(0.0, 0.1, 0.0), name="knee"),
        Distance(ball.at(0.1, 0.0, 0.0), 0.9, body.origin, name="link"),
    ]
    loads = [
        DistributedForce("coil", (2.0, -4.0, 1.0), name="snow"),
        FollowerForce(body.at(0.1, 0.2, 0.3), (4.0, -3.0, 2.0), name="jet"),
        SpringDamper(coil.at(0.9), 300.0, 5.0, 0.4, ground=(0.3, 0.2, 1.5), name="strut"),
    ]
    start = [InitialVelocity("body", (0.3, -0.2, 0.5), (0.0, 0.0, 0.0), velocity=(1.0, 0.0, 2.0))]
    beams = [rod, coil]
    return Scene(beams, joints, (0.3, -9.81, 1.0), start, loads, project_start=True, bodies=bodies)


def cable_carriers():
    """A cable that carries a body off its centre, and a rigid one of the same element."""
    rope = Beam("rope", (0.0, 0.0), (0.6, 0.8), 2, FLAT, STEEL, element=CABLE_2D)
    rod = Beam("rod", (0.6, 0.8), (1.8, 0.1), 2, FLAT, RUBBER, element=CABLE_2D, rigid=True)
    box = RigidBody("box", (1.75, 0.0), shape=RigidBox(0.3, 0.2, 0.1), density=900.0)
    joints = [
        Clamp(rope.at(0.1)),
        Pin(rope.at_end, rod.at(0.3), name="elbow"),
        Pin(rod.at_end, box.at(0.1, 0.05), name="hook"),
    ]
    return Scene([rope, rod], joints, gravity=(1.0, -9.81), project_start=True, bodies=[box])


SCENES = {
    scene.__name__: scene
    for scene in (
        one_planar_beam,
        planar_pair,
        planar_mixed,
        planar_cables,
        one_spatial_beam,
        spatial_pair,
        spatial_mixed,
        damped_pair,
        planar_machine,
        spatial_machine,
        planar_bodies,
        planar_carriers,
        spatial_carriers,
        cable_carriers,
    )
}
for ELEMENT in ALL_ELEMENTS:
    SCENES[ELEMENT.name] = lambda element=ELEMENT: clamped(element)
#: Scenes with something rigid.
RIGID = ("planar_bodies", "planar_carriers", "spatial_carriers", "cable_carriers")
#: Scenes with bilinear or driven joints, with loads that follow the motion or with damping.
MACHINES = ("damped_pair", "planar_machine", "spatial_machine", *RIGID)


def rotor(rate=1.0, eccentricity=0.0, damping=0.0):
    """A disc of 2 kg in springs that turn with it (Jeffcott): critical at 10 and 12 rad/s."""
    body = RigidBody("disc", (0, 0, 0), mass=2.0, inertia=(1.0, 1.0, 1.0))
    if eccentricity:
        body = replace(body, centre=(eccentricity, 0, 0))
    given = {"turn_stiffness": (4e4, 5e4, 6e4), "damping": (damping, damping, 0.0)}
    springs = Bushing(body.at(0, 0, 0), (200.0, 288.0, 1e4), name="shaft", **given)
    return Scene([], [], bodies=[body], loads=[springs], frame=RotatingFrame(rate))
