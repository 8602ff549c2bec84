"""Derivatives of frequencies in design and speed, beside differences of the very call."""

import numpy as np

from ancfdae import Adjoint, Scene, assemble, equilibrium, modes
from validation.external.runs import Requirement
from validation.literature.tables import Array, derivative_table
from validation.report import Report
from validation.rotation.blade import scene_of
from validation.rotation.shaft import shaft_scene

__all__ = ["derivatives"]

_BLADE = ("scene.rate", "scene.through_x", "blade.height", "blade.length", "blade.youngs_modulus")
_SHAFT = ("scene.rate", "shaft.radius", "shaft.length", "disc.radius")
# Relative step: h^2 of the change and round-off of frequencies, 1e-12/h.
_STEP = 1e-4


def derivatives(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    report.heading("Derivatives")
    report.text(_TEXT)
    n = 4 if quick else 8
    shaft = shaft_scene(n).with_values({"scene.rate": 150.0})
    parts = ("blade", scene_of(n, 1.0, 6.0), _BLADE), ("shaft", shaft, _SHAFT)
    required = []
    for name, scene, design in parts:
        report.heading(name.capitalize(), 3)
        apart, adjoint = _compared(report, name, scene, design)
        required.append(Requirement(f"{name}: derivatives against differences", 1e-5, apart))
        required.append(Requirement(f"{name}: direct against adjoint", 1e-8, adjoint))
    return required


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


_TEXT = """
Frequencies in the turning frame, about the equilibrium, which changes with the variable as tension
and geometry do: `modes(scene, at=equilibrium(scene), design=...)` against central differences of
the same two calls, with steps of 1e-4 of the variable. Blade: hub ratio 1, speed 6. Shaft: 150
rad/s.
"""
