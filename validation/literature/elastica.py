"""Case: the elastica (Mattiasson 1981), and the derivatives of its tip in every parameter."""

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.special import ellipeinc, ellipkinc

from ancfdae import Beam, Clamp, Material, PointForce, Scene, equilibrium
from ancfdae.observables import design_value, position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.external.runs import Requirement
from validation.literature.at_rest import log_derivatives
from validation.literature.rod import Rod, tip_loaded
from validation.literature.tables import Array, convergence, derivative_table, relative
from validation.report import Agreement, Report

__all__ = ["elastica"]

# P L^2/(E I), w/L, u/L and the angle of the tip as printed by Mattiasson (1981).
_PUBLISHED: Final = np.array(
    [
        [0.2, 0.06636, 0.00265, 0.09964],
        [0.4, 0.13098, 0.01035, 0.19715],
        [0.6, 0.19235, 0.02249, 0.29074],
        [0.8, 0.24945, 0.03817, 0.37906],
        [1.0, 0.30172, 0.05643, 0.46135],
        [2.0, 0.49346, 0.16064, 0.78175],
        [3.0, 0.60325, 0.25442, 0.98602],
        [5.0, 0.71379, 0.38763, 1.21537],
        [10.0, 0.81061, 0.55500, 1.43029],
    ]
)
_NAMES: Final = ("deflection w/L", "shortening u/L")
_E, _L, _SLENDER = 1e9, 1.0, 0.02
_ALPHA: Final = 2.0
_DESIGN: Final = ("beam.youngs_modulus", "beam.height", "beam.length", "load.force_y")


