"""Nothing depends on where a scene stands, how it is turned, or in which units it is written.

Twelve small scenes and the public calls on them, once as they are and once moved by a thousand
lengths, turned, or in other units of length, mass and time: the same digits.
"""

import warnings
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from ancfdae import (
    CABLE_2D,
    CABLE_3D,
    DOP853,
    HHT,
    IDA,
    AdaptiveSteps,
    Adjoint,
    Beam,
    Bushing,
    Clamp,
    DesignVariable,
    DirectDifferentiation,
    Evaluator,
    FrequencyMisfit,
    Integral,
    Material,
    Misfit,
    Pin,
    PointForce,
    PointMass,
    Radau,
    Responses,
    RigidBody,
    RotatingFrame,
    Scene,
    Spherical,
    SpringDamper,
    Weld,
    assemble,
    campbell,
    critical_load,
    differentiate,
    equilibrium,
    equilibrium_gradient,
    error_bars,
    estimate_adjoint_error,
    gradient,
    mass_properties,
    modes,
    record_observables,
    simulate,
    suggest_step,
    sweep,
)
from ancfdae.observables import kinetic_energy, strain_energy
from ancfdae.sections import Rectangle

pytestmark = pytest.mark.rounding
FAR = 1e3
EPS = np.finfo(float).eps


@dataclass(frozen=True)
class Place:
    """Where a scene stands, how it is turned, and its units of length, mass and time."""

    name: str
    offset: float = 0.0
    angle: float = 0.0
    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0

    def turned(self, x):
        """Return vectors in the turned frame."""
        x = np.asarray(x, dtype=float)
        c, s = np.cos(self.angle), np.sin(self.angle)
        R = np.eye(x.shape[-1])
        R[:2, :2] = [[c, -s], [s, c]]
        if len(R) == 3:
            # About a second axis, too.
            R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ R
        return x @ R.T

    def at(self, *x):
        """Return a place, from one in lengths of the scene."""
        return tuple((self.length * (self.turned(x) + self.offset)).tolist())

    def along(self, *x, unit=(0, 0, 0)):
        """Return a vector of some dimension: powers of length, mass and time."""
        return tuple((self.unit(*unit) * self.turned(x)).tolist())

    def unit(self, length, mass, time):
        return self.length**length * self.mass**mass * self.time**time

    def material(self, density, youngs_modulus, damping_time=0.0):
        return Material(
            density=density * self.unit(-3, 1, 0),
            youngs_modulus=youngs_modulus * self.unit(-1, 1, -2),
            poisson_ratio=0.3,
            damping_time=damping_time * self.time,
        )

    def section(self, height, width):
        return Rectangle(height * self.length, width * self.length)

    def rod(self, name, start, end, elements=2, stiffness=1e7, section=(0.05, 0.04), **more):
        damping = more.pop("damping_time", 0.0)
        if len(start) == 3:
            more["height_axis"] = self.along(0, 1, 0)
        made = self.section(*section), self.material(1000.0, stiffness, damping)
        return Beam(name, self.at(*start), self.at(*end), elements, *made, **more)

    def gravity(self, *g):
        return self.along(*g, unit=(1, 0, -2))


HERE = Place("here")
#: For every call: both ways from the units of `HERE`, once far away and turned.
PLACES = (
    Place("km, g, h", length=1e-3, mass=1e3, time=1 / 3600),
    Place("all at once", FAR, 0.7, 1e3, 1e-3, 1e3),
)
#: For calls that choose their steps, one change at a time.
ONES = (
    Place("far", offset=FAR),
    Place("turned", angle=0.7),
    Place("mm, t, s", length=1e3, mass=1e-3),
)
DOWN_2, DOWN_3 = (0.0, -9.81), (0.0, 0.0, -9.81)
FORCE, SPRING, DAMPER = (1, 1, -2), (0, 1, -2), (0, 1, -1)


def cantilever(x):
    rod = x.rod("rod", (0, 0), (1, 0), stiffness=1e8)
    return Scene([rod], [Clamp(rod.at_start)], gravity=x.gravity(*DOWN_2))


def pendulum(x):
    rod = x.rod("rod", (0, 0), (0.6, -0.8), stiffness=1e7)
    return Scene([rod], [Pin(rod.at_start)], gravity=x.gravity(*DOWN_2))


def damped(x):
    rod = x.rod("rod", (0, 0), (1, 0), stiffness=1e8, damping_time=1e-3)
    return Scene([rod], [Clamp(rod.at_start)], gravity=x.gravity(*DOWN_2))


