"""The assembler behind the system protocol, and the linear solvers that factorise its matrices.

Every partial of the protocol is compared with a complex step of the system's own values, the
values with a plain assembly of oracle elements and shape functions written by hand. Complex
steps have no truncation error: STEP^2 vanishes against one.
"""

import inspect
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from members import (
    acceleration_side,
    acceleration_side_total,
    constraint_b,
    constraint_force,
    constraint_force_b,
    constraint_force_q,
    constraint_force_rate,
    constraint_force_rate_total,
    constraint_q_times_total,
    force_b,
    force_q,
    force_rate,
    force_rate_total,
    force_total,
    force_v,
    jerk_side,
    jerk_side_total,
    mass_b_times,
    velocity_side,
    velocity_side_total,
)
from scipy.spatial.transform import Rotation

from ancfdae import (
    CABLE_2D,
    Beam,
    Clamp,
    CurvedBeam,
    DesignVariable,
    Distance,
    DistributedForce,
    Drive,
    FollowerForce,
    Guide,
    Harmonic,
    Material,
    MechanicalSystem,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Rectangle,
    Revolute,
    RigidBody,
    RigidBox,
    RigidCylinder,
    RigidMotion,
    RigidSphere,
    SaintVenantKirchhoff,
    Scene,
    Spherical,
    SpringDamper,
    Uniform,
    assemble,
    distribution,
)
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors import InvalidInput, SingularMatrix
from ancfdae.integrators.hht.equations import Coefficients
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.start import consistent_start, start_sensitivity
from ancfdae.model.elements import ALL_ELEMENTS, BeamElement, ElementParameter
from ancfdae.numerics import linear_solvers
from ancfdae.numerics.extrapolation import real_derivative
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.numerics.patterns import Pattern

from oracle import plain_ancf as ancf
from oracle import plain_cable

STEP = 1e-40
# Two evaluations of one derivative differ by round-off: sums over up to 432 quadrature points and
# 28 entries of g, with terms a few hundred times the result (the cancellation in the strain,
# about 1e-1, and in the product rule): 1e3 eps = 2e-13, five times that is allowed.
DERIVATIVE = 1e-12
# Time is real: derivatives in it come from extrapolated differences, good to about 1e-11.
DIFFERENCES = 1e-9
# Values against the oracle: sums as above without the product rule, and a reference that was
# turned into the direction of the beam (a few eps more).
VALUE = 3e-13

STEEL = Material(density=2700.0, youngs_modulus=3e6, poisson_ratio=0.3)
RUBBER = Material(density=1100.0, youngs_modulus=1e6, poisson_ratio=0.41)
FLAT = Rectangle(height=0.06, width=0.04)
THICK = Rectangle(height=0.09, width=0.05)
TALL = Rectangle(height=0.08, width=0.04)
GUM = Material(density=1100.0, youngs_modulus=1e6, poisson_ratio=0.41, damping_time=0.02)


# ---------------------------------------------------------------- scenes


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
    beam = Beam("rod", start, end, 2, FLAT, STEEL, element=element)
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
    start = [RigidMotion("crank", 1.5, (0.0, 0.0), velocity=(0.1, 0.2))]
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
    start = [RigidMotion("rod", (0.3, -0.2, 0.5), (0.1, 0.2, 0.0), velocity=(1.0, 0.0, 2.0))]
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
        Drive(crank.at(0.2, y=0.01), Uniform(speed=2.0, acceleration=1.5), name="motor"),
        Pin(crank.at_end, rod.at_start, name="elbow"),
        PointOnLine(rod.at(0.8, y=0.02), direction=(0.9, 0.2), name="slot"),
        Distance(rod.at(0.9, y=-0.02), 1.1, bow.at(0.7, y=0.01), name="link"),
        Guide(bow.at(0.1), (1.0, 0.5), law, name="shaker"),
        Distance(bow.at_end, 0.8, ground=(1.9, 0.6), name="stay"),
    ]
    loads = [
        PointForce(rod.at(0.4, y=0.01), (3.0, -5.0), name="weight"),
        DistributedForce("bow", (2.0, -4.0), name="snow"),
        FollowerForce(bow.at(0.6, y=-0.02), (4.0, -3.0), name="jet"),
        SpringDamper(rod.at(0.3), 300.0, 5.0, 0.4, bow.at(0.8, y=0.02), name="strut"),
    ]
    start = [RigidMotion("crank", 1.5, (0.0, 0.0), velocity=(0.1, 0.2))]
    return Scene([crank, rod, bow], joints, (1.0, -9.81), start, loads, project_start=True)


def spatial_machine():
    """A chain of hinges about oblique axes; a slider, a link, a drive and every load."""
    crank = Beam("crank", (0, 0, 0), (0.4, 0.8, 0.3), 1, THICK, GUM, height_axis=(1, 0, 1))
    coil = arc("coil", (0.4, 1.8, 0.3), 1.0, (0.0, 0.5), 3, pitch=0.3)
    joints = [
        Revolute(crank.at(0.1, y=0.02), (0.3, -0.2, 1.0), name="bearing"),
        Revolute(crank.at_end, (0.2, 1.0, 0.4), coil.at(0.15, y=0.01, z=0.01), name="elbow"),
        Drive(crank.at(0.6), Harmonic(0.5, 3.0, 0.2), axis=(0.3, -0.2, 1.0), name="motor"),
        PointOnLine(coil.at(0.8, z=0.01), (0.2, 1.0, 0.3), (0.8, 0.9, 0.3), name="slot"),
    ]
    loads = [
        PointForce(coil.at(0.4, z=0.01), (3.0, -5.0, 1.0), name="weight"),
        DistributedForce("coil", (2.0, -4.0, 1.0), name="snow"),
        FollowerForce(coil.at(0.6, y=-0.02), (4.0, -3.0, 2.0), name="jet"),
        SpringDamper(coil.at(0.9), 300.0, 5.0, 0.4, ground=(0.3, 0.2, 1.5), name="strut"),
    ]
    start = [RigidMotion("crank", (0.3, -0.2, 0.5), (0.0, 0.0, 0.0), velocity=(1.0, 0.0, 2.0))]
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
    start = [RigidMotion("wheel", 1.5, (0.9, 0.8), velocity=(0.1, 0.2))]
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
    start = [RigidMotion("arm", 1.5, (0.6, 0.8), velocity=(0.1, 0.2))]
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
    start = [RigidMotion("body", (0.3, -0.2, 0.5), (0.0, 0.0, 0.0), velocity=(1.0, 0.0, 2.0))]
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
MATERIAL = ("youngs_modulus", "poisson_ratio", "density")
ALL = (*MATERIAL, "width", "height", "length", "damping_time")


def of(beam, *parameters):
    return [f"{beam}.{parameter}" for parameter in parameters]


