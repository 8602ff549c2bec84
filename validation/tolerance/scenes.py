"""Scenes on which `gradient(tolerance=...)` is calibrated, and others on which it is judged."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ancfdae import (
    CABLE_2D,
    DOP853,
    AtTimes,
    Beam,
    Clamp,
    InitialVelocity,
    Integral,
    Material,
    Pin,
    PointForce,
    PointMass,
    PointOnLine,
    Radau,
    Revolute,
    RigidBody,
    RigidBox,
    RigidCylinder,
    RotationDriver,
    Scene,
    Spherical,
    SpringDamper,
    Terminal,
    Weld,
    assemble,
)
from ancfdae.extend import FormulaSystem, Integrator, MechanicalSystem
from ancfdae.laws import ConstantAcceleration, SmoothStep
from ancfdae.numerics.arrays import Array
from ancfdae.observables import (
    bending_moment,
    custom,
    driver_torque,
    kinetic_energy,
    position,
    reaction,
)
from ancfdae.sections import Circle, Rectangle, Tube
from ancfdae.sensitivity.objectives import Objective
from validation.external.slider_crank import SliderCrank

_FINE = DOP853(1e-11)


@dataclass(frozen=True)
class Case:
    """A system, what is asked of it, and by what the answer is known."""

    name: str
    system: MechanicalSystem
    objective: Objective
    t_end: float
    reference: Integrator = _FINE


_FALLING = (0.0, -9.81)
_RUBBER = Material(1100, 5e6, 0.4)
_SLACK = Material(1100, 5e6, 0.4, 2e-3)
_STEEL = Material(7800, 2.1e11, 0.3)
_DAMPED_STEEL = Material(7800, 2.1e11, 0.3, 1e-4)
_ALLOY = Material(2700, 7e10, 0.33, 1e-4)
_NYLON = Material(1150, 2e9, 0.4)
_DAMPED_NYLON = Material(1150, 2e9, 0.4, 5e-4)


def _case(
    name: str,
    scene: Scene,
    design: Sequence[str],
    objective: Objective,
    t_end: float,
    reference: Integrator = _FINE,
) -> Case:
    return Case(name, assemble(scene, design), objective, t_end, reference)


# Calibration.


def _cantilever(material: Material, name: str, t_end: float, reference: Integrator) -> list[Case]:
    """Return a clamped beam on which a force acts suddenly."""
    rod = Beam("rod", (0, 0), (1, 0), 4, Rectangle(0.03, 0.02), material)
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[PointForce(rod.at_end, (0, -20.0))])
    tip = position(rod.at_end, 1)
    design = ("rod.height", "rod.youngs_modulus", "rod.density")
    return [
        _case(f"{name}, end", scene, design, Terminal(tip), t_end, reference),
        _case(f"{name}, integral", scene, design, Integral(tip**2), t_end, reference),
    ]


def _spun() -> list[Case]:
    """Return a soft rod that turns about a pin."""
    rod = Beam("rod", (0, 0), (0.8, 0), 4, Rectangle(0.04, 0.04), _RUBBER)
    start = [InitialVelocity("rod", 6.0, (0, 0))]
    scene = Scene([rod], [Pin(rod.at_start, name="pin")], _FALLING, start=start)
    design = ("rod.height", "rod.youngs_modulus")
    return [
        _case("spun rod, end", scene, design, Terminal(position(rod.at_end, 0)), 0.4),
        _case("spun rod, pin", scene, design, Integral(reaction("pin", 0) ** 2), 0.4),
    ]


def _rigid_pair() -> list[Case]:
    """Two rigid bars that fall."""
    bars = [
        RigidBody("a", (0.5, 0), shape=RigidBox(1.0, 0.1, 0.1), density=1000.0),
        RigidBody("b", (1.4, 0), shape=RigidBox(0.8, 0.1, 0.1), density=1000.0),
    ]
    joints = [Pin(bars[0].at(-0.5)), Pin(bars[0].at(0.5), bars[1].at(-0.4))]
    spring = SpringDamper(bars[1].at(0.4), 400.0, 5.0, 0.5, ground=(2.0, 0.8), name="spring")
    scene = Scene([], joints, _FALLING, loads=[spring], bodies=bars)
    design = ("spring.stiffness", "spring.damping")
    end = position(bars[1].at(0.4), 1)
    return [
        _case("two bars, end", scene, design, Terminal(end), 3.0),
        _case("two bars, energy", scene, design, Integral(kinetic_energy("b")), 3.0),
    ]


def _four_bar(material: Material, name: str, t_end: float, reference: Integrator) -> list[Case]:
    """Return a driven four-bar linkage with a coupler that bends."""
    crank = RigidBody("crank", (0, 0.1), shape=RigidBox(0.04, 0.2, 0.02), density=2700.0)
    coupler = Beam("coupler", (0, 0.2), (0.7, 0.5), 3, Rectangle(0.015, 0.02), material)
    rocker = RigidBody("rocker", (0.75, 0.25), shape=RigidBox(0.04, 0.4, 0.02), density=2700.0)
    joints = [
        Pin(crank.at(0, -0.1)),
        RotationDriver(crank.at(0, -0.1), SmoothStep(0.0, 2.0, duration=t_end), name="motor"),
        Pin(crank.at(0, 0.1), coupler.at_start),
        Pin(coupler.at_end, rocker.at(-0.05, 0.25)),
        Pin(rocker.at(0.05, -0.25), name="foot"),
    ]
    scene = Scene([coupler], joints, _FALLING, bodies=[crank, rocker])
    design = ("coupler.height", "coupler.density")
    times = [0.5 * t_end, 0.75 * t_end, t_end]
    middle, torque = position(coupler.at(0.5), 1), Integral(driver_torque("motor") ** 2)
    return [
        _case(f"{name}, middle", scene, design, AtTimes(middle**2, times), t_end, reference),
        _case(f"{name}, torque", scene, design, torque, t_end, reference),
    ]


def _two_links() -> list[Case]:
    """Return a double pendulum of soft damped beams."""
    a = Beam("a", (0, 0), (0.5, 0), 2, Rectangle(0.03, 0.03), _SLACK)
    b = Beam("b", (0.5, 0), (1.0, 0.2), 2, Rectangle(0.03, 0.03), _SLACK)
    scene = Scene([a, b], [Pin(a.at_start), Pin(a.at_end, b.at_start)], _FALLING)
    design = ("a.height", "b.height", "b.density")
    fine = Radau(0.6 / 1500)
    tip = position(b.at_end, 0)
    return [
        _case("soft links, end", scene, design, Terminal(tip), 0.6, fine),
        _case("soft links, integral", scene, design, Integral(tip**2), 0.6, fine),
    ]


def _calibration() -> list[Case]:
    return [
        *_cantilever(_NYLON, "nylon cantilever", 0.1, DOP853(1e-9)),
        *_cantilever(_STEEL, "steel cantilever", 0.01, DOP853(1e-8)),
        *_cantilever(_DAMPED_STEEL, "damped steel cantilever", 0.2, Radau(0.2 / 1500)),
        *_spun(),
        *_rigid_pair(),
        *_four_bar(_DAMPED_NYLON, "damped four-bar", 1.0, Radau(1.0 / 1500)),
        *_four_bar(_NYLON, "four-bar", 0.25, DOP853(1e-9)),
        *_two_links(),
    ]


# Held out.


class _Guided(FormulaSystem):
    """A double pendulum of point masses whose tip is moved along a line; written by hand."""

    n_q, n_lam = 2, 1
    design_names = ("m2", "L1", "c")

    def __init__(self, b: npt.ArrayLike = (1.5, 1.0, 0.3)) -> None:
        super().__init__(np.asarray(b))

    def with_values(self, b: Array) -> "_Guided":
        return _Guided(b)

    def start(self) -> tuple[Array, Array]:
        return np.array([-0.4, 1.1]), np.array([0.0, 0.5 / (0.8 * np.cos(1.1))])

    def mass_matrix(self, q: Array) -> Array:
        m2, L1, _ = self.b
        coupling = 0.8 * m2 * L1 * np.cos(q[0] - q[1])
        return np.array([[(1 + m2) * L1**2, coupling], [coupling, 0.64 * m2]])

    def force(self, t: float, q: Array, v: Array) -> Array:
        m2, L1, c = self.b
        pull, joint = 0.8 * m2 * L1 * np.sin(q[0] - q[1]), c * (v[1] - v[0])
        first = -pull * v[1] ** 2 - 9.81 * (1 + m2) * L1 * np.sin(q[0]) - c * v[0] + joint
        return np.array([first, pull * v[0] ** 2 - 7.848 * m2 * np.sin(q[1]) - joint])

    def position_constraint(self, t: float, q: Array) -> Array:
        L1 = self.b[1]
        moved = L1 * (np.sin(q[0]) + np.sin(0.4)) + 0.8 * (np.sin(q[1]) - np.sin(1.1))
        return np.array([moved - 0.1 * np.sin(5 * t)])


def _angle(t: Array, q: Array, v: Array, lam: Array, b: Array) -> Array:
    return q[:, 0]


def _blade() -> Case:
    """Return a thin alloy blade that a hub spins up."""
    hub = RigidBody("hub", (0, 0), shape=RigidCylinder(0.1, 0.05), density=2700.0)
    blade = Beam("blade", (0.1, 0), (1.1, 0), 4, Rectangle(0.01, 0.05), _ALLOY)
    turn = SmoothStep(0.0, 3.0, duration=0.8)
    joints = [
        Pin(hub.at(0, 0)),
        RotationDriver(hub.at(0, 0), turn, name="motor"),
        Weld(blade.at_start, hub.at(0.1, 0)),
    ]
    scene = Scene([blade], joints, bodies=[hub])
    moment = Integral(bending_moment(blade.at(0.1)) ** 2)
    return _case("blade", scene, ("blade.height", "blade.density"), moment, 1.0, Radau(1 / 1500))


def _slider(damped: bool, t_end: float, reference: Integrator) -> Case:
    """Return a crank that turns at constant speed, a rod that bends, a slider with mass."""
    material = _DAMPED_STEEL if damped else Material(1150, 2e7, 0.4)
    crank = RigidBody("crank", (0.1, 0), shape=RigidBox(0.2, 0.04, 0.02), density=2700.0)
    rod = Beam("rod", (0.2, 0), (0.7, 0), 4, Rectangle(0.01, 0.02), material)
    joints = [
        Pin(crank.at(-0.1)),
        RotationDriver(crank.at(-0.1), ConstantAcceleration(speed=20.0), name="motor"),
        Pin(crank.at(0.1), rod.at_start),
        PointOnLine(rod.at_end, direction=(1, 0)),
    ]
    bodies: list[RigidBody | PointMass] = [crank, PointMass(rod.at_end, 0.2, name="slider")]
    start = [InitialVelocity("crank", 20.0, (0, 0))]
    scene = Scene([rod], joints, start=start, bodies=bodies, project_start=True)
    objective: Objective = Terminal(position(rod.at(0.5), 1))
    if damped:
        objective = Integral(driver_torque("motor") ** 2)
    name = "slider-crank of damped steel" if damped else "slider-crank of rubber"
    return _case(name, scene, ("rod.height", "slider.mass"), objective, t_end, reference)


def _arm() -> Case:
    """Return a robot's arm of thin tube in space."""
    tube = Tube(radius=0.02, thickness=0.002)
    upper = Beam("upper", (0, 0, 0), (0, 0, 0.6), 2, tube, _ALLOY)
    fore = Beam("fore", (0, 0, 0.6), (0.5, 0, 0.6), 2, tube, _ALLOY)
    bend = SmoothStep(0.0, 0.8, duration=0.4)
    joints = [
        Clamp(upper.at_start),
        Revolute(fore.at_start, axis=(0, 1, 0), other=upper.at_end, name="elbow"),
        RotationDriver(fore.at_start, bend, axis=(0, 1, 0), other=upper.at_end, name="motor"),
    ]
    payload = PointMass(fore.at_end, 0.4, name="payload")
    scene = Scene([upper, fore], joints, (0, 0, -9.81), bodies=[payload])
    objective = Terminal(position(fore.at_end, 2))
    design = ("fore.thickness", "payload.mass")
    return _case("robot's arm", scene, design, objective, 0.5, Radau(0.5 / 1500))