def rope(x):
    rod = x.rod("rod", (0, 0), (1, 0), 3, 1e7, (0.02, 0.02), element=CABLE_2D)
    joints = [Pin(rod.at_start), Pin(rod.at_end)]
    return Scene([rod], joints, gravity=x.gravity(*DOWN_2))


def double_pendulum(x):
    rod, other = x.rod("rod", (0, 0), (1, 0)), x.rod("other", (1, 0), (1.5, 0.5))
    joints = [Pin(rod.at_start), Pin(other.at_start, rod.at_end)]
    return Scene([rod, other], joints, gravity=x.gravity(*DOWN_2))


def column(x):
    rod = x.rod("rod", (0, 0), (1, 0), 4, 1e8, (0.05, 0.05), element=CABLE_2D)
    push = PointForce(rod.at_end, x.along(-50.0, 0.0, unit=FORCE), name="push")
    # The strain energy is a difference: of strains e its digits are eps/e^2, 1e-10 at this force.
    return Scene([rod], [Clamp(rod.at_start)], loads=[push])


def sprung(x):
    rod = x.rod("rod", (0, 0), (1, 0), 1, rigid=True)
    spring = SpringDamper(
        rod.at_end,
        ground=x.at(1.0, 1.0),
        stiffness=300.0 * x.unit(*SPRING),
        damping=2.0 * x.unit(*DAMPER),
    )
    return Scene([rod], [Pin(rod.at_start)], loads=[spring], gravity=x.gravity(*DOWN_2))


def carrier(x):
    rod = x.rod("rod", (0, 0), (1, 0), stiffness=1e8)
    load = PointMass(rod.at_end, 0.5 * x.mass)
    return Scene([rod], [Clamp(rod.at_start)], bodies=[load], gravity=x.gravity(*DOWN_2))


def spatial_cantilever(x):
    rod = x.rod("rod", (0, 0, 0), (1, 0, 0), 2, 1e8)
    return Scene([rod], [Clamp(rod.at_start)], gravity=x.gravity(*DOWN_3))


def spatial_pendulum(x):
    rod = x.rod("rod", (0, 0, 0), (1, 0, 0), 1, 1e7)
    return Scene([rod], [Spherical(rod.at_start)], gravity=x.gravity(*DOWN_3))


def spatial_rope(x):
    rod = x.rod("rod", (0, 0, 0), (1, 0, 0), 3, 1e7, (0.02, 0.02), element=CABLE_3D)
    joints = [Clamp(rod.at_start)]
    return Scene([rod], joints, gravity=x.gravity(*DOWN_3))


def rotor(x):
    inertia = [1.0 * x.unit(2, 1, 0)] * 3
    axes = x.turned(np.eye(3)).tolist()
    body = RigidBody("rod", x.at(0, 0, 0), mass=2.0 * x.mass, inertia=inertia, frame=axes)
    stiffness = [200.0 * x.unit(*SPRING)] * 3
    turning = [400.0 * x.unit(2, 1, -2)] * 3
    shaft = Bushing(body.at(0, 0, 0), stiffness, name="shaft", turn_stiffness=turning)
    frame = RotatingFrame(1.0 / x.time, x.along(0, 0, 1), x.at(0, 0, 0))
    return Scene([], [], bodies=[body], loads=[shaft], frame=frame)


SCENES = {
    make.__name__: make
    for make in (
        *(cantilever, pendulum, damped, rope, double_pendulum, column, sprung, carrier),
        *(spatial_cantilever, spatial_pendulum, spatial_rope, rotor),
    )
}
END, STEP = 2.0**-5, 2.0**-8
ENERGY, TIME, LENGTH, MASS = (2, 1, -2), (0, 0, 1), (1, 0, 0), (0, 1, 0)


@cache
def scene_at(name, place):
    return SCENES[name](place)


def design_of(name):
    """Return targets: of a size, a modulus and a place, those that the scene has."""
    beam = scene_at(name, HERE).beams[0] if scene_at(name, HERE).beams else None
    if beam is None:
        return ["rod.mass"]
    if beam.rigid:
        return ["rod.height", "rod.density", "rod.length"]
    targets = ["rod.youngs_modulus", "rod.density"]
    return targets + ([] if name == "double_pendulum" else ["rod.length"])


def energies(x):
    """Return an objective that does not depend on directions; J s."""
    return Integral(strain_energy() + 0.5 * kinetic_energy())


