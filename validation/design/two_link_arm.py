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
_ALLOWED, _TOLERANCE = 40e6, 1e-3  # Pa, m
_MANOEUVRE, _KNOTS = 0.5, 6  # s
_INSTANTS: Final = (0.5, 0.55, 0.6)  # s
_TIP: Final = Point("lower", 1.0)
_SHOULDER, _ELBOW = np.pi / 3, np.pi / 6
_TARGET: Final = (0.5 * _LENGTH, _LENGTH * (np.sqrt(0.75) + 1.0))
_TIMES: Final = tuple(float(t) for t in np.linspace(0, _MANOEUVRE, _KNOTS + 1))


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
        law = Spline(_TIMES, [0.0] * len(_TIMES))
        loads.append(Torque(upper.at_start, 1.0, name="shoulder", law=law))
        loads.append(Torque(lower.at_start, 1.0, other=upper.at_end, name="elbow", law=law))
    weights = [PointMass(point, _WEIGHT) for point in (lower.at_start, lower.at_end)]
    return Scene([upper, lower], joints, loads=loads, bodies=weights)


def torques(elements: int, step: float) -> Array:
    """Return what motors on the given path need at the control times between; (2 n,), N m."""
    system = assemble(arm(elements, driven=True))
    solution = simulate(system, _MANOEUVRE, HHT(step))
    needed = [observe(drive_torque(name), solution, system) for name in ("shoulder", "elbow")]
    return np.concatenate([np.interp(_TIMES[1:-1], solution.t, each) for each in needed])


def evaluation(elements: int, step: float) -> Once:
    """Return mass, kg, then the misses of the tip and the stresses over what is allowed.

    Variables: heights of the elements, cm, and control values of the torques, 10 N m.
    """
    heights = [*distribution("upper.height", elements), *distribution("lower.height", elements)]
    controls = [
        DesignVariable(f"{motor} {k}", [f"{motor}.value[{k}]"])
        for motor in ("shoulder", "elbow")
        for k in range(1, _KNOTS)
    ]
    unit = np.array([1e-2] * len(heights) + [10.0] * len(controls))
    system = assemble(arm(elements), [*heights, *controls])
    misses = [
        AtTimes((position(_TIP, i) - _TARGET[i]) / _TOLERANCE, instant)
        for instant in _INSTANTS
        for i in (0, 1)
    ]
    sharpness = 50 / _ALLOWED
    stresses = [
        SmoothMaximum(maximum_stress(link, sharpness), sharpness) / _ALLOWED
        for link in ("upper", "lower")
    ]
    asked = [Terminal(mass("upper") + mass("lower")), *misses, *stresses]

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        moved = system.with_values(unit * x)
        found = gradients(moved, asked, _INSTANTS[-1], HHT(step), method=Adjoint())
        values = np.array([g.value for g in found])
        slopes = unit * np.array([g.gradient for g in found])
        n = len(misses) + 1
        # The tip may miss to either side.
        return np.append(values, -values[1:n]), np.vstack([slopes, -slopes[1:n]])

    return evaluate


def optimise(elements: int, step: float, iterations: int) -> Optimisation:
    """Find heights and torques for the least mass, from links 2 cm high on a given path."""
    evaluate = evaluation(elements, step)
    start = np.concatenate([np.full(2 * elements, 2.0), torques(elements, step) / 10])
    bounds = [(0.3, 5.0)] * (2 * elements) + [(-10.0, 10.0)] * (len(start) - 2 * elements)
    return constrained(evaluate, start, bounds, 0.3, iterations)
