"""Section on the woodpecker toy of report `events`: its limit cycle, its events, its gradients."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ancfdae import (
    DOP853,
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Radau,
    Terminal,
    gradient,
    gradients,
    simulate,
)
from ancfdae.observables import custom, elapsed_time
from ancfdae.plotting import Panel, Series
from validation.events.minimal import differences
from validation.events.woodpecker import START, Woodpecker
from validation.report import Agreement, Report

__all__ = ["fill"]

Array = np.ndarray[Any, Any]

_TWIN, _METHODS, _CYCLE = 1e-7, 1e-10, 1e-8
# The coordinates among the design variables, and their places in q and v.
_STATES: Final = ("q3", "v0", "v1", "v3")
_TEXT: Final = """
A sleeve with clearance slides down a pole and carries a bird on a torsional spring. Its ends and
the beak of the bird hit the pole: three contacts with friction 0.3 and restitution 0, 0 and 0.5,
Newton's law. Equations and data: Ch. Glocker (dissertation, TU Muenchen, 1995) and
R. I. Leine, Ch. Glocker and D. H. van Campen (Nonlinear dynamics of the woodpecker toy, ASME
DETC2001/VIB-21608), as the examples of Siconos and cardillo repeat them. The package integrates
four absolute coordinates with one joint. While an end stays on the pole, one more constraint holds
it, and friction is a force in closed form. The reference integrates three minimal coordinates and
tries all branches of impulses and of contact forces (`validation/events/woodpecker_twin.py`).
"""
HEIGHT: Final = custom(lambda t, q, v, lam, b: q[:, 0] + 1e-3 * v[:, 3] + 0.1 * q[:, 3], "height")


def fill(report: Report, quick: bool) -> None:
    """Add the section on the toy to report `events`."""
    report.heading("C. Woodpecker toy")
    report.text(_TEXT)
    toy = _cycle(report, 1 if quick else 4)
    if not quick:
        _against_twin(report, toy)
        _plot(report, toy)


def _cycle(report: Report, corrections: int) -> Woodpecker:
    """Find the limit cycle by Newton's method with exact derivatives; return the toy on it."""
    toy, J, value, time = Woodpecker(), np.eye(4), np.zeros(4), 0.0
    place = {
        name: custom(
            lambda t, q, v, lam, b, name=name: (q if name[0] == "q" else v)[:, int(name[1])], name
        )
        for name in _STATES
    }
    height = custom(lambda t, q, v, lam, b: q[:, 0], "y")
    objectives = [Terminal(x) for x in (*place.values(), height, elapsed_time())]
    fall = miss = 0.0
    for _ in range(corrections):
        found = gradients(
            toy, objectives, 0.2, DOP853(1e-12), events=[*toy.events(), toy.section()],
            modes=toy.modes(),
        )  # fmt: skip
        x, J = toy.b[5:], np.array([each.gradient[5:] for each in found[:4]])
        value = np.array([each.value for each in found[:4]])
        miss = float(np.max(np.abs((value - x) / x)))
        fall, time = -found[4].value, found[5].value
        if miss > _CYCLE / 10:
            toy = toy.with_values(
                np.append(toy.b[:5], x - np.linalg.solve(J - np.eye(4), value - x))
            )
    multipliers = np.sort(np.abs(np.linalg.eigvals(J)))[::-1]
    q, u, _ = toy.twin(toy.b, time)
    back = np.max(np.abs(np.array([q[2], *u]) / toy.b[5:] - 1))
    report.table(
        ["limit cycle", "found"],
        [
            ["period", f"{time:.9f} s"],
            ["fall of the sleeve in a period", f"{1e3 * fall:.6f} mm"],
            ["largest multipliers", ", ".join(f"{x:.4f}" for x in multipliers[:2])],
            ["the state returns, package", f"to {miss:.1e}"],
            ["the state returns, reference from the same start", f"to {back:.1e}"],
        ],
    )
    report.text(
        "Newton's method on the map of a cycle takes its matrix from `gradients`, through all "
        "events. The state at the start of the published examples returns after 0.146 s with "
        "velocities that differ by 0.2 to 1 %: they lie close to this cycle."
    )
    report.figure("woodpecker.period", time)
    report.figure("woodpecker.fall", fall)
    report.figure("woodpecker.multiplier", float(multipliers[0]))
    worst = report.figure("woodpecker.cycle", float(max(miss, back)))
    report.claim(
        "(C) Woodpecker: the limit cycle by exact derivatives is one of the reference, too",
        f"{_CYCLE:.0e}", f"{worst:.1e}", _verdict(worst <= _CYCLE),
    )  # fmt: skip
    return toy


