"""Part of the report on the elements: Newton iterations where elements are shorter than high."""

import numpy as np

from ancfdae import (
    HHT,
    Beam,
    EnhancedContinuum,
    Material,
    Pin,
    Scene,
    equilibrium,
    simulate,
)
from ancfdae.sections import Rectangle
from validation.report import Report
from validation.scenes import cantilever

_E, _H, _L = 1e7, 0.05, 1.2


def fill(report: Report, quick: bool) -> None:
    """Add the table and its claim."""
    report.say("short-elements")
    rows, worst = [], 0.0
    for d in (2, 3):
        for ratio in (10,) if quick else (10, 50, 200):
            n = round(ratio * _L / _H)
            row: list[object] = [f"{d}D", ratio, n]
            for name, count in (("fall", _falling), ("rest", _resting)):
                default, exact = (count(d, n, assumed) for assumed in (True, False))
                report.figure(f"short.{name}.{d}d.r{ratio}", default / exact)
                worst = max(worst, default / exact)
                row += [f"{default:.3g}", f"{exact:.3g}"]
            rows.append(row)
    columns = ["falling: default", "exact strains", "at rest: default", "exact strains"]
    report.table(["element", "h/l", "elements", *columns], rows)
    report.judge("short-elements", worst <= 1.2, worst=worst)


def _beam(d: int, n: int, assumed: bool) -> Beam:
    rest, energy = (0.0,) * (d - 1), EnhancedContinuum(assumed)
    section, material = Rectangle(_H, _H), Material(4000.0, _E, 0.3)
    return Beam("beam", (0.0, *rest), (_L, *rest), n, section, material, energy=energy)


def _falling(d: int, n: int, assumed: bool) -> float:
    """Return the iterations a step."""
    beam = _beam(d, n, assumed)
    scene = Scene([beam], [Pin(beam.at_start)], gravity=(0.0, -9.81, 0.0)[:d])
    run = simulate(scene, 0.25, HHT(2.0**-10))
    return run.statistics.iterations / run.statistics.steps if run.outcome.success else np.inf


def _resting(d: int, n: int, assumed: bool) -> float:
    """Return the iterations of the search."""
    beam = _beam(d, n, assumed)
    force = (0.0, 3 * _E * _H**4 / 12 / _L**2, 0.0)[:d]
    rest = equilibrium(cantilever(beam, force))
    return float(rest.solution.statistics.iterations) if rest.outcome.success else np.inf
