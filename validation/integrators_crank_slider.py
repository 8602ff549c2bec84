"""Crank-slider's part of the report on the integrators."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ancfdae import DOP853, HHT, IDA, IDAS, Integral, assemble, gradient
from ancfdae.assembly.system import AncfSystem
from ancfdae.errors import MissingPackageError
from ancfdae.extend import Integrator, MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import timed
from ancfdae.observables import position
from ancfdae.plotting import Series
from ancfdae.results import Solution
from validation.drawing import log_log
from validation.integrator_runs import (
    MANY,
    balance,
    common_rows,
    differentiated_run,
    family,
    label,
    motion_errors,
    step_of,
)
from validation.report import Report
from validation.scenes import crank_slider

_SYMBOLS = ("E_1", "h_1", "rho_1", "E_2", "h_2", "rho_2")
_DESIGN = tuple(
    f"{beam}.{name}"
    for beam in ("crank", "rod")
    for name in ("youngs_modulus", "height", "density")
)
_LENGTH = 2.7
_NAMES = ("Psi", *_SYMBOLS)


@dataclass(frozen=True)
class _Objective:
    """A run of the objective by HHT-I3 at several steps, and by the others at one tolerance."""

    name: str
    t_end: float
    exponents: Sequence[int]
    rtol: float


@dataclass(frozen=True)
class _Extent:
    """How much of the crank-slider's part is run.

    The early part of the motion, up to `t_early`, is run by all integrators.
    """

    t_early: float
    early_exponents: Sequence[int]
    early_rtol: float
    objectives: tuple[_Objective, _Objective]


_FULL = _Extent(
    2.0**-4,
    range(9, 15),
    1e-6,
    (
        _Objective("short", 2.0**-4, range(13, 19), 1e-9),
        _Objective("whole", 2.0, range(6, 15), 1e-6),
    ),
)
_QUICK = _Extent(
    2.0**-8,
    (10, 11),
    1e-4,
    (_Objective("short", 2.0**-8, (10, 11), 1e-4), _Objective("whole", 2.0**-7, (8, 9), 1e-4)),
)


def run(report: Report, quick: bool) -> None:
    """Fill the crank-slider's part and return what was required of it."""
    extent = _QUICK if quick else _FULL
    system = assemble(crank_slider(), _DESIGN)
    report.heading("Crank-slider: the first instants by all integrators")
    _early(report, system, extent)
    short, whole = extent.objectives
    report.say("crank-slider.psi")
    distances, agreed = _objective(report, short)
    report.say("crank-slider.short")
    report.heading("Crank-slider: dΨ/db over the whole run")
    _, agreed_whole = _objective(report, whole)
    report.say("crank-slider.whole")
    for name, distance in zip(_SYMBOLS[3:], distances, strict=True):
        report.require("crank-slider.order", distance, name=name)
    for part, apart in ((short, agreed), (whole, agreed_whole)):
        names = ", ".join(_SYMBOLS[3:])
        report.require("crank-slider.agreement", apart, names=names, t_end=part.t_end)


def _early(report: Report, system: AncfSystem, extent: _Extent) -> None:
    """States and sensitivities of the slider's position by all integrators."""
    n, rtol = 4, extent.early_rtol
    spacing = extent.t_early / n
    settings: list[Integrator] = [HHT(2.0**-k) for k in extent.early_exponents]
    settings += [kind(rtol, intervals=n, max_steps=MANY) for kind in (IDA, IDAS, DOP853)]
    reference = differentiated_run(system, extent.t_early, DOP853(1e-2 * rtol, n, max_steps=MANY))
    assert reference is not None
    x_0, x_b0 = _slider(reference.solution, system, spacing)
    rows: list[list[object]] = []
    for integrator in settings:
        done = differentiated_run(system, extent.t_early, integrator)
        names = [family(integrator), label(integrator)]
        if done is None:
            rows.append([*names, "not installed: sundials4py (Python 3.12)", *["-"] * len(_TITLES)])
            continue
        x, x_b = _slider(done.solution, system, spacing)
        states, multipliers = motion_errors(done.solution, reference.solution, spacing)
        relative = np.max(np.abs(x_b - x_b0), axis=0) / np.max(np.abs(x_b0), axis=0)
        drift, energy = balance(system, done.solution, _LENGTH)
        apart = float(np.max(np.abs(x - x_0)))
        ours = [float(np.max(relative[3:])), float(np.max(relative[:3]))]
        cells = [done.seconds, apart, states, multipliers, *ours, drift, energy]
        report.figures(f"early.{_key(integrator)}.{{}}", _COLUMNS, cells)
        rows.append([*names, done.solution.statistics.steps, *(f"{c:.2g}" for c in cells)])
    report.say("crank-slider.early", extent=extent, fine=0.01 * rtol, times=n + 1)
    report.table(["integrator", "setting", "steps", *_TITLES], rows)
    report.say("crank-slider.early.notes")


