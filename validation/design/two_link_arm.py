"""Light two-link arm: heights of its links and torques of its motors, optimised together."""

from typing import Final

import numpy as np

from ancfdae import (
    HHT,
    Adjoint,
    AtTimes,
    Beam,
    DesignVariable,
    Material,
    MotorTorque,
    Pin,
    PointMass,
    RotationDriver,
    Scene,
    SmoothMaximum,
    Terminal,
    assemble,
    gradients,
    simulate,
)
from ancfdae.extend import Joint, Load, MaterialPoint, Objective
from ancfdae.laws import SmoothStep, Spline
from ancfdae.numerics.arrays import Array
from ancfdae.observables import driver_torque, mass, maximum_von_mises, observe, position
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from ancfdae.sections import Rectangle
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Once, Optimisation, constrained, searched

_LENGTH, _WIDTH, _WEIGHT = 0.5, 0.02, 0.5  # m, m, kg of elbow motor and payload
_ALUMINIUM: Final = Material(2700.0, 7e10, 0.33, damping_time=1e-4)
_ALLOWED, _TOLERANCE = 40e6, 2e-3  # Pa, m
_SHOULDER, _ELBOW = np.pi / 3, np.pi / 6
_TARGET: Final = (0.5 * _LENGTH, (np.sqrt(0.75) + 1.0) * _LENGTH)
_TIP: Final = MaterialPoint("lower", 1.0)
_LINKS, _MOTORS = ("upper", "lower"), ("shoulder", "elbow")
_MANOEUVRE = 0.5  # s
_INSTANTS: Final = (0.5, 0.55, 0.6)
_CONTROLS: Final = (0.0, 0.125, 0.25, 0.375, 0.5)
# Sharpness k of the smooth maxima of quantities divided by their limits; dimensionless.
_SHARPNESS: Final = 50.0


def arm(elements: int, driven: bool = False) -> Scene:
    """Return the arm, straight and at rest; `driven` on a given path, or else by torques."""
    upper = Beam("upper", (0, 0), (_LENGTH, 0), elements, Rectangle(0.02, _WIDTH), _ALUMINIUM)
    # Placed by a point of another, a beam has its end relative to it.
    reach = (_LENGTH, 0)
    lower = Beam("lower", upper.at_end, reach, elements, Rectangle(0.02, _WIDTH), _ALUMINIUM)
    joints: list[Joint] = [Pin(upper.at_start), Pin(upper.at_end, lower.at_start)]
    loads: list[Load] = []
    if driven:
        path, more = (SmoothStep(0.0, angle, _MANOEUVRE) for angle in (_SHOULDER, _ELBOW))
        joints.append(RotationDriver(upper.at_start, path, name="shoulder"))
        joints.append(RotationDriver(lower.at_start, more, other=upper.at_end, name="elbow"))
    else:
        law = Spline(_CONTROLS, [0.0] * len(_CONTROLS))
        loads.append(MotorTorque(upper.at_start, 1.0, name="shoulder", law=law))
        loads.append(MotorTorque(lower.at_start, 1.0, other=upper.at_end, name="elbow", law=law))
    weights = [PointMass(point, _WEIGHT) for point in (lower.at_start, lower.at_end)]
    return Scene([upper, lower], joints, loads=loads, bodies=weights)


def torques(elements: int, step: float) -> Array:
    """Return what motors on the given path exert at the inner control times, N m."""
    system = assemble(arm(elements, driven=True))
    solution = simulate(system, _MANOEUVRE, HHT(step))
    exerted = [observe(driver_torque(name), solution, system) for name in ("shoulder", "elbow")]
    return np.concatenate([np.interp(_CONTROLS[1:-1], solution.t, each) for each in exerted])


def evaluation(elements: int, step: float, driven: bool = False) -> Once:
    """Return mass, kg, then stresses and misses of the tip over what is allowed.

    Variables: heights of the links, cm, and, unless `driven` on the given path, torques at the
    inner control times, 10 N m.
    """
    design = [DesignVariable(f"{link} height", [f"{link}.height"]) for link in _LINKS]
    if not driven:
        inner = range(1, len(_CONTROLS) - 1)
        design += [DesignVariable(f"{m} {k}", [f"{m}.value[{k}]"]) for m in _MOTORS for k in inner]
    unit = np.array([1e-2] * 2 + [10.0] * (len(design) - 2))
    system = assemble(arm(elements, driven), design)
    stresses = [maximum_von_mises(link, _SHARPNESS / _ALLOWED) / _ALLOWED for link in _LINKS]
    misses = [(position(_TIP, i) - _TARGET[i]) / _TOLERANCE for i in (0, 1)]
    asked: list[Objective] = [Terminal(mass("upper") + mass("lower"))]
    asked += [SmoothMaximum(stress, _SHARPNESS) for stress in stresses]
    asked += [AtTimes(miss, instant) for instant in _INSTANTS for miss in misses]

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        moved = system.with_values(unit * x)
        results = gradients(moved, asked, _INSTANTS[-1], HHT(step), method=Adjoint())
        values = np.array([g.value for g in results])
        slopes = unit * np.array([g.gradient for g in results])
        # The tip may miss to either side.
        return np.append(values, -values[3:]), np.vstack([slopes, -slopes[3:]])

    return evaluate


