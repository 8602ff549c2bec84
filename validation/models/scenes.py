"""The scenes of the report, each with a position, an energy or torque, and a stress."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, final

import numpy as np

from ancfdae import (
    BEAM_3D,
    AtTimes,
    Beam,
    Clamp,
    Integral,
    Material,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Revolute,
    RotationDriver,
    Scene,
    Weld,
)
from ancfdae.extend import Load, MaterialPoint, Objective
from ancfdae.laws import SmoothStep, Spline, UserLaw
from ancfdae.observables import driver_torque, kinetic_energy, position, strain_energy, von_mises
from ancfdae.sections import Rectangle
from validation.design.coupler_path import hoeken
from validation.design.two_link_arm import arm, torques
from validation.design.whirling_beam import blade, spin_up

_DAMPED: Final = Material(2700.0, 7e10, 0.33, damping_time=3e-4)
# Stresses in units of this, so that no number is huge; Pa.
_MEGA: Final = 1e6


@final
@dataclass(frozen=True)
class Case:
    """A scene, what is asked of it, and models beside those that the call makes."""

    key: str
    title: str
    scene: Scene
    t_end: float
    design: tuple[str, ...]
    objectives: Mapping[str, Objective]
    alternatives: Mapping[str, Scene] = field(default_factory=dict)


def _stress(beam: str, fraction: float, y: float) -> Objective:
    return Integral((von_mises(MaterialPoint(beam, fraction, y)) / _MEGA) ** 2)


def slider_crank(speed: float, key: str) -> Case:
    """Return two turns of a slider-crank from rest to rest, up to their middle; mean rad/s."""
    crank = Beam("crank", (0, 0), (0.15, 0), 2, Rectangle(0.02, 0.02), _DAMPED)
    rod = Beam("rod", (0.15, 0), (0.6, 0), 4, Rectangle(0.01, 0.02), _DAMPED)
    turn = 2 * np.pi / speed
    joints = [
        Pin(crank.at_start, name="bearing"),
        Pin(crank.at_end, rod.at_start, name="elbow"),
        PointOnLine(rod.at_end, (1, 0), name="slide"),
        RotationDriver(crank.at_start, SmoothStep(0.0, 4 * np.pi, 2 * turn), name="motor"),
    ]
    scene = Scene([crank, rod], joints, (0, -9.81), bodies=[PointMass(rod.at_end, 0.2)])
    design = ("rod.height", "rod.youngs_modulus", "crank.height")
    asked: dict[str, Objective] = {
        "position of the slider": Integral((position(rod.at_end, 0) - 0.45) ** 2),
        "torque of the motor": Integral(driver_torque("motor") ** 2),
        "stress in the rod": _stress("rod", 0.5, 0.005),
    }
    return Case(key, f"Slider-crank at {speed:g} rad/s", scene, turn, design, asked)


def four_bar() -> Case:
    """Return Hoeken's linkage of the report `design`; its crank and rocker are rigid."""
    design = ("coupler.height", "coupler.youngs_modulus", "coupler.density")
    asked: dict[str, Objective] = {
        "position of the coupler point": Integral(position(MaterialPoint("coupler", 1.0), 1) ** 2),
        "torque of the motor": Integral(driver_torque("motor") ** 2),
        "stress in the coupler": _stress("coupler", 0.5, 0.004),
    }
    return Case(
        "four-bar", "Four-bar with a flexible coupler", hoeken(4), np.pi / 20, design, asked
    )


def driven_arm() -> Case:
    """Return the two-link arm of the report `design`, led on a given path."""
    design = ("upper.height", "lower.height", "lower.youngs_modulus")
    asked: dict[str, Objective] = {
        "position of the tip": AtTimes(position(MaterialPoint("lower", 1.0), 1), 0.3),
        "torque of the shoulder": Integral(driver_torque("shoulder") ** 2),
        "stress in the lower link": _stress("lower", 0.0, 0.01),
    }
    return Case(
        "two-link-arm", "Two-link arm on a given path", arm(4, driven=True), 0.5, design, asked
    )


def free_arm() -> Case:
    """Return the same arm moved by the torques that led it, as the report `design` starts."""
    values = torques(4, 0.00625).reshape(2, 3)
    scene = arm(4)
    laws = [Spline((0.0, 0.125, 0.25, 0.375, 0.5), [0.0, *row.tolist(), 0.0]) for row in values]
    loads: list[Load] = [
        replace(load, law=law) for load, law in zip(scene.loads, laws, strict=True)
    ]
    design = ("upper.height", "lower.height", "lower.youngs_modulus")
    asked: dict[str, Objective] = {
        "position of the tip": AtTimes(position(MaterialPoint("lower", 1.0), 1), 0.3),
        "kinetic energy": Integral(kinetic_energy()),
        "stress in the lower link": _stress("lower", 0.0, 0.01),
    }
    return Case(
        "design-arm",
        "Arm of the report `design`, moved by torques",
        replace(scene, loads=loads),
        0.5,
        design,
        asked,
    )


