"""Case: limit load of a clamped-hinged deep circular arch (DaDeppo & Schmidt 1975)."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq

from ancfdae import Clamp, CurvedBeam, Material, Pin, Scene, TranslationDriver, equilibrium
from ancfdae.extend import MaterialPoint
from ancfdae.laws import ConstantAcceleration
from ancfdae.plotting import Panel, Series
from ancfdae.results import Equilibrium
from ancfdae.sections import Rectangle
from validation.external.runs import Requirement
from validation.literature.rod import Rod, derivatives, solve
from validation.literature.tables import Array, convergence, derivative_table, relative
from validation.report import Agreement, Report

__all__ = ["arch"]

_R, _SPAN, _E, _H, _W = 100.0, np.radians(215), 1.5e6, 1.0, 1.0
_EI: Final = _E * _W * _H**3 / 12
# P R^2/(E I): inextensible (DaDeppo & Schmidt), and 40 linear elements (Simo & Vu-Quoc).
_PUBLISHED, _SIMO = 8.97, 9.0528
_NAMES: Final = ("P R²/(E I)",)
_DESIGN: Final = ("crown.offset", "arch.youngs_modulus", "arch.height", "arch.length")
# Path of the crown: way down and to the hinge over R, and P R^2/(E I), read from the figure of
# DaDeppo & Schmidt (as distributed with AeroBeams.jl, test/referenceData/pinnedClampedArch).
_DOWN: Final = np.array(
    [
        [0.0338, 0.0878, 0.1417, 0.2057, 0.2693, 0.3289, 0.3992, 0.4908, 0.5751, 0.6676, 0.7537],
        [0.8664, 2.0, 2.845, 3.561, 4.097, 4.507, 4.946, 5.462, 5.916, 6.408, 6.851],
    ]
)
_DOWN_LATE: Final = np.array(
    [[0.8512, 0.9412, 1.0091, 1.087, 1.1354, 1.1721], [7.388, 7.945, 8.374, 8.816, 8.946, 8.718]]
)
_ASIDE: Final = np.array(
    [
        [0.0230, 0.0516, 0.0876, 0.1306, 0.1921, 0.2500, 0.3193, 0.3881, 0.4565, 0.5136, 0.5604],
        [0.9906, 1.728, 2.380, 2.994, 3.760, 4.330, 4.898, 5.513, 6.245, 6.971, 7.914],
    ]
)


@dataclass(frozen=True)
class _Limit:
    """Limit load over E I/R^2, where it is reached, the path up to there; z of the reference."""

    load: float
    down: float
    path: Array
    z: Array = field(default_factory=lambda: np.zeros(4))


def arch(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    counts = (16, 32) if quick else (16, 32, 64)
    report.heading("Deep circular arch: limit load")
    report.text(_TEXT)
    reference = _reference_limit(6 if quick else 22)
    report.text(
        f"Reference: P R²/(E I) = {reference.load:.6f} at a crown {reference.down:.4f} R down, "
        "with the extension and the shear of this arch."
    )
    limits = {n: _limit(n) for n in counts}
    values = [[x.load] for x in limits.values()]
    error = float(convergence(report, "arch", _NAMES, counts, values, [reference.load])[-1, 0])
    apart = _derivatives(report, counts[-1], limits[counts[-1]].down, reference)
    _plot(report, limits[counts[-1]].path, reference.path)
    load = limits[counts[-1]].load
    report.claim(
        "Deep circular arch: limit load over E I/R²",
        "8.97 (DaDeppo & Schmidt 1975); 9.0528 (Simo & Vu-Quoc 1986, 40 elements)",
        f"{load:.4f}, {counts[-1]} elements",
        Agreement.AGREES if relative(load, _PUBLISHED) < 5e-3 else Agreement.DISAGREES,
    )
    return [
        Requirement(f"arch: limit load, {counts[-1]} elements", 2e-3, error),
        Requirement("arch: d(limit load)/d(E, h, R)", 2e-3, apart),
    ]


# -- the elements --------------------------------------------------------------------------------


def _scene(n: int, down: float) -> Scene:
    angle = np.pi / 2 + _SPAN / 2 - _SPAN * np.linspace(0, 1, n + 1)
    c, s = np.cos(angle), np.sin(angle)
    frames = np.moveaxis(np.array([[s, -c], [c, s]]), -1, 0)
    positions = _R * np.array([c, s]).T
    beam = CurvedBeam("arch", positions, frames, Rectangle(_H, _W), Material(1.0, _E, 0.0))
    # The crown is a node: the number of elements is even.
    crown = TranslationDriver(
        beam.at(0.5), (0, 1), ConstantAcceleration(0.0, offset=-down * _R), name="crown"
    )
    return Scene([beam], [Clamp(beam.at_start), Pin(beam.at_end), crown])


def _at(n: int, down: float, start: Equilibrium | None, design: tuple[str, ...]) -> Equilibrium:
    bent = equilibrium(_scene(n, down), design=design, start=start)
    assert bent.outcome.success, bent.outcome
    return bent


def _limit(n: int) -> _Limit:
    """Lower the crown until the load no longer grows."""

    def crown(down: float, at: Equilibrium) -> tuple[float, float, float]:
        aside = at.solution.position(MaterialPoint("arch", 0.5))[0, 0]
        return down, float(aside) / _R, _load(at)

    path, last = [(0.0, 0.0, 0.0)], None
    for down in np.linspace(0.1, 1.1, 11):
        last = _at(n, float(down), last, _DESIGN[:1])
        path.append(crown(float(down), last))

    def growth(down: float) -> float:
        lam_b = _at(n, down, last, _DESIGN[:1]).lam_b
        assert lam_b is not None
        return float(lam_b[-1, 0])

    peak = _turning_point(growth)
    best = _at(n, peak, last, _DESIGN[:1])
    path += [crown(down, _at(n, down, best, _DESIGN[:1])) for down in (peak, peak + 0.03)]
    return _Limit(_load(best), peak, np.array(path))


def _load(bent: Equilibrium) -> float:
    """Return P R^2/(E I): the crown's equation is the last one."""
    return float(bent.lam[-1]) * _R**2 / _EI


