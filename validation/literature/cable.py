"""Case: a heavy cable under a point load (Michalos & Birnstiel 1962; Jayaraman & Knudson 1981)."""

from typing import Any, Final

import numpy as np
from numpy.polynomial.legendre import leggauss

from ancfdae import CABLE_2D, Beam, DesignVariable, Material, Pin, PointForce, Scene, equilibrium
from ancfdae.numerics.arrays import Array
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.rod import derivatives, solve
from validation.literature.tables import compared_at_rest, convergence, relative
from validation.published import published
from validation.report import Report

_FOOT, _POUND = 0.3048, 4.4482216152605
# Unloaded lengths of the two parts, span; section, modulus, weight per length, load.
_L1, _L2, _SPAN = 412.8837 * _FOOT, 613.0422 * _FOOT, 1000 * _FOOT
_A, _E = 0.85 * (_FOOT / 12) ** 2, 19e6 * _POUND / (_FOOT / 12) ** 2
_WEIGHT, _LOAD, _G = 3.16 * _POUND / _FOOT, 8000 * _POUND, 9.81
_PUBLISHED: Final = published("cable")
_NAMES: Final = ("vertical [m]", "horizontal [m]")


def cable(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (2, 4) if quick else (2, 4, 8, 16)
    report.say("cable")
    b = np.array([_E, _WEIGHT, _LOAD])
    catenary, sag = _displacement(b, hooke=True)
    exact = _displacement(b, hooke=False)[0]
    report.say(
        "cable.catenary", catenary=catenary, sag=sag, apart=np.max(relative(exact, catenary))
    )
    computed = [(_elements(n, _LOAD) - _elements(n, 0.0))[::-1] for n in counts]
    error = float(np.max(convergence(report, "cable", _NAMES, counts, computed, exact)[-1]))
    apart = _derivatives(report, counts[-1], b)
    _plot(report, counts[-1], exact)
    off = float(np.max(relative(computed[-1], _PUBLISHED["Jayaraman & Knudson 1981"])))
    report.judge("cable", off < 2e-3, found=computed[-1], n=counts[-1])
    report.require("cable", error, n=counts[-1])
    report.require("cable.derivatives", apart)


def _part(H: Any, V: Any, length: float, b: Array, hooke: bool) -> Array:
    """Return how far a part leads, from the tension (H, V) at its start.

    The tension T = |(H, V + w s)| stretches the cable by 1 + T/(E A) (Hooke) or, as in the elements
    (St. Venant-Kirchhoff), by lambda with T = E A lambda (lambda^2 - 1)/2.
    """
    E, w, _ = b
    points, weights = leggauss(40)
    up = V + w * length * (points + 1) / 2
    tension = np.sqrt(H**2 + up**2)
    strain = tension / (E * _A)
    stretch = 1 + strain
    for _ in range(0 if hooke else 6):
        stretch = stretch - (stretch**3 - stretch - 2 * strain) / (3 * stretch**2 - 1)
    along = length * weights / 2 * stretch / tension
    return np.array([H * np.sum(along), np.sum(along * up)])


def _places(z: Array, b: Array, hooke: bool) -> tuple[Array, Array]:
    """Return the loaded point and the end of the cable; z: tension at the start over the load."""
    H, V = z * _LOAD
    node = _part(H, V, _L1, b, hooke)
    return node, node + _part(H, V + b[1] * _L1 + b[2], _L2, b, hooke)


def _tension(b: Array, hooke: bool) -> Array:
    def residual(z: Array) -> Array:
        return np.array([_places(row, b, hooke)[1] - [_SPAN, 0] for row in z]) / _SPAN

    return solve(residual, np.array([2.5, -0.8]) if b[2] else np.array([0.5, -0.2]))[0]


def _displacement(b: Array, hooke: bool) -> tuple[Array, float]:
    """Return how the load moves its point, vertically and horizontally, and the sag before."""
    bare = b * [1, 1, 0]
    before, after = (_places(_tension(x, hooke), x, hooke)[0] for x in (bare, b))
    return (after - before)[::-1], float(-before[1])


def _scene(n: int, load: float) -> Scene:
    """Return two cables pinned together; a flat section has next to no bending stiffness."""
    h = 1e-3
    section, material = Rectangle(h, _A / h), Material(_WEIGHT / (_A * _G), _E, 0.0)
    # Where the parts meet while both are straight and unloaded.
    x = (_SPAN**2 + _L1**2 - _L2**2) / (2 * _SPAN)
    y = -float(np.sqrt(_L1**2 - x**2))
    left = Beam("left", (0, 0), (x, y), n, section, material, element=CABLE_2D)
    right = Beam("right", (x, y), (_SPAN, 0), n, section, material, element=CABLE_2D)
    joints = [Pin(left.at_start), Pin(left.at_end, right.at_start), Pin(right.at_end)]
    loads = [PointForce(left.at_end, (0, -load), name="load")]
    return Scene([left, right], joints, (0, -_G), loads=loads)


def _elements(n: int, load: float) -> Array:
    """Return the place of the loaded point."""
    scene = _scene(n, load)
    bent = equilibrium(scene)
    assert bent.outcome.success, bent.outcome
    return bent.solution.position(scene.beams[0].at_end)[0]


def _derivatives(report: Report, n: int, b: Array) -> float:
    """Compare d ln(place)/d ln(E, weight, load) with those of the elastic catenary."""

    def quantity(x: Array, c: Array) -> tuple[Array, Array]:
        node, end = _places(x, c, hooke=False)
        return (end - [_SPAN, 0]) / _SPAN, node

    node, node_b = derivatives(quantity, _tension(b, hooke=False), b)
    density = DesignVariable("density", ("left.density", "right.density"))
    modulus = DesignVariable("modulus", ("left.youngs_modulus", "right.youngs_modulus"))
    scene, exact = _scene(n, _LOAD), node_b * b / node[:, None]
    point = scene.beams[0].at_end
    quantities = {name: (position(point, i), exact[i]) for i, name in enumerate("xy")}
    design: dict[str, str | DesignVariable] = {"E": modulus, "weight": density, "P": "load.force_y"}
    ways = f"direct, {n} elements", "reference"
    return compared_at_rest(report, "cable", scene, quantities, design, ways)


def _plot(report: Report, n: int, exact: Array) -> None:
    """Show the cable without and with the load, and the displacements in print."""
    shapes = []
    for label, load in (("without the load", 0.0), ("with the load", _LOAD)):
        scene = _scene(n, load)
        run = equilibrium(scene).solution
        r = np.concatenate(
            [[run.position(beam.at(x))[0] for x in np.linspace(0, 1, 33)] for beam in scene.beams]
        )
        shapes.append(Series(label, r[:, 0], r[:, 1]))
    points = [dots(source, [values[1]], [values[0]]) for source, values in _PUBLISHED.items()]
    points.append(dots("reference", exact[1:], exact[:1]))
    moved = _elements(n, _LOAD) - _elements(n, 0.0)
    points.append(dots("elements", moved[:1], moved[1:]))
    panels = [
        Panel("Cable", "x [m]", "y [m]", shapes),
        Panel("Displacement of the loaded point", "horizontal [m]", "vertical [m]", points),
    ]
    report.plot("cable", panels, 2)
