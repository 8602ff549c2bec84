"""Part (G) of the report on events: an arm that moves in the least time under torque limits."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import scipy

from ancfdae import (
    DOP853,
    Adjoint,
    Beam,
    ComplexStep,
    DesignVariable,
    DirectDifferentiation,
    EndEvent,
    Material,
    MotorTorque,
    Pin,
    PointMass,
    Radau,
    Responses,
    Scene,
    Terminal,
    distributed_variables,
    gradients,
)
from ancfdae.extend import Load
from ancfdae.laws import BSpline
from ancfdae.observables import elapsed_time, position, velocity
from ancfdae.plotting import Panel, Series
from ancfdae.sections import Rectangle
from validation.events.minimal import Array
from validation.report import Agreement, Report

__all__ = ["fill"]

_LENGTH, _LIMITS = 0.5, {"shoulder": 12.0, "elbow": 5.0}
_ANGLES: Final = (np.pi / 3, np.pi / 2)
_VALUES, _LAST, _FIRST = 14, 1.2, 0.9
_STEP, _FINE = 0.02, 0.01
_END, _DIFFERENCES, _METHODS = 1e-6, 1e-7, 1e-10


def arm(values: Array) -> tuple[Beam, Beam, Scene]:
    """Return an arm of two rigid links, straight and at rest, with torques in N m."""
    material, section = Material(2700.0, 7e10, 0.33), Rectangle(0.03, 0.03)
    upper = Beam("upper", (0, 0), (_LENGTH, 0), 1, section, material, rigid=True)
    lower = Beam("lower", upper.at_end, (_LENGTH, 0), 1, section, material, rigid=True)
    laws = [BSpline(0.0, _LAST, row.tolist()) for row in values]
    loads: list[Load] = [
        MotorTorque(upper.at_start, 1.0, name="shoulder", law=laws[0]),
        MotorTorque(lower.at_start, 1.0, other=upper.at_end, name="elbow", law=laws[1]),
    ]
    weights = [PointMass(point, 0.5) for point in (lower.at_start, lower.at_end)]
    joints = [Pin(upper.at_start), Pin(upper.at_end, lower.at_start)]
    return upper, lower, Scene([upper, lower], joints, loads=loads, bodies=weights)


def target() -> Array:
    """Return the tip at the end of the manoeuvre, m."""
    first, second = _ANGLES[0], sum(_ANGLES)
    return _LENGTH * np.array([np.cos(first) + np.cos(second), np.sin(first) + np.sin(second)])


def _problem(values: Array) -> tuple[Scene, list[Any], dict[str, Any]]:
    """Return scene, design without the end time, and the functions of the optimisation."""
    _, lower, scene = arm(values)
    tip, place = lower.at_end, target()
    asked: dict[str, Any] = {"time": Terminal(elapsed_time())}
    for i, axis in enumerate("xy"):
        asked[f"place {axis}"] = Terminal(position(tip, i) - place[i])
        asked[f"speed {axis}"] = Terminal(velocity(tip, i))
    design = [v for m in _LIMITS for v in distributed_variables(f"{m}.value", _VALUES)]
    return scene, design, asked


def fill(report: Report, quick: bool) -> None:
    """Add the table, the plot and the claims."""
    report.heading("G. Least time under torque limits")
    report.text(
        f"An arm of two rigid links of {_LENGTH} m in the horizontal plane turns by 60 and 90 "
        f"degrees, from rest to rest, within torques of {_LIMITS['shoulder']:g} and "
        f"{_LIMITS['elbow']:g} N m. Variables are {_VALUES} control values of a B-spline for each "
        "motor, whose bounds are the limits of the torque, and `t_end`. SLSQP minimises the time "
        "under four end conditions: place and speed of the tip."
    )
    start = np.outer(list(_LIMITS.values()), 0.5 * np.linspace(1.0, -1.0, _VALUES))
    scene, design, asked = _problem(start)
    limits = np.append(np.repeat(list(_LIMITS.values()), _VALUES), 1.0)
    _gradients(report, scene, design, asked)
    low, high = -np.ones(len(limits)), np.ones(len(limits))
    low[-1], high[-1] = 0.2, _LAST

    def least(x: Array, step: float, iterations: int) -> tuple[Any, int]:
        """Return the optimum from a design by runs of a step, and how many designs were run."""
        r = Responses(
            scene, asked, _FIRST, Radau(step=step), design=[*design, "t_end"], scale=limits
        )
        found = scipy.optimize.minimize(
            r["time"],
            x,
            jac=r["time"].gradient,
            bounds=scipy.optimize.Bounds(low, high),
            constraints=[r.constraint(name, 0.0, 0.0) for name in asked if name != "time"],
            method="SLSQP",
            options={"maxiter": iterations, "ftol": 1e-10},
        )
        return found, len(r.history.rows)

    first = np.append(start.ravel(), _FIRST) / limits
    found, designs = least(first, _STEP, 1 if quick else 150)
    found, more = least(found.x, _STEP if quick else _FINE, 1 if quick else 20)
    torques, T = (found.x * limits)[:-1].reshape(2, -1), float(found.x[-1])
    # The same torques by another integrator at a tight tolerance.
    scene, _, asked = _problem(torques)
    checked = gradients(scene, list(asked.values()), T, DOP853(1e-11), design=["t_end"])
    miss = max(abs(x.value) for x in checked[1:3:2]) / _LENGTH
    miss = max(miss, abs(checked[3].value) / _LENGTH)
    speed = max(abs(checked[k].value) for k in (2, 4)) * T / _LENGTH
    rows: list[list[object]] = [
        ["least time", f"{T:.6f} s"],
        ["designs run, at steps of 20 and 10 ms", f"{designs} and {more}"],
        ["SLSQP", str(found.message)],
        ["tip beside its place, by DOP853(1e-11)", f"{miss:.1e} of the length"],
        ["its speed", f"{speed:.1e} of length over time"],
    ]
    report.table(["quantity", "found"], rows)
    report.figure("arm.time", T)
    report.figure("arm.miss", max(miss, speed))
    report.claim(
        "(G) End conditions of the arm in least time", f"{_END:.0e} of the length",
        f"{max(miss, speed):.1e}", _verdict(max(miss, speed) <= _END),
    )  # fmt: skip
    if not quick:
        _plot(report, torques, T)


def _gradients(report: Report, scene: Scene, design: list[Any], asked: dict[str, Any]) -> None:
    """Compare derivatives in values and end time with differences, and three methods."""
    few = [design[3], design[_VALUES + 5], "t_end"]
    functions = list(asked.values())[1:]
    T = _FIRST - 0.003
    by_method = [
        np.array([
            x.gradient
            for x in gradients(scene, functions, T, Radau(step=_STEP), design=few, method=method)
        ])
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    ]  # fmt: skip
    size = np.max(np.abs(by_method[0]))
    apart = float(max(np.max(np.abs(x - by_method[0])) for x in by_method[1:]) / size)

    names = [variable.name for variable in few[:-1]]
    # Differences in the end time and the two values, by runs of the same number of steps.
    slopes = _by_differences(scene, names, functions, T)
    off = float(np.max(np.abs(slopes - by_method[0])) / size)
    # The same end by an event.
    late = EndEvent(elapsed_time() - T, 1)
    ended = gradients(scene, functions, 1.1 * T, Radau(step=_STEP), design=few[:-1], events=[late])
    same = np.array([x.gradient for x in ended])
    through = float(np.max(np.abs(same - by_method[0][:, :-1])) / size)
    report.figure("arm.methods", apart)
    report.figure("arm.differences", off)
    report.claim(
        "(G) Derivatives of the end conditions in torques and end time against differences",
        f"{_DIFFERENCES:.0e}", f"{off:.1e}", _verdict(off <= _DIFFERENCES),
    )  # fmt: skip
    report.claim(
        "(G) arm: direct differentiation, adjoint and complex step agree", f"{_METHODS:.0e}",
        f"{apart:.1e}", _verdict(apart <= _METHODS),
    )  # fmt: skip
    report.claim(
        "(G) A run that an EndEvent ends at that time has the same derivatives in the torques",
        f"{_DIFFERENCES:.0e}", f"{through:.1e}", _verdict(through <= _DIFFERENCES),
    )  # fmt: skip


def _by_differences(scene: Scene, names: list[str], functions: list[Any], T: float) -> Array:
    """Return derivatives of functions in two values and the end time, by differences."""

    def values(x: Array) -> Array:
        pairs = zip(known.items(), x[:-1].tolist(), strict=True)
        own: dict[str | DesignVariable, float] = {k: now + change for (k, now), change in pairs}
        moved = scene.with_values(own)
        design = [names[0]]
        found = gradients(moved, functions, T + x[-1], Radau(step=_STEP), design=design)
        return np.array([each.value for each in found])

    known = {name: scene.numbers(name.split(".")[0])[name.split(".")[1]] for name in names}
    columns, h = [], 1e-3
    for unit in np.eye(3):
        near, far = ((values(s * h * unit) - values(-s * h * unit)) / (2 * s * h) for s in (1, 2))
        columns.append((4 * near - far) / 3)
    return np.array(columns).T


def _plot(report: Report, torques: Array, T: float) -> None:
    t = np.linspace(0.0, T, 201)
    series = []
    for (name, limit), row in zip(_LIMITS.items(), torques, strict=True):
        law = BSpline(0.0, _LAST, row.tolist())
        series.append(Series(name, t, law.derivative(row, t, 0) / limit))
    report.plot(
        "arm",
        [Panel("Torques over their limits", "t [s]", "torque [-]", series)],
        caption="The elbow starts, turns back and ends at its limit; the shoulder brakes at its "
        "limit.",
    )


def _verdict(holds: bool) -> Agreement:
    return Agreement.AGREES if holds else Agreement.DISAGREES
