"""Case: lateral buckling of a narrow cantilever, as an eigenvalue (Prandtl 1899; Michell 1899)."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq

from ancfdae import Beam, Material, Scene, critical_load, equilibrium, modes
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import CriticalLoad
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.rod import Rod, tip_loaded
from validation.literature.tables import convergence, derivative_table
from validation.published import published
from validation.report import Report
from validation.scenes import cantilever

_L, _H, _W, _E, _NU = 1.0, 0.1, 0.02, 2e11, 0.0
_PUBLISHED: Final = float(published("buckling")["load"])
_NAMES: Final = ("P L²/sqrt(E I G J)",)
_DESIGN: Final = ("beam.youngs_modulus", "beam.height", "beam.width", "beam.length")


def buckling(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (2, 4) if quick else (4, 8, 16, 32)
    report.say("buckling")
    b, tolerance = np.array([_E, _H, _W, _L]), 1e-5 if quick else 1e-11
    unit, exact = _unit(b), _reference(b, tolerance)
    narrow = _reference(b * [1, 10, 1, 1], tolerance) / _unit(b * [1, 10, 1, 1])
    report.say("buckling.reference", load=exact / unit, narrow=narrow, published=_PUBLISHED)
    loads = {n: -_critical(n).value for n in counts}
    error = float(
        convergence(
            report, "buckling", _NAMES, counts, [[P / unit] for P in loads.values()], [exact / unit]
        )[-1, 0]
    )
    n = counts[-1]
    apart = _derivatives(report, n, b, exact, tolerance)
    _plot(report, n, unit, exact)
    report.judge(
        "buckling",
        abs(narrow / _PUBLISHED - 1) < 2e-3,
        published=_PUBLISHED,
        load=loads[n] / unit,
        slender=_H / _W,
        n=n,
        narrow=narrow,
        more=10 * _H / _W,
    )
    report.require("buckling", error, n=n)
    report.require("buckling.derivatives", apart)


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
    return cantilever(beam, (0, -load, 0))


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
        dots("reference", [exact / unit], [0.0]),
        dots("closed form, no deflection before", [_PUBLISHED], [0.0]),
    ]
    title = "Square of the lowest frequency under the load"
    panel = Panel(title, "P L²/sqrt(E I G J) [-]", "omega²/omega²(0) [-]", series)
    report.plot("buckling", [panel])
