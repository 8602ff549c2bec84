"""Report on the integrators: the paper's two scenes by all of them, and what each costs."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae import DOP853, HHT, IDA, IDAS, assemble
from ancfdae.assembly.system import AncfSystem
from ancfdae.extend import Integrator
from ancfdae.integrators.sundials.index_reduced import IndexReduction
from ancfdae.plotting import Panel, Series
from validation import integrators_crank_slider
from validation.external.runs import Requirement, add_verdict
from validation.integrator_runs import (
    MANY,
    Array,
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
from validation.report import Agreement, Report
from validation.scenes import pendulum, pendulum_deflection

__all__ = ["run"]

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
    report.heading("Method")
    report.text(_METHOD)
    system = assemble(pendulum(), _DESIGN)
    runs = [(i, differentiated_run(system, extent.t_end, i)) for i in _settings(extent)]
    reference = differentiated_run(
        system, extent.t_end, DOP853(extent.reference, _intervals(extent), max_steps=MANY)
    )
    assert reference is not None
    found = [(r, errors(r, reference, _SPACING)) for _, r in runs if r is not None]
    _work_table(report, system, runs, reference)
    requirements = _agreement(report, [r for r, _ in found], reference, extent)
    requirements += _convergence(report, found, reference)
    _work_precision(report, found)
    _question(report, found, reference)
    requirements += integrators_crank_slider.run(report, quick)
    report.heading("Agreement")
    add_verdict(report, requirements, quick)
    report.heading("Limits")
    report.text(_LIMITS)


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


# ---------------------------------------------------------------- work table


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
    report.text(
        f"Three design variables along. Errors are largest differences to the last row at the "
        f"instants every {_SPACING:g} s; sensitivities are those of the deflection times the "
        "variable. *States*: the largest difference of any coordinate (slopes have no unit). "
        "*Multipliers* relative to the largest one, *drift* max |Phi| over the length of "
        "the beam, *energy* the change of the total energy over the largest kinetic energy, both "
        "at all instants of the run."
    )
    report.table(header, rows)
    report.text(_TABLE_NOTES)


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


# ---------------------------------------------------------------- agreement


def _agreement(
    report: Report, runs: Sequence[Run], reference: Run, extent: _Extent
) -> list[Requirement]:
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
    for name, value in zip(("deflection", *_SYMBOLS), worst, strict=True):
        report.figure(f"agreement.{name}", value)
    report.table(["one", "other", "deflection [m]", *(f"{s} [m]" for s in _SYMBOLS)], rows)
    digits = -np.log10(worst / _sizes(reference))
    multipliers = max(errors(r, reference, _SPACING).multipliers for r in tight[:-1])
    for name, value in zip(("deflection", *_SYMBOLS), digits, strict=True):
        report.figure(f"agreement.digits.{name}", value)
    report.figure("agreement.multipliers", multipliers)
    y, y_b = _at_all_instants(reference)
    values = dict(zip(("deflection", *_SYMBOLS), [y[-1], *y_b[-1]], strict=True))
    for name, value in values.items():
        report.figure(f"end.{name}", value)
    report.text(
        f"Largest differences over all {len(y)} instants. Every pair agrees on the deflection to "
        f"{worst[0]:.1g} m (asked for: 1e-8) and on its sensitivities to {np.max(worst[1:]):.1g} m "
        "(asked for: 1e-6). In digits of the largest value: "
        + ", ".join(f"{n} {d:.1f}" for n, d in zip(("deflection", *_SYMBOLS), digits, strict=True))
        + f"; multipliers differ from those of the reference by {multipliers:.1g} of the largest "
        f"one at most. At t = {extent.t_end:g} s the reference has "
        + ", ".join(f"{name} {value:.11g}" for name, value in values.items())
        + ".\n\n"
        + _WHY_NOT_MORE
    )
    who = f"pendulum, every pair of high order at rtol {extent.tolerances[-1]:.0e}"
    return [
        Requirement(f"{who}: deflection [m]", 1e-8, float(worst[0])),
        Requirement(f"{who}: its sensitivities to h, rho, E [m]", 1e-6, float(np.max(worst[1:]))),
    ]


def _at_all_instants(done: Run) -> tuple[Array, Array]:
    sensitivities = done.solution.sensitivities
    assert sensitivities is not None
    y_b = done.solution.derivative(pendulum_deflection) * sensitivities.values
    return pendulum_deflection(done.solution).real, y_b


# ---------------------------------------------------------------- HHT


def _convergence(
    report: Report, found: Sequence[tuple[Run, Errors]], reference: Run
) -> list[Requirement]:
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
        for name, value in zip(names, relative[k], strict=True):
            report.figure(f"hht.2{int(np.log2(step))}.{name}", value)
    for name, order in zip(names, orders[-1], strict=True):
        report.figure(f"hht.order.{name}", order)
    report.text(
        f"Largest errors at the instants every {_SPACING:g} s, relative to the largest value; in "
        "brackets the order from the step above."
    )
    report.table(["step [s]", *names], rows)
    _steps_needed(report, np.array(steps), relative)
    report.text(_CONVERGENCE_NOTES)
    _claim(report, steps[0], relative[0])
    distance = float(np.max(np.abs(orders[-1] - 2)))
    return [
        Requirement(
            "pendulum, HHT-I3: distance of the order of the last halving from 2", 0.1, distance
        )
    ]


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
    report.text("The step from which on the error stays below 1 % and 0.1 %, in seconds:")
    report.table(["quantity", "1 %", "0.1 %"], rows)


def _step_needed(steps: Array, column: Array, target: float) -> tuple[float, bool]:
    """Return the largest step from which on all errors are below the target."""
    above = np.flatnonzero(column > target)
    first = 0 if len(above) == 0 else int(above[-1]) + 1
    if first < len(steps):
        return float(steps[first]), False
    exponent = np.floor(np.log2(steps[-1] * np.sqrt(target / column[-1])))
    return float(2.0**exponent), True


def _claim(report: Report, step: float, relative: Array) -> None:
    wrong = ", ".join(f"{s}: {e:.2g}" for s, e in zip(_SYMBOLS, relative[1:], strict=True))
    report.claim(
        f"HHT-I3 at the step {step:g} s shows motion and sensitivities of the pendulum",
        "implied by Figs. 4 to 6, made with one step (2^-7 s)",
        f"largest relative errors: deflection {relative[0]:.2g}, sensitivities {wrong}",
        Agreement.AGREES if np.max(relative) < 0.05 else Agreement.DISAGREES,
    )


# ---------------------------------------------------------------- work and precision


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
        series = [
            Series(name, [x for x, _ in points], [y for _, y in points], marker=True)
            for name, points in lines.items()
        ]
        panels.append(
            Panel(
                title,
                "processor time [s]",
                "largest error over time [m]",
                series,
                x_scale="log",
                y_scale="log",
            )
        )
    report.plot(
        "work-precision",
        panels,
        columns=2,
        title="Planar pendulum, E = 1e7 N/m², three design variables along",
        caption="Largest error at the common instants. From left to right smaller steps or "
        "tolerances.",
    )


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
    report.text(
        "Processor time in seconds of the cheapest run above whose worst sensitivity, at all "
        "common instants, is right to the given part of its largest value:"
    )
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
    report.text(
        "Expected was: *for soft scenes the explicit path gives 6 to 8 digits of the sensitivities "
        f"for less CPU time than HHT-I3 pays for two.* HHT-I3 pays {paid.seconds:.2g} s at "
        f"{paid.label} for {paid.digits:.1f} digits. DOP853, " + "; ".join(lines) + ". "
        f"So the answer is **{'yes' if yes else 'no'}** in this run."
    )
    report.text(_ANSWER)


_METHOD = """
Two scenes of the paper, as in the reports `pendulum` and `crank-slider`, by every integrator of the
package. *HHT-I3*: fixed step, hht_alpha = -0.3, second order, eq. (1) with positions on the
constraints. *IDA*: SUNDIALS, variable order up to 5, sensitivities appended to the system. *IDAS*:
the same formulas by another wrapper, sensitivities staggered. Both on two forms: *GGL*, positions
and velocities on the constraints (stabilised index 2), and *index 1*, accelerations on the
constraints. *DOP853*: DOP853, order 8, accelerations from the index-1 form. They share the
assembler and the derivatives of its terms; equations, step control, linear algebra and the
sensitivity equations of each are its own. The reference is DOP853 at a tolerance a hundred times
below the others. Processor times are of one process on one core of a shared machine: read their
ratios, to a third. Digits are -log10 of a relative error.
"""

_TABLE_NOTES = """
Drift: the pendulum's constraints are linear in q, so every method keeps them to round-off; IDA
and IDAS with GGL add the error of their Newton iteration. Energy: only HHT-I3 loses a visible part;
it is what it takes out of waves that it cannot resolve. Multipliers follow the axial waves
and converge last.
"""

_WHY_NOT_MORE = """
Why not more digits: the beam is undamped and gravity sets in suddenly, so axial and thickness waves
never die out (the fastest mode of the linearised beam has 4108 rad/s, 650 periods in this second),
and a sensitivity to E counts their phases: error times frequency times time. The tolerances bound
the error of one step; IDA and IDAS add up tens of thousands of them, whence 1 to 20 times the
tolerance in the sensitivities. Tighter ones would bring more digits at the price of the table;
DOP853 at 1e-11 comes closest to the limit of round-off.
"""

_CONVERGENCE_NOTES = """
Errors fall irregularly down to 2^-13 s, with the E-sensitivity even rising on the way: 2^-11 s is
three steps in the period of the fastest mode (1.5 ms), so waves are damped and shifted in phase
rather than resolved, and their part in the sensitivity comes and goes. From about 12 steps per
period on the order is two. Single instants, and variables whose error has parts of opposite sign
(h between 2^-14 and 2^-15 s), show it one or two halvings later.
"""

_ANSWER = """
Why: what is wanted are phases of waves. A method that does not resolve them loses the sensitivities
even where it is stable, so the unconditional stability of HHT-I3 is of no use here; one that does
resolve them is stable at that step anyway. DOP853 takes one and a half radians of the fastest
mode in a step at rtol 1e-7; HHT-I3, of order 2, needs about fifty steps in a period for two digits.
The answer is for soft scenes: with the modulus of steel waves are a hundred times faster than here
and the explicit step falls with them. Where only the slow motion is wanted there, HHT-I3 can be the
cheaper; that is not measured here.
"""

_LIMITS = """
- Two scenes, both soft and undamped. The step of the explicit method falls with the highest
  frequency, about sqrt(12) times the speed of pressure waves over the thickness.
- Errors are measured against a run of the same package; that the equations themselves are right is
  the subject of the tests (oracle, complex step) and of the other reports.
- The crank's three variables are compared over the whole run between DOP853 and HHT-I3 only;
  SUNDIALS carries the rod's three there, and all six in the first instants.
- Processor times are of NumPy code with small matrices: overheads of calls, not flops.
"""