_TITLES = (
    "CPU [s]",
    "slider [m]",
    "states [m]",
    "multipliers [-]",
    "rod's [-]",
    "crank's [-]",
    "drift [-]",
    "energy [-]",
)
_COLUMNS = ("seconds", "slider", "states", "multipliers", "rod", "crank", "drift", "energy")


def _key(integrator: Integrator) -> str:
    place = f"{family(integrator)}.{label(integrator)}".replace(" ", "_")
    return place.replace("step_", "").replace("rtol_", "").replace("^", "").replace("_s", "")


def _slider(solution: Solution, system: AncfSystem, spacing: float) -> tuple[Array, Array]:
    """Position of the slider and its derivatives times the variables, at common instants."""

    def read(s: Solution) -> Array:
        return s.position(MaterialPoint("rod", 1.0))[:, 0]

    rows = common_rows(solution, spacing)
    x_b = solution.derivative(read)[rows] * system.b
    return read(solution).real[rows], x_b


@dataclass(frozen=True)
class _Value:
    """Psi and b dPsi/db by one integrator, in the order of `_NAMES`; nan where not asked for."""

    integrator: Integrator
    values: Array
    seconds: float


def _objective(report: Report, extent: _Objective) -> tuple[list[float], float]:
    """Convergence of HHT-I3 to the path of high order in Psi and its gradient.

    Returns the distances of the orders of the rod's sensitivities from 2, and the largest relative
    difference of DOP853 from SUNDIALS in them.
    """
    place = f"objective.{extent.name}"
    slider = position(crank_slider().beams[1].at_end, 0)
    psi = Integral((slider - 1.8) ** 2)

    def value(integrator: Integrator, variables: Sequence[str] = _DESIGN) -> _Value:
        chosen = assemble(crank_slider(), variables)
        run = partial(gradient, chosen, psi, extent.t_end, integrator)
        seconds, result = timed(run)
        values = np.full(1 + len(_DESIGN), np.nan)
        values[0] = result.value
        values[[1 + _DESIGN.index(v) for v in variables]] = result.gradient * chosen.b
        return _Value(integrator, values, seconds)

    rtol = extent.rtol
    explicit = value(DOP853(rtol, max_steps=MANY))
    try:
        sundials = value(IDAS(rtol, max_steps=MANY), _DESIGN[3:])
    except MissingPackageError:
        sundials = value(IDA(rtol, max_steps=MANY), _DESIGN[3:])
    ladder = [value(HHT(2.0**-k)) for k in extent.exponents]
    exact = np.where(np.isnan(sundials.values), explicit.values, sundials.values)
    table = np.abs(np.array([each.values for each in ladder]) / exact - 1)
    for each in (explicit, sundials):
        for name, number in zip(_NAMES, each.values, strict=True):
            if np.isfinite(number):
                report.figure(f"{place}.{_key(each.integrator)}.{name}", number)
    for each, errors in zip(ladder, table, strict=True):
        report.figures(f"{place}.{_key(each.integrator)}.{{}}", _NAMES, errors)
    for each in (explicit, sundials, *ladder):
        report.figure(f"{place}.{_key(each.integrator)}.seconds", each.seconds)
    report.say("crank-slider.objective", extent=extent, sundials=family(sundials.integrator))
    orders = _show(report, extent, ladder, table)
    agreed = _values(report, place, explicit, sundials, ladder)
    return [abs(order - 2) for order in orders[4:]], agreed


