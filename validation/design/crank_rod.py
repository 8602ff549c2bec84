"""Lightest connecting rod of a slider-crank under limits of stress and deflection."""

from typing import Final

import numpy as np
from scipy.optimize import brentq

from ancfdae import (
    HHT,
    Adjoint,
    Beam,
    DesignVariable,
    InitialVelocity,
    Material,
    Pin,
    PointMass,
    PointOnLine,
    RigidBody,
    RotationDriver,
    Scene,
    SmoothMaximum,
    Terminal,
    assemble,
    distributed_variables,
    gradients,
    simulate,
)
from ancfdae.extend import MaterialPoint, Observable
from ancfdae.laws import ConstantAcceleration
from ancfdae.numerics.arrays import Array
from ancfdae.observables import mass, maximum_von_mises, observe, position
from ancfdae.plotting import Panel, Series
from ancfdae.results import AncfSystem, Solution
from ancfdae.sections import Circle
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Once, Optimisation, constrained, searched
from validation.drawing import dots

# Jonker's slider-crank: lengths, speed, steel, rod of 6 mm, slider of half its mass.
_CRANK, _ROD, _SPEED, _SLIDER = 0.15, 0.30, 150.0, 0.033
_STEEL: Final = Material(7870.0, 2e11, 0.3, damping_time=1e-5)
_RADIUS = 3.0  # mm
_START = 5.0  # mm
_ALLOWED, _SAG = 150e6, 1.4e-3  # Pa, m
# Sharpness k of the smooth maxima of quantities divided by their limits; dimensionless.
_SHARPNESS: Final = 50.0
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
            RotationDriver(crank.origin, ConstantAcceleration(_SPEED), name="motor"),
            Pin(crank.at(_CRANK, 0), rod.at_start),
            PointOnLine(rod.at_end, direction=(1, 0)),
        ],
        start=[
            InitialVelocity("crank", _SPEED, about=(0, 0)),
            InitialVelocity("rod", -_SPEED * _CRANK / _ROD, about=(_CRANK + _ROD, 0)),
        ],
    )


def sag() -> Observable:
    """Return how far the middle of the rod is from the line through its ends; m."""
    pin, middle, slider = (MaterialPoint("rod", s) for s in (0.0, 0.5, 1.0))
    (e_x, e_y), (m_x, m_y) = (
        [position(point, i) - position(pin, i) for i in (0, 1)] for point in (slider, middle)
    )
    return (e_x * m_y - e_y * m_x) / _ROD


def evaluation(elements: int, steps: int, uniform: bool = False) -> Once:
    """Return mass over that of the rod of 6 mm, stress and sag over what is allowed.

    Variables: radii of the elements, mm; a single one of all if `uniform`.
    """
    t_end = 2 * np.pi / _SPEED
    one, each = (
        DesignVariable("radius", ["rod.radius"]),
        distributed_variables("rod.radius", elements),
    )
    system = assemble(slider_crank(elements), [one] if uniform else each)
    stress = maximum_von_mises("rod", _SHARPNESS / _ALLOWED) / _ALLOWED
    asked = [
        Terminal(mass("rod")) / _JONKER,
        SmoothMaximum(stress, _SHARPNESS),
        SmoothMaximum((sag() / _SAG) ** 2, _SHARPNESS) ** 0.5,
    ]

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        moved = system.with_values(1e-3 * x)
        results = gradients(moved, asked, t_end, HHT(t_end / steps), method=Adjoint())
        return np.array([g.value for g in results]), 1e-3 * np.array([g.gradient for g in results])

    return evaluate


def optimise(elements: int, steps: int, iterations: int) -> Optimisation:
    """Find the radii for the least mass within both limits, by at most 1 mm at a time."""
    start, bounds = np.full(elements, _START), [(2.0, 9.0)] * elements
    return constrained(evaluation(elements, steps), start, bounds, 1.0, iterations)


