"""Report on error bars: how often they hold over the scenes of the other reports."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    AdaptiveSteps,
    DirectDifferentiation,
    Integral,
    Scene,
    Terminal,
    error_bars,
    gradient,
)
from ancfdae.equations import MechanicalSystem
from ancfdae.extend import Integrator
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.numerics.arrays import Array
from ancfdae.observables import position, reaction
from ancfdae.plotting import Series
from ancfdae.results import ErrorBars
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import as_system
from validation.drawing import dots, log_log
from validation.error_estimates import estimates
from validation.external.slider_crank import SliderCrank, kinetic_energy_integral
from validation.report import Report
from validation.scenes import crank_slider, pendulum


@dataclass(frozen=True)
class _Case:
    """A scene, what is asked of it, and the settings of its coarsest runs."""

    name: str
    model: Scene | MechanicalSystem
    objective: Objective
    design: tuple[str, ...]
    t_end: float
    settings: Sequence[Integrator]
    reference: Integrator


@dataclass(frozen=True)
class _Found:
    """Errors of value and gradient, relative to the value and to the norm of the gradient."""

    case: str
    kind: str
    error: Array
    bar: Array
    better: Array
    resolved: bool | None


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `error-bars`; add its text, tables and figures."""
    report.say("method")
    found = [row for case in _cases(quick) for row in _measured(case, quick)]
    _table(report, found)
    _pictures(report, found)
    _verdict(report, found)
    estimates(report, quick)
    report.say("limits")


def _cases(quick: bool) -> list[_Case]:
    rigid: list[Integrator] = [HHT(10 / n) for n in ((100,) if quick else (50, 200, 800))]
    rigid += [HHT(rtol=x) for x in ((1e-2,) if quick else (1e-2, 1e-3, 1e-4))]
    rigid += [IDA(1e-4 if quick else 1e-6), DOP853(1e-6)]
    energy = kinetic_energy_integral()
    name = "SUNDIALS slider-crank, energy"
    cases = [_Case(name, SliderCrank(), energy, (), 10.0, rigid, DOP853(1e-8 if quick else 1e-11))]
    cases += _pendulums(quick)
    if quick:
        return cases
    scene, design = crank_slider(), ("crank.youngs_modulus", "rod.height", "rod.density")
    slider = Integral((position(scene.beams[1].at_end, 0) - 1.8) ** 2)
    wide = [*(HHT(2.0**-k) for k in (7, 9)), HHT(rtol=1e-2)]
    name = "crank-slider, eq. (43)"
    return [*cases, _Case(name, scene, slider, design, 0.25, wide, DOP853(1e-7))]


def _pendulums(quick: bool) -> list[_Case]:
    """Return the soft pendulum with waves, with damping, and so short that steps resolve all."""
    beam, damped = pendulum(), pendulum(damping_time=1e-3)
    tip, pin = position(beam.beams[0].at_end, 1), beam.joints[0].name
    design = ("pendulum.youngs_modulus", "pendulum.height", "pendulum.density")
    t_end = 2.0**-5 if quick else 0.5
    steps: list[Integrator] = [HHT(2.0**-k) for k in ((7,) if quick else (6, 8, 10, 12))]
    steps.append(HHT(rtol=1e-2 if quick else 1e-3))
    settings = [*steps, IDA(1e-4 if quick else 1e-6)]
    reference = DOP853(1e-6 if quick else 1e-9)
    pull = Integral(reaction(pin, 0) ** 2 + reaction(pin, 1) ** 2)
    cases = [
        _Case(f"soft pendulum, {what}", beam, objective, design, t_end, settings, reference)
        for what, objective in (
            ("integral of y²", Integral(tip**2)),
            ("y at the end", Terminal(tip)),
            ("reaction²", pull),
        )
    ]
    fine = HHT(t_end / 2 ** (8 if quick else 15), hht_alpha=-0.05)
    name = "soft pendulum, damped, y at the end"
    cases.append(_Case(name, damped, Terminal(tip), design, t_end, steps, fine))
    if not quick:
        short = [HHT(2.0**-k) for k in (9, 12, 15)]
        name = "soft pendulum, y after 1/16 s"
        cases.append(_Case(name, beam, Terminal(tip), design, 2.0**-4, short, DOP853(1e-10)))
    return cases


def _measured(case: _Case, quick: bool) -> list[_Found]:
    asked = case.model, case.objective, case.t_end
    method = DirectDifferentiation()
    exact = gradient(*asked, case.reference, design=case.design, method=method)
    rows = []
    for integrator in case.settings:
        for levels in (2,) if quick or integrator.order is None else (2, 3):
            bars = error_bars(*asked, integrator, design=case.design, levels=levels)
            rows.append(_row(case, integrator, levels, bars, exact.value, exact.gradient))
    return rows


