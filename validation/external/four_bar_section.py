"""Part of the report on external problems: the double four-bar through its singular positions."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ancfdae import HHT, Integral
from ancfdae.errors import StabilityWarning
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.numerics.arrays import Array
from ancfdae.observables import custom
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.external import published
from validation.external.pendulum_section import speed
from validation.external.rods import double_four_bar, four_bar_minimal
from validation.external.runs import (
    Attempt,
    Problem,
    compare_methods,
    controlled,
    key,
    rows_at,
    run,
    setting,
)
from validation.report import Report

_LIMIT: Final = 1e-5
# Corrections of the accelerations near a singular position are round-off up to this size.
_TOLERANCE: Final = 1e-5
# A run that needs more steps than this for each of its intervals has got stuck.
_MAX_STEPS: Final = 400
# Finished, but further off than this: wrong without saying so.
_WRONG: Final = 0.05


@dataclass(frozen=True)
class _Run:
    """One run of the motion; the error is the largest over the times of the table it reached."""

    integrator: Integrator
    attempt: Attempt
    times: Array
    errors: Array

    @property
    def name(self) -> str:
        """Integrator and tolerance of Newton's method, where it matters."""
        x = self.integrator
        if isinstance(x, SteppedIntegrator):
            return f"HHT, newton_tolerance = {x.newton_tolerance or 1e-14:.0e}"
        return type(x).__name__


def four_bar(report: Report, quick: bool) -> None:
    """Fill the section."""
    with warnings.catch_warnings():
        # The singular positions that runs warn of are the subject of this section.
        warnings.simplefilter("ignore", StabilityWarning)
        _fill(report, quick)


def _fill(report: Report, quick: bool) -> None:
    t_end = 1.0 if quick else 10.0
    steps = (8e-3, 4e-3) if quick else (4e-4, 2e-4, 1e-4)
    rtols = (1e-4,) if quick else (1e-6, 1e-8, 1e-10, 1e-12)
    report.say("four-bar")
    tolerant = [HHT(step, newton_tolerance=_TOLERANCE) for step in steps]
    integrators: list[Integrator] = [*tolerant, *(HHT(step) for step in steps)]
    # Every time of the table ends an interval, and no interval ends at a singular position.
    intervals = round(4 * t_end)
    integrators += controlled(rtols, intervals, _MAX_STEPS * intervals)
    runs = [_motion(integrator, t_end) for integrator in integrators]
    _table(report, runs)
    _plot(report, runs[len(steps) - 1])
    t_slopes = 1.0 if quick else 2.0
    loose = (1e-4,) if quick else (1e-4, 1e-6, 1e-8, 1e-10)
    intervals = round(4 * t_slopes)
    others = controlled(loose, intervals, _MAX_STEPS * intervals)
    slopes = _sensitivities(report, [*tolerant, *others], t_slopes)
    report.say("four-bar.why")
    report.say("four-bar.methods")
    state, state_b = four_bar_minimal(np.array([1.0]))
    exact = np.array([state[0, 0], *state_b[0, 0]])
    problem = Problem("four-bar", double_four_bar(), Integral(custom(speed, "speed")), 1.0, exact)
    step = HHT(8e-3 if quick else 2e-3, newton_tolerance=_TOLERANCE)
    compare_methods(
        report, problem, [step, *controlled((1e-4 if quick else 1e-6,), 4, 4 * _MAX_STEPS)]
    )
    _verdict(report, runs, steps[-1], slopes)


def _motion(integrator: Integrator, t_end: float) -> _Run:
    attempt = run(double_four_bar(), t_end, integrator, sensitivities=False)
    table = published.FOUR_BAR
    reached = 0.0 if attempt.solution is None else float(attempt.solution.t[-1])
    table = table[table[:, 0] <= reached + 1e-9]
    errors = np.zeros(0)
    if attempt.solution is not None and len(table):
        rows = rows_at(attempt.solution, table[:, 0])
        values = np.hstack([attempt.solution.q[rows, :2], attempt.solution.v[rows, :2]])
        errors = np.max(np.abs(values - table[:, 1:]), axis=1)
    return _Run(integrator, attempt, table[:, 0], errors)