def _cable(damped: bool) -> Case:
    """Return a chain of cable elements that falls from the horizontal."""
    material = Material(1150, 5e7, 0.4, 1e-3 if damped else 0.0)
    rope = Beam("rope", (0, 0), (1.5, 0), 6, Circle(0.01), material, element=CABLE_2D)
    scene = Scene([rope], [Pin(rope.at_start)], _FALLING)
    objective = (
        Integral(position(rope.at_end, 1) ** 2) if damped else Terminal(position(rope.at_end, 1))
    )
    reference = Radau(0.3 / 1500) if damped else DOP853(1e-9)
    name = "falling rope, damped" if damped else "falling rope"
    return _case(name, scene, ("rope.radius", "rope.density"), objective, 0.3, reference)


def _spatial() -> Case:
    """Return a soft rod in space that turns about a spherical joint."""
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 3, Rectangle(0.06, 0.04), _RUBBER)
    start = [InitialVelocity("rod", (0.0, 1.0, 2.0), (0, 0, 0))]
    scene = Scene([rod], [Spherical(rod.at_start)], (0, 0, -9.81), start=start)
    objective = Terminal(position(rod.at_end, 2))
    return _case("rod in space", scene, ("rod.height", "rod.width"), objective, 0.3, DOP853(1e-9))


