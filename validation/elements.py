"""Report on the elements: how many a beam needs, by strain energy and slenderness."""

from typing import Final

import numpy as np

from ancfdae import (
    Beam,
    Clamp,
    EnhancedContinuum,
    Material,
    Moment,
    Pin,
    PointForce,
    PointOnLine,
    SaintVenantKirchhoff,
    Scene,
    assemble,
    equilibrium,
    modes,
)
from ancfdae.extend import StrainEnergyFunction
from ancfdae.numerics.arrays import Array
from ancfdae.observables import observe, shear_force
from ancfdae.plotting import Series
from ancfdae.sections import Rectangle
from validation import shapes, short_elements, thin_beams
from validation.drawing import log_log
from validation.elements_sections import sections
from validation.report import Report

_E: Final = 1e9
_DENSITY: Final = 1000.0
_SLENDER: Final = (0.2, 0.1, 0.01, 0.001)
_ENERGIES: Final[dict[str, StrainEnergyFunction]] = {
    "full law": SaintVenantKirchhoff(),
    "enhanced, exact strains": EnhancedContinuum(assumed_strains=False),
    "enhanced (default)": EnhancedContinuum(),
}
# First root of cos x cosh x = -1: a clamped-free beam.
_ROOT: Final = 1.8751040687119611


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `elements`; add its text, tables and figures."""
    counts = (1, 2, 4) if quick else (1, 2, 4, 8, 16, 32, 64)
    report.say("method")
    for nu in (0.0, 0.3):
        _small(report, nu, counts, quick)
    _claims(report, counts[-1])
    _within(report, counts[1:])
    _large(report, counts[2:] if quick else counts[1:])
    _frequencies(report, counts, quick)
    sections(report, quick)
    shapes.fill(report, quick)
    short_elements.fill(report, quick)
    thin_beams.fill(report, quick)
    report.say("verdict")
    report.say("limits")


def _beam(d: int, h: float, n: int, nu: float, energy: StrainEnergyFunction) -> Beam:
    """Return a beam of length 1 m along x with a square section."""
    rest = (0.0,) * (d - 1)
    material = Material(_DENSITY, _E, nu)
    return Beam("beam", (0.0, *rest), (1.0, *rest), n, Rectangle(h, h), material, energy=energy)


def _tip(beam: Beam, load: PointForce | Moment) -> Array:
    """Return where the end comes to rest."""
    rest = equilibrium(Scene([beam], [Clamp(beam.at_start)], loads=[load]))
    return rest.solution.position(beam.at_end)[0]


def _deflection(d: int, h: float, n: int, nu: float, energy: StrainEnergyFunction) -> float:
    """Return the error of the deflection under a small force, relative to Timoshenko's beam."""
    factor, force = 10 * (1 + nu) / (12 + 11 * nu), 1e-6 * _E * h**4
    if isinstance(energy, SaintVenantKirchhoff):
        factor = 1.0
    exact = force * (4 / (_E * h**4) + 2 * (1 + nu) / (factor * _E * h**2))
    beam = _beam(d, h, n, nu, energy)
    tip = _tip(beam, PointForce(beam.at_end, (0.0, force, 0.0)[:d]))
    return float(tip[1] / exact - 1)


def _small(report: Report, nu: float, counts: tuple[int, ...], quick: bool) -> None:
    report.heading(f"Tip deflection under a small force, nu = {nu:g}")
    panels = []
    for d in (2, 3):
        rows: list[list[object]] = []
        for name, energy in _ENERGIES.items():
            for h in _SLENDER[1:3] if quick else _SLENDER:
                errors = [_deflection(d, h, n, nu, energy) for n in counts]
                rows.append([name, f"{h:g}", *(f"{x:.1e}" for x in errors)])
                report.figures(
                    f"deflection.{d}d.nu{nu:g}.h{h:g}.{_word(name)}.n{{}}", counts, errors
                )
        title = f"{'planar' if d == 2 else 'spatial'} element, nu = {nu:g}"
        report.say("small", title=title)
        report.table(["energy", "h/L", *map(str, counts)], rows)
        at = "0.01"
        series = [
            Series(str(row[0]), list(counts), [abs(float(str(x))) for x in row[2:]], marker=True)
            for row in rows
            if row[1] == at
        ]
        panels.append(log_log(title, "elements [-]", "error of deflection [-]", series))
    digits = f"{nu:g}".replace(".", "")
    report.plot("deflection-nu{digits}", panels, 2, digits=digits, nu=nu)