def _turning_point(growth: Callable[[float], float]) -> float:
    """Return where the growth of the load with the way down vanishes, from 1.1 R on."""
    low = high = 1.1
    while growth(high) * growth(low) > 0:
        low, high = high, high + 0.02
    return float(brentq(growth, low, high, xtol=1e-8))


# -- the reference -------------------------------------------------------------------------------


def _path(z: Array, down: Any, E: Any, h: Any, R: Any) -> tuple[Array, Array]:
    """Return what is left of the conditions and the place of the crown, for k candidates z.

    z: force and moment at the clamp and P, over E I/R^2 and E I/R. `down` is a length.
    """
    k, EI = len(z), E * _W * h**3 / 12
    rod = Rod(
        R * _SPAN, E * h * _W * np.array([1, 5 / 12, 5 / 12]), EI * np.ones(3), (0, 0, -1 / R)
    )
    zero = np.zeros(k)
    n, P, m = (
        np.stack([*v], axis=1) * unit
        for v, unit in (
            ((z[:, 0], z[:, 1], zero), EI / R**2),
            ((zero, -z[:, 3], zero), EI / R**2),
            ((zero, zero, z[:, 2]), EI / R),
        )
    )
    place, axes = _circle(np.pi / 2 + _SPAN / 2)
    start = np.concatenate([R * place, axes.ravel()])
    start = np.concatenate([np.broadcast_to(start, (k, 12)), m], axis=1).astype(complex)
    crown = rod.march(start, n, 0.5)
    end = rod.march(crown, n - P, 0.5)
    hinge = R * _circle(np.pi / 2 - _SPAN / 2)[0]
    left = [(end[:, i] - hinge[i]) / R for i in (0, 1)]
    left += [end[:, 14] * R / EI, (crown[:, 1] - R + down) / R]
    return np.stack(left, axis=1), crown[:, :2]