#: Scene and design; together every parameter of every scene, one variable for several beams and
#: one variable per element.
CASES = {
    "planar, all": ("one_planar_beam", of("rod", *ALL)),
    "planar, none": ("one_planar_beam", []),
    # One variable that enters the mass alone, one that enters the elastic force alone.
    "planar, inertial": ("one_planar_beam", of("rod", "density")),
    "planar, elastic": ("one_planar_beam", of("rod", "poisson_ratio")),
    "pair, one each": ("planar_pair", [*of("crank", "width", "length"), *of("rod", *ALL)]),
    "pair, shared": (
        "planar_pair",
        [
            DesignVariable("E", ["rod.youngs_modulus", "crank.youngs_modulus[2]"]),
            DesignVariable("rho", ["crank.density[0]", "crank.density[1]"]),
            DesignVariable("h", ["rod.height", "crank.height[1]"]),
        ],
    ),
    "pair, per element": (
        "planar_pair",
        [*distribution("crank.height", 3), *distribution("rod.poisson_ratio", 2), "crank.length"],
    ),
    "mixed, curved": ("planar_mixed", [*of("bow", *MATERIAL, "width", "length"), "rod.length"]),
    "mixed, per element": (
        "planar_mixed",
        [
            *distribution("bow.height", 2),
            DesignVariable("nu", ["rod.poisson_ratio"]),
            DesignVariable("h", ["rod.height"]),
            DesignVariable("w", ["bow.width[0]", "bow.width[1]"]),
        ],
    ),
    "cables": ("planar_cables", [*of("rod", *ALL), "rope.length", *distribution("rope.height", 2)]),
    "spatial, all": ("one_spatial_beam", of("rod", *ALL)),
    "spatial pair": (
        "spatial_pair",
        [*distribution("crank.height", 2), "crank.length", *of("rod", *ALL)],
    ),
    "spatial mixed": (
        "spatial_mixed",
        [*of("coil", *ALL), "rod.length", DesignVariable("E", ["rod.youngs_modulus"])],
    ),
    "spatial, shared": (
        "spatial_mixed",
        [DesignVariable("nothing but coil", ["coil.height[1]", "coil.height[0]"])],
    ),
    "damped pair": (
        "damped_pair",
        [
            *of("crank", *ALL),
            *distribution("rod.height", 1),
            DesignVariable("E", ["rod.youngs_modulus"]),
        ],
    ),
    "planar machine, elements": (
        "planar_machine",
        [*of("rod", *ALL), "crank.length", "bow.length", "crank.damping_time"],
    ),
    "planar machine, parts": (
        "planar_machine",
        [
            *of("motor", "speed", "offset", "acceleration"),
            *of("slot", "direction_x", "direction_y"),
            *of("link", "length"),
            *of("shaker", "amplitude", "frequency", "phase", "offset"),
            *of("stay", "length", "ground_x", "ground_y"),
            *of("weight", "force_x", "force_y"),
            DesignVariable("load", ["snow.force_x"]),
            *of("jet", "force_x", "force_y"),
            *of("strut", "stiffness", "damping", "free_length"),
            DesignVariable("both", ["rod.damping_time[0]", "rod.damping_time[1]"]),
        ],
    ),
    "spatial machine": (
        "spatial_machine",
        [
            *of("crank", "length", "damping_time", "youngs_modulus"),
            *of("coil", "length", "height", "damping_time"),
            *of("bearing", "axis_x", "axis_y", "axis_z"),
            *of("elbow", "axis_x", "axis_z"),
            *of("motor", "amplitude", "frequency", "phase"),
            *of("slot", "direction_z", "through_x"),
            *of("jet", "force_z"),
            *of("snow", "force_y"),
            *of("strut", "stiffness", "ground_z"),
        ],
    ),
    "planar bodies": (
        "planar_bodies",
        [
            *of("arm", "mass", "inertia", "centre_x", "centre_y"),
            *of("wheel", "radius", "length", "density", "centre_y"),
            *of("load", "mass"),
            *of("link", "length"),
            *of("strut", "stiffness", "damping"),
        ],
    ),
    "planar carriers": (
        "planar_carriers",
        [
            *of("rod", "length", "height", "damping_time"),
            *of("arm", "length", "density", "youngs_modulus", "height[1]"),
            *of("bow", "length", "height[0]", "width"),
            *of("box", "length", "height", "width", "density", "centre_x"),
            *of("bead", "mass"),
            *of("knot", "mass"),
            DesignVariable("m", ["load.mass"]),
            *of("snow", "force_y"),
        ],
    ),
    "spatial carriers": (
        "spatial_carriers",
        [
            *of("rod", "length", "width"),
            *of("coil", "length", "height", "density", "poisson_ratio"),
            *of("body", "mass", "inertia_xx", "inertia_xy", "inertia_yz", "centre_z"),
            *of("ball", "radius", "density", "centre_z"),
            *of("bead", "mass"),
            *of("elbow", "axis_x"),
        ],
    ),
    "cable carriers": (
        "cable_carriers",
        [*of("rope", "length", "height"), *of("rod", "length", "width"), "box.height"],
    ),
}


CASES |= {f"{element.name}, all": (element.name, of("rod", *ALL)) for element in ALL_ELEMENTS}


class Setting:
    """A system with a random state beside its start and random design derivatives of it."""

    def __init__(self, scene, design):
        self.scene = SCENES[scene]() if isinstance(scene, str) else scene
        self.design = design
        self.system = assemble(self.scene, design)
        system, rng = self.system, np.random.default_rng(3)
        self.q = system.start()[0] + 0.05 * rng.uniform(-1, 1, system.n_q)
        self.v, self.a = rng.uniform(-1, 1, (2, system.n_q))
        self.lam = rng.uniform(-1, 1, system.n_lam)
        scale = 1.0 / np.where(system.b == 0, 1.0, system.b)
        self.q_b, self.v_b, self.a_b = rng.uniform(-1, 1, (3, system.n_q, system.n_b)) * scale
        self.t, self._moved = 0.3, {}

    def moved(self, i):
        """The system with an imaginary step in one design variable, and the step; kept."""
        if i not in self._moved:
            size = STEP * self.unit(i)
            b = self.system.b.astype(complex)
            b[i] += 1j * size
            self._moved[i] = self.system.with_values(b), size
        return self._moved[i]

    def by_design(self, value):
        """Complex step of value(system, i, size) in every design variable, as a last axis."""
        columns = []
        for i in range(self.system.n_b):
            system, size = self.moved(i)
            columns.append(np.imag(value(system, i, 1j * size)) / size)
        return np.stack(columns, axis=-1)

    def noise(self, name):
        """Round-off of accelerations and multipliers where the bodies are not strained.

        A start by rigid motions leaves forces that are round-off, and so are their derivatives:
        of Q in the norm of the weights `force_round_off`, in single numbers by the least and the
        largest weight. Factor 10 for the solve, and for coordinates that move by more than 1 m.
        """
        weights, Q = self.system.weights, 10 * self.system.traits.force_round_off
        sizes = {"a": Q / np.sqrt(np.min(weights)), "lam": Q * np.sqrt(np.max(weights))}
        return sizes.get(name, 0.0)

    def unit(self, i):
        """Size of a design variable, one where it is zero."""
        return abs(self.system.b[i]) or 1.0

    def by_coordinate(self, value, state=None):
        """Complex step of value(q), or of value of another state, as a last axis."""
        state = self.q if state is None else state
        columns = []
        for k in range(self.system.n_q):
            q = state.astype(complex)
            q[k] += 1j * STEP
            columns.append(np.imag(value(q)) / STEP)
        return np.stack(columns, axis=-1)

    def check_design(self, partial, value, magnitude, tolerance=DERIVATIVE, noise=0.0):
        """Compare column by column: design variables have units of their own.

        `magnitude` is the size of the differentiated quantity, the scale where the exact
        derivative vanishes, and `noise` that of its round-off.
        """
        system = self.system
        if not system.n_b:
            assert partial.shape[-1] == 0
            return
        expected = self.by_design(value)
        assert partial.shape == expected.shape
        for i in range(system.n_b):
            scale = max(np.max(np.abs(expected[..., i])), magnitude / self.unit(i))
            allowed = tolerance * scale + noise / self.unit(i)
            assert np.max(np.abs(partial[..., i] - expected[..., i])) <= allowed, (
                system.design_names[i]
            )