def optimise(elements: int, step: float, iterations: int) -> Optimisation:
    """Find heights and torques for the least mass, from links of 2 cm on the given path."""
    start = np.concatenate([[2.0, 2.0], torques(elements, step) / 10])
    bounds = [(0.3, 5.0)] * 2 + [(-10.0, 10.0)] * (len(start) - 2)
    return constrained(evaluation(elements, step), start, bounds, 0.5, iterations, 1e-6)


def two_link_arm(quick: bool) -> Case:
    """Return the case of the two-link arm; coarse and short if `quick`."""
    elements, step, iterations = (1, 0.00625, 1) if quick else (2, 0.00625, 100)
    found = optimise(elements, step, iterations)
    search = found if quick else searched(found.evaluate, found.optimum, 0.05, 40, found.bounds)
    path = evaluation(elements, step, driven=True)
    given = searched(path, [2.0, 2.0], 0.2, 6 if quick else 40, [(0.3, 5.0)] * 2)
    return Case(
        key="two-link-arm",
        title="Light two-link arm, links and torques together",
        method="SLSQP in boxes",
        variables=[f"height of the {link} link [cm]" for link in _LINKS]
        + [f"torque {k} of the {motor} [10 N m]" for motor in _MOTORS for k in (1, 2, 3)],
        responses=_responses(),
        found=found,
        comparisons=[
            Comparison.with_search("mass [kg]", found, search, 1e-3),
            Comparison(
                "mass off the given path [kg]",
                float(found.evaluate(found.optimum)[0][0]),
                float(given.evaluate(given.optimum)[0][0]),
                f"motors on the given path, heights by COBYQA, {given.runs} runs",
                0.0,
                lower=True,
            ),
        ],
        panels=_panels(found, given, elements, step),
        findings=_findings(found, elements, step),
    )


def _responses() -> list[Response]:
    stresses = [Response(f"stress in the {link} link over 40 MPa", "-", 1.0) for link in _LINKS]
    misses = [
        Response(f"tip {side} its target in {i} at {instant:g} s, over 2 mm", "-", 1.0)
        for side in ("above", "below")
        for instant in _INSTANTS
        for i in "xy"
    ]
    return [Response("mass", "kg"), *stresses, *misses]


def _moved(x: Array, elements: int, step: float, driven: bool = False) -> tuple[Scene, Solution]:
    """Return scene and motion at what `evaluation` calls x."""
    names = [f"{link}.height" for link in _LINKS]
    names += [f"{motor}.value[{k}]" for motor in _MOTORS for k in (1, 2, 3)][: len(x) - 2]
    sizes = np.array([1e-2] * 2 + [10.0] * (len(x) - 2))
    values = dict[str | DesignVariable, float](zip(names, (sizes * x).tolist(), strict=True))
    scene = arm(elements, driven).with_values(values)
    return scene, simulate(scene, _INSTANTS[-1], HHT(step))


def _panels(found: Optimisation, given: Optimisation, elements: int, step: float) -> list[Panel]:
    _, optimum = _moved(found.optimum, elements, step)
    scene, led = _moved(given.optimum, elements, step, driven=True)
    points = [MaterialPoint(link, s) for link in _LINKS for s in np.linspace(0, 1, 5)]
    arms = []
    for time in (0.0, 0.125, 0.25, 0.375, 0.5):
        at = optimum.at([time])
        x, y = np.array([at.position(point)[0] for point in points]).T
        arms.append(Series(f"{time:g} s", x, y))
    t = np.linspace(0, _INSTANTS[-1], 121)
    controls = 10 * found.optimum[2:].reshape(2, 3)
    exerted = []
    for motor, inner in zip(_MOTORS, controls, strict=True):
        law = Spline(_CONTROLS, [0.0, *inner.tolist(), 0.0])
        torque = [float(law.derivative(np.array(law.values), time, 0)) for time in t]
        exerted.append(Series(f"{motor}, optimum", t, torque))
        torque_led = observe(driver_torque(motor), led, assemble(scene))
        exerted.append(Series(f"{motor}, given path", led.t, torque_led))
    return [
        Panel("Optimal arm on its way", "x [m]", "y [m]", arms),
        Panel("Torques of the motors", "t [s]", "torque [N m]", exerted),
    ]


def _findings(found: Optimisation, elements: int, step: float) -> str:
    _, solution = _moved(found.optimum, elements, step)
    after = solution.t >= _MANOEUVRE - 0.5 * step
    miss = np.linalg.norm(solution.position(_TIP)[after] - np.array(_TARGET), axis=1)
    return (
        f"The tip stays within {1e3 * np.max(miss):.2g} mm of its target for the tenth of a second "
        "after the manoeuvre, also between the three instants. The motors may deviate from the "
        "path, and so start and stop the links more gently than any links on the path can be."
    )