def scaled(result, scene, design, units):
    """Return value and b_j dpsi/db_j of a gradient, without dimension."""
    sizes = assemble(scene, design).b
    return np.append(result.value, result.gradient * sizes) / units


def back(run, x, scene):
    """Return the coordinates of a run in the frame and the unit of `HERE`."""
    parts = [run.nodes(body.name) for body in scene.members]
    turn = np.linalg.inv(x.turned(np.eye(parts[0].shape[-1])))
    states = []
    for nodes in parts:
        nodes = nodes.copy()
        # Slopes have no unit.
        nodes[:, :, 0] = nodes[:, :, 0] / x.length - x.offset
        states.append(nodes @ turn)
    return np.concatenate([each.reshape(len(run.t), -1) for each in states], axis=1)


def moved(integrator):
    def call(name, x):
        scene = scene_at(name, x)
        # Steps under error control differ: the end is compared.
        return back(simulate(scene, END * x.time, integrator(x)), x, scene)[-1]

    return call


def differentiated(integrator, method):
    def call(name, x):
        scene, design = scene_at(name, x), design_of(name)
        settings = {"design": design, "method": method}
        found = gradient(scene, energies(x), END * x.time, integrator(x), **settings)
        return scaled(found, scene, design, x.unit(*ENERGY) * x.time)

    return call


def rests(name, x):
    scene = scene_at(name, x)
    return back(equilibrium(scene).solution, x, scene)


def rest_differentiated(method):
    def call(name, x):
        scene, design = scene_at(name, x), design_of(name)
        found = equilibrium_gradient(scene, strain_energy(), design=design, method=method)
        return scaled(found, scene, design, x.unit(*ENERGY))

    return call


def vibrations(name, x):
    scene, design = scene_at(name, x), design_of(name)
    at = equilibrium(scene, design=design) if name in HELD else None
    found = modes(scene, 2, at=at, design=design)
    s = found.exponents * x.time
    return np.concatenate([np.sort(s.real), np.sort(s.imag)])


def step(name, x):
    return np.array([suggest_step(scene_at(name, x)).step / x.time])


def masses(name, x):
    found = mass_properties(scene_at(name, x))
    turn = np.linalg.inv(x.turned(np.eye(len(found.centre))))
    centre = (found.centre / x.length - x.offset) @ turn
    size = np.trace(found.inertia) / x.unit(2, 1, 0)
    return np.concatenate([[found.mass / x.mass, size], centre])


def buckling(name, x):
    scene = scene_at(name, x)
    # The load turns with the scene: a number that scales both components.
    force = x.along(-1.0, 0.0)
    load = DesignVariable(
        "P", {f"push.force_{a}": w for a, w in zip("xy", force, strict=True) if w}
    )
    found = critical_load(
        scene, load, 1000.0 * x.unit(*FORCE), design=["rod.youngs_modulus", "rod.length"]
    )
    sizes = assemble(scene, ["rod.youngs_modulus", "rod.length"]).b
    return np.append(found.value, found.gradient * sizes) / x.unit(*FORCE)


def frame(x):
    """A frame of two bars under a load on its corner, which sways."""
    post = x.rod("rod", (0, 0), (0, 1), 4, 1e9, (0.02, 0.05))
    beam = x.rod("beam", (0, 1), (1, 1), 4, 1e9, (0.02, 0.05))
    joints = [Pin(post.at_start), Weld(post.at_end, beam.at_start), Pin(beam.at_end)]
    return Scene([post, beam], joints, loads=[push(post)]), (0.2, -1.0)


def truss(x):
    """Two shallow bars, which snap through."""
    left = x.rod("rod", (-1, 0), (0, 0.05), 3, 1e9, (0.04, 0.04))
    right = x.rod("right", (0, 0.05), (1, 0), 3, 1e9, (0.04, 0.04))
    joints = [Pin(left.at_start), Pin(left.at_end, right.at_start), Pin(right.at_end)]
    return Scene([left, right], joints, loads=[push(left)]), (0.0, -1.0)


def post(x):
    """A column of beams, in the plane."""
    rod = x.rod("rod", (0, 0), (1, 0), 4, 1e9, (0.03, 0.04))
    return Scene([rod], [Clamp(rod.at_start)], loads=[push(rod)]), (-1.0, 0.0)


def spatial_post(x):
    """A column of beams, in space."""
    rod = x.rod("rod", (0, 0, 0), (1, 0, 0), 4, 1e9, (0.03, 0.04))
    return Scene([rod], [Clamp(rod.at_start)], loads=[push(rod)]), (-1.0, 0.0, 0.0)


