"""Similarity scaling: one scene in units over sixteen orders of magnitude."""

from collections.abc import Sequence

import numpy as np

from ancfdae import HHT, differentiate
from ancfdae.extend import MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.drawing import log_log
from validation.extremes.scenes import SI, Rod, Units
from validation.report import Report

_DESIGN = ("rod.youngs_modulus", "rod.height", "rod.density", "rod.length")
_STEP, _STEPS = 2.0**-7, 64
_QUANTITIES = ("place of the tip", "accelerations", "reaction", "sensitivities of the tip")


def scaling(report: Report, quick: bool) -> float:
    """Add the section; return the largest difference."""
    exponents = (-8, 8) if quick else range(-8, 9)
    steps = 16 if quick else _STEPS
    report.say("scaling", steps=steps)
    panels, rows, worst = [], [], 0.0
    for dimension in (2, 3):
        rod = Rod(dimension=dimension)
        base, iterations = _dimensionless(rod, SI, steps)
        for unit in ("length", "mass", "time"):
            table, others = [], 0
            for k in exponents:
                scaled, count = _dimensionless(rod, Units(**{unit: 10.0**k}), steps)
                pairs = zip(scaled, base, strict=True)
                table.append([np.max(np.abs(x - y)) / np.max(np.abs(y)) for x, y in pairs])
                others += count != iterations
            errors = np.array(table)
            worst = max(worst, float(np.max(errors)))
            for name, value in zip(_QUANTITIES, np.max(errors, axis=0), strict=True):
                report.figure(f"units.{dimension}d.{unit}.{name.replace(' ', '_')}", value)
            kind = "planar" if dimension == 2 else "spatial"
            rows.append([kind, unit, *(f"{x:.0e}" for x in np.max(errors, axis=0)), others])
            panels.append(_panel(f"{kind}, {unit}", unit, exponents, errors))
    report.table(["element", "unit", *_QUANTITIES, "runs with other iterations"], rows)
    report.plot("units", panels, 3)
    report.figure("units.worst", worst)
    return worst


def _panel(title: str, unit: str, exponents: Sequence[int], errors: Array) -> Panel:
    others = [i for i, k in enumerate(exponents) if k != 0]
    units = 10.0 ** np.array(exponents)[others]
    return log_log(
        title,
        f"unit of {unit}, SI / new [-]",
        "difference [-]",
        [
            Series(name, units, np.maximum(errors[others, i], 1e-17), marker=True)
            for i, name in enumerate(_QUANTITIES)
        ],
    )


def _dimensionless(rod: Rod, units: Units, steps: int) -> tuple[list[Array], int]:
    """Tip, accelerations, reaction and scaled sensitivities, all in SI; Newton iterations."""
    h = _STEP * units.time
    run = differentiate(rod.scene(units), h * steps, HHT(h), design=_DESIGN)
    assert run.sensitivities is not None

    def tip(solution: Solution) -> Array:
        return solution.position(MaterialPoint("rod", 1.0))

    sensitivities = run.derivative(tip) * run.sensitivities.values / units.length
    parts = [
        tip(run) / units.length,
        run.acceleration(MaterialPoint("rod", 1.0)) * units.time**2 / units.length,
        run.reaction("pin(rod@0)") / units.force,
        sensitivities,
    ]
    return parts, run.statistics.iterations
