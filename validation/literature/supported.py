"""Case: natural frequencies of a simply supported thick beam."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from ancfdae import Beam, Clamp, Material, Pin, PointOnLine, Scene, modes
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Series
from ancfdae.sections import Rectangle
from validation.drawing import log_log
from validation.literature.tables import convergence, derivative_table, relative
from validation.published import published
from validation.report import Report

_L, _H, _E, _RHO = 2.0, 0.4, 1e9, 7850.0
_PUBLISHED, _PUBLISHED_POISSON = (published("supported")[x] for x in ("frequencies", "poisson"))
_NAMES: Final = ("bending 1", "bending 2", "bending 3", "axial", "torsion")
# Without corrections of shear and torsion: J = Iyy + Izz.
_SECTION: Final = Rectangle(_H, _H, shear_factors=(1.0, 1.0), torsion_constant=_H**4 / 6)
_DESIGN: Final = ("beam.length", "beam.height", "beam.youngs_modulus", "beam.density")


def supported(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (4, 8) if quick else (4, 8, 16, 32)
    report.say("supported")
    exact = reference(np.array([_L, _H, _E, _RHO]))
    report.say("supported.published", apart=np.max(relative(exact, _PUBLISHED)))
    computed = [np.append(_planar(n)[0], _torsion(n)) for n in counts]
    errors = convergence(report, "supported", _NAMES, counts, computed, exact)
    nu = 0.3
    poisson = reference(np.array([_L, _H, _E, _RHO]), nu, 10 * (1 + nu) / (12 + 11 * nu))[:4]
    off = float(np.max(relative(poisson, _PUBLISHED_POISSON)))
    report.say("supported.poisson", off=off)
    locked_free = [_planar(n, nu=0.3)[0] for n in counts]
    corrected = convergence(report, "supported.nu0.3", _NAMES[:4], counts, locked_free, poisson)
    apart = _derivatives(report, counts[-1])
    panel = log_log(
        "Natural frequencies",
        "elements [-]",
        "relative error [-]",
        [
            Series(name, counts, np.maximum(errors[:, k], 1e-16), marker=True)
            for k, name in enumerate(_NAMES)
        ],
    )
    report.plot("supported", [panel])
    worst = float(np.max(errors[-1]))
    report.judge("supported", worst < 1.5e-3, found=computed[-1])
    report.require("supported.bending", float(np.max(errors[-1, :3])), n=counts[-1])
    report.require("supported.axial", float(errors[-1, 3]), n=counts[-1])
    report.require("supported.poisson", float(np.max(corrected[-1])), n=counts[-1])
    report.require("supported.torsion", float(errors[-1, 4]), n=counts[-1])
    report.require("supported.derivatives", apart)


def reference(b: Array, nu: float = 0.0, factor: float = 1.0) -> Array:
    """Return the frequencies of theory; b: L, h, E and rho, possibly complex."""
    L, h, E, rho = b
    G, I_over_A = factor * E / (2 * (1 + nu)), h**2 / 12
    bending = []
    for n in (1, 2, 3):
        k = n * np.pi / L
        # Timoshenko's beam: rho^2 I/G x^2 - (rho A + rho I k^2 (1 + E/G)) x + E I k^4 = 0.
        a, c = rho**2 * I_over_A / G, E * I_over_A * k**4
        half = (rho + rho * I_over_A * k**2 * (1 + E / G)) / 2
        bending.append(np.sqrt(c / (half + np.sqrt(half**2 - a * c))))
    axial, torsion = np.pi / (2 * L) * np.sqrt(E / rho), np.pi / L * np.sqrt(G / rho)
    return np.array([*bending, axial, torsion])


def _planar(n: int, design: Sequence[str] = (), nu: float = 0.0) -> tuple[Array, Any]:
    """Return three bending frequencies and the axial one, and their derivatives."""
    section = Rectangle(_H, _H) if nu else _SECTION
    beam = Beam("beam", (0, 0), (_L, 0), n, section, Material(_RHO, _E, nu))
    scene = Scene([beam], [Pin(beam.at_start), PointOnLine(beam.at_end, (1, 0))])
    lowest = modes(scene, 4, design=design)
    # In the order of frequencies the axial mode is the second.
    order = [0, 2, 3, 1]
    return lowest.frequencies[order], lowest.frequencies_b[order] if design else None


def _torsion(n: int) -> float:
    """Return the first frequency of torsion between clamps, the one nearest to theory."""
    beam = Beam("beam", (0, 0, 0), (_L, 0, 0), n, _SECTION, Material(_RHO, _E, 0.0))
    frequencies = modes(Scene([beam], [Clamp(beam.at_start), Clamp(beam.at_end)]), 6).frequencies
    return float(frequencies[np.argmin(np.abs(frequencies - _PUBLISHED[-1]))])


def _derivatives(report: Report, n: int) -> float:
    b = np.array([_L, _H, _E, _RHO])
    value, value_b = _planar(n, _DESIGN)
    exact = reference(b)
    rows = []
    for k, name in enumerate(("L", "h", "E", "rho")):
        step = np.zeros(4)
        step[k] = 1e-30
        slope = reference(b * (1 + 1j * step)).imag / 1e-30 / exact
        computed = value_b[:, k] * b[k] / value
        rows += [
            (f"ln {mode}", f"ln {name}", float(x), float(e))
            for mode, x, e in zip(_NAMES[:4], computed, slope[:4], strict=True)
            # The axial frequency does not depend on h.
            if abs(e) > 1e-9
        ]
    return derivative_table(report, "supported", rows, (f"direct, {n} elements", "closed form"))
