"""Derivatives of frequencies in design and speed, beside differences of the very call."""

import numpy as np

from ancfdae import Adjoint, Scene, assemble, equilibrium, modes
from ancfdae.numerics.arrays import Array
from validation.literature.tables import derivative_table
from validation.report import Report
from validation.rotation.blade import scene_of
from validation.rotation.shaft import shaft_scene

_BLADE = ("scene.rate", "scene.through_x", "blade.height", "blade.length", "blade.youngs_modulus")
_SHAFT = ("scene.rate", "shaft.radius", "shaft.length", "disc.radius")
# Relative step: h^2 of the change and round-off of frequencies, 1e-12/h.
_STEP = 1e-4


def derivatives(report: Report, quick: bool) -> None:
    """Fill the section."""
    report.say("derivatives")
    n = 4 if quick else 8
    shaft = shaft_scene(n).with_values({"scene.rate": 150.0})
    parts = ("blade", scene_of(n, 1.0, 6.0), _BLADE), ("shaft", shaft, _SHAFT)
    for name, scene, design in parts:
        report.heading(name.capitalize(), 3)
        apart, adjoint = _compared(report, name, scene, design)
        report.require("derivatives", apart, name=name)
        report.require("adjoint", adjoint, name=name)


def _compared(
    report: Report, key: str, scene: Scene, design: tuple[str, ...]
) -> tuple[float, float]:
    at, values, rows = equilibrium(scene), assemble(scene, design).b, []
    direct = modes(scene, 4, at=at, design=design).frequencies_b
    adjoint = modes(scene, 4, at=at, design=design, method=Adjoint()).frequencies_b
    for k, name in enumerate(design):
        h = _STEP * abs(values[k])
        ends = [_frequencies(scene.with_values({name: values[k] + s * h})) for s in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * h)
        rows += [
            (f"mode {j}", name, float(direct[j, k]), float(difference[j]))
            for j in range(4)
            # A frequency that a variable does not move has round-off for its derivative.
            if abs(direct[j, k]) > 1e-4 * np.max(np.abs(direct[:, k]))
        ]
    apart = derivative_table(report, key, rows, ("modes", "differences of the call"))
    between = float(np.max(np.abs(adjoint - direct) / np.max(np.abs(direct), axis=0)))
    return apart, report.figure(f"{key}.adjoint.apart", between)


def _frequencies(scene: Scene) -> Array:
    return modes(scene, 4, at=equilibrium(scene)).frequencies
