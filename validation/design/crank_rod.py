"""Lightest connecting rod of a slider-crank under a stress limit."""

from typing import Final

import numpy as np
from scipy.optimize import brentq, minimize

from ancfdae import (
    HHT,
    Adjoint,
    AncfSystem,
    Beam,
    Circle,
    DesignVariable,
    Drive,
    Material,
    Pin,
    Point,
    PointMass,
    PointOnLine,
    RigidBody,
    RigidMotion,
    Scene,
    SmoothMaximum,
    Solution,
    Terminal,
    Uniform,
    assemble,
    distribution,
    gradients,
    mass,
    maximum_stress,
    observe,
    simulate,
)
from ancfdae.plotting import Panel, Series
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Array, Once, Optimisation, stopwatch

__all__ = ["crank_rod"]

# Jonker's slider-crank: lengths, speed, steel, rod of 6 mm, slider of half its mass.
_CRANK, _ROD, _SPEED, _SLIDER = 0.15, 0.30, 150.0, 0.033
_STEEL: Final = Material(7870.0, 2e11, 0.3, damping_time=1e-5)
_RADIUS = 3.0  # mm
_START = 5.0  # mm
_ALLOWED = 150e6  # Pa
_JONKER: Final = 7870.0 * np.pi * 0.003**2 * _ROD  # kg


def slider_crank(elements: int) -> Scene:
    """Return the mechanism with the rod of 6 mm in Jonker's initial motion."""
    crank = RigidBody("crank", (0, 0), mass=0.1, inertia=1e-3)
    rod = Beam("rod", (_CRANK, 0), (_CRANK + _ROD, 0), elements, Circle(1e-3 * _RADIUS), _STEEL)
    return Scene(
        beams=[rod],
        bodies=[crank, PointMass(rod.at_end, _SLIDER)],
        joints=[
            Pin(crank.origin),
            Drive(crank.origin, Uniform(_SPEED), name="motor"),
            Pin(crank.at(_CRANK, 0), rod.at_start),
            PointOnLine(rod.at_end, direction=(1, 0)),
        ],
        start=[
            RigidMotion("crank", _SPEED, about=(0, 0)),
            RigidMotion("rod", -_SPEED * _CRANK / _ROD, about=(_CRANK + _ROD, 0)),
        ],
    )


def optimise(elements: int, steps: int, start: Array, iterations: int = 40) -> Optimisation:
    """Find x, the logarithms of the radii in mm, for the least mass under a stress limit.

    One radius per element, or a single one if `start` has one. Mass and stress are logarithms,
    too: both are nearly linear in x, which SLSQP likes.
    """
    t_end = 2 * np.pi / _SPEED
    integrator = HHT(t_end / steps)
    sharpness = 50 / _ALLOWED
    stress = SmoothMaximum(maximum_stress("rod", sharpness), sharpness)
    # SLSQP takes the unit matrix for curvature at first: the factor keeps its steps within 5 %.
    lightness = 0.1 * np.log(Terminal(mass("rod")) / _JONKER)
    responses = [lightness, np.log(stress / _ALLOWED)]
    uniform = len(start) == 1
    one, each = DesignVariable("radius", ["rod.radius"]), distribution("rod.radius", elements)
    system = assemble(slider_crank(elements), [one] if uniform else each)

    def run(x: Array) -> tuple[Array, Array]:
        radii = 1e-3 * np.exp(x)
        moved = system.with_values(radii)
        found = gradients(moved, responses, t_end, integrator, method=Adjoint())
        return np.array([g.value for g in found]), np.array([g.gradient for g in found]) * radii

    evaluate, clock = Once(run), stopwatch()
    bounds = [(np.log(2.5), np.log(9.0))] * len(start)
    result = minimize(
        lambda x: evaluate(x)[0][0],
        start,
        jac=lambda x: evaluate(x)[1][0],
        method="SLSQP",
        bounds=bounds,
        constraints={
            "type": "ineq",
            "fun": lambda x: -evaluate(x)[0][1:],
            "jac": lambda x: -evaluate(x)[1][1:],
        },
        options={"maxiter": iterations, "ftol": 1e-7},
    )
    return Optimisation.of(evaluate, start, result, clock(), bounds)