def _oscillator() -> Case:
    """Three masses on springs, one of them stiff, shaken."""
    masses = [
        RigidBody(n, (x, 0), shape=RigidBox(0.1, 0.1, 0.1), density=1000.0)
        for n, x in zip("abc", (0.5, 1.0, 1.5), strict=True)
    ]
    springs = [
        SpringDamper(masses[0].at(0), 200.0, 0.1, 0.5, ground=(0.0, 0.05), name="s"),
        SpringDamper(masses[1].at(0), 2e4, 1.0, 0.5, masses[0].at(0), name="m"),
        SpringDamper(masses[2].at(0), 300.0, 0.1, 0.5, masses[1].at(0), name="e"),
    ]
    joints = [PointOnLine(x.at(0), direction=(1, 0)) for x in masses]
    scene = Scene([], joints, (2.0, 0.0), loads=springs, bodies=masses)
    objective = Terminal(position(masses[2].at(0), 0))
    design = ("s.stiffness", "m.stiffness", "e.damping")
    return _case("masses on springs", scene, design, objective, 4.0)


def _loaded() -> Case:
    """Return a damped steel beam with a mass at its end, on which a force acts suddenly."""
    rod = Beam("rod", (0, 0), (0.6, 0), 3, Rectangle(0.01, 0.02), _DAMPED_STEEL)
    force = PointForce(rod.at_end, (0.0, -30.0), name="force")
    mass = PointMass(rod.at_end, 0.5, name="tip")
    scene = Scene([rod], [Clamp(rod.at_start)], loads=[force], bodies=[mass])
    objective = Integral(position(rod.at_end, 1) ** 2)
    design = ("rod.height", "tip.mass", "rod.youngs_modulus")
    return _case("beam with a mass", scene, design, objective, 0.5, Radau(0.5 / 1500))


def _held_out() -> list[Case]:
    few = DOP853(1e-11, intervals=4)
    return [
        _blade(),
        _slider(True, 0.2, Radau(0.2 / 1500)),
        _slider(False, 0.1, DOP853(1e-9)),
        _arm(),
        _cable(True),
        _cable(False),
        _spatial(),
        _oscillator(),
        _loaded(),
        Case("guided pendulum", _Guided(), Terminal(custom(_angle, "angle")), 3.0, few),
        Case(
            "guided pendulum, integral", _Guided(), Integral(custom(_angle, "angle") ** 2), 3.0, few
        ),
        Case("spring of SUNDIALS, short", SliderCrank(), Terminal(custom(_angle, "angle")), 3.0),
    ]


CALIBRATION: Callable[[], list[Case]] = _calibration
HELD_OUT: Callable[[], list[Case]] = _held_out