@pytest.fixture(scope="module", params=CASES)
def setting(request):
    return Setting(*CASES[request.param])


@pytest.fixture(scope="module", params=SCENES)
def plain(request):
    """Every scene once, without design variables."""
    return Setting(request.param, [])


@pytest.fixture(scope="module", params=[name for name in SCENES if name not in RIGID])
def bending(request):
    """Scenes of beams that bend."""
    return Setting(request.param, [])


@pytest.fixture(scope="module", params=[name for name in SCENES if name not in MACHINES])
def conservative(request):
    """Scenes of pins and clamps under gravity."""
    return Setting(request.param, [])


def assert_close(value, expected, tolerance):
    scale = np.max(np.abs(expected))
    assert scale > 0
    assert np.shape(value) == np.shape(expected)
    assert np.max(np.abs(value - expected)) <= tolerance * scale


# ---------------------------------------------------------------- completeness


def concrete_subclasses(base):
    found = set()
    for kind in base.__subclasses__():
        found |= concrete_subclasses(kind)
        # Only public classes of the package: other tests may define some of their own.
        public = kind.__module__.startswith("ancfdae.") and not kind.__name__.startswith("_")
        if not inspect.isabstract(kind) and public:
            found.add(kind)
    return found


def test_every_element_is_known_and_so_appears_in_the_scenes_of_this_file():
    # Joints and loads: each one alone in test_joints and test_loads.
    assert concrete_subclasses(BeamElement) == {type(element) for element in ALL_ELEMENTS}


def test_every_scene_and_every_parameter_has_a_case():
    assert {scene for scene, _ in CASES.values()} == set(SCENES)
    for dimension in (2, 3):
        driven = set()
        for scene, design in CASES.values():
            system = assemble(SCENES[scene](), design)
            if system.naming.layout.d == dimension:
                targets = [t for variable in system._design for t in variable.targets]
                beams = {beam.name for beam in system._scene.beams}
                owners = (target.split(".") for target in targets)
                driven |= {name.split("[")[0] for owner, name in owners if owner in beams}
        assert driven == set(ALL)


# ---------------------------------------------------------------- partials by complex step


def test_force_b(setting):
    s = setting
    Q = s.system.force(s.t, s.q, s.v)
    partial = force_b(s.system, s.t, s.q, s.v)
    s.check_design(partial, lambda x, i, e: x.force(s.t, s.q, s.v), np.max(np.abs(Q)))


def test_force_total(setting):
    s = setting
    total = force_total(s.system, s.t, s.q, s.v, s.q_b, s.v_b)
    rows = [np.concatenate([x[None], x_b.T]) for x, x_b in ((s.q, s.q_b), (s.v, s.v_b))]
    both = s.system.force_and_total(s.t, *rows)
    assert np.array_equal(both[1:].T, total)
    Q = s.system.force(s.t, s.q, s.v)
    # The same products in another order.
    assert np.max(np.abs(both[0] - Q)) < 1e-13 * np.max(np.abs(Q))

    def moved(x, i, e):
        return x.force(s.t, s.q + e * s.q_b[:, i], s.v + e * s.v_b[:, i])

    s.check_design(total, moved, np.max(np.abs(s.system.force(s.t, s.q, s.v))))


def test_mass_b_times(setting):
    s = setting
    partial = mass_b_times(s.system, s.q, s.a)
    magnitude = np.max(np.abs(s.system.mass_times(s.q, s.a)))
    s.check_design(partial, lambda x, i, e: x.mass_times(s.q, s.a), magnitude)


def test_force_rate_total(setting):
    s = setting
    partial = force_rate_total(s.system, s.t, s.q, s.v, s.a, s.q_b, s.v_b, s.a_b)

    def rate(x, i, e):
        q, v, a = s.q + e * s.q_b[:, i], s.v + e * s.v_b[:, i], s.a + e * s.a_b[:, i]
        return force_rate(x, s.t, q, v, a)

    s.check_design(partial, rate, np.max(np.abs(force_rate(s.system, s.t, s.q, s.v, s.a))))


def test_constraint_b(setting):
    s = setting
    partial = constraint_b(s.system, s.t, s.q)
    s.check_design(partial, lambda x, i, e: x.constraint(s.t, s.q), 1.0)  # positions of 1 m


def test_constraint_force_b(setting):
    s = setting
    partial = constraint_force_b(s.system, s.t, s.q, s.lam)
    magnitude = np.max(np.abs(constraint_force(s.system, s.t, s.q, s.lam)))
    s.check_design(partial, lambda x, i, e: constraint_force(x, s.t, s.q, s.lam), magnitude)


def test_constraint_q_times_total(setting):
    s = setting
    partial = constraint_q_times_total(s.system, s.t, s.q, s.v, s.q_b)

    def product(x, i, e):
        values = x.constraint_q(s.t, s.q + e * s.q_b[:, i])
        return x.constraint_pattern.dot(values, s.v)

    s.check_design(partial, product, 1.0)


def test_start_b(setting):
    s = setting
    for k in (0, 1):
        s.check_design(s.system.start_b()[k], lambda x, i, e, k=k: x.start()[k], 1.0)