def _row(
    case: _Case, integrator: Integrator, levels: int, bars: ErrorBars, value: float, slope: Array
) -> _Found:
    # Derivatives times the variable, so that they can be compared with each other.
    scale = np.abs(as_system(case.model, case.design).b)
    sizes = np.append(abs(value), np.full(len(slope), np.linalg.norm(slope * scale)))
    factor = np.append(1.0, scale) / sizes
    exact = np.append(value, slope)
    kind = type(integrator).__name__
    if isinstance(integrator, SteppedIntegrator):
        controlled = isinstance(integrator.steps, AdaptiveSteps)
        kind = "HHT, controlled" if controlled else "HHT, fixed"
    return _Found(
        case.name,
        f"{kind}, {levels} levels",
        np.abs(np.append(bars.value, bars.gradient) - exact) * factor,
        np.append(bars.value_bar, bars.gradient_bar) * factor,
        np.abs(np.append(bars.extrapolated_value, bars.extrapolated_gradient) - exact) * factor,
        bars.resolved,
    )


def _joined(rows: Sequence[_Found]) -> tuple[Array, Array, Array]:
    """Return errors, bars and errors of extrapolated numbers of all rows."""
    error, bar, better = zip(*((row.error, row.bar, row.better) for row in rows), strict=True)
    return np.concatenate(error), np.concatenate(bar), np.concatenate(better)


def _table(report: Report, found: Sequence[_Found]) -> None:
    report.heading("How often the bars hold")
    rows: list[list[object]] = []
    for kind in dict.fromkeys(row.kind for row in found):
        for case in dict.fromkeys(row.case for row in found if row.kind == kind):
            mine = [row for row in found if row.kind == kind and row.case == case]
            error, bar, better = _joined(mine)
            held, width = np.mean(error <= bar), np.median(bar / error)
            rows.append(
                [
                    kind,
                    case,
                    len(error),
                    f"{100 * held:.0f} %",
                    f"{np.max(error / bar):.2g}",
                    f"{width:.2g}",
                    f"{np.median(better / error):.2g}",
                ]
            )
    report.say("table")
    report.table(
        ["runs", "scene and objective", "numbers", "bar holds", "worst", "width", "extrapolated"],
        rows,
    )


def _pictures(report: Report, found: Sequence[_Found]) -> None:
    kinds = list(dict.fromkeys(row.kind for row in found))
    series = []
    for kind in kinds:
        mine = [row for row in found if row.kind == kind]
        error, bar, _ = _joined(mine)
        good = (error > 0) & (bar > 0)
        series.append(dots(kind, error[good], bar[good]))
    ends = np.array([1e-13, 1.0])
    series.append(Series("bar = error", ends, ends))
    panel = log_log("Bars against true errors, relative", "true error [-]", "bar [-]", series)
    report.plot("bars", [panel])


def _verdict(report: Report, found: Sequence[_Found]) -> None:
    report.heading("Agreement")
    lines = []
    for levels in ("2 levels", "3 levels"):
        mine = [row for row in found if row.kind.endswith(levels) and row.kind.startswith("HHT")]
        if not mine:
            continue
        error, bar, _ = _joined(mine)
        held = report.figure(f"held.hht.{levels[0]}", float(np.mean(error <= bar)))
        worst = report.figure(f"worst.hht.{levels[0]}", float(np.max(error / bar)))
        lines.append(
            f"HHT-I3, {levels}: {100 * held:.0f} % of {len(error)} bars hold; the worst error is "
            f"{worst:.2g} times its bar."
        )
    mine = [row for row in found if not row.kind.startswith("HHT")]
    error, bar, _ = _joined(mine)
    held = report.figure("held.tolerance", float(np.mean(error <= bar)))
    lines.append(f"Runs refined by tolerance: {100 * held:.0f} % of {len(error)} bars hold.")
    report.text("\n".join(f"- {line}" for line in lines))
    shares, widths, texts = [], list[Array](), []
    for resolved, name in ((True, "resolved"), (False, "unresolved")):
        mine = [row for row in found if row.resolved is resolved]
        if mine:
            over = np.concatenate([row.error / row.bar for row in mine])
            shares.append(report.figure(f"held.{name}", float(np.mean(over <= 1))))
            widths.append(1 / over)
            width = report.figure(f"width.{name}", float(np.median(1 / over)))
            scenes = len({row.case for row in mine})
            texts.append(
                f"{name}: {100 * shares[-1]:.0f} % of {len(over)} bars, median width {width:.2g}, "
                f"worst {np.max(over):.2g}, {scenes} scenes and objectives"
            )
    width = report.figure("width", float(np.median(np.concatenate(widths))))
    report.judge("verdict", shares[0] >= 0.95, texts="; ".join(texts))
    report.judge(
        "cost",
        min(shares) >= 0.95 and width <= 10,
        shares=" and ".join(f"{100 * x:.0f} %" for x in shares),
        width=width,
    )