def crank_rod(quick: bool) -> Case:
    """Return the case of the connecting rod; coarse and short if `quick`."""
    elements, steps, iterations = (2, 60, 2) if quick else (6, 150, 60)
    found = optimise(elements, steps, iterations)
    search = searched(found.evaluate, found.start, 0.3, 5 if quick else 150, found.bounds)
    radius = _lightest_uniform(elements, steps)
    lightest = float(found.evaluate(found.optimum)[0][0])
    return Case(
        key="crank-rod",
        title="Lightest connecting rod of a slider-crank",
        method="SLSQP in boxes",
        variables=[f"radius {k} [mm]" for k in range(elements)],
        responses=[
            Response("mass over that of the rod of 6 mm", "-"),
            Response("stress over 150 MPa", "-", 1.0),
            Response("sag over 1.4 mm", "-", 1.0),
        ],
        found=found,
        comparisons=[
            Comparison.with_search("mass over that of the rod of 6 mm", found, search, 1e-3),
            Comparison(
                "mass over that of the rod of 6 mm, not uniform",
                lightest,
                (radius / _RADIUS) ** 2,
                f"the lightest uniform rod, of {radius:.3f} mm",
                0.0,
                lower=True,
            ),
        ],
        panels=_panels(found, radius, elements, steps),
        findings=_findings(lightest / (radius / _RADIUS) ** 2, found, elements, steps),
    )


def _lightest_uniform(elements: int, steps: int) -> float:
    """Return the radius at which the uniform rod just keeps both limits; mm."""
    evaluate = evaluation(elements, steps, uniform=True)
    return float(brentq(lambda r: np.max(evaluate([r])[0][1:]) - 1, 4.0, 9.0, xtol=1e-4))


def _moved(found: Optimisation, elements: int, steps: int) -> tuple[AncfSystem, Solution]:
    system = assemble(slider_crank(elements), distributed_variables("rod.radius", elements))
    system = system.with_values(1e-3 * found.optimum)
    t_end = 2 * np.pi / _SPEED
    return system, simulate(system, t_end, HHT(t_end / steps))


def _panels(found: Optimisation, uniform: float, elements: int, steps: int) -> list[Panel]:
    _, solution = _moved(found, elements, steps)
    row = len(solution.t) // 4
    s = np.linspace(0, 1, 2 * elements + 1)
    x, y = np.array([solution.position(MaterialPoint("rod", each))[row] for each in s]).T
    series = [
        Series("crank", [0, x[0]], [0, y[0]], marker=True),
        Series("rod", x, y),
        dots("slider", [x[-1]], [y[-1]]),
    ]
    along = np.repeat(np.linspace(0, _ROD, elements + 1), 2)[1:-1]
    radii = [
        Series("lightest uniform rod", along, np.full(2 * elements, uniform)),
        Series("optimum", along, np.repeat(found.optimum, 2)),
    ]
    return [
        Panel("Mechanism", "x [m]", "y [m]", series),
        Panel("Radius along the rod", "from the crank pin [m]", "radius [mm]", radii),
    ]


def _findings(ratio: float, found: Optimisation, elements: int, steps: int) -> str:
    system, solution = _moved(found, elements, steps)
    # Sharper than in the optimisation: within 1 % of the largest stress at any place.
    stress = maximum_von_mises("rod", 10 * _SHARPNESS / _ALLOWED)
    largest = float(np.max(observe(stress, solution, system))) / _ALLOWED
    sags = observe(sag(), solution, system)
    furthest = float(np.max(np.abs(sags))) / _SAG
    return (
        f"The rod weighs {ratio:.3f} times the lightest uniform one: thick in the middle, thin at "
        f"its pins. Its largest stress at any place and instant is {largest:.3f}, its largest sag "
        f"{furthest:.3f} times that allowed: the smooth maximum exceeds the largest over the "
        "places, and is less than that over time."
    )
