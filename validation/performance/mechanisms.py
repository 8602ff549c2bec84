"""A step of small mechanisms: rigid bodies, a flexible connecting rod, chains."""

from functools import partial
from itertools import pairwise

from ancfdae import (
    CABLE_2D,
    HHT,
    Beam,
    Material,
    Pin,
    PointMass,
    PointOnLine,
    Revolute,
    RigidBody,
    RotationDriver,
    Scene,
    assemble,
    simulate,
)
from ancfdae.equations import MechanicalSystem
from ancfdae.laws import ConstantAcceleration
from ancfdae.numerics.timing import medians
from ancfdae.sections import Rectangle
from validation.performance.row import Row
from validation.performance.unit import banded_lu

_STEP, _NEWTON, _GRAVITY = 2.0**-10, 1e-8, 9.81
_AXIS, _BOX = (0.0, 0.0, 1.0), (0.01, 0.1, 0.1)


def chain(count: int) -> Scene:
    """Return a chain of spatial rigid bodies of 0.5 m on revolute joints, from rest."""
    bodies = [
        RigidBody(f"b{k}", (0.5 * k, 0.0, 0.0), 1.0, _BOX, centre=(0.25, 0.0, 0.0))
        for k in range(count)
    ]
    joints = [Revolute(bodies[0].at(0, 0, 0), _AXIS)]
    joints += [
        Revolute(left.at(0.5, 0, 0), _AXIS, right.at(0, 0, 0)) for left, right in pairwise(bodies)
    ]
    return Scene([], joints, (0, -_GRAVITY, 0), bodies=bodies)


def rigid_slider_crank() -> Scene:
    """Return a planar crank, a connecting rod and a slider under gravity."""
    crank = RigidBody("crank", (0, 0), 1.0, 0.01, centre=(0.1, 0))
    rod = RigidBody("rod", (0.2, 0), 2.0, 0.05, centre=(0.25, 0))
    joints = [
        Pin(crank.at(0, 0)),
        Pin(crank.at(0.2, 0), rod.at(0, 0)),
        PointOnLine(rod.at(0.5, 0), direction=(1, 0)),
    ]
    slider = PointMass(rod.at(0.5, 0), 0.5, name="slider")
    return Scene([], joints, (0, -_GRAVITY), bodies=[crank, rod, slider])


def flexible_slider_crank(cables: int) -> Scene:
    """Return a driven rigid crank with a connecting rod of cables."""
    steel = Material(7850, 2.1e11, 0.3)
    section = Rectangle(0.01, 0.01)
    crank = Beam("crank", (0, 0), (0.15, 0), 1, section, steel, rigid=True, element=CABLE_2D)
    rod = Beam("rod", (0.15, 0), (0.55, 0), cables, section, steel, element=CABLE_2D)
    joints = [
        Pin(crank.at_start),
        RotationDriver(crank.at_start, ConstantAcceleration(speed=10.0)),
        Pin(crank.at_end, rod.at_start),
        PointOnLine(rod.at_end, direction=(1, 0)),
    ]
    slider = PointMass(rod.at_end, 0.1, name="slider")
    return Scene([crank, rod], joints, bodies=[slider], project_start=True)


def measure(steps: int = 2048, repeats: int = 5) -> list[Row]:
    """Return the time of a step; the start, measured by a run of one step, is taken off."""
    scenes = (
        ("one rigid body on a revolute joint", chain(1), 0.4),
        ("the rigid slider-crank", rigid_slider_crank(), 0.5),
        ("the slider-crank with 4 cables", flexible_slider_crank(4), 1.0),
        ("a chain of 20 bodies, revolute", chain(20), 6.0),
    )
    rows = []
    for name, scene, most in scenes:
        system, unit = assemble(scene), banded_lu(repeats)
        short, long = medians([partial(_run, system, k) for k in (1, 1 + steps)], repeats)
        step = (long - short) / steps
        rows.append(Row(f"step of {name}", 1e6 * step, "us"))
        rows.append(Row(f"step of {name}, in banded LUs", step / unit, "-", f"at most {most:g}"))
    return rows


def _run(system: MechanicalSystem, steps: int) -> object:
    return simulate(system, steps * _STEP, HHT(_STEP, newton_tolerance=_NEWTON))
