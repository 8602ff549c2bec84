"""Curved, pretwisted and off-axis beams: section forces by statics, deflections by closed forms."""

from typing import Final

import numpy as np

from ancfdae import (
    Beam,
    Clamp,
    CurvedBeam,
    Material,
    Moment,
    PointForce,
    Scene,
    assemble,
    equilibrium,
)
from ancfdae.extend import Section
from ancfdae.numerics.arrays import Array
from ancfdae.results import Solution
from ancfdae.sections import ISection, QuadratureSection, Rectangle
from ancfdae.sensitivity.observables.observable import observe
from ancfdae.sensitivity.observables.sections import axial_force, shear_force
from validation.report import Report

_E: Final = 2e11
_NU: Final = 0.3
_G: Final = _E / (2 * (1 + _NU))
_STEEL: Final = Material(7800.0, _E, _NU)
_PLATE: Final = Rectangle(0.02, 0.01)
_PROFILE: Final = ISection(0.04, 0.03, 0.002, 0.003)
_FORCE: Final = (0.0, 0.0, 1.0)
_NONE: Final = (0.0, 0.0, 0.0)


def sections(report: Report, quick: bool) -> None:
    """Fill in the rows on sections."""
    counts = (8, 16) if quick else (8, 16, 32)
    report.say("sections")
    cases = {
        "arc, shear force under F": [_arc_shear(_PLATE, n, _FORCE, _NONE) for n in counts],
        "arc, shear force under M": [_arc_shear(_PLATE, n, _NONE, (1.0, 0.0, 0.0)) for n in counts],
        "arc of I section, shear force": [_arc_shear(_PROFILE, n, _FORCE, _NONE) for n in counts],
        "pretwisted strip, axial force": [_strip_force(n) for n in counts],
        "bar off the axis, shear force": [_off_axis(n)[0] for n in counts],
        "bar off the axis, twist": [_off_axis(n)[1] for n in counts],
        "arc, deflection": [_arc_deflection(_PLATE, n) for n in counts],
        "arc of I section, deflection": [_arc_deflection(_PROFILE, n) for n in counts],
        **{f"untwist, {k}:1": [_untwist(k, n) for n in counts] for k in (2, 10, 40)},
    }
    rows: list[list[object]] = []
    for name, errors in cases.items():
        rows.append([name, *(f"{x:.1e}" for x in errors)])
        for n, error in zip(counts, errors, strict=True):
            word = name.replace(", ", "-").replace(" ", "-").replace(":", "-")
            report.figure(f"section.{word}.n{n}", error)
    report.table(["error of", *map(str, counts)], rows)
    worst = max(abs(errors[-1]) for errors in cases.values())
    report.judge("sections", worst < 0.01, n=counts[-1], worst=worst)


def _curved(section: Section, places: Array, frames: Array) -> CurvedBeam:
    return CurvedBeam("rod", places, frames, section, _STEEL)


def _arc(section: Section, n: int) -> CurvedBeam:
    """Return a quarter of a circle of radius 1 m in the plane of x and y."""
    angle = np.linspace(0.0, np.pi / 2, n + 1)
    c, s, none = np.cos(angle), np.sin(angle), np.zeros(n + 1)
    axes = [[c, s, none], [-s, c, none], [none, none, none + 1]]
    return _curved(section, np.stack([s, 1 - c, none], 1), np.moveaxis(np.array(axes), -1, 0))


def _pretwisted(section: Section, n: int, rate: float) -> CurvedBeam:
    """Return a bar of length 1 m that turns about x."""
    x = np.linspace(0.0, 1.0, n + 1)
    c, s, none = np.cos(rate * x), np.sin(rate * x), np.zeros(n + 1)
    axes = [[none + 1, none, none], [none, c, s], [none, -s, c]]
    return _curved(section, np.stack([x, none, none], 1), np.moveaxis(np.array(axes), -1, 0))


def _rest(rod: Beam | CurvedBeam, force: tuple[float, ...], moment: tuple[float, ...]) -> Solution:
    load = PointForce(rod.at_end, force) if any(force) else Moment(rod.at_end, moment)
    return equilibrium(_scene(rod, load)).solution


def _scene(rod: Beam | CurvedBeam, *loads: PointForce | Moment) -> Scene:
    return Scene([rod], [Clamp(rod.at_start)], loads=loads)


