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
from ancfdae.observables import custom
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.external import published
from validation.external.pendulum_section import speed
from validation.external.rods import double_four_bar, four_bar_minimal
from validation.external.runs import (
    Attempt,
    Problem,
    Requirement,
    compare_methods,
    controlled,
    key,
    rows_at,
    run,
    setting,
)
from validation.external.scleronomic import Array
from validation.report import Agreement, Report

__all__ = ["four_bar"]

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


def four_bar(report: Report, quick: bool) -> list[Requirement]:
    """Fill the section and return what was required of it."""
    with warnings.catch_warnings():
        # The singular positions that runs warn of are the subject of this section.
        warnings.simplefilter("ignore", StabilityWarning)
        return _filled(report, quick)


def _filled(report: Report, quick: bool) -> list[Requirement]:
    t_end = 1.0 if quick else 10.0
    steps = (8e-3, 4e-3) if quick else (4e-4, 2e-4, 1e-4)
    rtols = (1e-4,) if quick else (1e-6, 1e-8, 1e-10, 1e-12)
    report.heading("Double four-bar (IFToMM library, A02)")
    report.text(_TEXT)
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
    report.text(_WHY)
    report.heading("Every method", level=3)
    report.text(_METHODS)
    state, state_b = four_bar_minimal(np.array([1.0]))
    exact = np.array([state[0, 0], *state_b[0, 0]])
    problem = Problem("four-bar", double_four_bar(), Integral(custom(speed, "speed")), 1.0, exact)
    step = HHT(8e-3 if quick else 2e-3, newton_tolerance=_TOLERANCE)
    compare_methods(
        report, problem, [step, *controlled((1e-4 if quick else 1e-6,), 4, 4 * _MAX_STEPS)]
    )
    return _verdict(report, runs, steps[-1], slopes)


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
    report.text(
        "Largest absolute error of x, y [m] and their rates [m/s] of point B₀ at the times of the "
        "table. *Bent*: largest departure of coupler B₀B₁ from horizontal, m, which would show "
        "that a run has branched off; *multiplier*: the largest of the run."
    )


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
    report.plot(
        "four-bar",
        [
            Panel(
                "Point B₀",
                "time t [s]",
                "x [m]",
                [
                    Series("six coordinates, HHT", t, q[:, 0]),
                    Series("minimal form", t[1:], exact[:, 0]),
                ],
            ),
            Panel(
                "Distance from a singular position",
                "time t [s]",
                "singular value in m, multiplier in N/m",
                [
                    Series("smallest singular value of Phi_q", t, rank),
                    Series("largest multiplier", t, largest),
                ],
                y_scale="log",
            ),
        ],
        columns=2,
        title=f"Double four-bar, HHT, {setting(each.integrator)}",
        caption="Two of five constraints become dependent twice per turn; multipliers do not "
        "converge there, while positions pass.",
    )


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
    report.text(
        f"Derivatives of x, y and their rates at t = {t_end:g} s by direct differentiation, "
        f"HHT with newton_tolerance = {_TOLERANCE:.0e}, against the variational equations of the "
        "minimal form (largest absolute error):"
    )
    header = ["integrator", "setting", "in L", "in g", "reached [s]", "CPU [s]", "outcome"]
    report.table(header, rows)
    return errors


def _slope_error(solution: Solution | None, exact: Array) -> Array | None:
    if solution is None or solution.sensitivities is None:
        return None
    b = solution.sensitivities
    mine = np.concatenate([b.q_b[-1, :2], b.v_b[-1, :2]])
    error: Array = np.max(np.abs(mine - exact), axis=0)
    return error


def _verdict(
    report: Report, runs: Sequence[_Run], step: float, slopes: Mapping[Integrator, float]
) -> list[Requirement]:
    tolerant = HHT(step, newton_tolerance=_TOLERANCE)
    chosen = next(each for each in runs if each.integrator == tolerant)
    error = float(np.max(chosen.errors)) if chosen.attempt.finished else float("inf")
    slope = slopes.get(chosen.integrator, float("inf"))
    silent = sum(_judged(each).endswith("WRONG") for each in runs)
    report.claim(
        "Double four-bar through its singular positions",
        "table of the IFToMM problem A02, recomputed; 1e-5 at h = 1e-4",
        f"{error:.1e} (HHT, h = {step:g}, newton_tolerance = {_TOLERANCE:.0e})",
        Agreement.AGREES if error <= _LIMIT else Agreement.DISAGREES,
    )
    what = f"four-bar, HHT, h = {step:g}"
    return [
        Requirement(f"{what}: x, y and their rates at the times of the table", _LIMIT, error),
        Requirement(f"{what}: derivatives in L and g", _LIMIT, slope),
        Requirement("four-bar: runs that finish with a wrong motion", 0.0, float(silent)),
    ]


_TEXT = """
Three cranks of L = 1 m on bearings 1 m apart and two couplers of 1 m, five uniform bars of 1 kg,
g = 9.81 m/s²; it starts upright at 1 rad/s. Coordinates are the positions of the three points B_i
(natural coordinates): six, with five constraints for one degree of freedom. Twice per turn all
bars lie in one line: Phi_q has rank 3 there, multipliers are not determined, and motions other
than the parallelogram branch off. The comparison is the *minimal form*
phi'' = (3.5/3) (g/L) sin phi, which is not singular; it reproduces the table to 1e-11.
"""

_WHY = """
Which integrators pass, and why:

- **In the motion itself** the multipliers have a pole: evaluated on the minimal form they grow as
  0.27/s newtons per metre with the smallest singular value s of Phi_q, and change sign at s = 0.
  The forces Phi_q^T lam stay bounded. No method can converge in the multipliers there; the
  question is whether the positions pass.
- **HHT** never evaluates the singular position itself, only instants up to one step away, where s
  is about h/2 times the angular velocity. Round-off of the constraints (1e-16) enters the
  accelerations as 1e-16/(beta h² s): at h = 1e-4 and s = 1.4e-4 measured corrections stop at 2e-4
  of the motion. With its default newton_tolerance HHT takes round-off above 1e-6 of the motion for
  a failure, stops, and says so. That the default passes at a larger step and stops at a smaller
  one is no contradiction: this round-off grows as 1/h³. With newton_tolerance = 1e-5 a correction
  is accepted once its estimated successor is below that; since Newton's method converges
  quadratically until then, positions lose nothing, and every step passes.
- **IDA and IDAS** pass as long as the tolerance allows a step across the position. The tighter it
  is, the closer to the pole they must step, and Newton's method fails there; they shrink the step
  until they give up, and report it. Sensitivities of the multipliers have a pole of higher order,
  so with them they stop at looser tolerances already.
- **DOP853** solves for accelerations, whose equations lose the digits of 1/s²; its error
  estimate sees that noise at the tightest tolerance only and runs into the limit of steps. Down to
  1e-8 it is the cheapest by far, positions and derivatives alike: it takes few, long steps.

A run that stops keeps what it has, and that is right to its tolerance. Whether a variable
step passes depends on where it falls; a fixed step of HHT with newton_tolerance = 1e-5 does
not depend on that. The safe way is a minimal form, or HHT checked against DOP853.
"""

_METHODS = """
Objective: the integral of the horizontal speed of B₀ over 1 s, that is x(1), past the first
singular position (t = 0.71 s). Columns as for the slider-crank; the exact gradient is that of the
minimal form. IDAS stops at the singular position as soon as sensitivities come along, as above;
central differences of IDA and IDAS divide errors of the motion by the perturbation.
"""
