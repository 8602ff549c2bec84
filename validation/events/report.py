"""Report on runs with events: closed forms, integrations in minimal coordinates, what breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Radau,
    Terminal,
    gradient,
)
from ancfdae.extend import Integrator, Objective
from ancfdae.plotting import Panel, Series
from ancfdae.results import Gradient
from validation.events import awkward, cops, manoeuvre, rod, toy
from validation.events.mechanisms import Ball, Box, DoublePendulum, FiveBar, SliderCrank
from validation.events.minimal import differences
from validation.report import Agreement, Report

__all__ = ["run"]

_EXACT: Final = (DirectDifferentiation(), Adjoint(), ComplexStep())
_METHODS_EQUAL, _BALL, _TWIN = 1e-10, 1e-9, 1e-7
# Value and derivatives in z_0, v_0, g and the restitution, in closed form.
_BALLS: Final = {
    1.9: (3.139918957, 0.837828113, 0.101531721, -0.103906844, 9.099954976),
    3.2: (2.043656070001, 0.311880018998, -0.033280796140, 0.048092789540, 9.155137855557),
}
_CASADI: Final = (7.418, 0.0598, -0.468, 0.0)

_INTRODUCTION: Final = """
A run with events is a sequence of smooth phases. Each case has its own reference: a closed form, or
an integration in minimal coordinates by SciPy, which locates its own events and knows nothing of
this package (`validation/events/minimal.py`). Derivatives of that integration are central
differences of two widths, extrapolated. Errors of gradients are the largest error of a component
times its variable, relative to the largest such component.
"""


class _Case(NamedTuple):
    """A system with events, its objective, a step, and the relative width of differences."""

    name: str
    system: Any
    objective: Objective
    t_end: float
    events: Sequence[Any]
    modes: Mapping[str, Any] | None
    step: float
    width: float = 2e-4

    def gradient(self, integrator: Integrator, method: Any = _EXACT[0]) -> Gradient:
        """Return value and gradient by an integrator and a method."""
        return gradient(
            self.system, self.objective, self.t_end, integrator, method=method,
            events=self.events, modes=self.modes,
        )  # fmt: skip

    def methods_apart(self, integrator: Integrator) -> float:
        """Return how far direct differentiation, adjoint and complex step are apart."""
        first, *others = (self.gradient(integrator, method).gradient for method in _EXACT)
        sizes = np.where(self.system.b == 0, 1.0, np.abs(self.system.b))
        size = np.max(np.abs(first * sizes))
        return float(max(np.max(np.abs((x - first) * sizes)) for x in others) / size)


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `events`; add its text, tables and figures."""
    report.heading("Method")
    report.text(_INTRODUCTION)
    _ball(report)
    _box(report)
    _linkages(report, quick)
    toy.fill(report, quick)
    rod.fill(report, quick)
    awkward.fill(report, quick)
    manoeuvre.fill(report, quick)
    cops.fill(report, quick)


def _ball(report: Report) -> None:
    report.heading("A. Bouncing ball")
    report.text(
        "z_0 = 5 m, v_0 = -0.1 m/s, g = 10 m/s^2, restitution 0.8; the height at 1.9 s, after one "
        "impact, and at 3.2 s, after two, and its derivatives in these four numbers. CasADi 3.8.2 "
        "with IDAS returned 7.418, 0.0598, -0.468 and 0 at 1.9 s (forward sensitivities; measured "
        "when the issue was filed, not in this run). "
        "Diffrax 0.7 is right if the user restarts the solver by hand after each event."
    )
    rows, worst, apart = [], 0.0, 0.0
    integrators = {
        "HHT": HHT(0.05), "Radau": Radau(0.2), "DOP853": DOP853(1e-11), "IDA": IDA(1e-10),
    }  # fmt: skip
    for t_end, exact in _BALLS.items():
        case = _Case("ball", Ball(), Terminal(Ball.height), t_end, [Ball.floor], None, 0.05)
        for name, integrator in integrators.items():
            found = case.gradient(integrator)
            errors = np.abs(np.array([found.value, *found.gradient]) - exact)
            worst = max(worst, float(np.max(errors)))
            rows.append([f"{t_end} s, {name}", *(f"{x:.1e}" for x in errors)])
        apart = max(apart, case.methods_apart(HHT(0.05)), case.methods_apart(Radau(0.2)))
        rows.append([f"{t_end} s, closed form", *(f"{x:.9f}" for x in exact)])
    off = [f"{abs(x - y):.1e}" for x, y in zip(_CASADI, _BALLS[1.9][1:], strict=True)]
    rows.append(["1.9 s, CasADi, as said above", "2.0e-11", *off])
    report.table(["run", "z", "z_0", "v_0", "g", "restitution"], rows)
    report.figure("ball.error", worst)
    report.figure("ball.methods", apart)
    report.claim(
        "(A) Height of the bouncing ball and its four derivatives, four integrators",
        f"{_BALL:.0e}",
        f"{worst:.1e}",
        _verdict(worst <= _BALL),
    )
    _methods_claim(report, "(A) bouncing ball, HHT and Radau", apart)


