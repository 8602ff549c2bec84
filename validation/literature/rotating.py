"""Case: bending frequencies of a rotating cantilever (Wright et al. 1982; Hodges & Rutkowski 1981).

The blade stands in a turning frame: its equilibrium there, and small motions about it.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.polynomial.legendre import Legendre, leggauss
from scipy.linalg import eigh

from ancfdae import Beam, Clamp, Material, RotatingFrame, Scene, equilibrium, modes
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.external.runs import Requirement
from validation.literature.tables import Array, convergence, derivative_table, relative
from validation.report import Agreement, Report

__all__ = ["PUBLISHED", "rotating"]

# Omega and the first three flap frequencies, both over sqrt(E I/(rho A L^4)).
PUBLISHED: Final = np.array(
    [
        [0, 3.5160, 22.0345, 61.6972],
        [1, 3.6816, 22.1810, 61.8418],
        [2, 4.1373, 22.6149, 62.2732],
        [3, 4.7973, 23.3203, 62.9850],
        [4, 5.5850, 24.2733, 63.9668],
        [5, 6.4495, 25.4461, 65.2050],
        [6, 7.3604, 26.8091, 66.6839],
        [7, 8.2996, 28.3341, 68.3860],
        [8, 9.2568, 29.9954, 70.2930],
        [9, 10.2257, 31.7705, 72.3867],
        [10, 11.2023, 33.6404, 74.6493],
        [11, 12.1843, 35.5890, 77.0638],
        [12, 13.1702, 37.6031, 79.6145],
    ]
)
_NAMES: Final = ("flap 1", "flap 2", "flap 3")
_L, _W, _RHO, _E = 1.0, 0.004, 1000.0, 1e9
_UNIT: Final = np.sqrt(_E * _W**2 / (12 * _RHO * _L**4))
_FAST: Final = 12.0


def rotating(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    counts = (2, 4) if quick else (2, 4, 8, 16)
    speeds = PUBLISHED[::6] if quick else PUBLISHED[::2]
    report.heading("Rotating cantilever")
    report.text(_TEXT)
    exact = np.array([_reference(speed) for speed in PUBLISHED[:, 0]])
    printed = float(np.max(relative(exact, PUBLISHED[:, 1:])))
    report.text(
        f"Reference and printed table are {printed:.0e} apart at most, their last digit. "
        f"Convergence at the speed {_FAST:g}:"
    )
    convergence(report, "rotating", _NAMES, counts, [_flap(n, _FAST)[0] for n in counts], exact[-1])
    computed = np.array([_flap(counts[-1], row[0])[0] for row in speeds])
    error = float(np.max(relative(computed, speeds[:, 1:])))
    apart = _derivatives(report, counts[-1])
    _plot(report, speeds[:, 0], computed, exact)
    report.claim(
        "Rotating cantilever: flap frequencies at the speed 12",
        "13.1702, 37.6031, 79.6145 (Wright et al. 1982; Hodges & Rutkowski 1981)",
        "{:.4f}, {:.4f}, {:.4f}; all speeds within {:.0e}".format(*computed[-1], error),
        Agreement.AGREES if error < 2e-3 else Agreement.DISAGREES,
    )
    return [
        Requirement(f"rotating cantilever, {counts[-1]} elements: all speeds", 2e-3, error),
        Requirement("rotating cantilever: d(frequency)/d(E, w, L)", 5e-3, apart),
    ]


def _flap(n: int, speed: float, design: Sequence[str] = ()) -> tuple[Array, Array]:
    """Return the first three flap frequencies in the unit of the speed, and their derivatives."""
    section = Rectangle(2 * _W, _W)
    blade = Beam("blade", (0, 0, 0), (_L, 0, 0), n, section, Material(_RHO, _E, 0.0))
    scene = Scene([blade], [Clamp(blade.at_start)], frame=RotatingFrame(speed * _UNIT))
    computed = modes(scene, 8, at=equilibrium(scene), design=design, damped=True)
    # Motions odd in z: z of positions and slopes along x and y, x and y of the slope along z.
    k = np.arange(len(computed.shapes))
    odd = (k % 3 == 2) != (k // 3 % 4 == 3)
    out_of_plane, in_plane = (np.linalg.norm(computed.shapes[x], axis=0) for x in (odd, ~odd))
    rows = np.flatnonzero(out_of_plane > in_plane)[:3]
    slopes = computed.natural_frequencies_b[rows] if design else np.zeros((len(rows), 0))
    return computed.natural_frequencies[rows] / _UNIT, slopes / _UNIT


def _reference(speed: float, degree: int = 24) -> Array:
    """Return the frequencies of the rotating Euler beam: Ritz's method with polynomials."""
    points, weights = leggauss(2 * degree)
    x, w = (points + 1) / 2, weights / 2
    # x^2 times polynomials keeps the clamp.
    clamp = Legendre.fromroots([0.0, 0.0], domain=[0, 1])
    shapes = [clamp * Legendre.basis(k, domain=[0, 1]) for k in range(degree)]
    V, V_1, V_2 = (np.array([s.deriv(m)(x) if m else s(x) for s in shapes]).T for m in (0, 1, 2))
    M = (V.T * w) @ V
    K = (V_2.T * w) @ V_2 + speed**2 * (V_1.T * (w * (1 - x**2) / 2)) @ V_1
    values: Array = np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[0, 2]))
    return values


