"""Case: the Princeton beam, a strip bent about an oblique axis (Dowell & Traybar 1975)."""

from typing import Any, Final

import numpy as np

from ancfdae import Beam, Clamp, Material, PointForce, Scene, equilibrium
from ancfdae.observables import position
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.external.runs import Requirement
from validation.literature.at_rest import log_derivatives
from validation.literature.rod import Rod, clamped, derivatives, tip_loaded
from validation.literature.tables import Array, convergence, derivative_table, relative
from validation.report import Agreement, Report

__all__ = ["princeton"]

_L, _H, _W, _E, _NU = 0.508, 12.3777e-3, 3.2024e-3, 71.7e9, 0.31
_LOADS: Final = (8.896, 13.345)
_ANGLES: Final = np.array([0.0, 15, 30, 45, 60, 75, 90])
# Displacement of the tip in the stiff and in the soft direction, in metres, by load and angle: beam
# elements, then solid elements of ANSYS (Obrezkov, Mikkola & Matikainen 2022).
_BEAM: Final = {
    8.896: (
        (
            1.071417630e-2,
            1.061328706e-2,
            1.011169630e-2,
            8.837226265e-3,
            6.604665004e-3,
            3.538889001e-3,
            0,
        ),
        (0, 4.208232124e-2, 7.939482948e-2, 0.108987937, 0.129887616, 0.142194370, 0.146245978),
    ),
    13.345: (
        (
            1.606423724e-2,
            1.645825752e-2,
            1.665873206e-2,
            1.518618440e-2,
            1.157837500e-2,
            6.248967384e-3,
            0,
        ),
        (0, 6.435812858e-2, 0.117735994, 0.156467239, 0.181861627, 0.196097131, 0.200677707),
    ),
}
_SOLID: Final = {
    8.896: (
        (
            1.069752828e-2,
            1.057180106e-2,
            9.938278402e-3,
            8.686786771e-3,
            6.500006282e-3,
            3.481999513e-3,
            0,
        ),
        (0, 4.101165651e-2, 7.696749069e-2, 0.105976311, 0.127251299, 0.139594740, 0.143848652),
    ),
    13.345: (
        (
            1.603700622e-2,
            1.637026068e-2,
            1.640440775e-2,
            1.485055210e-2,
            1.127173264e-2,
            6.062461977e-3,
            0,
        ),
        (0, 6.270699533e-2, 0.113752002, 0.153554457, 0.179978534, 0.192972233, 0.197669499),
    ),
}
_NAMES: Final = ("stiff direction [m]", "soft direction [m]")