def _box(report: Report) -> None:
    report.heading("B. Frictional box")
    report.text(
        "A box slides at v_0 = 1 m/s against Coulomb's friction mu g = 1 m/s^2 and stands after "
        "1 s. A `Switch` at speed zero leads to a mode without friction. At 1.5 s its place is "
        "x_0 + v_0^2/(2 mu g), so that the derivatives of place and speed in x_0 and v_0 are 1, 0, "
        "v_0/(mu g) = 1 and 0 (nimblephysics issue 97: (1, 0, 1, 0)), and -v_0^2/(2 mu^2 g) = -5 "
        "of the place in mu. This is friction under a given normal force; friction in impacts "
        "follows in C."
    )
    box, rows, worst, apart = Box(), [], 0.0, 0.0
    exact = {"place": (1.0, 1.0, -5.0), "speed": (0.0, 0.0, 0.0)}
    for what, slopes in exact.items():
        objective = Terminal(getattr(Box, what))
        case = _Case("box", box, objective, 1.5, [Box.stands], box.modes(), 0.05)
        for integrator in (HHT(0.05), Radau(0.1), DOP853(1e-11)):
            found = case.gradient(integrator).gradient
            worst = max(worst, float(np.max(np.abs(found - slopes))))
            name = f"{what}, {type(integrator).__name__}"
            rows.append([name, *(f"{x:.12f}" for x in found)])
    place = _Case("box", box, Terminal(Box.place), 1.5, [Box.stands], box.modes(), 0.05)
    apart = place.methods_apart(HHT(0.05))
    report.table(["derivative of", "in x_0", "in v_0", "in mu"], rows)
    report.figure("box.error", worst)
    report.claim(
        "(B) Derivatives of the box that friction stops", "1e-09", f"{worst:.1e}",
        _verdict(worst <= _BALL),
    )  # fmt: skip
    _methods_claim(report, "(B) box", apart)


def _linkages(report: Report, quick: bool) -> None:
    report.heading("C, D. Linkages against minimal coordinates")
    report.text(
        "*Five-bar* with impacts of its coupler joint on a floor (after Corner, Sandu and Sandu "
        "2019; dimensions of our own), *slider-crank* whose slider has a clearance of 1 mm in its "
        "guide (lengths, masses, speeds, restitution 0.4 and friction 0.01 of Flores, Leine and "
        "Glocker 2010; slider inertia 7e-5 kg m^2; until 8.2 ms, before its corners rattle to "
        "rest), and a "
        "*double pendulum* that locks its elbow at a right angle. Both upper corners of "
        "the slider strike, in turns. The package integrates absolute coordinates with 4, 6 and 2 "
        "constraints; references integrate 2, 3 and 2 angles."
    )
    five, crank, pendulum = FiveBar(), SliderCrank(), DoublePendulum()
    cases = (
        _Case("five-bar", five, Terminal(FiveBar.tip), five.t_end, [FiveBar.impact], None, 0.01),
        _Case(
            "slider-crank", crank, Terminal(SliderCrank.slider), crank.t_end, crank.impacts(),
            None, 2e-4, 5e-5,
        ),
        _Case(
            "lock", pendulum, Terminal(DoublePendulum.tip), pendulum.t_end,
            [DoublePendulum.lock], pendulum.modes(), 0.01,
        ),
    )  # fmt: skip
    rows, worst, apart = [], [0.0, 0.0], 0.0
    for case in cases[-1:] if quick else cases:
        b = np.array(case.system.b)
        value = case.system.by_twin(b)
        slopes = differences(case.system.by_twin, b, case.width)
        for integrator in (DOP853(1e-12), Radau(rtol=1e-6 if quick else 1e-10)):
            found = case.gradient(integrator)
            size = np.max(np.abs(slopes * b))
            error = float(np.max(np.abs((found.gradient - slopes) * b)) / size)
            off = abs(found.value - value) / abs(value)
            worst = [max(worst[0], off), max(worst[1], error)]
            assert found.event_solution is not None  # of a run with events
            count = len(found.event_solution.events)
            name = f"{case.name}, {type(integrator).__name__}"
            rows.append([name, count, f"{off:.1e}", f"{error:.1e}"])
        own = max(case.methods_apart(x) for x in (HHT(case.step), Radau(2 * case.step)))
        apart = max(apart, own)
        report.figure(f"{case.name}.methods", own)
    report.table(["case", "events", "error of the value", "error of the gradient"], rows)
    report.figure("twins.value", worst[0])
    report.figure("twins.gradient", worst[1])
    report.claim(
        "(C, D) Gradients against differences of an integration in minimal coordinates",
        f"{_TWIN:.0e}",
        f"{worst[1]:.1e} (values {worst[0]:.1e})",
        _verdict(max(worst) <= _TWIN),
    )
    _methods_claim(report, "(C, D) linkages, HHT and Radau", apart)
    if not quick:
        _five_bar_plot(report, five)


def _five_bar_plot(report: Report, five: FiveBar) -> None:
    from ancfdae import simulate

    run_ = simulate(five, five.t_end, HHT(2e-3), events=[FiveBar.impact])
    height = Series("coupler joint", run_.t, run_.q[:, 5])
    floor = Series("floor", np.array([0.0, five.t_end]), np.full(2, five.b[2]), dashed=True)
    speed = Series("coupler joint", run_.t, run_.v[:, 5])
    report.plot(
        "five-bar",
        [
            Panel("Height", "t [s]", "y [m]", [height, floor]),
            Panel("Vertical speed", "t [s]", "v [m/s]", [speed]),
        ],
        columns=2,
        title="Five-bar linkage with impacts",
        caption="The speed jumps at each impact, and the run has no step across one.",
    )


def _methods_claim(report: Report, what: str, apart: float) -> None:
    report.claim(
        f"{what}: direct differentiation, adjoint and complex step agree",
        f"{_METHODS_EQUAL:.0e}",
        f"{apart:.1e}",
        _verdict(apart <= _METHODS_EQUAL),
    )


def _verdict(holds: bool) -> Agreement:
    return Agreement.AGREES if holds else Agreement.DISAGREES
