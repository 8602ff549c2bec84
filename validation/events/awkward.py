"""Part (F) of the report on events: what broke other codes, each row a result."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from ancfdae import (
    HHT,
    AtTimes,
    EndEvent,
    Impact,
    Mode,
    RigidBody,
    Scene,
    Switch,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.errors import UnlikelyValueWarning
from ancfdae.observables import position
from validation.events.mechanisms import Ball, Box
from validation.events.minimal import Array
from validation.report import Agreement, Report

__all__ = ["fill"]

_FALL = (-0.1 + np.sqrt(0.01 + 100.0)) / 10.0


def fill(report: Report, quick: bool) -> None:
    """Add the table and its claims."""
    report.heading("F. What broke other codes")
    rows = []
    for what, case, limit in _CASES:
        error, words = case(quick)
        verdict = "holds" if error <= limit else "does not hold"
        rows.append([what, f"{error:.1e}", f"{limit:.0e}", words, verdict])
        key = "awkward." + "-".join(what.split()[:4]).replace(",", "")
        report.figure(key, error)
        report.claim(
            f"(F) {what}", f"{limit:.0e}", f"{error:.1e}",
            Agreement.AGREES if error <= limit else Agreement.DISAGREES,
        )  # fmt: skip
    report.table(["case", "error", "limit", "what is compared", "verdict"], rows)


def _saved(_: bool) -> tuple[float, str]:
    """Read values at times within one unit in the last place of the impact."""
    ball = Ball()
    first = simulate(ball, 1.9, HHT(0.1), events=[Ball.floor]).events[0].time
    worst = abs(first - _FALL)
    before = np.array([1.0, first, -(first**2) / 2, 0.0])
    with warnings.catch_warnings():
        # Of times at which an event happens.
        warnings.simplefilter("ignore", UnlikelyValueWarning)
        *until, after = (
            gradient(ball, AtTimes(Ball.height, [time]), 1.9, HHT(0.1), events=[Ball.floor])
            for time in (np.nextafter(first, 0), first, np.nextafter(first, 9))
        )
    for found in until:
        worst = max(worst, abs(found.value), float(np.max(np.abs(found.gradient - before))))
    return float(max(worst, abs(after.value))), "value and gradient before, value after"


def _at_one_time(_: bool) -> tuple[float, str]:
    """Let two bodies that have nothing to do with each other hit the floor at one time."""
    bodies = [RigidBody(f"ball{n}", (3 * n, 1.0), mass=1.0 + n, inertia=0.3) for n in (0, 1)]
    low, high = (position(body.at(0, 0), 1) for body in bodies)
    events = [Impact(gap, 0.5, f"floor {n}") for n, gap in enumerate((low, high))]
    found = gradient(
        Scene(bodies=bodies, gravity=(0, -10.0)), Terminal(low * high), 0.6, HHT(0.01),
        design=["ball0.position_y", "ball1.position_y"], events=events,
    )  # fmt: skip
    fall, after = np.sqrt(0.2), 0.6 - np.sqrt(0.2)
    own = (5 * after - 5 * fall + 10 * after) / (10 * fall)
    y = 5 * fall * after - 5 * after**2
    return float(np.max(np.abs(found.gradient - own * y))), "gradient against closed form"


def _state(_: bool) -> tuple[float, str]:
    """Let the state trigger an event that changes both state and model."""
    ball = Ball((5.0, 0.0, 10.0, 0.5))
    low = Switch(Ball.height - 2.0, "low", -1, "low")
    modes = {"low": Mode(ball, [Impact(Ball.height - 2.0, 0.5, "net")])}
    fall, u = np.sqrt(0.6), np.sqrt(60.0)
    s = 0.9 - fall
    exact = 0.5 * (10 / u) * s - (0.5 * u - 10 * s) / (10 * fall)
    found = gradient(ball, Terminal(Ball.height), 0.9, HHT(0.05), events=[low], modes=modes)
    value = 2 + 0.5 * u * s - 5 * s * s
    return float(max(abs(found.value - value), abs(found.gradient[0] - exact))), "closed form"


def _at_start(_: bool) -> tuple[float, str]:
    """Start with a closing gap, and with the function of an end at zero, which does not count."""

    class Low(Ball):
        def start(self) -> tuple[Array, Array]:
            return 0 * self.b[:1], self.b[1:2] * 1

    ball = Low((5.0, -2.0, 10.0, 0.8))
    up = EndEvent(Ball.height, -1, "down again")
    found = gradient(ball, Terminal(Ball.height), 0.3, HHT(0.1), events=[Ball.floor])
    slopes = np.array([0.0, -0.24, -0.045, 0.6])
    error = abs(found.value - (1.6 * 0.3 - 0.45)) + np.max(np.abs(found.gradient - slopes))
    ended = simulate(Low((5.0, 2.0, 10.0, 0.8)), 1.0, HHT(0.1), events=[up])
    return float(max(error, abs(ended.t[-1] - 0.4))), "value, gradient, time of the end"


def _no_change(_: bool) -> tuple[float, str]:
    """Run with functions that are never zero, always zero, or touch zero."""
    ball = Ball()
    plain = simulate(ball, 0.9, HHT(0.1))
    worst = 0.0
    for never in (EndEvent(Ball.height**2 + 1.0), EndEvent(0 * Ball.height)):
        run = simulate(ball, 0.9, HHT(0.1), events=[never])
        worst = max(worst, float(np.max(np.abs(run.q - plain.q))), float(len(run.events)))
    touch = simulate(ball, 0.9, HHT(0.1), events=[EndEvent((Ball.height - 4.0) ** 2)])
    words = "touches zero" in str(touch.outcome)
    return max(worst, 0.0 if words else 1.0), "the run without; touching ends it in words"


def _many(quick: bool) -> tuple[float, str]:
    """Let an elastic ball bounce ten thousand times."""
    count = 100 if quick else 10_000
    period = 2 * np.sqrt(0.2)
    ball = Ball((1.0, 0.0, 10.0, 1.0))
    run = simulate(ball, period * count, HHT(1.0), events=[Ball.floor])
    times = np.array([event.time for event in run.events])
    exact = period * (np.arange(len(times)) + 0.5)
    error = float(np.max(np.abs(times / exact - 1))) if len(times) == count else 1.0
    return error, f"{len(times)} times"


def _stopped(_: bool) -> tuple[float, str]:
    """Run on for long after a speed has become zero."""
    box = Box()
    run = simulate(box, 30.0, HHT(0.1), events=[Box.stands], modes=box.modes())
    return float(abs(run.q[-1, 0] - 0.5) + abs(len(run.events) - 1)), "place at 30 s"


_CASES: tuple[tuple[str, Callable[[bool], tuple[float, str]], float], ...] = (
    ("a saved time within one unit in the last place of an event", _saved, 1e-9),
    ("two independent impacts at one time, at this design only", _at_one_time, 1e-9),
    ("an event of the state that changes model and state", _state, 1e-9),
    ("an event at the start", _at_start, 1e-9),
    ("an event function without a change of sign", _no_change, 0.0),
    ("ten thousand events", _many, 1e-10),
    ("a body that friction stops for good", _stopped, 1e-9),
)
