"""Rotating cantilever: flap and lead-lag over the speed, beside Ritz's method and the print."""

from typing import Final

import numpy as np

from ancfdae import Beam, Clamp, Material, RotatingFrame, Scene, campbell
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.rotating import PUBLISHED, ritz
from validation.literature.tables import relative
from validation.report import Report

_NAMES: Final = ("lead-lag 1", "flap 1", "lead-lag 2", "flap 2")
_HUBS: Final = (0.0, 1.0, 5.0)
_LENGTH, _SIDE, _RHO, _E = 1.0, 0.004, 1000.0, 1e9


def unit() -> float:
    """Return sqrt(E I/(rho A L^4)), in which speeds and frequencies are given; rad/s."""
    return float(np.sqrt(_E * _SIDE**2 / (12 * _RHO * _LENGTH**4)))


def scene_of(elements: int, hub: float, speed: float) -> Scene:
    """Return a blade of square section that starts at the hub, in a frame that turns."""
    section, material = Rectangle(_SIDE, _SIDE), Material(_RHO, _E, 0.0)
    blade = Beam("blade", (0, 0, 0), (_LENGTH, 0, 0), elements, section, material)
    frame = RotatingFrame(speed * unit(), through=(-hub * _LENGTH, 0, 0))
    return Scene([blade], [Clamp(blade.at_start)], frame=frame)


def blades(report: Report, quick: bool) -> None:
    """Fill the section."""
    report.say("blade")
    elements, speeds = (4, np.arange(0.0, 13.0, 4.0)) if quick else (10, np.arange(0.0, 13.0))
    printed = [relative(_ritz(row[0], 0.0)[1::2], row[1:3]) for row in PUBLISHED]
    report.say("blade.printed", apart=np.max(printed))
    rows, panels, errors = [], [], []
    for hub in _HUBS:
        found = campbell(scene_of(elements, hub, 0.0), speeds * unit(), 4).frequencies / unit()
        exact = np.array([_ritz(speed, hub) for speed in speeds])
        # At rest both bendings of a square coincide; lines are named at the highest speed.
        found = found[:, np.argsort(found[-1])[np.argsort(np.argsort(exact[-1]))]]
        apart = relative(found, exact)
        errors.append(report.figure(f"blade.hub{hub:g}.error", float(np.max(apart))))
        for k in np.flatnonzero(np.isin(speeds, (0.0, 4.0, 12.0))):
            pairs = zip(found[k], exact[k], strict=True)
            rows.append([f"{hub:g}", f"{speeds[k]:g}", *(f"{a:.4f} ({b:.4f})" for a, b in pairs)])
        panels.append(_panel(hub, speeds, found, exact))
    report.table(["hub", "speed", *(f"{name} (reference)" for name in _NAMES)], rows)
    report.plot("blade", panels, 3)
    report.judge("blade", max(errors) < 1e-3, percent=100 * max(errors))
    for hub, error in zip(_HUBS, errors, strict=True):
        report.require("blade", error, elements=elements, hub=hub)


def _panel(hub: float, speeds: Array, found: Array, exact: Array) -> Panel:
    series = [Series(f"{name}, reference", speeds, exact[:, k]) for k, name in enumerate(_NAMES)]
    points = np.tile(speeds, len(_NAMES)), found.T.ravel()
    series.append(dots("elements", *points))
    return Panel(f"hub ratio {hub:g}", "speed [-]", "frequency [-]", series)


def _ritz(speed: float, hub: float) -> Array:
    """Return lead-lag 1, flap 1, lead-lag 2, flap 2 of the Euler beam by polynomials."""
    flap = ritz(speed, hub, count=2)
    # In the plane of rotation the centrifugal force has a part across the blade.
    return np.sqrt(np.column_stack([flap - speed**2, flap]).ravel())