def _claims(report: Report, n: int) -> None:
    """Hold the errors of all three against what theory says, at h/L = 0.01."""
    # Poisson locking: E (1 - nu)/((1 + nu)(1 - 2 nu)) instead of E.
    locked = 1.3 * 0.4 / 0.7 - 1
    for name, nu, expected, count in (
        ("full law", 0.3, locked, n),
        ("enhanced, exact strains", 0.3, -1 / (4 * n**2), n),
        ("enhanced (default)", 0.0, 0.0, 1),
        ("enhanced (default)", 0.3, 0.0, 1),
    ):
        errors = [_deflection(d, 0.01, count, nu, _ENERGIES[name]) for d in (2, 3)]
        # The full law on a finite mesh has the error of its curvature besides.
        near = max(abs(error - expected) for error in errors) < max(0.1 * abs(expected), 1e-6)
        report.judge(
            "claims",
            near,
            name=name,
            nu=nu,
            count=count,
            expected=expected,
            errors=", ".join(f"{error:.3g}" for error in errors),
        )


def _within(report: Report, counts: tuple[int, ...]) -> None:
    report.say("within")
    rows, largest = [], {}
    for name, energy in _ENERGIES.items():
        errors = [_bent(n, energy) for n in counts]
        for k, what in enumerate(("deflection", "shear force")):
            rows.append([name, what, *(f"{pair[k]:.1e}" for pair in errors)])
            for n, pair in zip(counts, errors, strict=True):
                key = what.replace(" ", "-")
                report.figure(f"within.{key}.{_word(name)}.n{n}", pair[k])
        largest[name] = np.max(np.abs(errors), axis=0)
    report.table(["energy", "error of", *map(str, counts)], rows)
    deflection = largest["enhanced (default)"][0]
    shear = max(each[1] for each in largest.values())
    # What is left is the square of the deflection over the height, 1e-8.
    for what, error in (("deflection, default energy", deflection), ("shear force, all", shear)):
        report.judge("within", error < 1e-6, what=what, error=error)


def _bent(n: int, energy: StrainEnergyFunction) -> tuple[float, float]:
    """Return the errors of deflection and shear force in three-point bending."""
    h, beam = 0.1, _beam(2, 0.1, n, 0.0, energy)
    force, factor = 1e-6 * _E * h**4, 1.0 if isinstance(energy, SaintVenantKirchhoff) else 5 / 6
    joints = [Pin(beam.at_start), PointOnLine(beam.at_end, (1.0, 0.0))]
    scene = Scene([beam], joints, loads=[PointForce(beam.at(0.5), (0.0, -force))])
    rest, system = equilibrium(scene), assemble(scene)
    exact = force / (4 * _E * h**4) + force / (2 * factor * _E * h**2)
    deflection = -rest.solution.position(beam.at(0.5))[0, 1] / exact - 1
    places = (beam.at(0.5, before=True), beam.at(0.5))
    V = [observe(shear_force(place), rest.solution, system)[0] / force for place in places]
    return float(deflection), float(np.max(np.abs(np.array(V) - (-0.5, 0.5))))


def _large(report: Report, counts: tuple[int, ...]) -> None:
    report.say("large")
    exact, rows = np.array([2 / np.pi, 2 / np.pi]), []
    for name, energy in _ENERGIES.items():
        errors = []
        for n in counts:
            beam = _beam(2, 0.01, n, 0.0, energy)
            moment = np.pi / 2 * _E * 0.01**4 / 12
            errors.append(float(np.linalg.norm(_tip(beam, Moment(beam.at_end, moment)) - exact)))
            report.figure(
                f"circle.{name.split(' (')[0].replace(', ', '-').replace(' ', '-')}.n{n}",
                errors[-1],
            )
        rows.append([name, *(f"{x:.1e}" for x in errors)])
    report.table(["energy", *map(str, counts)], rows)


def _frequencies(report: Report, counts: tuple[int, ...], quick: bool) -> None:
    report.say("frequencies")
    h, rows = 0.01, []
    exact = _ROOT**2 * np.sqrt(_E * h**2 / (12 * _DENSITY))
    for d in (2, 3):
        for name, energy in _ENERGIES.items():
            errors = []
            for n in counts[: 4 if d == 3 and quick else None]:
                beam = _beam(d, h, n, 0.3, energy)
                lowest = modes(Scene([beam], [Clamp(beam.at_start)]), count=1)
                errors.append(float(lowest.frequencies[0] / exact - 1))
                report.figure(f"frequency.{d}d.{_word(name)}.n{n}", errors[-1])
            rows.append([f"{d}D", name, *(f"{x:.1e}" for x in errors)])
    report.table(["element", "energy", *map(str, counts)], rows)


def _word(name: str) -> str:
    """Return the name of an energy as part of the name of a figure."""
    return name.split(" (")[0].replace(", ", "-").replace(" ", "-")
