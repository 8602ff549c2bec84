"""Rotating cantilever: flap and lead-lag over the speed, beside Ritz's method and the print."""

from typing import Final

import numpy as np
import scipy
from numpy.polynomial.legendre import Legendre, leggauss

from ancfdae import Beam, Clamp, Material, RotatingFrame, Scene, campbell
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.external.runs import Requirement
from validation.literature.rotating import PUBLISHED
from validation.literature.tables import Array, relative
from validation.report import Agreement, Report

__all__ = ["blades", "scene_of", "unit"]

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


def blades(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    report.heading("Rotating cantilever")
    report.text(_TEXT)
    elements, speeds = (4, np.arange(0.0, 13.0, 4.0)) if quick else (10, np.arange(0.0, 13.0))
    printed = [relative(_ritz(row[0], 0.0)[1::2], row[1:3]) for row in PUBLISHED]
    report.text(f"Reference and printed table are {np.max(printed):.0e} apart at most.")
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
    report.plot("blade", panels, 3, "Rotating cantilever: frequencies over the speed")
    report.claim(
        "Flap and lead-lag of a rotating cantilever, hub ratios 0, 1, 5, speeds to 12",
        "within 0.1 % of Wright et al. (1982) or Ritz's method",
        f"within {100 * max(errors):.2g} %",
        Agreement.AGREES if max(errors) < 1e-3 else Agreement.DISAGREES,
    )
    name = f"rotating cantilever, {elements} elements, hub ratio"
    return [
        Requirement(f"{name} {hub:g}: all speeds", 1e-3, error)
        for hub, error in zip(_HUBS, errors, strict=True)
    ]


def _panel(hub: float, speeds: Array, found: Array, exact: Array) -> Panel:
    series = [Series(f"{name}, reference", speeds, exact[:, k]) for k, name in enumerate(_NAMES)]
    points = np.tile(speeds, len(_NAMES)), found.T.ravel()
    series.append(Series("elements", *points, line=False, marker=True))
    return Panel(f"hub ratio {hub:g}", "speed [-]", "frequency [-]", series)


def _ritz(speed: float, hub: float, degree: int = 24) -> Array:
    """Return lead-lag 1, flap 1, lead-lag 2, flap 2 of the Euler beam by polynomials."""
    points, weights = leggauss(2 * degree)
    x, w = (points + 1) / 2, weights / 2
    # x^2 times polynomials keeps the clamp.
    clamp = Legendre.fromroots([0.0, 0.0], domain=[0, 1])
    shapes = [clamp * Legendre.basis(k, domain=[0, 1]) for k in range(degree)]
    V, V_1, V_2 = (np.array([s.deriv(m)(x) if m else s(x) for s in shapes]).T for m in (0, 1, 2))
    tension = hub * (1 - x) + (1 - x**2) / 2
    K = (V_2.T * w) @ V_2 + speed**2 * (V_1.T * (w * tension)) @ V_1
    flap = scipy.linalg.eigh(K, (V.T * w) @ V, eigvals_only=True, subset_by_index=[0, 1])
    # In the plane of rotation the centrifugal force has a part across the blade.
    both: Array = np.sqrt(np.column_stack([flap - speed**2, flap]).ravel())
    return both


_TEXT = """
*Published*: A. D. Wright, C. E. Smith, R. W. Thresher and J. L. C. Wang, *J. Appl. Mech.* 49 (1982)
197-202. *Reference*: the Euler beam under the tension m Ω² (R (L - x) + (L² - x²)/2), by Ritz's
method with 24 polynomials; lead-lag has Ω² less in the square of its frequency. *Here*: a blade of
square section, side/length 0.004, clamped to the hub, `campbell` over the speeds. Speeds and
frequencies are over sqrt(E I/(rho A L⁴)); the hub ratio is its radius over the length of the blade.
"""