def pendulum() -> Case:
    """Return the pendulum of the paper, damped."""
    material = Material(4000.0, 1e7, 0.3, damping_time=5e-3)
    beam = Beam("pendulum", (0, 0), (1.2, 0), 4, Rectangle(0.05, 0.05), material)
    design = ("pendulum.height", "pendulum.youngs_modulus", "pendulum.density")
    asked: dict[str, Objective] = {
        "position of the tip": AtTimes(position(beam.at_end, 1), 0.5),
        "kinetic energy": Integral(kinetic_energy()),
        "stress": _stress("pendulum", 0.5, 0.025),
    }
    return Case(
        "pendulum",
        "Pendulum",
        Scene([beam], [Pin(beam.at_start, name="pin")], (0, -9.81)),
        0.6,
        design,
        asked,
    )


def cable() -> Case:
    """Return a cord between two supports that its weight pulls down, modelled as a beam."""
    material = Material(1100.0, 5e6, 0.3, damping_time=2e-3)
    cord = Beam("cord", (0, 0), (2, 0), 8, Rectangle(0.01, 0.01), material)
    joints = [Pin(cord.at_start, name="left"), Pin(cord.at_end, name="right")]
    design = ("cord.height", "cord.youngs_modulus", "cord.density")
    asked: dict[str, Objective] = {
        "position of the middle": Integral(position(cord.at(0.5), 1) ** 2),
        "strain energy": Integral(strain_energy()),
        "stress": _stress("cord", 0.5, 0.0),
    }
    return Case(
        "cable", "Cable under gravity", Scene([cord], joints, (0, -9.81)), 0.5, design, asked
    )


def spinning_blade() -> Case:
    """Return the blade of the report `design` in space, spun up, and in its plane."""
    planar = blade(4)
    flat = planar.beams[0]
    beam = Beam("blade", (0, 0, 0), (1, 0, 0), 4, flat.section, flat.material, element=BEAM_3D)
    axis = (0.0, 0.0, 1.0)
    joints = [
        Revolute(beam.at_start, axis),
        RotationDriver(beam.at_start, UserLaw(spin_up), name="hub"),
    ]
    named = replace(planar, joints=[planar.joints[0], replace(planar.joints[1], name="hub")])
    design = ("blade.height", "blade.youngs_modulus", "blade.density")
    asked: dict[str, Objective] = {
        "deflection of the tip": Integral(position(beam.at_end, 1) ** 2 + position(beam.at_end, 0)),
        "torque of the hub": Integral(driver_torque("hub") ** 2),
        "stress": _stress("blade", 0.0, 0.01),
    }
    return Case(
        "blade", "Spinning blade", Scene([beam], joints), 1.0, design, asked, {"planar": named}
    )


def frame() -> Case:
    """Return a portal frame; a load passes from point to point of its girder."""
    section, material = Rectangle(0.02, 0.02), Material(1200.0, 3e9, 0.35, damping_time=1e-3)
    left = Beam("left", (0, 0), (0, 1), 2, section, material)
    girder = Beam("girder", (0, 1), (2, 1), 8, section, material)
    right = Beam("right", (2, 0), (2, 1), 2, section, material)
    joints = [
        Clamp(left.at_start),
        Clamp(right.at_start),
        Weld(left.at_end, girder.at_start),
        Weld(right.at_end, girder.at_end),
    ]
    times = np.linspace(0.0, 1.0, 9)
    loads = [
        PointForce(
            girder.at(k / 8), (0, -20.0), law=Spline(times[k - 1 : k + 2].tolist(), [0.0, 1.0, 0.0])
        )
        for k in range(1, 8)
    ]
    design = ("girder.height", "left.height", "girder.youngs_modulus")
    asked: dict[str, Objective] = {
        "position of the middle": Integral((position(girder.at(0.5), 1) - 1.0) ** 2),
        "strain energy": Integral(strain_energy()),
        "stress in the girder": _stress("girder", 0.5, 0.01),
    }
    return Case(
        "frame",
        "Frame under a moving load",
        Scene([left, girder, right], joints, loads=loads),
        1.0,
        design,
        asked,
    )


#: All scenes; a quick report takes the first.
CASES: Final[tuple[Callable[[], Case], ...]] = (
    lambda: slider_crank(5.0, "slider-crank-slow"),
    lambda: slider_crank(60.0, "slider-crank-fast"),
    four_bar,
    driven_arm,
    pendulum,
    cable,
    spinning_blade,
    frame,
    free_arm,
)
