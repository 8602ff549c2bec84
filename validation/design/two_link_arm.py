"""Light two-link arm: heights of its links and torques of its motors, optimised together."""

from typing import Final

import numpy as np

from ancfdae import (
    HHT,
    Adjoint,
    AtTimes,
    Beam,
    DesignVariable,
    Drive,
    Joint,
    Load,
    Material,
    Pin,
    Point,
    PointMass,
    Ramp,
    Rectangle,
    Scene,
    SmoothMaximum,
    Spline,
    Terminal,
    Torque,
    assemble,
    distribution,
    drive_torque,
    gradients,
    mass,
    maximum_stress,
    observe,
    position,
    simulate,
)
from ancfdae.plotting import Panel, Series
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Array, Once, Optimisation, constrained, searched

__all__ = ["two_link_arm"]

_LENGTH, _WIDTH, _WEIGHT = 0.5, 0.02, 0.5  # m, m, kg of elbow motor and payload
_ALUMINIUM: Final = Material(2700.0, 7e10, 0.33, damping_time=1e-4)
_ALLOWED, _TOLERANCE = 40e6, 2e-3  # Pa, m
_SHOULDER, _ELBOW = np.pi / 3, np.pi / 6
_TARGET: Final = (0.5 * _LENGTH, (np.sqrt(0.75) + 1.0) * _LENGTH)
_TIP: Final = Point("lower", 1.0)
_MANOEUVRE = 0.5  # s
_INSTANTS: Final = (0.5, 0.55, 0.6)
_CONTROLS: Final = (0.0, 0.125, 0.25, 0.375, 0.5)
# Of the smooth maxima, of what is 1 where it is all that is allowed.
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
        path, more = (Ramp(0.0, angle, _MANOEUVRE) for angle in (_SHOULDER, _ELBOW))
        joints.append(Drive(upper.at_start, path, name="shoulder"))
        joints.append(Drive(lower.at_start, more, other=upper.at_end, name="elbow"))
    else:
        law = Spline(_CONTROLS, [0.0] * len(_CONTROLS))
        loads.append(Torque(upper.at_start, 1.0, name="shoulder", law=law))
        loads.append(Torque(lower.at_start, 1.0, other=upper.at_end, name="elbow", law=law))
    weights = [PointMass(point, _WEIGHT) for point in (lower.at_start, lower.at_end)]
    return Scene([upper, lower], joints, loads=loads, bodies=weights)


def torques(elements: int, step: float) -> Array:
    """Return what motors on the given path exert at the inner control times, N m."""
    system = assemble(arm(elements, driven=True))
    solution = simulate(system, _MANOEUVRE, HHT(step))
    exerted = [observe(drive_torque(name), solution, system) for name in ("shoulder", "elbow")]
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
    stresses = [maximum_stress(link, _SHARPNESS / _ALLOWED) / _ALLOWED for link in _LINKS]
    misses = [(position(_TIP, i) - _TARGET[i]) / _TOLERANCE for i in (0, 1)]
    asked = [Terminal(mass("upper") + mass("lower"))]
    asked += [SmoothMaximum(stress, _SHARPNESS) for stress in stresses]
    asked += [AtTimes(miss, instant) for instant in _INSTANTS for miss in misses]

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        moved = system.with_values(unit * x)
        found = gradients(moved, asked, _INSTANTS[-1], HHT(step), method=Adjoint())
        values = np.array([g.value for g in found])
        slopes = unit * np.array([g.gradient for g in found])
        # The tip may miss to either side.
        return np.append(values, -values[3:]), np.vstack([slopes, -slopes[3:]])

    return evaluate


def optimise(elements: int, step: float, iterations: int) -> Optimisation:
    """Find heights and torques for the least mass, from links of 2 cm on the given path."""
    start = np.concatenate([[2.0, 2.0], torques(elements, step) / 10])
    bounds = [(0.3, 5.0)] * 2 + [(-10.0, 10.0)] * (len(start) - 2)
    return constrained(evaluation(elements, step), start, bounds, 0.5, iterations, 1e-6)


def two_link_arm(quick: bool) -> Case:
    """Return the case."""
    elements, step, iterations = (1, 0.025, 2) if quick else (2, 0.00625, 100)
    found = optimise(elements, step, iterations)
    search = searched(found.evaluate, found.optimum, 0.05, 19 if quick else 60, found.bounds)
    path = evaluation(elements, step, driven=True)
    given = searched(path, [2.0, 2.0], 0.2, 8 if quick else 60, [(0.3, 5.0)] * 2)
    return Case(
        key="two-link-arm",
        title="Light two-link arm, links and torques together",
        question=_QUESTION,
        method="SLSQP in boxes",
        variables=[f"height of the {link} link [cm]" for link in _LINKS]
        + [f"torque {k} of the {motor} [10 N m]" for motor in _MOTORS for k in (1, 2, 3)],
        responses=_responses(),
        found=found,
        comparisons=[
            Comparison.with_search("mass [kg]", found, search, 1e-3),
            Comparison(
                "the same [kg]",
                float(found.evaluate(found.optimum)[0][0]),
                float(given.evaluate(given.optimum)[0][0]),
                f"motors on the given path, heights by COBYQA, {given.runs} runs",
                0.0,
                lower=True,
            ),
        ],
        panels=_panels(found, given, elements, step),
        caption="The arm on its way, at every tenth of a second, and torques of both motors.",
        findings=_findings(found, given, elements, step),
    )


def _responses() -> list[Response]:
    names = [f"{i} of the tip at {instant:g} s" for instant in _INSTANTS for i in "xy"]
    stresses = [Response(f"stress in the {link} link over 40 MPa", "-", 1.0) for link in _LINKS]
    misses = [
        Response(f"{sign}miss in {name} over 2 mm", "-", 1.0) for sign in ("", "-") for name in names
    ]
    return [Response("mass", "kg"), *stresses, *misses]


def _moved(x: Array, elements: int, step: float, driven: bool = False) -> tuple[Scene, Solution]:
    """Return the motion at what `evaluation` calls x, half a second longer than the manoeuvre."""
    names = [f"{link}.height" for link in _LINKS]
    names += [f"{motor}.value[{k}]" for motor in _MOTORS for k in (1, 2, 3)]
    unit = np.array([1e-2] * 2 + [10.0] * 6)[: len(x)]
    values = {name: float(value) for name, value in zip(names, unit * x, strict=False)}
    scene = arm(elements, driven).with_values(values)
    return scene, simulate(scene, 2 * _MANOEUVRE, HHT(step))


def _panels(
    found: Optimisation, given: Optimisation, elements: int, step: float
) -> list[Panel]:
    _, solution = _moved(found.optimum, elements, step)
    arms = []
    points = [Point(link, s) for link in _LINKS for s in np.linspace(0, 1, 5)]
    for time in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5):
        at = solution.at([time])
        arms.append(Series(f"{time:g} s", *np.array([at.position(p)[0] for p in points]).T))
    exerted = []
    for name, x, driven in (("optimum", found.optimum, False), ("given path", given.optimum, True)):
        scene, run = _moved(x, elements, step, driven)
        for motor in _MOTORS:
            torque = _torque(scene, run, motor, driven)
            shown = run.t <= _INSTANTS[-1] + step / 2
            exerted.append(Series(f"{motor}, {name}", run.t[shown], torque[shown]))
    return [
        Panel("Arm of the optimum on its way", "x [m]", "y [m]", arms),
        Panel("Torques of the motors", "t [s]", "torque [N m]", exerted),
    ]