def test_start_pull_back_is_the_contraction_of_start_b(setting):
    x = np.random.default_rng(10).uniform(-1, 1, (2, setting.system.n_q))
    q_b, v_b = setting.system.start_b()
    size = np.abs(x[0]) @ np.abs(q_b) + np.abs(x[1]) @ np.abs(v_b)
    error = setting.system.start_pull_back(*x) - (x[0] @ q_b + x[1] @ v_b)
    assert np.all(np.abs(error) <= VALUE * size)


def test_pulling_back_forms_no_column_of_coordinates_for_every_variable():
    beam = Beam("b", (0, 0), (1, 0), 200, Rectangle(0.05, 0.05), Material(4000, 1e7, 0.3))
    scene = Scene([beam], [Pin(beam.at_start)], gravity=(0, -9.81))
    system = assemble(scene, [f"b.height[{i}]" for i in range(200)])
    x, lam, t = np.ones((1, system.n_q)), np.ones((1, system.n_lam)), np.zeros(1)
    tracemalloc.start()
    system.pull_back(t, (x, x, x, lam), (x, lam))
    system.start_pull_back(x[0], x[0])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # One such array; the products of all pairs take a third of it.
    assert peak < system.n_q * system.n_b * 8 / 2, peak


def test_lengths_b(setting):
    s = setting
    if not s.scene.beams:
        assert s.system.naming.lengths_b.shape == (0, s.system.n_b)
        return
    s.check_design(s.system.naming.lengths_b, lambda x, i, e: x.naming.lengths, 1.0)


def test_design_derivatives_of_the_constraints_are_not_all_zero():
    # The checks above would accept zero for zero: pins away from the nodes move with the length.
    s = Setting("planar_pair", ["crank.length", "rod.length"])
    for partial in (
        constraint_b(s.system, s.t, s.q),
        constraint_force_b(s.system, s.t, s.q, s.lam),
        constraint_q_times_total(s.system, s.t, s.q, s.v, s.q_b),
    ):
        # The crank is held at its ends only, the rod inside of its second element.
        assert not np.any(partial[:, 0])
        assert np.any(partial[:, 1])
    q_b, v_b = s.system.start_b()
    assert np.all(np.any(q_b, axis=0))
    assert np.all(np.any(v_b, axis=0))


def test_force_is_minus_the_gradient_of_the_energies(conservative):
    s, system = conservative, conservative.system
    gradient = s.by_coordinate(
        lambda q: system.energies.strain(q[None])[0] + system.energies.gravity(q)
    )
    assert_close(system.force(s.t, s.q, s.v), -gradient, DERIVATIVE)


def test_force_q(plain):
    s, system = plain, plain.system
    expected = s.by_coordinate(lambda q: system.force(s.t, q, s.v))
    Q_q = system.pattern.dense(force_q(system, s.t, s.q, s.v))
    assert_close(Q_q, expected, DERIVATIVE)


def test_tangent_of_conservative_forces_is_symmetric(conservative):
    s, system = conservative, conservative.system
    Q_q = system.pattern.dense(force_q(system, s.t, s.q, s.v))
    assert_close(Q_q, Q_q.T, VALUE)
    assert not system.traits.velocity_forces
    assert not np.any(force_v(system, s.t, s.q, s.v))


def test_force_v(plain):
    s, system = plain, plain.system
    Q_v = system.pattern.dense(force_v(system, s.t, s.q, s.v))
    if not system.traits.velocity_forces:
        moved = system.force(s.t, s.q, s.v + 1.0)
        assert np.array_equal(moved, system.force(s.t, s.q, s.v))
        assert not np.any(Q_v)
        return
    expected = s.by_coordinate(lambda v: system.force(s.t, s.q, v), s.v)
    assert_close(Q_v, expected, DERIVATIVE)


def test_force_rate(plain):
    s, system = plain, plain.system
    moved = system.force(s.t, s.q + 1j * STEP * s.v, s.v + 1j * STEP * s.a)
    expected = moved.imag / STEP
    assert_close(force_rate(system, s.t, s.q, s.v, s.a), expected, DERIVATIVE)


def test_constraint_q_and_its_transpose(plain):
    s, system = plain, plain.system
    expected = s.by_coordinate(lambda q: system.constraint(s.t, q))
    B = system.constraint_pattern.dense(system.constraint_q(s.t, s.q))
    assert_close(B, expected, DERIVATIVE)
    assert_close(constraint_force(system, s.t, s.q, s.lam), B.T @ s.lam, VALUE)


def test_linear_constraints_have_no_curvature(conservative):
    s, system = conservative, conservative.system
    assert system.traits.linear_constraints
    values = system.constraint_q(s.t, s.q + 1j * STEP * s.v)
    assert not np.any(np.imag(values))
    for array in (
        constraint_force_q(system, s.t, s.q, s.lam),
        velocity_side(system, s.t, s.q),
        acceleration_side(system, s.t, s.q, s.v),
        jerk_side(system, s.t, s.q, s.v, s.a),
        constraint_force_rate(system, s.t, s.q, s.v, s.lam),
    ):
        assert not np.any(array)


def test_curvature_of_constraints(plain):
    s, system = plain, plain.system
    values = system.pattern.dense(constraint_force_q(system, s.t, s.q, s.lam))
    if system.traits.linear_constraints:
        assert not np.any(values)
        return
    expected = s.by_coordinate(lambda q: constraint_force(system, s.t, q, s.lam))
    assert_close(values, expected, DERIVATIVE)


def test_constraint_q_rate(plain):
    s, system = plain, plain.system
    dense, dot = system.constraint_pattern.dense, system.constraint_pattern.dot
    rate = dense(system.constraint_q(s.t, s.q, s.v))
    if system.traits.linear_constraints:
        assert not np.any(rate)
        return
    # Along the motion, prescribed motions included, and as the partial of dPhi/dt in q.
    moved = real_derivative(lambda e: system.constraint_q(s.t + e, s.q + e * s.v))
    assert_close(rate, dense(moved), DIFFERENCES)
    expected = s.by_coordinate(
        lambda q: dot(system.constraint_q(s.t, q), s.v) - velocity_side(system, s.t, q)
    )
    assert_close(rate, expected, DERIVATIVE)


def test_constraint_q_second_rate(plain):
    s, system = plain, plain.system
    dense, dot = system.constraint_pattern.dense, system.constraint_pattern.dot
    rate = dense(system.constraint_q(s.t, s.q, s.v, s.a))
    if system.traits.linear_constraints:
        assert not np.any(rate)
        return
    moved = real_derivative(
        lambda e: system.constraint_q(s.t + e, s.q + e * (s.v + e / 2 * s.a), s.v + e * s.a)
    )
    assert_close(rate, dense(moved), DIFFERENCES)
    expected = s.by_coordinate(
        lambda q: dot(system.constraint_q(s.t, q), s.a) - acceleration_side(system, s.t, q, s.v)
    )
    assert_close(rate, expected, DERIVATIVE)


