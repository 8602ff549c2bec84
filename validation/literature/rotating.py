"""Case: bending frequencies of a rotating cantilever (Wright et al. 1982; Hodges & Rutkowski 1981).

The blade stands in a turning frame: its equilibrium there, and small motions about it.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.polynomial.legendre import Legendre, leggauss
from scipy.linalg import eigh

from ancfdae import Beam, Clamp, Material, RotatingFrame, Scene, equilibrium, modes
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.tables import convergence, derivative_table, relative
from validation.published import published
from validation.report import Report

# The speed and the first three flap frequencies, both over sqrt(E I/(rho A L^4)).
PUBLISHED: Final = published("rotating")["flap"]
_NAMES: Final = ("flap 1", "flap 2", "flap 3")
_L, _W, _RHO, _E = 1.0, 0.004, 1000.0, 1e9
_UNIT: Final = np.sqrt(_E * _W**2 / (12 * _RHO * _L**4))
_FAST: Final = 12.0


def rotating(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (2, 4) if quick else (2, 4, 8, 16)
    speeds = PUBLISHED[::6] if quick else PUBLISHED[::2]
    report.say("rotating")
    exact = np.array([_reference(speed) for speed in PUBLISHED[:, 0]])
    printed = float(np.max(relative(exact, PUBLISHED[:, 1:])))
    report.say("rotating.printed", printed=printed, fast=_FAST)
    convergence(report, "rotating", _NAMES, counts, [_flap(n, _FAST)[0] for n in counts], exact[-1])
    computed = np.array([_flap(counts[-1], row[0])[0] for row in speeds])
    error = float(np.max(relative(computed, speeds[:, 1:])))
    apart = _derivatives(report, counts[-1])
    _plot(report, speeds[:, 0], computed, exact)
    report.judge("rotating", error < 2e-3, found=computed[-1], error=error)
    report.require("rotating", error, n=counts[-1])
    report.require("rotating.derivatives", apart)


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


def ritz(speed: float, hub: float = 0.0, count: int = 3) -> Array:
    """Return squares of flap frequencies of the rotating Euler beam by 24 polynomials.

    `hub` is the radius of the hub over the length.
    """
    degree = 24
    points, weights = leggauss(2 * degree)
    x, w = (points + 1) / 2, weights / 2
    # x^2 times polynomials keeps the clamp.
    clamp = Legendre.fromroots([0.0, 0.0], domain=[0, 1])
    shapes = [clamp * Legendre.basis(k, domain=[0, 1]) for k in range(degree)]
    V, V_1, V_2 = (np.array([s.deriv(m)(x) if m else s(x) for s in shapes]).T for m in (0, 1, 2))
    tension = hub * (1 - x) + (1 - x**2) / 2
    K = (V_2.T * w) @ V_2 + speed**2 * (V_1.T * (w * tension)) @ V_1
    return eigh(K, (V.T * w) @ V, eigvals_only=True, subset_by_index=[0, count - 1])


def _reference(speed: float) -> Array:
    return np.sqrt(ritz(speed))


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
            dots("Wright et al. 1982", PUBLISHED[:, 0], PUBLISHED[:, mode + 1]),
            dots("elements", speeds, computed[:, mode]),
        ]
        panels.append(Panel(name, "speed [-]", "frequency [-]", series))
    report.plot("rotating", panels, 3)
