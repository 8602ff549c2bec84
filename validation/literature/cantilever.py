"""Case: the cantilever of Gerstmayr & Irschik (2008), with and without Poisson's ratio."""

from typing import Any, Final

import numpy as np

from ancfdae import Beam, Clamp, Material, PointForce, SaintVenantKirchhoff, Scene, equilibrium
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.external.runs import Requirement
from validation.literature.at_rest import log_derivatives
from validation.literature.rod import Rod, clamped, derivatives, tip_loaded
from validation.literature.tables import Array, convergence, derivative_table, relative
from validation.report import Agreement, Report

__all__ = ["cantilever"]

_L, _H, _E = 2.0, 0.1, 2.07e11
_LOAD: Final = 3 * _E * _H**4 / 12 / _L**2
# Displacement of the tip in the limit of a thin beam.
_PUBLISHED: Final = np.array([-0.508537304, -1.207239855])
_NAMES: Final = ("u_x [m]", "u_y [m]")
_DESIGN: Final = ("beam.youngs_modulus", "beam.height", "load.force_y")


def cantilever(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    counts = (2, 4) if quick else (2, 4, 8, 16, 32, 64)
    report.heading("Cantilever of Gerstmayr and Irschik")
    report.text(_TEXT)
    tips, apart_of, series = {}, {}, []
    for nu in (0.0, 0.3):
        report.text(f"nu = {nu:g}, against the exact rod with this shear and extension:")
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
    report.text(
        f"{counts[long]} elements are {plain:.1e} and {poisson:.1e} away: with nu = 0.3 continuum "
        f"and rod are two materials at strains of 7 %.{'' if quick else _SHORT}"
    )
    worst = report.figure("cantilever.locked", float(np.max(locked[-1])))
    report.text(
        f"With the full law of St. Venant-Kirchhoff, {counts[-1]} elements are {worst:.1%} off at "
        "nu = 0.3 (Poisson locking)."
    )
    apart = _derivatives(report, counts[long])
    title = "Largest error of the tip"
    panel = Panel(title, "elements [-]", "relative error [-]", series, "log", "log")
    caption = "Against the exact rod."
    report.plot("cantilever", [panel], caption=caption)
    report.claim(
        "Cantilever of Gerstmayr and Irschik: displacement of the tip",
        "(-0.508537304, -1.207239855) m, thin beam",
        "({:.6f}, {:.6f}) m at nu = 0.3, {} elements".format(*tips[0.3][-1], counts[-1]),
        Agreement.AGREES if error < 6e-3 else Agreement.DISAGREES,
    )
    return [
        Requirement("cantilever, nu = 0.3: tip against the published one", 6e-3, error),
        Requirement("cantilever, nu = 0: tip against the exact rod", 1e-3, plain),
        Requirement("cantilever, nu = 0.3: d(tip)/d(E, h, P)", 2e-3, apart),
    ]


def _scene(n: int, nu: float, locked: bool = False) -> Scene:
    section, material = Rectangle(_H, _H), Material(7800.0, _E, nu)
    energy = SaintVenantKirchhoff() if locked else None
    beam = Beam("beam", (0, 0), (_L, 0), n, section, material, energy=energy)
    load = PointForce(beam.at_end, (0, -_LOAD), name="load")
    return Scene([beam], [Clamp(beam.at_start)], loads=[load])


def _tip(n: int, nu: float, locked: bool = False) -> Array:
    scene = _scene(n, nu, locked)
    place: Array = equilibrium(scene).solution.position(scene.beams[0].at_end)[0]
    moved: Array = place - np.array([_L, 0])
    return moved


def _rod(nu: float, E: Any = _E, h: Any = _H) -> Rod:
    # Cowper's shear factor of a rectangle.
    G = E / (2 * (1 + nu)) * 10 * (1 + nu) / (12 + 11 * nu)
    return Rod(_L, h * _H * np.array([E, G, G]), E * h**3 * _H / 12 * np.ones(3))


def _rod_tip(nu: float) -> Array:
    end = tip_loaded(_rod(nu), np.array([0, -_LOAD, 0]), steps=3)[0].real
    moved: Array = end[:2] - np.array([_L, 0])
    return moved


def _derivatives(report: Report, n: int) -> float:
    """Compare d ln(u)/d ln(E, h, P) at nu = 0.3 with those of the reference."""
    moment = tip_loaded(_rod(0.3), np.array([0, -_LOAD, 0]), steps=3)[1]

    def quantity(m: Array, b: Array) -> tuple[Array, Array]:
        end = clamped(_rod(0.3, b[0], b[1]), m[None], b[2] * np.array([0, -1, 0]))[0]
        return end[12:], end[:2] - np.array([_L, 0])

    b = np.array([_E, _H, _LOAD])
    u, u_b = derivatives(quantity, moment, b)
    scene, rows, off = _scene(n, 0.3), [], 0.0
    for axis, name in enumerate(("u_x", "u_y")):
        tip = position(scene.beams[0].at_end, axis) - (_L if not axis else 0.0)
        computed, apart = log_derivatives(scene, tip, _DESIGN)
        exact, off = u_b[axis] * b / u[axis], max(off, apart)
        rows += [
            (f"ln {name}", f"ln {parameter}", float(x), float(e))
            for parameter, x, e in zip("EhP", computed, exact, strict=True)
        ]
    worst = derivative_table(report, "cantilever", rows, (f"direct, {n} elements", "reference"))
    report.text(f"Direct differentiation and adjoint are {off:.0e} apart.")
    return worst


_SHORT: Final = (
    " Those of 64 elements are about as long as the section's radius of gyration. They let bending "
    "shorten the axis by (3/2) (I/A) curvature², as the plain position field does (theory, "
    "strain energy, point 5 of assumed strains): a part of the squared strain of bending."
)
_TEXT = """
*Published*: J. Gerstmayr and H. Irschik, *J. Sound Vib.* 318 (2008) 461-487. A cantilever of L =
2 m, 0.1 m x 0.1 m, E = 2.07e11 N/m², under a tip force of 3 E I/L². *Reference*: shooting on the
exact rod. *Here*: planar beam, `equilibrium`.
"""
