"""Random scenes on which calls to a tolerance are judged: a seed makes a case, always the same.

Fourteen families, each with what made a call certain and wrong once: two time scales, pulses that
steps pass over, waves that numerical damping eats, long runs of pendulums, friction. Scenes are
small, so that a run that knows the answer takes seconds.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

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
    RigidBody,
    RigidBox,
    RotationalFriction,
    RotationDriver,
    Scene,
    SmoothMaximum,
    Spherical,
    SpringDamper,
    Terminal,
    TranslationalFriction,
    assemble,
)
from ancfdae.extend import Integrator, Law
from ancfdae.laws import ConstantAcceleration, Harmonic, RunUp, SmoothStep, UserLaw
from ancfdae.numerics.arrays import Array
from ancfdae.observables import (
    custom,
    kinetic_energy,
    maximum_von_mises,
    position,
    reaction,
    strain_energy,
    velocity,
)
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import Observable
from validation.tolerance.scenes import Case

_FALLING = (0.0, -9.81)
# Objectives at instants read the polynomials between 200 of them: 64 leave 1e-3 of some gradients.
_FINE = DOP853(1e-9, intervals=200)
# Steps of a run where waves are damped. Error control takes too few for integrals and derivatives
# that are small beside the motion: 1e-2 of some at rtol = 1e-9, 2e-3 at 1e-12.
_MANY = 1024
_Random = np.random.Generator


@final
@dataclass(frozen=True)
class Generated(Case):
    """A case, its family and seed; `told` is the same system with the instants of its pulses."""

    family: str = ""
    seed: int = 0
    told: Any = None


@final
@dataclass(frozen=True)
class _Marks(Law):
    """Zero, with breakpoints: what a run that knows the answer is told of pulses."""

    instants: Any

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return zero."""
        return np.zeros_like(np.asarray(t), dtype=float)

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Return the instants."""
        return tuple(self.instants)


@dataclass(frozen=True)
class _Draft:
    """A scene, its design, and what may be asked: points and further observables."""

    scene: Scene
    design: Sequence[str]
    t_end: float
    point: Any
    others: Sequence[Observable] = ()
    reference: Integrator = _FINE
    pulses: Array | Sequence[float] = ()
    objective: Objective | None = None
    straight: bool = False


def case(family: str, seed: int) -> Generated:
    """Return the case of a family and a seed."""
    rng = np.random.default_rng([seed, *map(ord, family)])
    draft = FAMILIES[family](rng)
    objective = _objective(draft, rng) if draft.objective is None else draft.objective
    system = assemble(draft.scene, draft.design)
    told = assemble(_told(draft), draft.design) if len(draft.pulses) else system
    name = f"{family} {seed}"
    return Generated(name, system, objective, draft.t_end, draft.reference, family, seed, told)


def _told(draft: _Draft) -> Scene:
    scene = draft.scene
    zero = (0.0,) * len(scene.gravity or _FALLING)
    marks = PointForce(draft.point, zero, name="marks", law=_Marks(tuple(draft.pulses)))
    parts = scene.beams, scene.joints, scene.gravity, scene.start
    return Scene(*parts, loads=[*scene.loads, marks], bodies=scene.bodies)


def _objective(draft: _Draft, rng: _Random) -> Objective:
    """Choose one of five kinds."""
    axis = 0 if draft.straight else int(rng.integers(2))
    x, v = position(draft.point, axis), velocity(draft.point, axis)
    kinds: list[Callable[[], Objective]] = [
        lambda: Terminal(x),
        lambda: Terminal(v),
        lambda: Integral(v**2),
        lambda: AtTimes(x**2, tuple(draft.t_end * np.array([0.31, 0.62, 0.97]))),
        lambda: SmoothMaximum(x, 5.0),
    ]
    kinds += [lambda other=other: Integral(other) for other in draft.others]  # type: ignore[misc]
    return kinds[int(rng.integers(len(kinds)))]()


def _log(rng: _Random, low: float, high: float) -> float:
    """Return a number whose logarithm is even between two powers of ten."""
    return float(10.0 ** rng.uniform(low, high))


def _box(name: str, at: Sequence[float], length: float = 0.1) -> RigidBody:
    sizes = (length, *[0.1] * 2)
    return RigidBody(name, tuple(at), shape=RigidBox(*sizes), density=1000.0)


def _springs(rng: _Random) -> _Draft:
    """Return two masses of 1 kg on a rail: a soft spring and a stiff one, pre-stretched."""
    a, b = _box("a", (0.5, 0)), _box("b", (1.0, 0))
    fast = _log(rng, 1.5, 3.4)
    stretch = float(rng.choice([0.0, 1.0])) * _log(rng, -5, -3)
    damping = float(rng.choice([0.0, 0.0, 1.0])) * _log(rng, -1, 2)
    loads = [
        SpringDamper(a.at(0), _log(rng, 0.5, 2), 0.1 * damping, 0.4, ground=(0.0, 0.0), name="s"),
        SpringDamper(b.at(0), fast**2 / 2, damping, 0.5 - stretch, a.at(0), name="m"),
    ]
    rails = [PointOnLine(x.at(0), direction=(1, 0)) for x in (a, b)]
    scene = Scene([], rails, (2.0, 0.0), loads=loads, bodies=[a, b])
    t_end = min(1.0, 300.0 / fast)
    return _Draft(
        scene, ("s.stiffness", "m.stiffness"), t_end, b.at(0), [kinetic_energy("b")], straight=True
    )


def _ringing(rng: _Random) -> _Draft:
    """Return masses on springs of which one is stiff and stretched, seen at the end."""
    draft = _springs(rng)
    x, v = position(draft.point, 0), velocity(draft.point, 0)
    kinds = Terminal(v), Terminal(x), Integral(v**2)
    return replace(draft, t_end=draft.t_end / 2, objective=kinds[int(rng.integers(3))])


def _pendulum(rng: _Random) -> _Draft:
    """Return one to three rigid bars that fall, a single one for up to forty seconds."""
    count = int(rng.choice([1, 1, 2, 3]))
    turn = float(rng.uniform(-1.2, 0.5))
    ends = np.array([[np.cos(turn), np.sin(turn)]]) * np.arange(count + 1)[:, None]
    bars, joints = list[RigidBody](), list[Any]()
    for k, name in enumerate("abc"[:count]):
        middle = (ends[k] + ends[k + 1]) / 2
        box = RigidBox(1.0, 0.1, 0.1)
        slanted = RigidBody(name, tuple(middle), turn=turn, shape=box, density=1000.0)
        before = bars[-1].at(0.5) if bars else None
        joints.append(Pin(slanted.at(-0.5), before, name=f"p{k}"))
        bars.append(slanted)
    friction = [RotationalFriction(bars[0].at(-0.5), 0.0, 0.1, _log(rng, -1, 1), name="f")]
    loads = friction if rng.random() < 0.5 else []
    scene = Scene([], joints, _FALLING, loads=loads, bodies=bars)
    t_end = float(rng.uniform(2, 40)) if count == 1 else float(rng.uniform(0.5, 3))
    design = [f"{bars[-1].name}.density", *(["f.viscous"] if loads else [f"{bars[0].name}.length"])]
    return _Draft(scene, design, t_end, bars[-1].at(0.5), [reaction("p0", 0) ** 2])


def _pulse(rng: _Random) -> _Draft:
    """Return a mass on a spring that a Gaussian pulse hits."""
    a = _box("a", (0.5, 0))
    width, at = _log(rng, -3.2, -1.5), float(rng.uniform(0.3, 0.9))

    law = UserLaw(lambda t: np.exp(-np.square((t - at) / width)))
    force = PointForce(a.at(0), (_log(rng, 0, 1) / width, 0.0), name="f", law=law)
    spring = SpringDamper(a.at(0), _log(rng, 1, 2.5), 0.2, 0.4, ground=(0.0, 0.0), name="s")
    rail = PointOnLine(a.at(0), direction=(1, 0))
    scene = Scene([], [rail], (0.0, 0.0), loads=[spring, force], bodies=[a])
    pulses = at + width * np.array([-6.0, -3, -1.5, 0, 1.5, 3, 6])
    design = ("s.stiffness", "f.force_x")
    return _Draft(scene, design, 1.0, a.at(0), [kinetic_energy("a")], pulses=pulses, straight=True)


def _window(rng: _Random) -> _Draft:
    """Return a mass on a spring, and an objective that looks for an instant only."""
    a = _box("a", (0.5, 0))
    width, at = _log(rng, -3.2, -1.0), float(rng.uniform(0.3, 0.9))

    def seen(t: Array, q: Array, v: Array, lam: Array, b: Array) -> Array:
        return np.asarray(np.exp(-(((t - at) / width) ** 2)) / width * (q[:, 0] + 0.1 * v[:, 0]))

    spring = SpringDamper(a.at(0), _log(rng, 1, 2.5), 0.2, 0.3, ground=(0.0, 0.0), name="s")
    scene = Scene([], [PointOnLine(a.at(0), direction=(1, 0))], (0, 0), loads=[spring], bodies=[a])
    pulses = at + width * np.array([-6.0, -3, -1.5, 0, 1.5, 3, 6])
    objective = Integral(custom(seen, "window"))
    design = ("s.stiffness", "s.damping")
    return _Draft(scene, design, 1.0, a.at(0), pulses=pulses, objective=objective)


def _kinked(rng: _Random) -> _Draft:
    """Return two bars of which a motor turns one, with a ramp or a run-up, and a spring."""
    bars = [
        RigidBody("a", (0.5, 0), shape=RigidBox(1.0, 0.1, 0.1), density=1000.0),
        RigidBody("b", (1.4, 0), shape=RigidBox(0.8, 0.1, 0.1), density=1000.0),
    ]
    lasts = _log(rng, -1.5, 0)
    law = SmoothStep(0.0, 1.0, lasts, begin=float(rng.uniform(0, 0.5)))
    joints: list[Any] = [Pin(bars[0].at(-0.5), name="p"), Pin(bars[0].at(0.5), bars[1].at(-0.4))]
    spring = SpringDamper(bars[1].at(0.4), 400.0, 5.0, 0.5, ground=(2.0, 0.8), name="s")
    loads: list[Any] = [spring]
    if rng.random() < 0.5:
        joints.append(RotationDriver(bars[0].at(-0.5), law, name="motor"))
    else:
        loads.append(PointForce(bars[1].at(0.4), (0, 50.0), law=law, name="f"))
    scene = Scene([], joints, _FALLING, loads=loads, bodies=bars)
    t_end = float(rng.uniform(0.5, 0.9))
    others = [reaction("p", 0) ** 2, kinetic_energy("b")]
    return _Draft(scene, ("s.stiffness", "b.density"), t_end, bars[1].at(0.4), others)


def _friction(rng: _Random) -> _Draft:
    """Return a mass that a spring pulls over a rough rail, sticking and slipping."""
    a = _box("a", (0.5, 0))
    pull = UserLaw(lambda t, speed: speed * t, (_log(rng, 0, 1.5),))
    rough = TranslationalFriction(
        a.at(0), (1, 0), 3.0, _log(rng, -2.5, -0.5), 0.5, 4.0, 0.1, name="r"
    )
    loads = [
        SpringDamper(a.at(0), _log(rng, 1.5, 2.7), 0.1, 0.5, ground=(0.0, 0.0), name="s"),
        PointForce(a.at(0), (1.0, 0.0), law=pull, name="f"),
        rough,
    ]
    rail = PointOnLine(a.at(0), direction=(1, 0))
    scene = Scene([], [rail], loads=loads, bodies=[a])
    t_end = float(rng.uniform(0.3, 1.2))
    return _Draft(
        scene, ("s.stiffness", "r.coulomb"), t_end, a.at(0), [kinetic_energy("a")], straight=True
    )


def _rod(rng: _Random) -> _Draft:
    """Return an undamped rod, soft or stiff, that turns about a pin or is clamped."""
    E, size = _log(rng, 6.5, 9.4), float(rng.uniform(0.02, 0.06))
    count, length = int(rng.integers(1, 3)), 0.8
    rod = Beam("rod", (0, 0), (length, 0), count, Rectangle(size, size), Material(1100, E, 0.35))
    held = Pin(rod.at_start, name="p") if rng.random() < 0.6 else Clamp(rod.at_start, name="p")
    turning = isinstance(held, Pin) and rng.random() < 0.5
    start = [InitialVelocity("rod", float(rng.uniform(1, 8)), (0, 0))] if turning else []
    scene = Scene([rod], [held], _FALLING, start=start)
    # Waves through the section are the fastest; 160 periods of them at most.
    fast = math.sqrt(E / 1100) * 4 / size
    t_end = min(float(rng.uniform(0.05, 0.5)), 1000.0 / fast)
    others = [strain_energy("rod"), reaction("p", 0) ** 2]
    return _Draft(scene, ("rod.height", "rod.density"), t_end, rod.at_end, others)


def _stiff(rng: _Random) -> _Draft:
    """Return an undamped rod whose end is asked for its velocity, which waves make."""
    draft = _rod(rng)
    axis = int(rng.integers(2))
    kinds = Terminal(velocity(draft.point, axis)), Terminal(position(draft.point, axis))
    return replace(draft, objective=kinds[int(rng.integers(2))])


def _damped(rng: _Random) -> _Draft:
    """Return a damped rod of rubber or alloy on which a force acts suddenly, or that falls."""
    stiff = rng.random() < 0.5
    E, damping = (7e10, _log(rng, -5, -3.5)) if stiff else (_log(rng, 6, 7), _log(rng, -3, -1.5))
    rod = Beam("rod", (0, 0), (0.6, 0), 2, Rectangle(0.02, 0.02), Material(1500, E, 0.4, damping))
    held = Clamp(rod.at_start, name="p") if stiff else Pin(rod.at_start, name="p")
    bodies = [PointMass(rod.at_end, _log(rng, -1, 0), name="tip")] if rng.random() < 0.5 else []
    loads = [PointForce(rod.at_end, (0.0, -20.0 if stiff else -0.5))]
    scene = Scene([rod], [held], _FALLING, loads=loads, bodies=bodies)
    t_end = float(rng.uniform(0.1, 0.3))
    others = [strain_energy("rod")]
    objective = None
    if rng.random() < 0.3:
        sharp = 50 / (1e7 if stiff else 1e5)
        objective = SmoothMaximum(maximum_von_mises("rod", sharp), sharp)
    design = ("rod.height", "rod.youngs_modulus")
    return _Draft(
        scene, design, t_end, rod.at_end, others, Radau(t_end / _MANY), objective=objective
    )


def _slider(rng: _Random) -> _Draft:
    """Return a driven slider-crank with a rod of rubber, nylon or steel, damped or not."""
    soft = rng.random() < 0.5
    damping = 0.0 if soft else _log(rng, -4.5, -3)
    material = Material(1150, _log(rng, 6.5, 7.5) if soft else _log(rng, 9, 11.3), 0.4, damping)
    crank = RigidBody("crank", (0.1, 0), shape=RigidBox(0.2, 0.04, 0.02), density=2700.0)
    rod = Beam("rod", (0.2, 0), (0.7, 0), 2, Rectangle(0.02, 0.02), material)
    speed = float(rng.uniform(5, 25))
    uniform = rng.random() < 0.5
    law = (
        ConstantAcceleration(speed=speed)
        if uniform
        else RunUp(speed, float(rng.uniform(0.02, 0.1)))
    )
    joints = [
        Pin(crank.at(-0.1), name="p"),
        RotationDriver(crank.at(-0.1), law, name="motor"),
        Pin(crank.at(0.1), rod.at_start),
        PointOnLine(rod.at_end, direction=(1, 0)),
    ]
    bodies: list[Any] = [crank, PointMass(rod.at_end, 0.2, name="slider")]
    start = [InitialVelocity("crank", speed, (0, 0))] if uniform else []
    scene = Scene([rod], joints, start=start, bodies=bodies, project_start=True)
    t_end = float(rng.uniform(0.004, 0.015)) if soft else float(rng.uniform(0.05, 0.1))
    reference: Integrator = DOP853(1e-12, intervals=200) if soft else Radau(t_end / _MANY)
    others = [strain_energy("rod"), reaction("p", 0) ** 2]
    return _Draft(scene, ("rod.height", "slider.mass"), t_end, rod.at(0.5), others, reference)


def _cable(rng: _Random) -> _Draft:
    """Return a chain of cable elements that falls from the horizontal."""
    damping = float(rng.choice([0.0, 1.0])) * _log(rng, -3.5, -2.5)
    E, t_end = _log(rng, 6, 7.5), float(rng.uniform(0.1, 0.3))
    section, material = Rectangle(0.02, 0.02), Material(1150, E, 0.4, damping)
    rope = Beam("rope", (0, 0), (1.2, 0), 3, section, material, element=CABLE_2D)
    scene = Scene([rope], [Pin(rope.at_start, name="p")], _FALLING)
    reference: Integrator = Radau(t_end / _MANY) if damping else _FINE
    others = [strain_energy("rope"), reaction("p", 0) ** 2]
    design = ("rope.height", "rope.youngs_modulus")
    return _Draft(scene, design, t_end, rope.at_end, others, reference)


def _spatial(rng: _Random) -> _Draft:
    """Return a rubber rod in space that turns about a spherical joint."""
    material = Material(1100, _log(rng, 6, 7.5), 0.4)
    rod = Beam("rod", (0, 0, 0), (1, 0, 0), 1, Rectangle(0.06, 0.04), material)
    spin = tuple(float(x) for x in rng.uniform(0, 3, 3))
    start = [InitialVelocity("rod", spin, (0, 0, 0))]
    scene = Scene([rod], [Spherical(rod.at_start, name="p")], (0, 0, -9.81), start=start)
    others, t_end = [strain_energy("rod")], float(rng.uniform(0.04, 0.12))
    return _Draft(scene, ("rod.height", "rod.width"), t_end, rod.at_end, others)


def _shaken(rng: _Random) -> _Draft:
    """Return a damped four-bar linkage with a flexible coupler, turned to and fro."""
    material = Material(1150, _log(rng, 7, 10), 0.4, _log(rng, -4, -2.5))
    crank = RigidBody("crank", (0, 0.1), shape=RigidBox(0.04, 0.2, 0.02), density=2700.0)
    coupler = Beam("coupler", (0, 0.2), (0.7, 0.5), 2, Rectangle(0.015, 0.02), material)
    rocker = RigidBody("rocker", (0.75, 0.25), shape=RigidBox(0.04, 0.5, 0.02), density=2700.0)
    joints = [
        Pin(crank.at(0, -0.1), name="p"),
        RotationDriver(
            crank.at(0, -0.1), Harmonic(float(rng.uniform(0.2, 1.0)), 15.0), name="motor"
        ),
        Pin(crank.at(0, 0.1), coupler.at_start),
        Pin(coupler.at_end, rocker.at(-0.05, 0.25)),
        Pin(rocker.at(0, -0.25)),
    ]
    bodies = [crank, rocker]
    scene = Scene([coupler], joints, _FALLING, bodies=bodies, project_start=True)
    t_end = float(rng.uniform(0.08, 0.25))
    others = [strain_energy("coupler"), reaction("p", 0) ** 2]
    design = ("coupler.height", "rocker.density")
    return _Draft(scene, design, t_end, coupler.at(0.35), others, Radau(t_end / _MANY))


FAMILIES: Final[dict[str, Callable[[_Random], _Draft]]] = {
    "springs": _springs,
    "ringing": _ringing,
    "pendulum": _pendulum,
    "pulse": _pulse,
    "window": _window,
    "kinked": _kinked,
    "friction": _friction,
    "rod": _rod,
    "stiff rod": _stiff,
    "damped rod": _damped,
    "slider": _slider,
    "cable": _cable,
    "spatial": _spatial,
    "four-bar": _shaken,
}