def instants(s, k=3):
    """States of k instants as rows, and their times."""
    rng = np.random.default_rng(8)
    q = s.q + 0.05 * rng.uniform(-1, 1, (k, s.system.n_q))
    v, a = rng.uniform(-1, 1, (2, k, s.system.n_q))
    return s.t + 0.1 * np.arange(k), (q, v, a, rng.uniform(-1, 1, (k, s.system.n_lam)))


def test_linearise_is_the_loop_over_instants(plain):
    s, system = plain, plain.system
    t, states = instants(s)
    ours, loop = system.linearise(t, *states), MechanicalSystem.linearise(system, t, *states)
    assert_close(ours.M, loop.M, VALUE)
    assert_close(ours.f_q, loop.f_q, VALUE)
    assert_close(ours.Phi_q, loop.Phi_q, VALUE)
    assert (ours.f_v is None) == (not system.traits.velocity_forces)
    if system.traits.velocity_forces:
        assert_close(ours.f_v, loop.f_v, VALUE)


def test_design_partials_are_the_loop_over_instants(setting):
    s, system = setting, setting.system
    t, states = instants(s)
    ours = system.design_partials(t, *states)
    loop = MechanicalSystem.design_partials(system, t, *states)
    for name in ("f_b", "Phi_b"):
        value, expected = getattr(ours, name), getattr(loop, name)
        assert value.shape == expected.shape
        for i in range(system.n_b):
            scale = np.max(np.abs(expected[..., i]))
            assert np.max(np.abs(value[..., i] - expected[..., i])) <= VALUE * scale


def test_pull_back_is_the_contraction_of_the_design_partials(setting):
    s, system = setting, setting.system
    t, states = instants(s)
    rng = np.random.default_rng(9)
    covectors = tuple(rng.uniform(-1, 1, (len(t), n)) for n in (system.n_q, system.n_lam))
    ours = system.pull_back(t, states, covectors)
    partials = system.design_partials(t, *states)
    terms = [
        partial * covector[..., None]
        for partial, covector in zip((partials.f_b, partials.Phi_b), covectors, strict=True)
    ]
    expected = sum(np.sum(term, axis=(0, 1)) for term in terms)
    # Each sum against the sum of its magnitudes.
    size = sum(np.sum(np.abs(term), axis=(0, 1)) for term in terms)
    assert ours.shape == expected.shape == (system.n_b,)
    assert np.all(np.abs(ours - expected) <= VALUE * size)


def test_arrays_of_the_protocol_have_their_shapes(setting):
    s, x = setting, setting.system
    n_q, n_lam, n_b = x.n_q, x.n_lam, x.n_b
    lam_b = np.zeros((n_lam, n_b))
    for array, shape in (
        (velocity_side_total(x, s.t, s.q, s.q_b), (n_lam, n_b)),
        (acceleration_side_total(x, s.t, s.q, s.v, s.q_b, s.v_b), (n_lam, n_b)),
        (jerk_side_total(x, s.t, s.q, s.v, s.a, s.q_b, s.v_b, s.a_b), (n_lam, n_b)),
        (constraint_force_rate_total(x, s.t, s.q, s.v, s.lam, s.q_b, s.v_b, lam_b), (n_q, n_b)),
        (constraint_q_times_total(x, s.t, s.q, s.v, s.q_b), (n_lam, n_b)),
        (force_v(x, s.t, s.q, s.v), (x.pattern.size,)),
        (x.mass(s.q), (x.pattern.size,)),
        (x.weights, (n_q,)),
        (velocity_side(x, s.t, s.q), (n_lam,)),
    ):
        assert array.shape == shape
    assert len(x.constraint_names) == n_lam
    assert len(x.design_names) == n_b
    assert np.all(x.weights > 0)


# ---------------------------------------------------------------- values by hand


def plain_elements(scene):
    """(rows of q, parameters, reference node vectors, oracle rule) of every element."""
    n_s = scene.beams[0].element.n_s
    size, node = n_s * scene.dimension, 0
    for beam in scene.beams:
        shape, parameters = beam.reference(), beam.element_parameters()
        positions = [np.asarray(beam.place, float)]
        for length, chord in zip(shape.lengths, shape.chords, strict=True):
            positions.append(positions[-1] + length * chord)
        rule = {} if shape.straight else {"n_xi": 12, "n_y": 6, "n_z": 6}
        for k in range(beam.element_count):
            slopes = shape.slopes[:, : n_s - 1]
            X_o = [positions[k], *slopes[k], positions[k + 1], *slopes[k + 1]]
            rows = np.arange((node + k) * size, (node + k + 2) * size)
            yield rows, dict(zip(ALL_COLUMNS, parameters[k], strict=False)), np.array(X_o), rule
        node += beam.element_count + 1


def oracle_of(element):
    """The oracle of an element."""
    return plain_cable if element is CABLE_2D else ancf


ALL_COLUMNS = ("E", "nu", "rho", "l", "tau", "h", "w")


def test_force_is_the_sum_of_oracle_elements(conservative):
    s, d = conservative, conservative.scene.dimension
    # The oracle has the energy of the source paper.
    beams = [replace(beam, energy=beam.energy and SaintVenantKirchhoff()) for beam in s.scene.beams]
    paper = assemble(replace(s.scene, beams=beams))
    expected = np.zeros(s.system.n_q)
    g, oracle = s.scene.gravity, oracle_of(s.scene.beams[0].element)
    for rows, p, X_o, rule in plain_elements(s.scene):
        section = (p["h"], p["w"], p["l"], X_o)
        X = s.q[rows].reshape(-1, d)
        expected[rows] -= oracle.force(X, p["E"], p["nu"], *section, **rule).ravel()
        if g is not None:
            expected[rows] += oracle.gravity_force(g, p["rho"], *section, **rule).ravel()
    assert_close(paper.force(s.t, s.q, s.v), expected, VALUE)


