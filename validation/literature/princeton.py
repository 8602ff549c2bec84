"""Case: the Princeton beam, a strip bent about an oblique axis (Dowell & Traybar 1975)."""

from typing import Any, Final

import numpy as np

from ancfdae import Beam, Material, Scene, equilibrium
from ancfdae.numerics.arrays import Array
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.drawing import dots
from validation.literature.rod import Rod, clamped, derivatives, tip_loaded
from validation.literature.tables import compared_at_rest, convergence, relative
from validation.published import published
from validation.report import Report
from validation.scenes import cantilever

_L, _H, _W, _E, _NU = 0.508, 12.3777e-3, 3.2024e-3, 71.7e9, 0.31
_PUBLISHED: Final = published("princeton")
_LOADS, _ANGLES = _PUBLISHED["loads"].tolist(), _PUBLISHED["angles"]
# By load: displacements of the tip in the stiff and in the soft direction at each angle; m.
_BEAM: Final = dict(zip(_LOADS, _PUBLISHED["beams"], strict=True))
_SOLID: Final = dict(zip(_LOADS, _PUBLISHED["solids"], strict=True))
_NAMES: Final = ("stiff direction [m]", "soft direction [m]")


def princeton(report: Report, quick: bool) -> None:
    """Fill the section."""
    counts = (2, 4) if quick else (2, 4, 8, 16)
    angles = _ANGLES[::3] if quick else _ANGLES
    report.say("princeton")
    load = _LOADS[1]
    exact = _rod_tip(load, 45.0)
    report.say("princeton.convergence", load=load)
    errors = convergence(
        report, "princeton", _NAMES, counts, [_tip(n, load, 45.0) for n in counts], exact
    )
    n = counts[-1]
    computed = {P: np.array([_tip(n, P, angle) for angle in angles]) for P in _LOADS}
    principal, oblique = _against_print(report, n, computed, angles)
    apart = _derivatives(report, n)
    _plot(report, angles, computed)
    report.judge("princeton", oblique < 0.03, mm=1e3 * _tip(n, load, 45.0))
    report.require("princeton.principal", principal)
    report.require("princeton.oblique", oblique)
    report.require("princeton.exact", float(np.max(errors[-1])))
    report.require("princeton.derivatives", apart)


def _against_print(
    report: Report, n: int, computed: dict[float, Array], angles: Array
) -> tuple[float, float]:
    """Tabulate what is printed; return the errors in principal directions and at 45°."""
    rows: list[list[object]] = []
    principal, oblique = [], []
    for P, tips in computed.items():
        for angle, tip in zip(angles, tips, strict=True):
            k = int(np.flatnonzero(angle == _ANGLES)[0])
            beam, solid = (np.array(table[P])[:, k] for table in (_BEAM, _SOLID))
            off = np.max(np.abs(tip - beam)[beam > 0] / beam[beam > 0])
            principal += [off] if angle in (0, 90) else []
            oblique += [off] if angle == 45 else []
            cells = [f"{1e3 * x:.4f}" for x in (*tip, *beam, *solid)]
            rows.append([f"{P:g} N, {angle:g}°", *cells, f"{off:.1e}"])
    report.say("princeton.printed", n=n)
    both = ("stiff", "soft")
    header = [f"{who}, {way}" for who in ("here", "beam", "solid") for way in both]
    report.table(["load", *header, "error"], rows)
    polar = _tip(n, _LOADS[1], 45.0, _W * _H * (_W**2 + _H**2) / 12)
    wrong = float(np.max(relative(polar, np.array(_BEAM[_LOADS[1]])[:, 3])))
    report.figure("princeton.polar-moment.error", wrong)
    report.say("princeton.polar-moment", wrong=wrong)
    return float(max(principal)), float(max(oblique))


def _scene(n: int, load: float, angle: float, torsion_constant: float | None = None) -> Scene:
    section = Rectangle(_H, _W, torsion_constant=torsion_constant)
    beam = Beam("beam", (0, 0, 0), (_L, 0, 0), n, section, Material(2810.0, _E, _NU))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return cantilever(beam, (0, load * c, load * s))


def _tip(n: int, load: float, angle: float, torsion_constant: float | None = None) -> Array:
    scene = _scene(n, load, angle, torsion_constant)
    place: Array = equilibrium(scene).solution.position(scene.beams[0].at_end)[0]
    return place[1:]


def _rod(E: Any, h: Any, w: Any) -> Rod:
    """Return the rod with the section's torsion constant and Cowper's shear factor."""
    n = np.arange(1, 200, 2)
    series = np.sum(np.tanh(n * np.pi * h / (2 * w)) / n**5)
    J = h * w**3 / 3 * (1 - 192 / np.pi**5 * w / h * series)
    G = E / (2 * (1 + _NU))
    shear = G * 10 * (1 + _NU) / (12 + 11 * _NU)
    return Rod(
        _L,
        h * w * np.array([E, shear, shear]),
        np.array([G * J, E * h * w**3 / 12, E * w * h**3 / 12]),
    )


def _rod_tip(load: float, angle: float) -> Array:
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return tip_loaded(_rod(_E, _H, _W), load * np.array([0, c, s]), steps=2)[0][1:3].real


def _derivatives(report: Report, n: int) -> float:
    """Compare d ln(tip)/d ln(E, h, w) at 45° with those of the reference."""
    direction = np.array([0, 1, 1]) / np.sqrt(2)
    load = _LOADS[1]
    moment = tip_loaded(_rod(_E, _H, _W), load * direction, steps=2)[1]

    def quantity(m: Array, b: Array) -> tuple[Array, Array]:
        end = clamped(_rod(*b), m[None], load * direction)[0]
        return end[12:], end[1:3]

    b = np.array([_E, _H, _W])
    tip, tip_b = derivatives(quantity, moment, b)
    scene, exact = _scene(n, load, 45.0), tip_b * b / tip[:, None]
    point = scene.beams[0].at_end
    quantities = {
        f"{name} displacement": (position(point, axis), exact[axis - 1])
        for axis, name in ((1, "stiff"), (2, "soft"))
    }
    design = {"E": "beam.youngs_modulus", "h": "beam.height", "w": "beam.width"}
    ways = f"direct, {n} elements", "reference"
    return compared_at_rest(report, "princeton", scene, quantities, design, ways)


def _plot(report: Report, angles: Array, computed: dict[float, Array]) -> None:
    fine = np.linspace(0, 90, 3 * len(angles) - 2)
    curves = {P: 1e3 * np.array([_rod_tip(P, angle) for angle in fine]) for P in _LOADS}
    panels = []
    for way, name in enumerate(("stiff", "soft")):
        series = []
        for P in _LOADS:
            series += [
                Series(f"reference, {P:g} N", fine, curves[P][:, way]),
                dots(f"ANSYS beam, {P:g} N", _ANGLES, 1e3 * np.array(_BEAM[P][way])),
                dots(f"ANSYS solid, {P:g} N", _ANGLES, 1e3 * np.array(_SOLID[P][way])),
                dots(f"elements, {P:g} N", angles, 1e3 * computed[P][:, way]),
            ]
        panels.append(Panel(f"Tip, {name} direction", "angle of the load [°]", "w [mm]", series))
    report.plot("princeton", panels, 2)