def _arc_shear(
    section: Section, n: int, force: tuple[float, ...], moment: tuple[float, ...]
) -> float:
    """Error of the shear force along z at an arbitrary place."""
    rod = _arc(section, n)
    solution, place = _rest(rod, force, moment), rod.at(0.53)
    width = solution.slope(place, 2)[0]
    computed = observe(shear_force(place, 2), solution, assemble(_scene(rod)))[0]
    return float(computed - force @ width / np.linalg.norm(width))


def _strip_force(n: int) -> float:
    """Axial force of a pretwisted strip under a torque of 1 N m; N."""
    rod = _pretwisted(Rectangle(0.04, 0.004), n, 2.0)
    solution = _rest(rod, _NONE, (1.0, 0.0, 0.0))
    return float(observe(axial_force(rod.at(0.53)), solution, assemble(_scene(rod)))[0])


def _off_axis(n: int) -> tuple[float, float]:
    """Errors of shear force and twist of a bar of 30 x 20 mm, its centre at z = 50 mm."""
    nodes, weights = np.array([-1, 0, 1]) * np.sqrt(0.6) / 2, np.array([5, 8, 5]) / 18
    k_y, k_z, J = _properties(Rectangle(0.03, 0.02))
    section = QuadratureSection(
        places=[(0.03 * a, 0.05 + 0.02 * b) for a in nodes for b in nodes],
        areas=(6e-4 * np.outer(weights, weights)).ravel().tolist(),
        shear_factors=(k_y, k_z),
        torsion_constant=J,
    )
    rod = Beam("rod", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), n, section, _STEEL)
    solution = _rest(rod, (0.0, 1.0, 0.0), _NONE)
    y, z = (solution.slope(rod.at_end, axis)[0] for axis in (1, 2))
    force = observe(shear_force(rod.at(0.53)), solution, assemble(_scene(rod)))[0]
    return float(force - 1), float(0.5 * (y[2] - z[1]) / (0.05 / (_G * J)) - 1)


def _arc_deflection(section: Section, n: int) -> float:
    """Error of the deflection across the plane of an arc, against Castigliano's theorem."""
    rod = _arc(section, n)
    A, (_, I_z), (_, k_z, J) = *_moments(section), _properties(section)
    bent = np.pi / 4 / (_E * I_z) + (3 * np.pi / 4 - 2) / (_G * J)
    exact = bent + np.pi / 2 / (k_z * _G * A)
    return float(_rest(rod, _FORCE, _NONE).position(rod.at_end)[0, 2] / exact - 1)


def _untwist(ratio: int, n: int) -> float:
    """Error of the twist of a pretwisted bar, 0.1 rad/m, under tension.

    N = E A e + c k, 0 = c e + K k, with c = E t (I_p - J), K = G J + E (t (1 - J/I_p))^2 int r^4.
    """
    section, t = Rectangle(0.04, 0.04 / ratio), 0.1
    rod, (A, (I_y, I_z)), J = _pretwisted(section, n, t), _moments(section), _properties(section)[2]
    h, w, polar = 0.04, 0.04 / ratio, I_y + I_z
    r4 = A * ((h**4 + w**4) / 80 + 2 * h**2 * w**2 / 144)
    c, K = _E * t * (polar - J), _G * J + _E * (t * (1 - J / polar)) ** 2 * r4
    N = 1e-7 * _E * A
    twist = np.linalg.solve([[_E * A, c], [c, K]], [N, 0.0])[1]
    y = _rest(rod, (N, 0.0, 0.0), _NONE).slope(rod.at_end, 1)[0]
    before = np.array([0.0, np.cos(t), np.sin(t)])
    return float(np.cross(before, y)[0] / np.linalg.norm(y) / twist - 1)


def _moments(section: Section) -> tuple[float, tuple[float, float]]:
    """Area, and integrals of y^2 and z^2."""
    y, z, dA = (x[0] for x in section.points(np.array([section.sizes()]), False))
    return float(dA.sum()), (float(dA @ y**2), float(dA @ z**2))


def _properties(section: Section) -> tuple[float, float, float]:
    """Shear factors and torsion constant."""
    k_y, k_z, J = section.properties(np.array([section.sizes()]), np.array([_NU]))
    return float(k_y[0]), float(k_z[0]), float(J[0])
