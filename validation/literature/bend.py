"""Case: the 45-degree bend under an out-of-plane force (Bathe & Bolourchi 1979)."""

from typing import Any, Final

import numpy as np

from ancfdae import CurvedBeam, Material, Scene, equilibrium
from ancfdae.numerics.arrays import Array
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.rod import Rod, clamped, derivatives, tip_loaded
from validation.literature.tables import compared_at_rest, convergence, relative
from validation.published import published
from validation.report import Report
from validation.scenes import cantilever

_R, _E, _TURN, _LOAD = 100.0, 1e7, np.pi / 4, 600.0
# J = Iyy + Izz and full shear, as the reference has them.
_SECTION: Final = Rectangle(1.0, 1.0, shear_factors=(1.0, 1.0), torsion_constant=1 / 6)
_PUBLISHED: Final = published("bend")
_NAMES: Final = ("in plane", "out of plane", "along tangent")


def bend(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (4, 8) if quick else (8, 16, 32, 64)
    report.say("bend")
    rod = _displacement(_rod_tip(_LOAD))
    report.say("bend.asked", apart=np.max(relative(rod, _PUBLISHED["asked"])))
    errors = convergence(report, "bend", _NAMES, counts, [_elements(n) for n in counts], rod)
    apart = _derivatives(report, counts[-1])
    _plot(report, counts[-1], (300, 600) if quick else (150, 300, 450, 600))
    error = float(np.max(errors[-1]))
    x, y, z = _rod_tip(_LOAD)
    report.judge("bend", error < 1e-3, y=y, z=z, x=x, n=counts[-1], error=error)
    report.require("bend", error, n=counts[-1])
    report.require("bend.derivatives", apart)


def _scene(n: int, load: float = _LOAD) -> Scene:
    angle = np.linspace(0, _TURN, n + 1)
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(n + 1)
    positions = _R * np.array([s, 1 - c, zero]).T
    frames = np.moveaxis(np.array([[c, s, zero], [-s, c, zero], [zero, zero, zero + 1]]), -1, 0)
    beam = CurvedBeam("bend", positions, frames, _SECTION, Material(1.0, _E, 0.0))
    return cantilever(beam, (0, 0, load))


def _rod(E: Any = _E, h: Any = 1.0) -> Rod:
    """Return the rod of width 1 and given J; the height lies in the plane of the bend."""
    bending = E * np.array([1 / 12, h / 12, h**3 / 12])
    return Rod(_R * _TURN, E * h * np.array([1, 0.5, 0.5]), bending, (0, 0, 1 / _R))


def _rod_tip(load: float) -> Array:
    return tip_loaded(_rod(), np.array([0, 0, load]), steps=4)[0][:3].real


def _tip_place() -> Array:
    return _R * np.array([np.sin(_TURN), 1 - np.cos(_TURN), 0])


def _displacement(tip: Array) -> Array:
    """Return what is lost in the plane, gained out of it and lost along the tangent."""
    u = tip - _tip_place()
    return np.array([-u[1], u[2], -u[0]])


def _elements(n: int, load: float = _LOAD) -> Array:
    scene = _scene(n, load)
    return _displacement(equilibrium(scene).solution.position(scene.beams[0].at_end)[0])


def _derivatives(report: Report, n: int) -> float:
    """Compare d ln(tip)/d ln(E, h, P) with those of the reference."""
    moment = tip_loaded(_rod(), np.array([0, 0, _LOAD]), steps=4)[1]

    def quantity(m: Array, b: Array) -> tuple[Array, Array]:
        end = clamped(_rod(b[0], b[1]), m[None], b[2] * np.array([0, 0, 1]))[0]
        return end[12:], end[:3]

    b = np.array([_E, 1.0, _LOAD])
    place, place_b = derivatives(quantity, moment, b)
    scene, exact = _scene(n), place_b * b / place[:, None]
    tip = scene.beams[0].at_end
    quantities = {name: (position(tip, i), exact[i]) for i, name in enumerate("xyz")}
    design = {"E": "bend.youngs_modulus", "h": "bend.height", "P": "load.force_z"}
    ways = f"direct, {n} elements", "reference"
    return compared_at_rest(report, "bend", scene, quantities, design, ways)


def _plot(report: Report, n: int, loads: tuple[int, ...]) -> None:
    fine = np.linspace(50, 600, 3 * len(loads))
    curve = np.array([_rod_tip(load) for load in fine])
    lost = np.array([_elements(n, load) for load in loads])
    computed = _tip_place() + lost[:, [2, 0, 1]] * [-1, -1, 1]
    panels = []
    for name, axis, printed in (("y", 1, 1), ("z", 2, 2), ("x", 0, 3)):
        series = [
            Series("reference", fine, curve[:, axis]),
            dots(f"{n} elements", loads, computed[:, axis]),
        ]
        series += [
            dots(source, values[:, 0], values[:, printed])
            for source, values in _PUBLISHED.items()
            if source != "asked"
        ]
        panels.append(Panel(f"{name} of the tip", "P [lbf]", f"{name} [in]", series))
    report.plot("bend", panels, 3)