def _circle(angle: float) -> tuple[Array, Array]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c, s, 0]), np.array([[s, -c, 0], [c, s, 0], [0, 0, 1]])


def _reference_limit(steps: int) -> _Limit:
    z, path = np.zeros(4), [(0.0, 0.0, 0.0)]

    def at(down: float) -> tuple[Array, Array]:
        return solve(lambda x: _path(x, down * _R, _E, _H, _R)[0], z)

    def crown(down: float, z: Array) -> tuple[float, float, float]:
        place = _path(z[None].astype(complex), down * _R, _E, _H, _R)[1][0]
        return down, float(place[0].real) / _R, float(z[3])

    for down in np.linspace(0.05, 1.1, steps):
        z, _ = at(float(down))
        path.append(crown(float(down), z))

    def growth(down: float) -> float:
        return float(np.linalg.solve(at(down)[1], [0, 0, 0, -1])[3])

    peak = _turning_point(growth)
    z = at(peak)[0]
    path += [crown(down, at(down)[0]) for down in (peak, peak + 0.03)]
    return _Limit(float(z[3]), peak, np.array(path), z)


def _derivatives(report: Report, n: int, down: float, reference: _Limit) -> float:
    """Compare d ln P/d ln(E, h, R): at the limit the way down to it does not matter."""
    last: Equilibrium | None = None
    for place in (0.6, 1.0, down):
        last = _at(n, place, last, _DESIGN)
    assert last is not None
    assert last.lam_b is not None
    values = np.array([_E, _H, _R * _SPAN])
    computed = last.lam_b[-1, 1:] * values / last.lam[-1]

    def quantity(x: Array, b: Array) -> tuple[Array, Array]:
        left = _path(x[None], reference.down * _R, *b)[0][0]
        return left, x[3:] * b[0] * b[1] ** 3 / b[2] ** 2

    b = np.array([_E, _H, _R])
    load, load_b = derivatives(quantity, reference.z, b)
    rows = [
        ("ln P", f"ln {name}", float(x), float(e))
        for name, x, e in zip("EhR", computed, load_b[0] * b / load[0], strict=True)
    ]
    return derivative_table(report, "arch", rows, (f"direct, {n} elements", "reference"))


def _plot(report: Report, path: Array, reference: Array) -> None:
    down = np.concatenate([_DOWN, _DOWN_LATE], axis=1)
    panels = []
    for title, column, read in (("Way down", 0, down), ("Way to the hinge", 1, _ASIDE)):
        series = [
            Series("reference", reference[:, column], reference[:, 2]),
            Series("elements", path[:, column], path[:, 2], line=False, marker=True),
            Series("DaDeppo & Schmidt 1975", read[0], read[1], line=False, marker=True),
        ]
        panels.append(Panel(f"{title} of the crown", "way/R [-]", "P R²/(E I) [-]", series))
    report.plot("arch", panels, 2, "Deep circular arch")


_TEXT = """
*Published*: D. A. DaDeppo and R. Schmidt, *J. Appl. Mech.* 42 (1975) 894-896: an inextensible
arch of 215°, clamped at one end, hinged at the other, carries at most P = 8.97 E I/R² at its
crown; J. C. Simo and L. Vu-Quoc, *Comput. Meth. Appl. Mech. Engng* 58 (1986) 79-116, found 9.0528
with 40 linear elements. *Here*: R = 100, section 1 x 1, nu = 0; the crown is lowered by a
`TranslationDriver`, whose multiplier is the load, and the load is largest where its derivative in
the way vanishes. *Reference*: shooting on the exact rod, in two parts.
"""
