"""Case: limit load of a clamped-hinged deep circular arch (DaDeppo & Schmidt 1975)."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq

from ancfdae import Clamp, CurvedBeam, Material, Pin, Scene, TranslationDriver, equilibrium
from ancfdae.extend import MaterialPoint
from ancfdae.laws import ConstantAcceleration
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import Equilibrium
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.rod import Rod, derivatives, solve
from validation.literature.tables import convergence, derivative_table, logarithmic, relative
from validation.published import published
from validation.report import Report

_R, _SPAN, _E, _H, _W = 100.0, np.radians(215), 1.5e6, 1.0, 1.0
_EI: Final = _E * _W * _H**3 / 12
_PUBLISHED: Final = published("arch")
_NAMES: Final = ("P R²/(E I)",)
_DESIGN: Final = ("crown.offset", "arch.youngs_modulus", "arch.height", "arch.length")


@dataclass(frozen=True)
class _Limit:
    """Limit load over E I/R^2, where it is reached, the path up to there; z of the reference."""

    load: float
    down: float
    path: Array
    z: Array = field(default_factory=lambda: np.zeros(4))


def arch(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (16, 32) if quick else (16, 32, 64)
    report.say("arch")
    reference = _reference_limit(6 if quick else 22)
    report.say("arch.reference", reference=reference)
    limits = {n: _limit(n) for n in counts}
    values = [[x.load] for x in limits.values()]
    error = float(convergence(report, "arch", _NAMES, counts, values, [reference.load])[-1, 0])
    apart = _derivatives(report, counts[-1], limits[counts[-1]].down, reference)
    _plot(report, limits[counts[-1]].path, reference.path)
    load = limits[counts[-1]].load
    report.judge("arch", relative(load, _PUBLISHED["limit_load"]) < 5e-3, load=load, n=counts[-1])
    report.require("arch", error, n=counts[-1])
    report.require("arch.derivatives", apart)


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
    rows = logarithmic("P", "EhR", computed, load_b[0] * b / load[0])
    return derivative_table(report, "arch", rows, (f"direct, {n} elements", "reference"))


def _plot(report: Report, path: Array, reference: Array) -> None:
    down, aside = _PUBLISHED["down"], _PUBLISHED["aside"]
    panels = []
    for title, column, read in (("Way down", 0, down), ("Way to the hinge", 1, aside)):
        series = [
            Series("reference", reference[:, column], reference[:, 2]),
            dots("elements", path[:, column], path[:, 2]),
            dots("DaDeppo & Schmidt 1975", read[0], read[1]),
        ]
        panels.append(Panel(f"{title} of the crown", "way/R [-]", "P R²/(E I) [-]", series))
    report.plot("arch", panels, 2)