def _show(
    report: Report, extent: _Objective, ladder: Sequence[_Value], table: Array
) -> list[float]:
    """Table and plot of the errors of HHT-I3; returns the mean orders."""
    names = ("Ψ", *_SYMBOLS)
    steps = [step_of(each.integrator) for each in ladder]
    rows: list[list[object]] = []
    for k, step in enumerate(steps):
        order = np.log2(table[k - 1] / table[k]) if k else np.full(len(names), np.nan)
        cells = [
            f"{e:.2g}" + (f" ({o:.2f})" if k else "") for e, o in zip(table[k], order, strict=True)
        ]
        rows.append([f"2^{int(np.log2(step))}", f"{ladder[k].seconds:.2g}", *cells])
    report.say("crank-slider.errors")
    report.table(["step [s]", "CPU [s]", *names], rows)
    # Over three halvings: single ones are irregular while waves are not resolved.
    orders = [
        report.figure(f"objective.{extent.name}.order.{name}", _mean_order(column))
        for name, column in zip(_NAMES, table.T, strict=True)
    ]
    report.say(
        "crank-slider.orders",
        orders=", ".join(f"{name} {order:.2f}" for name, order in zip(names, orders, strict=True)),
    )
    series = [
        Series(name, steps, column, marker=True)
        for name, column in zip(names, table.T, strict=True)
    ]
    anchor = float(np.max(table[-1, 4:]))
    guide = Series("order 2", steps, anchor * (np.array(steps) / steps[-1]) ** 2, dashed=True)
    axes = "step of HHT-I3 [s]", "relative error [-]"
    panel = log_log("Relative error of Ψ and of its sensitivities", *axes, [*series, guide])
    report.plot("crank-slider-{extent.name}", [panel], extent=extent)
    return orders


def _values(
    report: Report, place: str, explicit: _Value, sundials: _Value, ladder: Sequence[_Value]
) -> float:
    """Values side by side with the digits they share; returns the worst difference."""
    coarse, fine = ladder[-2].values, ladder[-1].values
    extrapolated = fine + (fine - coarse) / 3
    finest = ladder[-1].integrator
    rows: list[list[object]] = []
    for k, name in enumerate(("Ψ", *_SYMBOLS)):
        one, other = sundials.values[k], explicit.values[k]
        exact = other if np.isnan(one) else one
        cells = ["-" if np.isnan(one) else f"{one:.10g}", f"{other:.10g}"]
        cells += [f"{fine[k]:.7g}", f"{extrapolated[k]:.7g}"]
        cells += ["-" if np.isnan(one) else _digits(other / one - 1)]
        cells += [_digits(fine[k] / exact - 1), _digits(extrapolated[k] / exact - 1)]
        report.figure(f"{place}.extrapolated.{_NAMES[k]}", abs(extrapolated[k] / exact - 1))
        rows.append([name, *cells])
    report.say(
        "crank-slider.values",
        sundials=_paid(sundials),
        explicit=_paid(explicit),
        hht=_paid(ladder[-1]),
    )
    header = [
        "",
        f"SUNDIALS, {label(sundials.integrator)}",
        f"DOP853, {label(explicit.integrator)}",
    ]
    header += [f"HHT-I3, {label(finest)}", "HHT-I3 extrapolated"]
    header += ["digits: DOP853", "digits: HHT-I3", "digits: extrapolated"]
    report.table(header, rows)
    apart = np.abs(explicit.values[4:] / sundials.values[4:] - 1)
    report.figures(f"{place}.agreement.{{}}", _SYMBOLS[3:], apart)
    return float(np.max(apart))


def _paid(each: _Value) -> str:
    return f"{family(each.integrator)} {each.seconds:.3g} s"


def _digits(difference: float) -> str:
    return f"{-np.log10(max(abs(difference), 1e-16)):.1f}"


def _mean_order(column: Array) -> float:
    first = max(len(column) - 4, 0)
    return float(np.log2(column[first] / column[-1]) / (len(column) - 1 - first))
