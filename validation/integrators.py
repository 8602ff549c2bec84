"""Report on the integrators: the paper's two scenes by all of them, and what each costs."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae import DOP853, HHT, IDA, IDAS, assemble
from ancfdae.assembly.system import AncfSystem
from ancfdae.extend import Integrator
from ancfdae.integrators.sundials.index_reduced import IndexReduction
from ancfdae.numerics.arrays import Array
from validation import integrators_crank_slider
from validation.drawing import error_over_work
from validation.integrator_runs import (
    MANY,
    Errors,
    Run,
    balance,
    cheapest,
    common_rows,
    differentiated_run,
    errors,
    family,
    label,
    step_of,
)
from validation.report import Report
from validation.scenes import pendulum, pendulum_deflection

_SYMBOLS = ("h", "rho", "E")
_DESIGN = ("pendulum.height", "pendulum.density", "pendulum.youngs_modulus")
_LENGTH = 1.2
# Instants that all runs share; s.
_SPACING = 2.0**-6
_INDEX_1 = IndexReduction.INDEX_1
_WITHOUT = "not installed: sundials4py (its wheels need Python 3.12)"


@dataclass(frozen=True)
class _Extent:
    """How much of the pendulum's part is run."""

    t_end: float
    exponents: Sequence[int]
    tolerances: Sequence[float]
    reference: float