def push(rod):
    return PointForce(rod.at_end, (0.0,) * rod.dimension, name="push")


LOADED = {make.__name__: make for make in (frame, truss, post, spatial_post)}


def critical(name, x):
    """Return a critical load and its derivatives in a modulus and a height of elastic frames."""
    scene, direction = LOADED[name](x)
    force = zip("xyz"[: len(direction)], x.along(*direction), strict=True)
    load = DesignVariable("P", {f"push.force_{a}": w for a, w in force if w})
    design = ["rod.youngs_modulus", "rod.height"]
    found = critical_load(scene, load, 1e6 * x.unit(*FORCE), design=design)
    return np.append(found.value, found.gradient * assemble(scene, design).b) / x.unit(*FORCE)


def to_a_tolerance(name, x):
    scene, design = scene_at(name, x), design_of(name)
    found = gradient(scene, energies(x), END * x.time, design=design, tolerance=1e-3)
    return scaled(found, scene, design, x.unit(*ENERGY) * x.time)


def shaft(x):
    rod = x.rod("rod", (0, 0, 0), (1, 0, 0), 4, 1e9, (0.03, 0.03))
    frame = RotatingFrame(0.0, x.along(1, 0, 0), x.at(0, 0, 0))
    return Scene([rod], [Clamp(rod.at_start)], frame=frame)


def diagram(name, x):
    scene = shaft(x) if name == "shaft" else scene_at(name, x)
    found = campbell(scene, np.array([0.0, 1.0, 2.0]) / x.time, 4)
    return np.sort(found.frequencies * x.time, axis=1).ravel()


def bars(name, x):
    scene, design = scene_at(name, x), design_of(name)
    found = error_bars(scene, energies(x), END * x.time, HHT(STEP * x.time), design=design)
    return np.array([found.value, found.value_bar]) / (x.unit(*ENERGY) * x.time)


def bar_of_one_run(name, x):
    found = estimate_adjoint_error(scene_at(name, x), energies(x), END * x.time, HHT(STEP * x.time))
    return np.array([found.value, found.error]) / (x.unit(*ENERGY) * x.time)


def derivatives_of_states(name, x):
    """Return b q_b at the end in the frame and the unit of `HERE`."""
    scene, design = scene_at(name, x), design_of(name)
    run = differentiate(scene, END * x.time, HHT(STEP * x.time), design=design)
    q_b = (run.sensitivities.q_b[-1] * assemble(scene, design).b).T
    unmoved = replace(x, offset=0.0)
    return back(replace(run, t=run.t[: len(design)], q=q_b), unmoved, scene).ravel()


def values_over_time(name, x):
    """Return energies over time to a tolerance, and at kept times of one run."""
    scene, energy = scene_at(name, x), strain_energy() + kinetic_energy()
    at = np.linspace(0.25, 1.0, 4) * END * x.time
    found = simulate(scene, END * x.time, tolerance=1e-3, observables=[energy], at=at)
    kept = record_observables(scene, [energy], END * x.time, HHT(STEP * x.time), keep=2)
    return np.concatenate([found.values.ravel(), kept.values.ravel()]) / x.unit(*ENERGY)


def many_designs(name, x):
    """Return gradients of a sweep, and values and Jacobian of responses."""
    scene, design = scene_at(name, x), design_of(name)
    settings, b = (END * x.time, HHT(STEP * x.time)), assemble(scene, design).b
    what = Evaluator(energies(x), *settings, gradient=True, design=design)
    rows = sweep(scene, np.array([b, 1.05 * b]), what, design=design).results
    both = Responses(scene, {"energy": energies(x)}, *settings, design=design, scale=b)
    ones = np.ones(len(b))
    parts = [np.append(row["value"], row["gradient"] * b) for row in rows]
    parts += [both.values(ones), both.jacobian(ones).ravel()]
    return np.concatenate(parts) / (x.unit(*ENERGY) * x.time)


def misfits(name, x):
    """Return residuals of energies over time and of frequencies, and their Jacobians."""
    scene, design = scene_at(name, x), design_of(name)
    b, energy = assemble(scene, design).b, strain_energy() + kinetic_energy()
    times, unit = np.array([0.5, 1.0]) * END * x.time, x.unit(*ENERGY)
    moving = Misfit([energy], times, np.ones((1, 2)) * unit, 1 / unit)
    fits = [moving.fit(scene, END * x.time, HHT(STEP * x.time), design=design)]
    fits += [FrequencyMisfit([5.0 / x.time], x.time).fit(scene, design=design)]
    parts = [np.append(fit.residuals(b), (fit.jacobian(b) * b).ravel()) for fit in fits]
    return np.concatenate(parts)