def _against_twin(report: Report, toy: Woodpecker) -> None:
    """Compare events, value and gradient over two cycles with the reference, and the methods."""
    b, t_end = toy.b, 0.29

    def by_twin(b: Array) -> float:
        q, u, _ = toy.twin(b, t_end)
        return float(q[0] + 1e-3 * u[2] + 0.1 * q[2])

    slopes, rows = differences(by_twin, b, 2e-5), []
    size, worst = np.max(np.abs(slopes * b)), 0.0
    times = [t for t, _ in toy.twin(b, t_end)[2].events]
    for integrator in (DOP853(1e-12), Radau(rtol=1e-10)):
        found = gradient(
            toy, Terminal(HEIGHT), t_end, integrator, events=toy.events(), modes=toy.modes()
        )
        assert found.event_solution is not None  # of a run with events
        events = [x.time for x in found.event_solution.events]
        late = float(np.max(np.abs(np.array(events) - times)))
        off = abs(found.value / by_twin(b) - 1)
        error = float(np.max(np.abs((found.gradient - slopes) * b)) / size)
        worst = max(worst, late / t_end, off, error)
        numbers = (f"{x:.1e}" for x in (late, off, error))
        rows.append([type(integrator).__name__, len(events), *numbers])
    report.table(["integrator", "events", "times, s", "value", "gradient in nine numbers"], rows)
    report.figure("woodpecker.twin", worst)
    report.claim(
        "(C) Woodpecker: event times, value and gradient after two cycles against the reference",
        f"{_TWIN:.0e}", f"{worst:.1e}", _verdict(worst <= _TWIN),
    )  # fmt: skip
    apart = 0.0
    for stepped in (HHT(1e-3), Radau(2e-3)):
        first, *others = (
            gradient(
                toy, Terminal(HEIGHT), 0.15, stepped, method=method, events=toy.events(),
                modes=toy.modes(),
            ).gradient
            * START
            for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
        )  # fmt: skip
        apart = max(apart, *(np.max(np.abs(x - first)) / np.max(np.abs(first)) for x in others))
    report.figure("woodpecker.methods", float(apart))
    report.claim(
        "(C) woodpecker, HHT and Radau: direct differentiation, adjoint and complex step agree",
        f"{_METHODS:.0e}", f"{apart:.1e}", _verdict(apart <= _METHODS),
    )  # fmt: skip


def _plot(report: Report, toy: Woodpecker) -> None:
    run = simulate(toy, 0.44, DOP853(1e-9), events=toy.events(), modes=toy.modes())
    angles = [Series(name, run.t, run.q[:, k]) for name, k in (("sleeve", 1), ("bird", 3))]
    report.plot(
        "woodpecker",
        [
            Panel("Angles", "t [s]", "angle [rad]", angles),
            Panel("Height", "t [s]", "y [mm]", [Series("sleeve", run.t, 1e3 * run.q[:, 0])]),
        ],
        columns=2,
        title="Woodpecker toy on its limit cycle",
        caption="The sleeve sticks, slides, flies and hits the pole with both ends in each period.",
    )


def _verdict(holds: bool) -> Agreement:
    return Agreement.AGREES if holds else Agreement.DISAGREES