_FULL = _Extent(1.0, range(7, 17), (1e-5, 1e-7, 1e-9), 1e-11)
_QUICK = _Extent(2 * _SPACING, (7, 8, 9), (1e-4, 1e-5), 1e-7)


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `integrators`; add its text, tables and figures."""
    extent = _QUICK if quick else _FULL
    report.say("method")
    system = assemble(pendulum(), _DESIGN)
    runs = [(i, differentiated_run(system, extent.t_end, i)) for i in _settings(extent)]
    reference = differentiated_run(
        system, extent.t_end, DOP853(extent.reference, _intervals(extent), max_steps=MANY)
    )
    assert reference is not None
    found = [(r, errors(r, reference, _SPACING)) for _, r in runs if r is not None]
    _work_table(report, system, runs, reference)
    _agreement(report, [r for r, _ in found], reference, extent)
    _convergence(report, found, reference)
    _work_precision(report, found)
    _question(report, found, reference)
    integrators_crank_slider.run(report, quick)
    report.heading("Agreement")
    report.verdict(quick)
    report.say("limits")


def _intervals(extent: _Extent) -> int:
    return round(extent.t_end / _SPACING)


def _settings(extent: _Extent) -> list[Integrator]:
    """All settings but the reference."""
    n = _intervals(extent)
    found: list[Integrator] = [HHT(2.0**-k) for k in extent.exponents]
    found += [IDA(rtol, intervals=n, max_steps=MANY) for rtol in extent.tolerances]
    found += [IDA(rtol, n, MANY, _INDEX_1) for rtol in extent.tolerances[-2:]]
    found += [IDAS(rtol, intervals=n, max_steps=MANY) for rtol in extent.tolerances]
    found += [IDAS(rtol, n, MANY, _INDEX_1) for rtol in extent.tolerances[-2:]]
    return [*found, *(DOP853(rtol, n, max_steps=MANY) for rtol in extent.tolerances)]


def _work_table(
    report: Report,
    system: AncfSystem,
    runs: Sequence[tuple[Integrator, Run | None]],
    reference: Run,
) -> None:
    report.heading("Planar pendulum: errors and work")
    header = ["integrator", "setting", "steps", "CPU [s]", "deflection [m]", "states [m]"]
    header += ["multipliers [-]"]
    header += [f"{symbol}-sensitivity [m]" for symbol in _SYMBOLS]
    header += ["drift [-]", "energy [-]"]
    rows: list[list[object]] = []
    for integrator, done in [*runs, (reference.integrator, reference)]:
        names = [family(integrator), label(integrator)]
        if done is None:
            rows.append([*names, _WITHOUT, *["-"] * (len(header) - 3)])
            continue
        cells = _cells(system, done, reference)
        _keep(report, "pendulum", integrator, dict(zip(header[2:], cells, strict=True)))
        rows.append([*names, cells[0], *(f"{x:.2g}" for x in cells[1:])])
    report.say("work-table", spacing=_SPACING)
    report.table(header, rows)
    report.say("work-table.notes")


def _cells(system: AncfSystem, done: Run, reference: Run) -> list[float]:
    own = errors(done, reference, _SPACING)
    drift, energy = balance(system, done.solution, _LENGTH)
    return [
        done.solution.statistics.steps,
        done.seconds,
        own.deflection,
        own.states,
        own.multipliers,
        *own.sensitivities.tolist(),
        drift,
        energy,
    ]


def _keep(report: Report, scene: str, integrator: Integrator, values: dict[str, float]) -> None:
    """Keep the row of a table in results.json."""
    place = f"{scene}.{family(integrator)}.{label(integrator)}"
    for name, value in values.items():
        key = f"{place}.{name.split(' ')[0]}".replace("step ", "").replace("rtol ", "")
        report.figure(key.replace(" s.", ".").replace(" ", "_").replace("^", ""), value)


def _agreement(report: Report, runs: Sequence[Run], reference: Run, extent: _Extent) -> None:
    """Compare the most accurate runs with each other at all instants."""
    report.heading("Do the integrators of high order agree?")
    tight = [r for r in runs if label(r.integrator) == f"rtol {extent.tolerances[-1]:.0e}"]
    tight.append(reference)
    rows, worst = [], np.zeros(4)
    for left, right in itertools.combinations(tight, 2):
        (y, y_b), (z, z_b) = (_at_all_instants(r) for r in (left, right))
        apart = np.array([np.max(np.abs(y - z)), *np.max(np.abs(y_b - z_b), axis=0)])
        worst = np.maximum(worst, apart)
        names = (f"{family(r.integrator)}, {label(r.integrator)}" for r in (left, right))
        rows.append([*names, *(f"{x:.1g}" for x in apart)])
    report.figures("agreement.{}", ("deflection", *_SYMBOLS), worst)
    report.table(["one", "other", "deflection [m]", *(f"{s} [m]" for s in _SYMBOLS)], rows)
    digits = -np.log10(worst / _sizes(reference))
    multipliers = max(errors(r, reference, _SPACING).multipliers for r in tight[:-1])
    report.figures("agreement.digits.{}", ("deflection", *_SYMBOLS), digits)
    report.figure("agreement.multipliers", multipliers)
    y, y_b = _at_all_instants(reference)
    values = dict(zip(("deflection", *_SYMBOLS), [y[-1], *y_b[-1]], strict=True))
    report.figures("end.{}", values, values.values())
    report.say(
        "agreement",
        times=len(y),
        worst=worst,
        sensitivities=np.max(worst[1:]),
        digits=", ".join(
            f"{n} {d:.1f}" for n, d in zip(("deflection", *_SYMBOLS), digits, strict=True)
        ),
        multipliers=multipliers,
        extent=extent,
        values=", ".join(f"{name} {value:.11g}" for name, value in values.items()),
    )
    rtol = extent.tolerances[-1]
    report.require("deflection", float(worst[0]), rtol=rtol)
    report.require("sensitivities", float(np.max(worst[1:])), rtol=rtol)


def _at_all_instants(done: Run) -> tuple[Array, Array]:
    sensitivities = done.solution.sensitivities
    assert sensitivities is not None
    y_b = done.solution.derivative(pendulum_deflection) * sensitivities.values
    return pendulum_deflection(done.solution).real, y_b


def _convergence(report: Report, found: Sequence[tuple[Run, Errors]], reference: Run) -> None:
    """Order of HHT-I3 and the steps it needs."""
    report.heading("How HHT-I3 converges to them")
    sizes = _sizes(reference)
    table, steps = [], []
    for done, own in found:
        if done.integrator.order is not None:
            table.append(np.array([own.deflection, *own.sensitivities]) / sizes)
            steps.append(step_of(done.integrator))
    relative = np.array(table)
    orders = np.log2(relative[:-1] / relative[1:])
    names = ("deflection", *_SYMBOLS)
    rows: list[list[object]] = []
    for k, step in enumerate(steps):
        order = ["-"] * 4 if k == 0 else [f"{x:.2f}" for x in orders[k - 1]]
        cells = [f"{e:.2g} ({o})" for e, o in zip(relative[k], order, strict=True)]
        rows.append([f"2^{int(np.log2(step))}", *cells])
        report.figures(f"hht.2{int(np.log2(step))}.{{}}", names, relative[k])
    report.figures("hht.order.{}", names, orders[-1])
    report.say("convergence", spacing=_SPACING)
    report.table(["step [s]", *names], rows)
    _steps_needed(report, np.array(steps), relative)
    report.say("convergence.notes")
    wrong = ", ".join(f"{s}: {e:.2g}" for s, e in zip(_SYMBOLS, relative[0, 1:], strict=True))
    verdict = np.max(relative[0]) < 0.05
    report.judge("one-step", verdict, step=steps[0], relative=relative[0], wrong=wrong)
    distance = float(np.max(np.abs(orders[-1] - 2)))
    report.require("order", distance)


def _sizes(reference: Run) -> Array:
    """Largest deflection and sensitivities at the common instants."""
    rows = common_rows(reference.solution, _SPACING)
    y, y_b = _at_all_instants(reference)
    return np.array([np.max(np.abs(y[rows])), *np.max(np.abs(y_b[rows]), axis=0)])


def _steps_needed(report: Report, steps: Array, table: Array) -> None:
    rows: list[list[object]] = []
    for name, column in zip(("deflection", *_SYMBOLS), table.T, strict=True):
        cells: list[object] = [name]
        for target in (1e-2, 1e-3):
            step, extrapolated = _step_needed(steps, column, target)
            report.figure(f"hht.step_for_{target:.0e}.{name}", step)
            power = f"2^{np.log2(step):.0f}"
            cells.append(f"about {power} (extrapolated at order 2)" if extrapolated else power)
        rows.append(cells)
    report.say("steps-needed")
    report.table(["quantity", "1 %", "0.1 %"], rows)


def _step_needed(steps: Array, column: Array, target: float) -> tuple[float, bool]:
    """Return the largest step from which on all errors are below the target."""
    above = np.flatnonzero(column > target)
    first = 0 if len(above) == 0 else int(above[-1]) + 1
    if first < len(steps):
        return float(steps[first]), False
    exponent = np.floor(np.log2(steps[-1] * np.sqrt(target / column[-1])))
    return float(2.0**exponent), True


def _work_precision(report: Report, found: Sequence[tuple[Run, Errors]]) -> None:
    report.heading("Accuracy against processor time")
    readings: dict[str, Callable[[Errors], float]] = {
        "Deflection": lambda e: e.deflection,
        "Its sensitivity to E, times E": lambda e: float(e.sensitivities[2]),
    }
    panels = []
    for title, read in readings.items():
        lines: dict[str, list[tuple[float, float]]] = {}
        for done, own in found:
            lines.setdefault(family(done.integrator), []).append((done.seconds, read(own)))
        panels.append(error_over_work(title, lines, "largest error over time [m]"))
    report.plot("work-precision", panels, 2)


@dataclass(frozen=True)
class _Point:
    """A run by what it costs and the relative error of its worst sensitivity."""

    family: str
    label: str
    error: float
    seconds: float

    @property
    def digits(self) -> float:
        """Correct digits of the worst sensitivity."""
        return float(-np.log10(self.error))


def _point(done: Run, own: Errors, reference: Run) -> _Point:
    error = float(np.max(own.sensitivities / _sizes(reference)[1:]))
    return _Point(family(done.integrator), label(done.integrator), error, done.seconds)


def _question(report: Report, found: Sequence[tuple[Run, Errors]], reference: Run) -> None:
    """Answer what was expected of the explicit path."""
    report.heading("What is cheapest for which accuracy?")
    points = [_point(done, own, reference) for done, own in found]
    families = list(dict.fromkeys(p.family for p in points))
    rows: list[list[object]] = []
    for target in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8):
        cells: list[object] = [f"{target:.0e}"]
        for name in families:
            own = [(p.error, p.seconds) for p in points if p.family == name]
            seconds = cheapest(own, target)
            cells.append(f"{seconds:.2g}" if np.isfinite(seconds) else "not reached")
        rows.append(cells)
    report.say("question")
    report.table(["error", *families], rows)
    hht = [p for p in points if p.family == "HHT-I3" and p.error <= 1e-2]
    hht = hht or [p for p in points if p.family == "HHT-I3"][-1:]
    paid = min(hht, key=lambda p: p.seconds)
    explicit = [p for p in points if p.family == "DOP853"]
    lines = [
        f"{p.label}: {p.digits:.1f} digits for {p.seconds:.2g} s, "
        f"{p.seconds / paid.seconds:.2g} of the time of HHT-I3"
        for p in explicit
    ]
    for name, value in (("error", paid.error), ("seconds", paid.seconds)):
        report.figure(f"question.hht.{name}", value)
    for p in explicit:
        report.figure(f"question.explicit.{p.label.replace('rtol ', '')}.digits", p.digits)
        report.figure(f"question.explicit.{p.label.replace('rtol ', '')}.seconds", p.seconds)
    yes = any(p.digits >= 6 and p.seconds < paid.seconds for p in explicit) and paid.digits >= 2
    report.say("answer", paid=paid, lines="; ".join(lines), answer="yes" if yes else "no")