#: Scenes with an equilibrium near.
HELD = (
    *("cantilever", "damped", "rope", "column", "sprung", "carrier"),
    *("spatial_cantilever", "spatial_rope"),
)
ELASTIC = tuple(name for name in SCENES if name not in ("sprung", "rotor"))
#: Scenes that move.
MOVING = tuple(name for name in SCENES if name != "rotor")
CALLS = {
    "HHT": (moved(lambda x: HHT(STEP * x.time)), SCENES),
    "HHT, controlled": (moved(lambda x: HHT(rtol=1e-4)), ELASTIC[:5] + ELASTIC[6:]),
    "HHT, derivatives controlled": (
        differentiated(
            lambda x: HHT(AdaptiveSteps(1e-3, sensitivities=True)), DirectDifferentiation()
        ),
        ("pendulum", "sprung", "spatial_rope"),
    ),
    "Radau, controlled": (
        moved(lambda x: Radau(rtol=1e-4)),
        ("pendulum", "rope", "sprung", "spatial_pendulum"),
    ),
    "Radau": (moved(lambda x: Radau(STEP * x.time)), SCENES),
    "DOP853": (moved(lambda x: DOP853(1e-8)), ("pendulum", "sprung", "rotor", "rope")),
    "IDA": (moved(lambda x: IDA(1e-6)), ("pendulum", "sprung", "rope", "spatial_pendulum")),
    "direct": (differentiated(lambda x: HHT(STEP * x.time), DirectDifferentiation()), MOVING),
    "adjoint": (differentiated(lambda x: HHT(STEP * x.time), Adjoint()), MOVING[::2]),
    "adjoint of Radau": (differentiated(lambda x: Radau(STEP * x.time), Adjoint()), MOVING[::3]),
    "equilibrium": (rests, HELD),
    "static gradient": (
        rest_differentiated(DirectDifferentiation()),
        [x for x in HELD if x in ELASTIC],
    ),
    "static adjoint": (rest_differentiated(Adjoint()), [x for x in HELD if x in ELASTIC]),
    "modes": (vibrations, (*HELD, "rotor")),
    "step": (step, (*HELD, "double_pendulum")),
    "mass": (masses, SCENES),
    "critical load": (buckling, ("column",)),
    "critical loads of beams": (critical, LOADED),
    # The steps of DOP853 that the column takes turn round-off of places into 5e-7.
    "to a tolerance": (to_a_tolerance, tuple(x for x in MOVING if x != "column")),
    "derivatives of states": (derivatives_of_states, MOVING[1::2]),
    "values over time": (values_over_time, ("pendulum", "sprung", "carrier", "spatial_rope")),
    "sweep and responses": (many_designs, MOVING[::2]),
    "misfits": (misfits, ("cantilever", "carrier", "spatial_cantilever")),
    "Campbell": (diagram, ("rotor", "shaft")),
    "error bars": (bars, ("cantilever", "sprung", "spatial_rope")),
    "error from one run": (bar_of_one_run, ("cantilever", "sprung", "spatial_rope")),
}


def bound(call, place):
    """Return the largest difference allowed, the looser for IDA, here with rtol = 1e-6.

    It chooses steps and orders from a list, by numbers that round-off changes: found 4e-8. Its
    tolerances are relative to components, which a turn changes: found 9e-7, and a run errs by up to
    10 times its tolerance (docs/theory/13-errors.md).
    """
    if call != "IDA":
        return 1e-9
    return 2 * 10 * 1e-6 if place.angle else 1e-7


@cache
def known(call, name):
    return CALLS[call][0](name, HERE)


CHOOSING = ("HHT, controlled", "Radau, controlled", "DOP853", "IDA", "critical load")
CASES = [
    pytest.param(call, name, place, id=f"{call}, {name}, {place.name}")
    for call, (_, names) in CALLS.items()
    for name in names
    for place in (PLACES + ONES if call in CHOOSING else PLACES)
]


@pytest.mark.parametrize(("call", "name", "place"), CASES)
def test_the_digits_stay(call, name, place):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected, found = known(call, name), CALLS[call][0](name, place)
    error = np.max(np.abs(found - expected)) / np.max(np.abs(expected))
    assert error <= bound(call, place)