def elastica(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    counts = (4, 8) if quick else (4, 8, 16, 32, 64)
    loads = _PUBLISHED[::4, 0] if quick else _PUBLISHED[:, 0]
    report.heading("Elastica")
    report.text(_TEXT)
    exact = np.array([closed_form(a)[:2] for a in loads])
    printed = np.array([closed_form(a) for a in _PUBLISHED[:, 0]]) - _PUBLISHED[:, 1:]
    report.text(
        "The closed form and the printed table are "
        f"{np.max(np.abs(printed)):.0e} "
        f"apart. Convergence at alpha = {_ALPHA:g}; the reference is the exact rod with the shear "
        "and the extension of this beam:"
    )
    tip = _rod_tip(_ALPHA)
    convergence(report, "elastica", _NAMES, counts, [_tip(n, _ALPHA) for n in counts], tip)
    computed = np.array([_tip(counts[-1], a) for a in loads])
    error = float(np.max(relative(computed, exact)))
    report.figure("elastica.error", error)
    report.text(
        f"Against the elastica itself, {counts[-1]} elements, largest error of w/L and u/L over "
        f"all loads: {error:.1e}; shear and extension, which the elastica leaves out, are "
        f"{np.max(relative(tip, closed_form(_ALPHA)[:2])):.1e} of it at alpha = {_ALPHA:g}."
    )
    apart = _derivatives(report, counts[-1])
    _plot(report, loads, computed)
    report.claim(
        "Elastica: tip of a cantilever",
        "w/L = 0.49346, u/L = 0.16064 at alpha = 2 (Mattiasson 1981)",
        "w/L = {:.5f}, u/L = {:.5f}; all loads within {:.0e}".format(
            *_tip(counts[-1], _ALPHA), error
        ),
        Agreement.AGREES if error < 1e-3 else Agreement.DISAGREES,
    )
    return [
        Requirement(
            f"elastica, {counts[-1]} elements, h/L = 0.02: w and u, all loads", 1e-3, error
        ),
        Requirement("elastica: d(w, u)/d(E, h, L, P)", 1e-3, apart),
    ]


def closed_form(alpha: float) -> Array:
    """Return w/L, u/L and the angle of the tip by elliptic integrals (Bisshopp & Drucker 1945)."""
    low, high = 1e-9, np.pi / 2 - 1e-9
    for _ in range(200):
        theta = (low + high) / 2
        low, high = (theta, high) if _load(theta) < alpha else (low, theta)
    return _shape(theta)


def _load(theta: float) -> float:
    """Return alpha at an angle of the tip."""
    m, phi = _modulus(theta)
    return float((ellipkinc(np.pi / 2, m) - ellipkinc(phi, m)) ** 2)


def _shape(theta: float) -> Array:
    """Return w/L, u/L and the angle at an angle of the tip."""
    m, phi = _modulus(theta)
    root = np.sqrt(_load(theta))
    w = 1 - 2 * (ellipeinc(np.pi / 2, m) - ellipeinc(phi, m)) / root
    return np.array([w, 1 - np.sqrt(2 * np.sin(theta)) / root, theta])


def _modulus(theta: float) -> tuple[float, float]:
    m = (1 + np.sin(theta)) / 2
    return m, float(np.arcsin(np.sqrt(0.5 / m)))


def _slopes(alpha: float) -> Array:
    """Return d(w/L, u/L)/d alpha, along the curve by its parameter theta."""
    theta, d = closed_form(alpha)[2], 1e-3

    def along(f: Callable[[float], Array | float]) -> Array:
        # Fourth order: the error is far below that of the elements.
        near = (np.asarray(f(theta + k * d)) for k in (-2, -1, 1, 2))
        a, b, c, e = near
        slope: Array = (a - 8 * b + 8 * c - e) / (12 * d)
        return slope

    return along(lambda x: _shape(x)[:2]) / along(_load)


def _scene(n: int, alpha: float) -> Scene:
    h = _SLENDER * _L
    section, material = Rectangle(h, h), Material(1.0, _E, 0.0)
    beam = Beam("beam", (0, 0), (_L, 0), n, section, material)
    P = alpha * _E * h**4 / 12 / _L**2
    return Scene(
        [beam], [Clamp(beam.at_start)], loads=[PointForce(beam.at_end, (0, -P), name="load")]
    )


def _tip(n: int, alpha: float) -> Array:
    scene = _scene(n, alpha)
    x, y = equilibrium(scene).solution.position(scene.beams[0].at_end)[0]
    return np.array([-y / _L, 1 - x / _L])


def _rod_tip(alpha: float) -> Array:
    h = _SLENDER * _L
    # The shear factor of a rectangle at nu = 0 is 5/6, and G = E/2.
    stretch = _E * h**2 * np.array([1, 5 / 12, 5 / 12])
    rod = Rod(_L, stretch, _E * h**4 / 12 * np.ones(3))
    force = np.array([0, -alpha * _E * h**4 / 12 / _L**2, 0])
    end = tip_loaded(rod, force, steps=2)[0].real
    return np.array([-end[1] / _L, 1 - end[0] / _L])


def _derivatives(report: Report, n: int) -> float:
    """Compare the derivatives of the tip with those of the closed form."""
    scene = _scene(n, _ALPHA)
    tip = scene.beams[0].at_end
    shortening = design_value("beam.length") - position(tip, 0)
    # w = L W(alpha) with alpha = P L^2/(E I): powers of E, h, L and P in alpha.
    powers, of_length = np.array([-1.0, -3.0, 2.0, 1.0]), np.array([0.0, 0.0, 1.0, 0.0])
    growth = _ALPHA * _slopes(_ALPHA) / closed_form(_ALPHA)[:2]
    rows, off = [], 0.0
    for name, observable, rate in zip(
        ("w", "u"), (position(tip, 1), shortening), growth, strict=True
    ):
        computed, apart = log_derivatives(scene, observable, _DESIGN)
        exact, off = powers * rate + of_length, max(off, apart)
        rows += [
            (f"ln {name}", f"ln {parameter}", float(a), float(b))
            for parameter, a, b in zip("EhLP", computed, exact, strict=True)
        ]
    worst = derivative_table(report, "elastica", rows, (f"direct, {n} elements", "closed form"))
    report.text(f"Direct differentiation and adjoint are {off:.0e} apart.")
    return worst


def _plot(report: Report, loads: Array, computed: Array) -> None:
    fine = np.linspace(0.02, 10, 80)
    curve = np.array([closed_form(a) for a in fine])
    series = [
        Series("w/L, closed form", fine, curve[:, 0]),
        Series("u/L, closed form", fine, curve[:, 1]),
        Series("w/L, Mattiasson 1981", _PUBLISHED[:, 0], _PUBLISHED[:, 1], line=False, marker=True),
        Series("u/L, Mattiasson 1981", _PUBLISHED[:, 0], _PUBLISHED[:, 2], line=False, marker=True),
        Series("w/L, elements", loads, computed[:, 0], line=False, marker=True),
        Series("u/L, elements", loads, computed[:, 1], line=False, marker=True),
    ]
    panel = Panel("Tip of a cantilever", "alpha = P L²/(E I) [-]", "w/L, u/L [-]", series)
    report.plot("elastica", [panel])


_TEXT = """
*Published*: K. Mattiasson, *Int. J. Numer. Meth. Engng* 17 (1981) 145-153, tabulates the tip of a
cantilever under a transverse dead force P, from elliptic integrals. *Reference*: those integrals
(K. E. Bisshopp and D. C. Drucker, *Quart. Appl. Math.* 3 (1945) 272-275), and their derivatives.
*Here*: planar beam, nu = 0, h/L = 0.02, `equilibrium`.
"""