def crank_rod(quick: bool) -> Case:
    """Return the case; the search without gradients has the uniform rod, of one variable."""
    elements, steps, iterations = (2, 60, 1) if quick else (6, 150, 40)
    start = np.full(elements, np.log(_START))
    found = optimise(elements, steps, start, iterations)
    uniform = optimise(elements, steps, start[:1], iterations)
    searched = _searched(uniform, iterations)
    return Case(
        key="crank-rod",
        title="Lightest connecting rod of a slider-crank",
        question=_QUESTION,
        method="SLSQP",
        variables=[f"ln(radius {k}/mm)" for k in range(elements)],
        responses=[
            Response("ln of mass over that of the rod of 6 mm, over 10", "-"),
            Response("ln of stress over what is allowed", "-", 0.0),
        ],
        found=found,
        comparisons=[
            Comparison(
                "radius of the lightest uniform rod [mm]",
                float(np.exp(uniform.optimum[0])),
                searched,
                "root of the stress by Brent's method, without gradients",
                1e-3,
            ),
            Comparison(
                "mass, in that of the rod of 6 mm",
                _mass(found),
                (searched / _RADIUS) ** 2,
                "the uniform rod of that radius",
                0.0,
                lower=True,
            ),
        ],
        panels=_panels(found, searched, elements, steps),
        caption="The motion after a quarter of a turn, with the rod at its optimum, and the radii.",
        findings=_findings(_mass(found), (searched / _RADIUS) ** 2, found, elements, steps),
        sizes=np.ones(elements),
    )


def _mass(found: Optimisation) -> float:
    return float(np.exp(10 * found.evaluate(found.optimum)[0][0]))


def _searched(uniform: Optimisation, iterations: int) -> float:
    """Return the radius at which the uniform rod has the stress allowed; mm."""

    def excess(x: float) -> float:
        return float(uniform.evaluate(np.array([x]))[0][1])

    low, high = np.log(4.0), np.log(9.0)
    return float(np.exp(brentq(excess, low, high, xtol=1e-5, maxiter=max(iterations, 20))))


def _moved(found: Optimisation, elements: int, steps: int) -> tuple[AncfSystem, Solution]:
    system = assemble(slider_crank(elements), distribution("rod.radius", elements))
    system = system.with_values(1e-3 * np.exp(found.optimum))
    t_end = 2 * np.pi / _SPEED
    return system, simulate(system, t_end, HHT(t_end / steps))


def _panels(found: Optimisation, uniform: float, elements: int, steps: int) -> list[Panel]:
    _, solution = _moved(found, elements, steps)
    row = len(solution.t) // 4
    s = np.linspace(0, 1, 2 * elements + 1)
    x, y = np.array([solution.position(Point("rod", each))[row] for each in s]).T
    series = [
        Series("crank", [0, x[0]], [0, y[0]], marker=True),
        Series("rod", x, y, marker=True),
    ]
    ends = np.linspace(0, _ROD, elements + 1)
    along = np.repeat(ends, 2)[1:-1]
    radii = [
        Series("start", along, np.full(2 * elements, _START)),
        Series("lightest uniform rod", along, np.full(2 * elements, uniform)),
        Series("optimum", along, np.repeat(np.exp(found.optimum), 2)),
    ]
    return [
        Panel("Mechanism", "x [m]", "y [m]", series),
        Panel("Radius along the rod", "from the crank pin [m]", "radius [mm]", radii),
    ]


def _findings(
    mass_found: float, mass_uniform: float, found: Optimisation, elements: int, steps: int
) -> str:
    system, solution = _moved(found, elements, steps)
    # Sharper than in the optimisation: within 1 % of the largest stress at any place.
    largest = float(np.max(observe(maximum_stress("rod", 500 / _ALLOWED), solution, system)))
    return (
        f"The rod weighs {mass_found / mass_uniform:.3f} times the lightest uniform one. Its "
        f"largest stress at any place and instant is {largest / _ALLOWED:.3f} times that allowed: "
        "the smooth maximum exceeds the largest over the places, and is less than that over time."
    )


_QUESTION = """
*After*: J. B. Jonker, *Comput. Methods Appl. Mech. Engrg.* 76 (1989) 297-319: a crank of 0.15 m
turns at 150 rad/s, a steel rod of 0.3 m and 6 mm diameter drives a slider of 0.033 kg, and the
rod starts straight, with the velocities of a rigid mechanism. He asked for its vibration; here it
is turned to the lightest rod: one radius per element, von Mises' stress at most 150 MPa over rod
and one turn, as a smooth maximum (Kreisselmeier and Steinhauser). No optimum of
this rod was found in print, so it is held against the uniform rod, found without gradients.
Damping is 1e-5 s (Kelvin-Voigt).
"""
