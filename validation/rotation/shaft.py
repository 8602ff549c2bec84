"""Whirling shaft with a disc: forward and backward whirl, beside the Euler-Bernoulli solution."""

from typing import Final

import numpy as np
import scipy

from ancfdae import (
    Beam,
    Clamp,
    Material,
    RigidBody,
    RigidCylinder,
    RotatingFrame,
    Scene,
    Weld,
    campbell,
)
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Circle
from validation.drawing import dots
from validation.literature.tables import relative
from validation.report import Report

_LENGTH, _RADIUS, _RHO, _E = 1.0, 0.005, 7850.0, 2.1e11
_DISC, _THICKNESS = 0.1, 0.01
# Modes that bend, at the highest rate; between them one of torsion.
_COUNT: Final = 6


def shaft_scene(elements: int) -> Scene:
    """Return a shaft that is held at one end and carries a disc at the other."""
    material = Material(_RHO, _E, 0.3)
    rod = Beam("shaft", (0, 0, 0), (0, 0, _LENGTH), elements, Circle(_RADIUS), material)
    shape = RigidCylinder(_DISC, _THICKNESS)
    disc = RigidBody("disc", (0, 0, _LENGTH), shape=shape, density=_RHO)
    joints = [Clamp(rod.at_start), Weld(rod.at_end, disc.at(0, 0, 0))]
    return Scene([rod], joints, bodies=[disc], frame=RotatingFrame(0.0))


def shafts(report: Report, quick: bool) -> None:
    """Fill the section."""
    report.say("shaft")
    elements, rates = (
        (4, np.arange(0.0, 201.0, 50.0)) if quick else (8, np.arange(0.0, 401.0, 25.0))
    )
    diagram = campbell(shaft_scene(elements), rates, _COUNT)
    bending = np.abs(diagram.whirl[-1]) > 0.99
    # At rest circles of both senses coincide.
    speeds = np.sort(diagram.whirl_speeds[1:][:, bending], axis=1)
    counts = int(np.sum(speeds[-1] < 0)), int(np.sum(speeds[-1] > 0))
    exact = np.array([_whirl(rate, *counts) for rate in rates[1:]])
    error = report.figure("shaft.error", float(np.max(relative(speeds, exact))))
    rows = [
        [
            f"{rates[1:][k]:g}",
            *(f"{a:.3f} ({b:.3f})" for a, b in zip(speeds[k], exact[k], strict=True)),
        ]
        for k in (0, len(speeds) // 2, -1)
    ]
    names = [f"backward {k + 1}" for k in range(counts[0])][::-1]
    names += [f"forward {k + 1}" for k in range(counts[1])]
    report.table(["rate [rad/s]", *(f"{name} (reference)" for name in names)], rows)
    panels = _panels(rates, names, speeds, exact, diagram.frequencies)
    report.plot("shaft", panels, 2)
    report.judge("shaft", error < 2e-3, percent=100 * error)
    report.require("shaft", error, elements=elements)


def _panels(
    rates: Array, names: list[str], speeds: Array, exact: Array, frequencies: Array
) -> list[Panel]:
    outside = [
        Series(f"{name}, reference", rates[1:], np.abs(exact[:, k])) for k, name in enumerate(names)
    ]
    points = np.tile(rates[1:], len(names)), np.abs(speeds).T.ravel()
    outside.append(dots("elements", *points))
    outside.append(Series("rate", rates, rates, dashed=True))
    inside = [Series(f"mode {k}", rates, column) for k, column in enumerate(frequencies.T)]
    axes = "rate [rad/s]", "frequency [rad/s]"
    return [
        Panel("whirl seen at rest", *axes, outside),
        Panel("modes in the turning frame", *axes, inside),
    ]


def _whirl(rate: float, backward: int, forward: int) -> Array:
    """Return the whirl speeds nearest to zero, ascending, of the Euler-Bernoulli shaft."""
    grid = np.linspace(0.5, 2000.0, 8000)
    roots = []
    for sign, count in ((-1.0, backward), (1.0, forward)):
        values = np.array([_determinant(sign * x, rate) for x in grid])
        places = np.flatnonzero(values[:-1] * values[1:] < 0)[:count]
        ends = [(sign * grid[i], sign * grid[i + 1]) for i in places]
        roots += [scipy.optimize.brentq(_determinant, a, b, args=(rate,)) for a, b in ends]
    return np.sort(roots)


def _determinant(speed: float, rate: float) -> float:
    """Return the determinant of the ends of u = a (cosh kx - cos kx) + b (sinh kx - sin kx)."""
    area, moment = np.pi * _RADIUS**2, np.pi * _RADIUS**4 / 4
    m = _RHO * np.pi * _DISC**2 * _THICKNESS
    across, polar = m * (_DISC**2 / 4 + _THICKNESS**2 / 12), m * _DISC**2 / 2
    k = (_RHO * area * speed**2 / (_E * moment)) ** 0.25
    C, S, c, s = (f(k * _LENGTH) for f in (np.cosh, np.sinh, np.cos, np.sin))
    u, u_1 = np.array([C - c, S - s]), k * np.array([S + s, C - c])
    u_2, u_3 = k**2 * np.array([C + c, S + s]), k**3 * np.array([S - s, C + c])
    tilt = across * speed**2 - polar * rate * speed
    rows = [_E * moment * u_2 - tilt * u_1, _E * moment * u_3 + m * speed**2 * u]
    return float(np.linalg.det(rows) / (C * k) ** 2)
