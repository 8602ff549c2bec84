"""Case: the cantilever of Gerstmayr & Irschik (2008), with and without Poisson's ratio."""

from typing import Any, Final

import numpy as np

from ancfdae import Beam, Material, SaintVenantKirchhoff, Scene, equilibrium
from ancfdae.numerics.arrays import Array
from ancfdae.observables import position
from ancfdae.plotting import Series
from ancfdae.sections import Rectangle
from validation import scenes
from validation.drawing import log_log
from validation.literature.rod import Rod, clamped, derivatives, tip_loaded
from validation.literature.tables import compared_at_rest, convergence, relative
from validation.published import published
from validation.report import Report

_L, _H, _E = 2.0, 0.1, 2.07e11
_LOAD: Final = 3 * _E * _H**4 / 12 / _L**2
# Displacement of the tip in the limit of a thin beam.
_PUBLISHED: Final = published("cantilever")["tip"]
_NAMES: Final = ("u_x [m]", "u_y [m]")
_DESIGN: Final = {"E": "beam.youngs_modulus", "h": "beam.height", "P": "load.force_y"}


def cantilever(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (2, 4) if quick else (2, 4, 8, 16, 32, 64)
    report.say("cantilever")
    tips, apart_of, series = {}, {}, []
    for nu in (0.0, 0.3):
        report.say("cantilever.poisson", nu=nu)
        rod = _rod_tip(nu)
        tips[nu] = [_tip(n, nu) for n in counts]
        errors = convergence(report, f"cantilever.nu{nu:g}", _NAMES, counts, tips[nu], rod)
        apart_of[nu] = np.max(errors, axis=1)
        series.append(Series(f"nu = {nu:g}", counts, apart_of[nu], marker=True))
    locked = [relative(_tip(n, 0.3, locked=True), _rod_tip(0.3)) for n in counts]
    series.append(Series("nu = 0.3, full law", counts, np.max(locked, axis=1), marker=True))
    error = float(np.max(relative(tips[0.3][-1], _PUBLISHED)))
    long = [i for i, n in enumerate(counts) if _L / n > _H / 2][-1]
    plain, poisson = apart_of[0.0][long], apart_of[0.3][long]
    report.say(
        "cantilever.materials",
        n=counts[long],
        plain=plain,
        poisson=poisson,
        short="" if quick else _SHORT,
    )
    worst = report.figure("cantilever.locked", float(np.max(locked[-1])))
    report.say("cantilever.locked", n=counts[-1], worst=worst)
    apart = _derivatives(report, counts[long])
    title = "Largest error of the tip"
    panel = log_log(title, "elements [-]", "relative error [-]", series)
    report.plot("cantilever", [panel])
    report.judge("cantilever", error < 6e-3, tip=tips[0.3][-1], n=counts[-1])
    report.require("cantilever.published", error)
    report.require("cantilever.exact", plain)
    report.require("cantilever.derivatives", apart)


def _scene(n: int, nu: float, locked: bool = False) -> Scene:
    section, material = Rectangle(_H, _H), Material(7800.0, _E, nu)
    energy = SaintVenantKirchhoff() if locked else None
    beam = Beam("beam", (0, 0), (_L, 0), n, section, material, energy=energy)
    return scenes.cantilever(beam, (0, -_LOAD))


def _tip(n: int, nu: float, locked: bool = False) -> Array:
    scene = _scene(n, nu, locked)
    place: Array = equilibrium(scene).solution.position(scene.beams[0].at_end)[0]
    return place - np.array([_L, 0])


def _rod(nu: float, E: Any = _E, h: Any = _H) -> Rod:
    # Cowper's shear factor of a rectangle.
    G = E / (2 * (1 + nu)) * 10 * (1 + nu) / (12 + 11 * nu)
    return Rod(_L, h * _H * np.array([E, G, G]), E * h**3 * _H / 12 * np.ones(3))


def _rod_tip(nu: float) -> Array:
    end = tip_loaded(_rod(nu), np.array([0, -_LOAD, 0]), steps=3)[0].real
    return end[:2] - np.array([_L, 0])


def _derivatives(report: Report, n: int) -> float:
    """Compare d ln(u)/d ln(E, h, P) at nu = 0.3 with those of the reference."""
    moment = tip_loaded(_rod(0.3), np.array([0, -_LOAD, 0]), steps=3)[1]

    def quantity(m: Array, b: Array) -> tuple[Array, Array]:
        end = clamped(_rod(0.3, b[0], b[1]), m[None], b[2] * np.array([0, -1, 0]))[0]
        return end[12:], end[:2] - np.array([_L, 0])

    b = np.array([_E, _H, _LOAD])
    u, u_b = derivatives(quantity, moment, b)
    scene = _scene(n, 0.3)
    u_x, u_y = (position(scene.beams[0].at_end, axis) - moved for axis, moved in ((0, _L), (1, 0)))
    exact = u_b * b / u[:, None]
    quantities = {"u_x": (u_x, exact[0]), "u_y": (u_y, exact[1])}
    ways = f"direct, {n} elements", "reference"
    return compared_at_rest(report, "cantilever", scene, quantities, _DESIGN, ways)


_SHORT: Final = (
    " Those of 64 elements are about as long as the section's radius of gyration. They let bending "
    "shorten the axis by (3/2) (I/A) curvature², as the plain position field does (theory, "
    "strain energy, point 5 of assumed strains): a part of the squared strain of bending."
)