def princeton(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    counts = (2, 4) if quick else (2, 4, 8, 16)
    angles = _ANGLES[::3] if quick else _ANGLES
    report.heading("Princeton beam")
    report.text(_TEXT)
    load = _LOADS[1]
    exact = _rod_tip(load, 45.0)
    report.text(f"Convergence at 45° and {load} N; the reference is the exact rod:")
    errors = convergence(
        report, "princeton", _NAMES, counts, [_tip(n, load, 45.0) for n in counts], exact
    )
    n = counts[-1]
    computed = {P: np.array([_tip(n, P, angle) for angle in angles]) for P in _LOADS}
    principal, oblique = _against_print(report, n, computed, angles)
    apart = _derivatives(report, n)
    _plot(report, angles, computed)
    report.claim(
        "Princeton beam, 45°, 13.345 N: displacement in the stiff and in the soft direction",
        "15.186, 156.467 mm (beam elements), 14.851, 153.554 mm (solid elements of ANSYS; Obrezkov "
        "et al. 2022)",
        "{:.3f}, {:.3f} mm".format(*(1e3 * _tip(n, load, 45.0))),
        Agreement.AGREES if oblique < 0.03 else Agreement.DISAGREES,
    )
    return [
        Requirement("Princeton beam, principal directions", 3e-3, principal),
        Requirement("Princeton beam at 45° with the torsion constant", 3e-2, oblique),
        Requirement(
            "Princeton beam at 45°, against the exact rod", 2e-3, float(np.max(errors[-1]))
        ),
        Requirement("Princeton beam: d(tip)/d(E, h, w, P)", 5e-3, apart),
    ]


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
    report.text(f"{n} elements, and the print, in mm; the error is that against the beam elements:")
    both = ("stiff", "soft")
    header = [f"{who}, {way}" for who in ("here", "beam", "solid") for way in both]
    report.table(["load", *header, "error"], rows)
    polar = _tip(n, _LOADS[1], 45.0, _W * _H * (_W**2 + _H**2) / 12)
    wrong = float(np.max(relative(polar, np.array(_BEAM[_LOADS[1]])[:, 3])))
    report.figure("princeton.polar-moment.error", wrong)
    report.text(f"With J = Iyy + Izz instead of the torsion constant: {wrong:.0%} at 45°.")
    return float(max(principal)), float(max(oblique))


def _scene(n: int, load: float, angle: float, torsion_constant: float | None = None) -> Scene:
    section = Rectangle(_H, _W, torsion_constant=torsion_constant)
    beam = Beam("beam", (0, 0, 0), (_L, 0, 0), n, section, Material(2810.0, _E, _NU))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    force = PointForce(beam.at_end, (0, load * c, load * s), name="load")
    return Scene([beam], [Clamp(beam.at_start)], loads=[force])


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
    scene, rows = _scene(n, load, 45.0), []
    design = ["beam.youngs_modulus", "beam.height", "beam.width"]
    for axis, name in ((1, "stiff"), (2, "soft")):
        computed, _ = log_derivatives(
            scene, position(scene.beams[0].at_end, axis), design, adjoint=axis == 2
        )
        rows += [
            (f"ln {name} displacement", f"ln {parameter}", float(x), float(e))
            for parameter, x, e in zip(
                "Ehw", computed, tip_b[axis - 1] * b / tip[axis - 1], strict=True
            )
        ]
    return derivative_table(report, "princeton", rows, (f"direct, {n} elements", "reference"))


def _plot(report: Report, angles: Array, computed: dict[float, Array]) -> None:
    fine = np.linspace(0, 90, 19)
    curves = {P: 1e3 * np.array([_rod_tip(P, angle) for angle in fine]) for P in _LOADS}
    panels = []
    for way, name in enumerate(("stiff", "soft")):
        series = []
        for P in _LOADS:
            series += [
                Series(f"reference, {P:g} N", fine, curves[P][:, way]),
                Series(
                    f"ANSYS beam, {P:g} N",
                    _ANGLES,
                    1e3 * np.array(_BEAM[P][way]),
                    line=False,
                    marker=True,
                ),
                Series(
                    f"ANSYS solid, {P:g} N",
                    _ANGLES,
                    1e3 * np.array(_SOLID[P][way]),
                    line=False,
                    marker=True,
                ),
                Series(
                    f"elements, {P:g} N", angles, 1e3 * computed[P][:, way], line=False, marker=True
                ),
            ]
        panels.append(Panel(f"Tip, {name} direction", "angle of the load [°]", "w [mm]", series))
    report.plot("princeton", panels, 2, "Princeton beam")


_TEXT = """
*Published*: E. H. Dowell and J. J. Traybar (AMS Reports 1194 and 1257, Princeton University,
1975) bent a strip of aluminium by tip weights at angles between its stiff (0°) and its soft (90°)
direction; E. H. Dowell, J. Traybar and D. H. Hodges, *J. Sound Vib.* 50 (1977) 533-544. L. P.
Obrezkov, A. Mikkola and M. K. Matikainen, *Nonlinear Dyn.* 109 (2022) 31-54, give converged
results of beam and of solid elements of ANSYS for L = 0.508 m, 12.3777 mm x 3.2024 mm, E = 71.7e9
N/m², nu = 0.31, which are compared here. Between the principal directions the strip twists.
*Reference*: exact rod with the series of Saint-Venant for J. *Here*: spatial beam, `equilibrium`.
"""
