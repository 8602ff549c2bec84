"""Case: lateral buckling of a narrow cantilever, as an eigenvalue (Prandtl 1899; Michell 1899)."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq

from ancfdae import Beam, Clamp, Material, PointForce, Scene, critical_load, equilibrium, modes
from ancfdae.plotting import Panel, Series
from ancfdae.results import CriticalLoad
from ancfdae.sections import Rectangle
from validation.external.runs import Requirement
from validation.literature.rod import Rod, tip_loaded
from validation.literature.tables import Array, convergence, derivative_table
from validation.report import Agreement, Report

__all__ = ["buckling"]

_L, _H, _W, _E, _NU = 1.0, 0.1, 0.02, 2e11, 0.0
# P L^2/sqrt(E I_2 G J) without deflection before buckling (Timoshenko & Gere 1961, section 6.3).
_PUBLISHED: Final = 4.013
_NAMES: Final = ("P L²/sqrt(E I G J)",)
_DESIGN: Final = ("beam.youngs_modulus", "beam.height", "beam.width", "beam.length")


def buckling(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    counts = (2, 4) if quick else (4, 8, 16, 32)
    report.heading("Lateral buckling of a narrow cantilever")
    report.text(_TEXT)
    b, tolerance = np.array([_E, _H, _W, _L]), 1e-5 if quick else 1e-11
    unit, exact = _unit(b), _reference(b, tolerance)
    narrow = _reference(b * [1, 10, 1, 1], tolerance) / _unit(b * [1, 10, 1, 1])
    report.text(
        f"Reference: {exact / unit:.5f}; for a section ten times as high, which bends little "
        f"before it buckles, {narrow:.5f} (closed form {_PUBLISHED})."
    )
    loads = {n: -_critical(n).value for n in counts}
    error = float(
        convergence(
            report, "buckling", _NAMES, counts, [[P / unit] for P in loads.values()], [exact / unit]
        )[-1, 0]
    )
    n = counts[-1]
    apart = _derivatives(report, n, b, exact, tolerance)
    _plot(report, n, unit, exact)
    report.claim(
        "Lateral buckling of a narrow cantilever",
        f"P L²/sqrt(E I G J) = {_PUBLISHED} (rigid in its plane); Timoshenko & Gere 1961",
        f"{loads[n] / unit:.4f} at h/w = {_H / _W:g}, {n} elements; {narrow:.4f} by the reference "
        f"at h/w = {10 * _H / _W:g}",
        Agreement.AGREES if abs(narrow / _PUBLISHED - 1) < 2e-3 else Agreement.DISAGREES,
    )
    return [
        Requirement(f"lateral buckling, {n} elements: load", 5e-3, error),
        Requirement("lateral buckling: d(load)/d(E, h, w, L)", 5e-3, apart),
    ]


def _stiffness(b: Array) -> tuple[Any, Any, Any]:
    """Return GJ and both bending stiffnesses, the lower one first."""
    E, h, w, _ = b
    # Saint-Venant's series for a rectangle; its terms fall as n^-5.
    n = np.arange(1, 200, 2)
    J = (
        w**3
        * h
        / 3
        * (1 - 192 / np.pi**5 * w / h * np.sum(np.tanh(n * np.pi * h / (2 * w)) / n**5))
    )
    return E / (2 * (1 + _NU)) * J, E * h * w**3 / 12, E * w * h**3 / 12


def _unit(b: Array) -> float:
    torsion, low, _ = _stiffness(b)
    return float(np.sqrt(low * torsion) / b[3] ** 2)


def _reference(b: Array, tolerance: float) -> float:
    """Return the load at which a motion out of the plane needs no force."""
    E, h, w, L = b
    # Cowper's shear factor of a rectangle.
    G = E / (2 * (1 + _NU)) * 10 * (1 + _NU) / (12 + 11 * _NU)
    torsion, low, high = _stiffness(b)
    rod = Rod(L, h * w * np.array([E, G, G]), np.array([torsion, low, high]))

    def stiffness(load: float) -> float:
        J = tip_loaded(rod, np.array([0, -load * _unit(b), 0]), steps=2)[2]
        # Torsion and bending out of the plane.
        return float(np.linalg.det(J[:2, :2]))

    return _first_zero(stiffness, tolerance) * _unit(b)


def _first_zero(f: Callable[[float], float], tolerance: float) -> float:
    """Return where a function that is positive at 3.5 changes its sign."""
    low, high = 3.5, 3.7
    while f(high) > 0:
        low, high = high, high + 0.2
    return float(brentq(f, low, high, xtol=tolerance))


def _scene(n: int, load: float) -> Scene:
    section, material = Rectangle(_H, _W), Material(7850.0, _E, _NU)
    beam = Beam("beam", (0, 0, 0), (_L, 0, 0), n, section, material)
    force = PointForce(beam.at_end, (0, -load, 0), name="load")
    return Scene([beam], [Clamp(beam.at_start)], loads=[force])


def _square(n: int, load: float) -> float:
    """Return omega^2 of the lowest mode, negative where it grows."""
    at = equilibrium(_scene(n, load))
    # Where the tangent is singular to round-off the search does not converge: the load is critical.
    if not at.outcome.success:
        return 0.0
    return -(modes(_scene(n, load), 1, at=at).exponents[0] ** 2).real


def _critical(n: int, design: tuple[str, ...] = ()) -> CriticalLoad:
    unit = _unit(np.array([_E, _H, _W, _L]))
    return critical_load(_scene(n, 0.0), "load.force_y", -5.0 * unit, design=design)


def _derivatives(report: Report, n: int, b: Array, exact: float, tolerance: float) -> float:
    critical = _critical(n, _DESIGN)
    ours = critical.gradient * b / critical.value
    rows = []
    for k, name in enumerate("EhwL"):
        d = np.zeros(4)
        d[k] = 1e-3
        high, low = (_reference(b * (1 + x), tolerance) for x in (d, -d))
        theirs = (high - low) / 2e-3 / exact
        rows.append(("ln P", f"ln {name}", float(ours[k]), theirs))
    return derivative_table(report, "buckling", rows, (f"direct, {n} elements", "reference"))


def _plot(report: Report, n: int, unit: float, exact: float) -> None:
    loads = np.linspace(0, 1.15, 5 if n < 16 else 13) * exact
    squares = np.array([_square(n, load) for load in loads])
    series = [
        Series(f"{n} elements", loads / unit, squares / squares[0], marker=True),
        Series("reference", [exact / unit], [0.0], line=False, marker=True),
        Series("closed form, no deflection before", [_PUBLISHED], [0.0], line=False, marker=True),
    ]
    title = "Square of the lowest frequency under the load"
    panel = Panel(title, "P L²/sqrt(E I G J) [-]", "omega²/omega²(0) [-]", series)
    report.plot("buckling", [panel])


_TEXT = """
*Published*: L. Prandtl and A. G. M. Michell (1899); S. P. Timoshenko and J. M. Gere, *Theory of
Elastic Stability* (1961): a cantilever under a tip force in its stiff plane buckles sideways at P
= 4.013 sqrt(E I G J)/L², its bending before that left out; it raises the load (D. H. Hodges and
D. A. Peters, *Int. J. Solids Struct.* 11 (1975) 1269-1280). *Reference*: exact rod, the load at
which the tangent of the shooting is singular out of the plane. *Here*: `critical_load`, a
bifurcation from the bent state. Drawn is the square of the lowest frequency by `modes`, which
vanishes there.
"""