def _table(report: Report, runs: Sequence[_Run]) -> None:
    rows: list[list[object]] = []
    for each in runs:
        row: list[object] = [each.name, setting(each.integrator)]
        solution = each.attempt.solution
        if solution is None:
            rows.append([*row, *["-"] * 8, each.attempt.note])
            continue
        cells = [f"{error:.1e}" for error in each.errors]
        name = key("four-bar", each.integrator)
        x = each.integrator
        if isinstance(x, SteppedIntegrator) and x.newton_tolerance == _TOLERANCE:
            name = f"{name}.tolerant"
        report.figure(f"{name}.reached", float(solution.t[-1]))
        if len(each.errors):
            report.figure(f"{name}.error", float(np.max(each.errors)))
        report.figure(f"{name}.seconds", each.attempt.seconds)
        cells += ["-"] * (len(published.FOUR_BAR) - len(cells))
        bent = float(np.max(np.abs(solution.q[:, 2:4] - solution.q[:, :2] - [1.0, 0.0])))
        reached = f"{solution.t[-1]:.4g}"
        cells += [f"{bent:.0e}", f"{np.max(np.abs(solution.lam)):.1e}"]
        rows.append([*row, *cells, reached, f"{each.attempt.seconds:.1f}", _judged(each)])
    header = ["integrator", "setting", *(f"t = {t:g}" for t in published.FOUR_BAR[:, 0])]
    report.table([*header, "bent", "multiplier", "reached [s]", "CPU [s]", "outcome"], rows)
    report.say("four-bar.table")


def _judged(each: _Run) -> str:
    if each.attempt.finished and len(each.errors) and np.max(each.errors) > _WRONG:
        return "finished, WRONG"
    return each.attempt.note


def _plot(report: Report, each: _Run) -> None:
    solution = each.attempt.solution
    assert solution is not None
    system, stride = double_four_bar(), max(len(solution.t) // 4000, 1)
    t, q = solution.t[::stride], solution.q[::stride]
    rank = [
        np.linalg.svd(system.constraint_q(0.0, x).reshape(5, 6), compute_uv=False)[-1] for x in q
    ]
    exact = four_bar_minimal(t[1:])[0]
    largest = np.max(np.abs(solution.lam[::stride]), axis=1)
    point = [Series("six coordinates, HHT", t, q[:, 0]), Series("minimal form", t[1:], exact[:, 0])]
    near = [
        Series("smallest singular value of Phi_q", t, rank),
        Series("largest multiplier", t, largest),
    ]
    axes = "time t [s]", "singular value in m, multiplier in N/m"
    panels = [
        Panel("Point B₀", "time t [s]", "x [m]", point),
        Panel("Distance from a singular position", *axes, near, y_scale="log"),
    ]
    report.plot("four-bar", panels, 2, setting=setting(each.integrator))


def _sensitivities(
    report: Report, integrators: Sequence[Integrator], t_end: float
) -> dict[Integrator, float]:
    """Errors of the derivatives in L and g at `t_end`, by direct differentiation."""
    exact = four_bar_minimal(np.array([t_end]))[1][0]
    rows: list[list[object]] = []
    errors = {}
    for integrator in integrators:
        attempt = run(double_four_bar(), t_end, integrator)
        row: list[object] = [type(integrator).__name__, setting(integrator)]
        error = _slope_error(attempt.solution, exact) if attempt.finished else None
        reached = 0.0 if attempt.solution is None else float(attempt.solution.t[-1])
        last = [f"{reached:.4g}", f"{attempt.seconds:.1f}", attempt.note]
        if error is None:
            rows.append([*row, "-", "-", *last])
            continue
        errors[integrator] = float(np.max(error))
        report.figure(key("four-bar", "derivatives", integrator, "error"), errors[integrator])
        rows.append([*row, *(f"{x:.1e}" for x in error), *last])
    report.say("four-bar.sensitivities", t_end=t_end, tolerance=_TOLERANCE)
    header = ["integrator", "setting", "in L", "in g", "reached [s]", "CPU [s]", "outcome"]
    report.table(header, rows)
    return errors


def _slope_error(solution: Solution | None, exact: Array) -> Array | None:
    if solution is None or solution.sensitivities is None:
        return None
    b = solution.sensitivities
    mine = np.concatenate([b.q_b[-1, :2], b.v_b[-1, :2]])
    return np.max(np.abs(mine - exact), axis=0)


def _verdict(
    report: Report, runs: Sequence[_Run], step: float, slopes: Mapping[Integrator, float]
) -> None:
    tolerant = HHT(step, newton_tolerance=_TOLERANCE)
    chosen = next(each for each in runs if each.integrator == tolerant)
    error = float(np.max(chosen.errors)) if chosen.attempt.finished else float("inf")
    slope = slopes.get(chosen.integrator, float("inf"))
    silent = sum(_judged(each).endswith("WRONG") for each in runs)
    report.judge("four-bar.verdict", error <= _LIMIT, error=error, step=step, tolerance=_TOLERANCE)
    report.require("four-bar", error, step=step)
    report.require("four-bar.derivatives", slope, step=step)
    report.require("four-bar.wrong", float(silent))
