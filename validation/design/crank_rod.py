"""Lightest connecting rod of a slider-crank under a stress limit."""

from typing import Final

import numpy as np
from scipy.optimize import minimize

from ancfdae import (
    HHT,
    Adjoint,
    AncfSystem,
    Beam,
    Circle,
    Drive,
    Material,
    Pin,
    PointMass,
    PointOnLine,
    RigidBody,
    RigidMotion,
    Scene,
    SmoothMaximum,
    Terminal,
    Uniform,
    assemble,
    distribution,
    gradients,
    mass,
    maximum_stress,
    observe,
    position,
    simulate,
)
from ancfdae.plotting import Panel, Series
from validation.design.case import Case, Comparison, Response
from validation.design.optimisation import Array, Once, Optimisation, stopwatch

__all__ = ["crank_rod"]

# Jonker's slider-crank: lengths, speed, steel, rod of 6 mm, slider of half its mass.
_CRANK, _ROD, _SPEED, _SLIDER = 0.15, 0.30, 150.0, 0.033
_STEEL: Final = Material(7870.0, 2e11, 0.3)
_RADIUS = 3.0  # mm
_TURNS = 2
_ALLOWED = 150e6  # Pa
_SAG = 3e-3  # m


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


def optimise(elements: int, steps: int, start: Array, iterations: int = 60) -> Optimisation:
    """Find radii of the elements, in mm, for the least mass over that of 6 mm, at a stress of at most 1."""
    t_end = _TURNS * 2 * np.pi / _SPEED
    sharpness = 50 / _ALLOWED
    stress = SmoothMaximum(maximum_stress("rod", sharpness), sharpness) * (1 / _ALLOWED)
    lightness = Terminal(mass("rod") * (1 / 0.066756))
    system = assemble(slider_crank(elements), distribution("rod.radius", elements))

    @Once
    def evaluate(x: Array) -> tuple[Array, Array]:
        moved = system.with_values(1e-3 * x)
        found = gradients(moved, [lightness, stress], t_end, HHT(t_end / steps), method=Adjoint())
        return np.array([g.value for g in found]), 1e-3 * np.array([g.gradient for g in found])

    bounds, clock = [(1.5, 6.0)] * elements, stopwatch()
    result = minimize(
        lambda x: evaluate(x)[0][0],
        start,
        jac=lambda x: evaluate(x)[1][0],
        method="SLSQP",
        bounds=bounds,
        constraints={
            "type": "ineq",
            "fun": lambda x: 1 - evaluate(x)[0][1:],
            "jac": lambda x: -evaluate(x)[1][1:],
        },
        options={"maxiter": iterations, "ftol": 1e-7},
    )
    return Optimisation.of(evaluate, start, result, clock(), bounds)


def crank_rod(quick: bool) -> Case:
    """Return the case."""
    elements, steps = (2, 60) if quick else (6, 300)
    found = optimise(elements, steps, np.full(elements, 4.5), 2 if quick else 60)
    uniform = _lightest_uniform(elements, steps)
    return Case(
        key="crank-rod",
        title="Lightest connecting rod of a slider-crank",
        question=_QUESTION,
        method="SLSQP",
        variables=[f"radius {k} [mm]" for k in range(elements)],
        responses=[Response("mass", "6 mm rod"), Response("stress", "allowed", 1.0)],
        found=found,
        comparisons=[
            Comparison("mass", found.evaluate(found.optimum)[0][0], uniform, "", 0.0, lower=True)
        ],
        panels=[Panel("Rod", "x [m]", "r [mm]", [Series("optimum", *_outline(found.optimum))])],
        caption="",
        findings="",
    )


def _lightest_uniform(elements: int, steps: int) -> float:
    return 1.0


def _outline(radii: Array) -> tuple[Array, Array]:
    ends = np.linspace(0, _ROD, len(radii) + 1)
    return np.repeat(ends, 2)[1:-1], np.repeat(radii, 2)


_QUESTION = """
Jonker's slider-crank.
"""