def _derivatives(report: Report, n: int) -> float:
    """Compare d ln(frequency)/d ln(E, w, L) at the fastest speed.

    A frequency is u f(Omega/u), u = w sqrt(E/(12 rho))/L^2, and so is its derivative.
    """
    d = 1e-4
    values = {"blade.youngs_modulus": _E, "blade.width": _W, "blade.length": _L}
    frequencies, slopes = _flap(n, _FAST, list(values))
    value = _reference(_FAST)
    f = (_reference(_FAST * (1 + d)) - _reference(_FAST * (1 - d))) / (2 * d)
    rows = []
    for k, (name, power) in enumerate(zip(("E", "w", "L"), (0.5, 1.0, -2.0), strict=True)):
        computed = slopes[:, k] * list(values.values())[k] / frequencies
        exact = power * (1 - f / value)
        rows += [
            (f"ln {mode}", f"ln {name}", float(x), float(e))
            for mode, x, e in zip(_NAMES[:2], computed, exact, strict=False)
        ]
    return derivative_table(report, "rotating", rows, (f"modes, {n} elements", "reference"))


def _plot(report: Report, speeds: Array, computed: Array, exact: Array) -> None:
    panels = []
    for mode, name in enumerate(_NAMES):
        series = [
            Series("reference", PUBLISHED[:, 0], exact[:, mode]),
            Series(
                "Wright et al. 1982",
                PUBLISHED[:, 0],
                PUBLISHED[:, mode + 1],
                line=False,
                marker=True,
            ),
            Series("elements", speeds, computed[:, mode], line=False, marker=True),
        ]
        panels.append(Panel(name, "speed [-]", "frequency [-]", series))
    report.plot("rotating", panels, 3, "Rotating cantilever: flap frequencies")


_TEXT = """
*Published*: A. D. Wright, C. E. Smith, R. W. Thresher and J. L. C. Wang, *J. Appl. Mech.* 49
(1982) 197-202, and D. H. Hodges and M. J. Rutkowski, *AIAA J.* 19 (1981) 1459-1466: flap
frequencies of a uniform cantilever that rotates about its clamped end, over sqrt(E I/(rho A L⁴)).
*Reference*: the same Euler beam by polynomials of degree 26. *Here*: spatial beam, w/L = 0.004
(rotary inertia and shear change mode 3 by 1e-4), small motions about steady rotation
(`validation/literature/rotating.py`).
"""