def test_mass_is_the_sum_of_oracle_elements_and_its_total_the_mass_of_the_scene(bending):
    s, d = bending, bending.scene.dimension
    expected, volumes, oracle = (
        np.zeros((s.system.n_q, s.system.n_q)),
        0.0,
        oracle_of(s.scene.beams[0].element),
    )
    for rows, p, X_o, rule in plain_elements(s.scene):
        section = (p["h"], p["w"], p["l"], X_o)
        expected[np.ix_(rows, rows)] += oracle.mass(d, p["rho"], *section, **rule)
        dV = [dV for *_, dV in oracle.quadrature_points(d, *section, **rule)]
        volumes += p["rho"] * np.sum(dV)
    M = s.system.pattern.dense(s.system.mass(s.q))
    assert_close(M, expected, VALUE)
    assert_close(s.system.mass_times(s.q, s.a), M @ s.a, VALUE)
    assert_close(s.system.energies.kinetic(s.v[None]), np.array([0.5 * s.v @ M @ s.v]), VALUE)
    translation = np.zeros((s.system.n_q // d, d))
    translation[:: s.system.naming.layout.bodies[0].stride, 0] = 1.0
    total = translation.ravel() @ s.system.mass_times(s.q, translation.ravel())
    assert_close(total, volumes, VALUE)
    if all(beam.reference().straight for beam in s.scene.beams):
        blocks = s.scene.element_parameters()
        P = ElementParameter
        which = [P.DENSITY, P.SIZE_1, P.SIZE_2, P.LENGTH]
        assert_close(total, np.sum(np.prod(blocks[:, which], axis=1)), VALUE)


def vector_by_hand(system, q, point, quantity):
    """Position (0) or slope (1, 2, 3) of a point by the oracle's shape functions."""
    d = system.naming.layout.d
    place = system.naming.layout.beam(point.beam)
    fractions = np.array(place.fractions)
    k = max(int(np.sum(fractions < point.fraction)) - 1, 0)
    xi = (point.fraction - fractions[k]) / (fractions[k + 1] - fractions[k])
    l = system.naming.lengths[place.first_element + k]
    oracle = oracle_of(system.naming.layout.beams[0].element)
    size = system.naming.layout.bodies[0].stride * d
    first = system.naming.layout.body(point.beam).first_vector * d + k * size
    X = q[first : first + 2 * size].reshape(-1, d)
    if quantity == 0:
        return oracle.shape(d, xi, point.y, point.z, l) @ X
    return oracle.shape_gradient(d, xi, point.y, point.z, l)[:, quantity - 1] @ X


def turns_by_hand(system, q, q_o, point):
    """Turns of a section from the reference: two tilts and those of its two axes, or one turn."""
    n_s, d = system.naming.layout.bodies[0].stride, system.naming.layout.d
    spanning = range(2, n_s) if n_s > 2 else [1]
    now, then = (
        np.array([vector_by_hand(system, x, point, k) for k in spanning]).T for x in (q, q_o)
    )
    y = then[:, 0] / np.linalg.norm(then[:, 0])
    if d == 2:
        return np.array([now[1, 0] * y[0] - now[0, 0] * y[1]])
    normal = np.cross(*then.T) / np.linalg.norm(np.cross(*then.T))
    map_of_section, z = now @ np.linalg.pinv(then), np.cross(normal, y)
    return np.array([*(normal @ now), z @ map_of_section @ y, y @ map_of_section @ z])


def test_constraints_are_those_of_vectors_by_hand(conservative):
    s, system, expected = conservative, conservative.system, []
    q_o = system._reference.q
    for joint in s.scene.joints:
        here = vector_by_hand(system, s.q, joint.points[0], 0)
        if isinstance(joint, PointOnLine):
            along = np.array(joint.direction) / np.linalg.norm(joint.direction)
            across = np.array([-along[1], along[0]])
            expected.append([across @ (here - joint.through)])
            continue
        if len(joint.points) == 2:
            there = vector_by_hand(system, s.q, joint.points[1], 0)
        elif isinstance(joint, Pin) and joint.ground is not None:
            there = np.array(joint.ground)
        else:
            there = vector_by_hand(system, q_o, joint.points[0], 0)
        expected.append(here - there)
        if isinstance(joint, Clamp):
            expected.append(turns_by_hand(system, s.q, q_o, joint.point))
    # Differences of positions of 1 m that differ by 0.05 m: 20 times the round-off of a sum of
    # eight products.
    assert_close(system.constraint(s.t, s.q), np.concatenate(expected), VALUE)


def test_pin_holds_to_the_given_ground():
    beam = Beam("rod", (0.0, 0.0), (1.0, 0.0), 2, FLAT, STEEL)
    system = assemble(Scene([beam], [Pin(beam.at_end, ground=(0.7, 0.2))]))
    # (1, 0) - (0.7, 0.2), one rounding.
    assert system.constraint(0.0, system._reference.q) == pytest.approx([0.3, -0.2], rel=1e-15)


def test_rigid_motion_turns_positions_and_slopes():
    for name in ("planar_pair", "spatial_pair"):
        # As declared: assembled, others would have to move too.
        scene = replace(SCENES[name](), joints=())
        system, (motion,), d = assemble(scene), scene.start, scene.dimension
        omega = np.zeros(3)
        omega[-1 if d == 2 else slice(None)] = motion.angular_velocity
        expected = np.zeros(system.n_q).reshape(-1, d + 1, d)
        place = system.naming.layout.body(motion.body)
        first, count = place.first_vector // place.stride, place.count // place.stride
        nodes = slice(first, first + count)
        arms = system.start()[0].reshape(-1, d + 1, d)[nodes].copy()
        arms[:, 0] -= motion.about
        space = np.zeros((*arms.shape[:-1], 3))
        space[..., :d] = arms
        expected[nodes] = np.cross(omega, space)[..., :d]
        expected[nodes, 0] += motion.velocity
        assert_close(system.start()[1], expected.ravel(), 1e-15)  # two products and a sum


# ---------------------------------------------------------------- consistent start


def test_start_sensitivity_is_the_complex_step_of_the_consistent_start(setting):
    s = setting
    matrices = saddle_point(s.system, 0.0)
    state = consistent_start(s.system, matrices, 0.0)
    partials = start_sensitivity(s.system, matrices, state)
    moved_states = {}

    def start_of(x, i):
        if i not in moved_states:
            moved_states[i] = consistent_start(x, saddle_point(x, 0.0), 0.0)
        return moved_states[i]

    for name in ("q", "v", "a", "lam"):
        values = getattr(state, name)

        def moved(x, i, e, name=name):
            return getattr(start_of(x, i), name)

        # Solves with a scaled matrix whose condition is below 1e4 come on top of DERIVATIVE.
        size, noise = np.max(np.abs(values)), s.noise(name)
        s.check_design(getattr(partials, f"{name}_b"), moved, size, 1e-9, noise)


def test_start_of_the_recurrence_is_differentiated_exactly(setting):
    s, c = setting, Coefficients(0.01, -0.3)

    def start(x):
        return RecurrenceStart.of(Problem.of(x, 1.0), c)

    first, moved_nodes = start(s.system), {}
    matrices = saddle_point(s.system, 0.0)
    partials = first.sensitivity(start_sensitivity(s.system, matrices, first.initial))
    for name in ("v", "a"):

        def moved(x, i, e, name=name):
            if i not in moved_nodes:
                moved_nodes[i] = start(x).node
            return getattr(moved_nodes[i], name)

        size = np.max(np.abs(getattr(first.node, name)))
        # Damping 1e7 times the mass stands in the matrix of the third derivative: 1e7 eps, and ten
        # times as much for the products.
        s.check_design(getattr(partials, f"{name}_b"), moved, size, 2e-8, s.noise(name))


def test_cases_contain_projected_starts():
    # Otherwise the terms of the projection would not be seen above.
    for name in ("planar_pair", "spatial_pair"):
        system = assemble(SCENES[name]())
        q, v = system.start()
        state = consistent_start(system, saddle_point(system, 0.0), 0.0)
        assert np.max(np.abs(state.q - q)) > 1e-3
        assert np.max(np.abs(state.v - v)) > 1e-3


# ---------------------------------------------------------------- design values


def scaled_values(system, factor):
    values = {}
    for variable, value in zip(system._design, system.b, strict=True):
        values |= {target: float(value) * factor for target in variable.targets}
    return values


def test_system_with_values_is_the_scene_with_values(setting):
    s, factor = setting, 1.01
    moved = s.system.with_values(s.system.b * factor)
    scene = s.scene.with_values(scaled_values(s.system, factor))
    other = assemble(scene, s.design)
    # Lengths go through coordinates and back, or through a factor: a few eps; a force of this
    # state changes by 10 times its relative error (strain of 0.1).
    if s.scene.beams:
        assert_close(moved.naming.lengths, other.naming.lengths, VALUE)
    assert_close(moved.start()[0], other.start()[0], VALUE)
    assert_close(moved.force(s.t, s.q, s.v), other.force(s.t, s.q, s.v), 10 * VALUE)
    assert_close(moved.mass_times(s.q, s.a), other.mass_times(s.q, s.a), VALUE)
    assert_close(moved.constraint(s.t, s.q), other.constraint(s.t, s.q), 10 * VALUE)
    if s.system.n_b:
        assert_close(other.b, s.system.b * factor, VALUE)
        change = moved.force(s.t, s.q, s.v) - s.system.force(s.t, s.q, s.v)
        assert np.max(np.abs(change)) > 0


def test_naming_design_variables_changes_nothing(setting):
    s = setting
    plain = assemble(s.scene)
    # Values are written through shares of a length: a rounding of the length or two.
    if s.scene.beams:
        assert_close(s.system.naming.lengths, plain.naming.lengths, VALUE)
    assert_close(s.system.force(s.t, s.q, s.v), plain.force(s.t, s.q, s.v), 10 * VALUE)
    assert_close(s.system.mass_times(s.q, s.a), plain.mass_times(s.q, s.a), VALUE)
    assert_close(s.system.start()[0], plain.start()[0], VALUE)


def test_with_values_of_the_same_values_is_the_same_system(setting):
    s = setting
    same = s.system.with_values(s.system.b)
    assert np.array_equal(same.force(s.t, s.q, s.v), s.system.force(s.t, s.q, s.v))
    assert np.array_equal(same.mass(s.q), s.system.mass(s.q))
    assert np.array_equal(same.constraint(s.t, s.q), s.system.constraint(s.t, s.q))


def test_wrong_number_of_design_values_is_refused():
    system = assemble(one_planar_beam(), ["rod.height"])
    for b in (np.zeros(0), np.ones(2), np.ones((1, 1))):
        with pytest.raises(InvalidInput, match="design values"):
            system.with_values(b)


def test_equal_elements_share_their_invariants_and_a_single_changed_one_does_not():
    shared = assemble(one_planar_beam(), distribution("rod.height", 2))
    assert len(shared._elastic._block.A) == 1
    assert len(shared.with_values(shared.b * [1.0, 1.1])._elastic._block.A) == 2
    # The imaginary part of a complex step makes an element different, too.
    assert len(shared.with_values(shared.b + np.array([0.0, 1e-40j]))._elastic._block.A) == 2


# ---------------------------------------------------------------- patterns


@pytest.mark.parametrize("shape", [(4, 7), (250, 250)], ids=["dense", "sparse"])
def test_pattern_products_are_those_of_the_dense_matrix(shape):
    rng = np.random.default_rng(1)
    rows, columns = rng.integers(0, shape[0], 60), rng.integers(0, shape[1], 60)
    pattern = Pattern(shape, rows, columns)
    raw = rng.uniform(-1, 1, 60) + 1j * rng.uniform(-1, 1, 60)
    expected = np.zeros(shape, dtype=complex)
    np.add.at(expected, (rows, columns), raw)
    values = pattern.gather(rows, columns, raw)
    # Sums of at most 60 products of size one.
    tolerance = 60 * np.finfo(float).eps
    assert_close(pattern.dense(values), expected, tolerance)
    assert_close(pattern.csr(values).toarray(), expected, tolerance)
    for x, y in (
        (rng.uniform(-1, 1, shape[1]), rng.uniform(-1, 1, shape[0])),
        (rng.uniform(-1, 1, (shape[1], 3)), rng.uniform(-1, 1, (shape[0], 3))),
    ):
        assert_close(pattern.dot(values, x), expected @ x, tolerance)
        assert_close(pattern.dot_transposed(values, y), expected.T @ y, tolerance)


# ---------------------------------------------------------------- linear solvers


STORAGES = {
    "band": (10**9, linear_solvers._BandStorage),
    "sparse": (0, linear_solvers._SparseStorage),
}


class Chain:
    """Two pinned chains of beams, a matrix on their pattern and the same matrix densely."""

    def __init__(self, kind, monkeypatch):
        half_width, storage = STORAGES[kind]
        monkeypatch.setattr(linear_solvers, "_BAND_HALF_WIDTH", half_width)
        self.system = chain_system()
        system = self.system
        self.B = system.constraint_q(0.0, system.start()[0])
        self.solver = SaddlePoint(system.pattern, system.constraint_pattern, system.weights, self.B)
        assert isinstance(self.solver._storage, storage)

    def values(self, is_complex):
        """M plus an unsymmetric perturbation of a tenth of its diagonal."""
        rng, pattern = np.random.default_rng(2), self.system.pattern
        weights = np.sqrt(self.system.weights)
        noise = rng.uniform(-1, 1, pattern.size) * weights[pattern.rows] * weights[pattern.columns]
        K = self.system.mass(None) + 0.003 * noise
        return K * (1 + 0.1j * rng.uniform(-1, 1, pattern.size)) if is_complex else K

    def matrix(self, K):
        n, m = self.system.n_q, self.system.n_lam
        A = np.zeros((n + m, n + m), dtype=K.dtype)
        A[:n, :n] = self.system.pattern.dense(K)
        A[n:, :n] = self.system.constraint_pattern.dense(self.B)
        A[:n, n:] = A[n:, :n].T
        return A


def chain_system():
    crank = Beam("crank", (0.0, 0.0), (1.0, 0.0), 9, FLAT, STEEL)
    rod = Beam("rod", (1.0, 0.0), (2.0, 0.5), 21, THICK, RUBBER)
    joints = [Pin(crank.at_start), Pin(crank.at_end, rod.at_start, name="p"), Pin(rod.at_end)]
    return assemble(Scene([crank, rod], joints))


@pytest.mark.parametrize("kind", STORAGES)
@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
@pytest.mark.parametrize("right", ["vector", "columns", "complex vector", "complex columns"])
def test_every_storage_solves_with_the_matrix_and_its_transpose(
    kind, is_complex, right, monkeypatch
):
    chain = Chain(kind, monkeypatch)
    K = chain.values(is_complex)
    A, factors = chain.matrix(K), chain.solver.factor(K, chain.B)
    rng = np.random.default_rng(4)
    shape = (len(A), 4) if right.endswith("columns") else (len(A),)
    b = rng.uniform(-1, 1, shape)
    if right.startswith("complex"):
        b = b + 1j * rng.uniform(-1, 1, shape)
    kept = b.copy()
    scale = chain.solver.scale
    S = scale[:, None] * A * scale
    # Error of a solution of the scaled system: condition times eps times growth, which for
    # partial pivoting is a small power of N in practice: 100.
    tolerance = 100 * np.linalg.cond(S) * np.finfo(float).eps
    assert tolerance < 1e-6  # otherwise the matrix would be too bad to show anything
    assert np.max(np.abs(A - A.T)) > 0.001 * np.max(np.abs(A))  # so that the transpose counts
    for matrix, x in ((A, factors.solve(b)), (A.T, factors.solve_transposed(b))):
        expected = np.linalg.solve(matrix, b)
        assert x.shape == b.shape
        unscaled = scale if b.ndim == 1 else scale[:, None]
        assert_close(x / unscaled, expected / unscaled, tolerance)
        assert (x.dtype.kind == "c") == (expected.dtype.kind == "c")
    assert np.array_equal(b, kept)  # right-hand sides are left alone


@pytest.mark.parametrize("kind", STORAGES)
def test_imaginary_part_of_a_complex_step_survives_the_factorisation(kind, monkeypatch):
    # (K + i eps N)^{-1} b has the imaginary part -eps K^{-1} N K^{-1} b.
    chain = Chain(kind, monkeypatch)
    K, rng = chain.values(False), np.random.default_rng(5)
    N = rng.uniform(-1, 1, chain.system.pattern.size)
    b = rng.uniform(-1, 1, chain.solver.size)
    real = chain.solver.factor(K, chain.B)
    x = real.solve(b)
    n = chain.system.n_q
    change = np.zeros_like(x)
    change[:n] = chain.system.pattern.dot(N, x[:n])
    expected = -real.solve(change)
    stepped = chain.solver.factor(K + 1j * STEP * N, chain.B).solve(b)
    A = chain.matrix(K)
    scale = chain.solver.scale
    tolerance = 100 * np.linalg.cond(scale[:, None] * A * scale) * np.finfo(float).eps
    assert_close(stepped.imag / STEP / scale, expected / scale, tolerance)


@pytest.mark.parametrize("kind", STORAGES)
def test_no_right_hand_side_gives_no_solution(kind, monkeypatch):
    chain = Chain(kind, monkeypatch)
    factors = chain.solver.factor(chain.values(False), chain.B)
    empty = np.zeros((chain.solver.size, 0))
    assert factors.solve(empty).shape == factors.solve_transposed(empty).shape == empty.shape


@pytest.mark.parametrize("kind", STORAGES)
@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
def test_singular_matrix_is_refused(kind, is_complex, monkeypatch):
    chain = Chain(kind, monkeypatch)
    K = chain.values(is_complex)
    with pytest.raises(SingularMatrix):
        chain.solver.factor(K, 0 * chain.B)  # a row of zeros
    with pytest.raises(SingularMatrix):
        chain.solver.factor(0 * K, chain.B)  # more coordinates than constraints
    spoiled = K.copy()
    spoiled[7] = np.nan
    with pytest.raises(SingularMatrix, match="not finite"):
        chain.solver.factor(spoiled, chain.B)


class SymmetricChain(Chain):
    """The same chains with a symmetric matrix, positive definite unless it is shifted."""

    def __init__(self):
        self.system = system = chain_system()
        self.B = system.constraint_q(0.0, system.start()[0])
        patterns = system.pattern, system.constraint_pattern
        self.solver = SaddlePoint(*patterns, system.weights, self.B, symmetric=True)

    def values(self, is_complex, shift=0.0):
        system, rng = self.system, np.random.default_rng(8)
        q = rng.uniform(-1, 1, system.n_q) * 0.01 + system.start()[0]
        K = system.mass(None) * (1 - shift) - 1e-8 * force_q(system, 0.0, q, q)
        return K * (1 + 0.1j * rng.uniform(-1, 1)) if is_complex else K


@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
@pytest.mark.parametrize("right", ["vector", "columns", "complex vector", "complex columns"])
@pytest.mark.parametrize("shift", [0.0, 1.5], ids=["definite", "indefinite"])
def test_symmetric_matrices(is_complex, right, shift):
    chain = SymmetricChain()
    K = chain.values(is_complex, shift)
    A, factors = chain.matrix(K), chain.solver.factor(K, chain.B)
    assert np.max(np.abs(A - A.T)) < 1e-14 * np.max(np.abs(A))
    symmetric = isinstance(factors, linear_solvers._SymmetricFactorization)
    assert symmetric == (shift == 0)  # a pivot of an indefinite matrix has not its sign
    rng, scale = np.random.default_rng(4), chain.solver.scale
    for columns in (1, 2, 4, 5, 8, 13) if right.endswith("columns") else ((),):
        b = rng.uniform(-1, 1, (len(A), columns) if columns else (len(A),))
        if right.startswith("complex"):
            b = b + 1j * rng.uniform(-1, 1, b.shape)
        tolerance = 100 * np.linalg.cond(scale[:, None] * A * scale) * np.finfo(float).eps
        assert tolerance < 1e-6
        unscaled = scale if b.ndim == 1 else scale[:, None]
        expected = np.linalg.solve(A, b) / unscaled
        for x in (factors.solve(b), factors.solve_transposed(b)):
            assert_close(x / unscaled, expected, tolerance)


def test_singular_symmetric_matrices_are_refused():
    chain = SymmetricChain()
    K = chain.values(False)
    for values, B in ((K, 0 * chain.B), (0 * K, chain.B), (np.nan * K, chain.B)):
        with pytest.raises(SingularMatrix):
            chain.solver.factor(values, B)


def test_chains_are_bands():
    system = chain_system()
    values = system.constraint_q(0.0, system.start()[0])
    arguments = (system.pattern, system.constraint_pattern, system.weights, values)
    # A narrow band of two nodes and the multipliers between them.
    storage = SaddlePoint(*arguments)._storage
    assert isinstance(storage, linear_solvers._BandStorage)
    assert storage._half_width <= 20
