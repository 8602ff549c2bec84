"""Case: the elastica (Mattiasson 1981), and the derivatives of its tip in every parameter."""

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.special import ellipeinc, ellipkinc

from ancfdae import Beam, Material, Scene, equilibrium
from ancfdae.numerics.arrays import Array
from ancfdae.observables import design_value, position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.rod import Rod, tip_loaded
from validation.literature.tables import compared_at_rest, convergence, relative
from validation.published import published
from validation.report import Report
from validation.scenes import cantilever

_PUBLISHED: Final = published("elastica")["tip"]
_NAMES: Final = ("deflection w/L", "shortening u/L")
_E, _L, _SLENDER = 1e9, 1.0, 0.02
_ALPHA: Final = 2.0
_DESIGN: Final = {
    "E": "beam.youngs_modulus", "h": "beam.height", "L": "beam.length", "P": "load.force_y",
}  # fmt: skip


def elastica(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (4, 8) if quick else (4, 8, 16, 32, 64)
    loads = _PUBLISHED[::4, 0] if quick else _PUBLISHED[:, 0]
    report.say("elastica")
    exact = np.array([closed_form(a)[:2] for a in loads])
    printed = np.array([closed_form(a) for a in _PUBLISHED[:, 0]]) - _PUBLISHED[:, 1:]
    report.say("elastica.printed", printed=np.max(np.abs(printed)), alpha=_ALPHA)
    tip = _rod_tip(_ALPHA)
    convergence(report, "elastica", _NAMES, counts, [_tip(n, _ALPHA) for n in counts], tip)
    computed = np.array([_tip(counts[-1], a) for a in loads])
    error = float(np.max(relative(computed, exact)))
    report.figure("elastica.error", error)
    report.say(
        "elastica.error",
        n=counts[-1],
        error=error,
        left_out=np.max(relative(tip, closed_form(_ALPHA)[:2])),
        alpha=_ALPHA,
    )
    apart = _derivatives(report, counts[-1])
    _plot(report, loads, computed)
    report.judge("elastica", error < 1e-3, tip=_tip(counts[-1], _ALPHA), error=error)
    report.require("elastica", error, n=counts[-1])
    report.require("elastica.derivatives", apart)


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
        return (a - 8 * b + 8 * c - e) / (12 * d)

    return along(lambda x: _shape(x)[:2]) / along(_load)


def _scene(n: int, alpha: float) -> Scene:
    h = _SLENDER * _L
    section, material = Rectangle(h, h), Material(1.0, _E, 0.0)
    beam = Beam("beam", (0, 0), (_L, 0), n, section, material)
    P = alpha * _E * h**4 / 12 / _L**2
    return cantilever(beam, (0, -P))


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
    w_b, u_b = np.outer(_ALPHA * _slopes(_ALPHA) / closed_form(_ALPHA)[:2], powers) + of_length
    quantities = {"w": (position(tip, 1), w_b), "u": (shortening, u_b)}
    ways = f"direct, {n} elements", "closed form"
    return compared_at_rest(report, "elastica", scene, quantities, _DESIGN, ways)


def _plot(report: Report, loads: Array, computed: Array) -> None:
    fine = np.linspace(0.02, 10, 80)
    curve = np.array([closed_form(a) for a in fine])
    series = [
        Series("w/L, closed form", fine, curve[:, 0]),
        Series("u/L, closed form", fine, curve[:, 1]),
        dots("w/L, Mattiasson 1981", _PUBLISHED[:, 0], _PUBLISHED[:, 1]),
        dots("u/L, Mattiasson 1981", _PUBLISHED[:, 0], _PUBLISHED[:, 2]),
        dots("w/L, elements", loads, computed[:, 0]),
        dots("u/L, elements", loads, computed[:, 1]),
    ]
    panel = Panel("Tip of a cantilever", "alpha = P L²/(E I) [-]", "w/L, u/L [-]", series)
    report.plot("elastica", [panel])
