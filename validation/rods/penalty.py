"""A ball that bounces: errors over cost, with contacts of growing stiffness and an event."""

from typing import Any

import numpy as np

from ancfdae import (
    AdaptiveSteps,
    Contact,
    Impact,
    InitialVelocity,
    Plane,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    gradient,
)
from ancfdae.extend import MaterialPoint
from ancfdae.numerics.timing import stopwatch
from ancfdae.observables import position
from ancfdae.plotting import Series
from validation.drawing import dots, log_log
from validation.report import Report

_HEIGHT, _SPEED, _G, _T = 5.0, -0.1, 10.0, 1.9
_DESIGN = ("ball.position_z", "ball.velocity_z", "scene.gravity_z")


def exact(height: Any, speed: Any, g: Any) -> Any:
    """Return the height after one bounce without loss; m."""
    impact = np.sqrt(speed**2 + 2 * g * height)
    rest = _T - (speed + impact) / g
    return impact * rest - g / 2 * rest**2


def _scene(stiffness: float | None) -> Scene:
    ball = RigidBody("ball", (0, 0, _HEIGHT), mass=1.0, inertia=(0.1, 0.1, 0.1))
    floor = Plane((0, 0, 0), (0, 0, 1))
    start = [InitialVelocity("ball", (0, 0, 0), (0, 0, _HEIGHT), (0, 0, _SPEED))]
    loads = [] if stiffness is None else [Contact(ball.at(0, 0, 0), floor, stiffness=stiffness)]
    return Scene([], [], (0, 0, -_G), start, loads, bodies=[ball])


def penalty(report: Report, quick: bool) -> None:
    """Fill the section: errors and costs of the event and of contacts of growing stiffness."""
    report.say("penalty")
    b = np.array([_HEIGHT, _SPEED, _G])
    moved = [exact(*(b + 1j * 1e-30 * row)).imag / 1e-30 for row in np.eye(3)]
    slopes = np.array(moved) * (1, 1, -1)  # gravity_z is -g
    value = float(exact(*b))
    powers = (4, 6) if quick else (3, 4, 5, 6, 7, 8, 9, 10)
    rows, found = [], []
    for power in (None, *powers):
        stiffness = None if power is None else 10.0**power
        scene = _scene(stiffness)
        height = position(MaterialPoint("ball"), 2)
        events = [Impact(height, 1.0, "floor")] if power is None else None
        # With events errors of derivatives are not controlled.
        steps = AdaptiveSteps(1e-8, sensitivities=events is None)
        call = scene, Terminal(height), _T, Radau(steps)
        clock = stopwatch()
        result = gradient(*call, design=list(_DESIGN), events=events)
        seconds = clock()
        error = abs(result.value - value) / _HEIGHT
        wrong = float(np.max(np.abs(result.gradient - slopes) / np.abs(slopes)))
        name = "event" if power is None else f"contact.1e{power}"
        report.figure(f"{name}.motion", error)
        report.figure(f"{name}.gradient", wrong)
        report.figure(f"{name}.seconds", seconds)
        label = "event" if power is None else f"1e{power}"
        rows.append([label, f"{error:.1e}", f"{wrong:.1e}", f"{seconds:.2g}"])
        found.append((seconds, error, wrong))
    report.table(
        ["k, N/m^1.5", "error of the height / 5 m", "largest error of a derivative", "s"], rows
    )
    report.judge(
        "penalty", found[-1][2] < found[1][2], rows=rows, penalty=rows[-1][1], event=rows[-1][2]
    )
    time, motion, slope = np.array(found).T
    curves = [
        Series("motion, contact", time[1:], motion[1:], marker=True),
        Series("gradient, contact", time[1:], slope[1:], marker=True),
        dots("motion, event", time[:1], motion[:1]),
        dots("gradient, event", time[:1], slope[:1]),
    ]
    labels = "processor time [s]", "relative error"
    panel = log_log("A bounce", *labels, curves)
    report.plot("penalty", [panel])
