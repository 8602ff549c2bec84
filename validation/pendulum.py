"""Report on the paper's flexible pendulum (section 4.1, Figs. 4 to 6), and beyond it."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ancfdae import (
    HHT,
    ComplexStep,
    FiniteDifference,
    RigidMotion,
    Solution,
    assemble,
    differentiate,
    simulate,
)
from ancfdae.plotting import Panel, Series
from ancfdae.sensitivity import Method
from validation.report import Agreement, Report
from validation.scenes import pendulum, pendulum_deflection

__all__ = ["run"]

Array = npt.NDArray[np.float64]

_HEIGHT, _DENSITY, _MODULUS = "pendulum.height", "pendulum.density", "pendulum.youngs_modulus"
_DESIGN = (_HEIGHT, _DENSITY, _MODULUS)
_SYMBOLS = ("h", "rho", "E")
_STEP = 2.0**-7

# At t = 1 s, E = 1e7: deflection and its derivatives E d/dE, h d/dh of the equations of motion
# themselves, by IDA (stabilised index-2 form, several tolerances) with an independent
# plain-quadrature code; project design notes, section 3.
_CONTINUOUS = {"deflection": -0.5794907, "E": 0.3337, "h": 0.7634}


# Name, Young's modulus, exponent of the first step, end time: long enough for a wave to cross the
# beam a few times, at steps that resolve it.
_ORDER_CASES = (("flexible", 1e7, 15, 2.0**-6), ("rigid-like", 1e9, 18, 2.0**-9))
_UNKNOWNS: dict[str, Callable[[Solution], Array]] = {
    "q": lambda run: run.q,
    "v": lambda run: run.v,
    "lambda": lambda run: run.lam,
}


@dataclass(frozen=True)
class _Extent:
    """How much of the report is run."""

    t_end: float
    halvings: int
    perturbations: Sequence[float]
    repeats: int


_FULL = _Extent(4.0, 4, [10.0**-k for k in range(1, 14)], 7)
_QUICK = _Extent(0.5, 1, [1e-2, 1e-5, 1e-8, 1e-11], 1)


def run(report: Report, quick: bool) -> None:
    """Fill the report."""
    extent = _QUICK if quick else _FULL
    report.heading("Method")
    report.text(_METHOD)
    soft = _scaled(
        differentiate(pendulum(youngs_modulus=5e6), extent.t_end, HHT(_STEP), design=_DESIGN)
    )
    hard_run = differentiate(pendulum(), extent.t_end, HHT(_STEP), design=_DESIGN)
    hard = _scaled(hard_run)
    _effect_of_modulus(report, hard, soft)
    _against_finite_differences(report, hard, extent)
    _planar_and_spatial(report, hard, extent)
    _exactness(report, hard_run, extent)
    _order(report, extent)
    _step_halving(report, hard, extent)
    _valley(report, hard, extent)
    _cost(report, extent)
    report.heading("Limits")
    report.text(_LIMITS)


@dataclass(frozen=True)
class _Curves:
    """Deflection over time and its derivatives times the value of the variable; m."""

    t: Array
    y: Array
    y_b: Array


def _scaled(solution: Solution) -> _Curves:
    sensitivities = solution.sensitivities
    assert sensitivities is not None
    y_b = solution.derivative(pendulum_deflection) * sensitivities.values
    return _Curves(solution.t, pendulum_deflection(solution).real, y_b)


def _relative(x: Array, reference: Array) -> float:
    """Norm over time of a difference, relative to the norm of the reference."""
    return float(np.linalg.norm(x - reference) / np.linalg.norm(reference))


def _effect_of_modulus(report: Report, hard: _Curves, soft: _Curves) -> None:
    report.heading("Effect of Young's modulus (paper, Fig. 4)")
    report.plot(
        "deflection",
        [
            Panel(
                "Deflection of the free end",
                "time t [s]",
                "deflection [m]",
                [Series("E = 1e7 N/m²", hard.t, hard.y), Series("E = 5e6 N/m²", soft.t, soft.y)],
            ),
            Panel(
                "Its sensitivity to Young's modulus",
                "time t [s]",
                "E · d(deflection)/dE [m]",
                [
                    Series("E = 1e7 N/m²", hard.t, hard.y_b[:, 2]),
                    Series("E = 5e6 N/m²", soft.t, soft.y_b[:, 2]),
                ],
            ),
        ],
        columns=2,
        title="Flexible pendulum, planar, HHT-I3 at the paper's step 2⁻⁷ s",
        caption="Deflection of the free end across the tangent at the pin, and what one per cent "
        "of Young's modulus changes, times 100.",
    )
    figures = {
        "largest deflection [m]": [float(np.max(np.abs(c.y))) for c in (hard, soft)],
        "rms of d/dE [m³/N]": [
            float(np.sqrt(np.mean((c.y_b[:, 2] / E) ** 2))) for c, E in ((hard, 1e7), (soft, 5e6))
        ],
    }
    for key, name in zip(figures, ("deflection_max", "dE_rms"), strict=True):
        for value, modulus in zip(figures[key], ("1e7", "5e6"), strict=True):
            report.figure(f"fig4.{name}.E{modulus}", value)
    report.table(["", "E = 1e7", "E = 5e6"], [[name, *values] for name, values in figures.items()])
    smaller = all(first < second for first, second in figures.values())
    report.claim(
        "The stiffer pendulum deflects less and is less sensitive to E",
        "yes (text to Fig. 4)",
        "; ".join(f"{name}: {a:.3g} against {b:.3g}" for name, (a, b) in figures.items()),
        Agreement.AGREES if smaller else Agreement.DISAGREES,
    )


def _against_finite_differences(report: Report, hard: _Curves, extent: _Extent) -> None:
    report.heading("Direct differentiation against 1 % finite differences (paper, Fig. 5)")
    check = _scaled(
        differentiate(
            pendulum(), extent.t_end, HHT(_STEP), design=_DESIGN, method=FiniteDifference(0.01)
        )
    )
    differences = [_relative(check.y_b[:, i], hard.y_b[:, i]) for i in range(3)]
    for symbol, value in zip(_SYMBOLS, differences, strict=True):
        report.figure(f"fig5.difference.{symbol}", value)
    report.plot(
        "finite-differences",
        [
            Panel(
                f"Sensitivity to {symbol}",
                "time t [s]",
                f"{symbol} · d(deflection)/d{symbol} [m]",
                [
                    Series("direct differentiation", hard.t, hard.y_b[:, i]),
                    Series("forward difference, 1 %", check.t, check.y_b[:, i]),
                ],
            )
            for i, symbol in enumerate(_SYMBOLS)
        ],
        columns=3,
        title="Sensitivities directly and by finite differences, E = 1e7 N/m², step 2⁻⁷ s",
        caption="The same discrete motion differentiated in two ways.",
    )
    report.claim(
        "Direct differentiation is comparable with 1 % finite differences",
        "comparable curves (Fig. 5)",
        "relative difference (norm over time) "
        + ", ".join(f"{s}: {d:.2g}" for s, d in zip(_SYMBOLS, differences, strict=True)),
        # "Comparable" curves: the eye sees a difference of a fifth of the amplitude.
        Agreement.AGREES if max(differences) < 0.2 else Agreement.PARTLY,
    )
    report.text(
        "Both curves differentiate the same discrete motion, so their agreement says nothing "
        "about the time step: see below."
    )


def _planar_and_spatial(report: Report, planar: _Curves, extent: _Extent) -> None:
    report.heading("Planar against spatial element (paper, Fig. 6)")
    spatial = _scaled(differentiate(pendulum(3), extent.t_end, HHT(_STEP), design=_DESIGN))
    differences = [_relative(spatial.y_b[:, i], planar.y_b[:, i]) for i in range(3)]
    motion = report.figure("fig6.difference.deflection", _relative(spatial.y, planar.y))
    for symbol, value in zip(_SYMBOLS, differences, strict=True):
        report.figure(f"fig6.difference.{symbol}", value)
    report.plot(
        "planar-spatial",
        [
            Panel(
                f"Sensitivity to {symbol}",
                "time t [s]",
                f"{symbol} · d(deflection)/d{symbol} [m]",
                [
                    Series("planar, 12 coordinates", planar.t, planar.y_b[:, i]),
                    Series("spatial, 24 coordinates", spatial.t, spatial.y_b[:, i]),
                ],
            )
            for i, symbol in enumerate(_SYMBOLS)
        ],
        columns=3,
        title="Sensitivities of the planar and the spatial model, E = 1e7 N/m², step 2⁻⁷ s",
        caption="Sensitivities of the deflection by both elements.",
    )
    report.claim(
        "Spatial sensitivities coincide with planar ones",
        "coincide well (Fig. 6)",
        f"relative difference: deflection {motion:.2g}, "
        + ", ".join(f"{s}: {d:.2g}" for s, d in zip(_SYMBOLS, differences, strict=True)),
        Agreement.AGREES if max(differences) < 0.2 else Agreement.PARTLY,
    )
    report.text(
        "They coincide because both elements lock in the same way: with the full St. "
        "Venant-Kirchhoff law at nu = 0.3 either bends (1 - nu)/((1 + nu)(1 - 2 nu)) = 1.346 "
        "times too stiffly. The agreement is not one with beam theory."
    )


def _exactness(report: Report, direct: Solution, extent: _Extent) -> None:
    report.heading("Is the derivative exact?")
    check = differentiate(
        pendulum(), extent.t_end, HHT(_STEP), design=_DESIGN, method=ComplexStep()
    )
    ours, other = direct.sensitivities, check.sensitivities
    assert ours is not None
    assert other is not None
    pairs = {
        "q": (ours.q_b, other.q_b),
        "v": (ours.v_b, other.v_b),
        "lambda": (ours.lam_b, other.lam_b),
    }
    rows = []
    for i, symbol in enumerate(_SYMBOLS):
        errors = [_relative(x[..., i], y[..., i]) for x, y in pairs.values()]
        for name, error in zip(pairs, errors, strict=True):
            report.figure(f"complex_step.{name}.{symbol}", error)
        rows.append([symbol, *errors])
    report.text(
        "Direct differentiation against the complex step of the whole run (relative difference, "
        "norm over time). Both differentiate the discrete equations; the complex step shares "
        "none of the derivative code."
    )
    report.table(["variable", *pairs], rows)
    E, rho = ours.values[2], ours.values[1]
    stress = E * ours.q_b[..., 2]
    motion = np.max(np.abs(stress + rho * ours.q_b[..., 1])) / np.max(np.abs(stress))
    first = report.figure("identity.q", float(motion))
    force = E * ours.lam_b[..., 2] + rho * ours.lam_b[..., 1] - direct.lam
    second = report.figure(
        "identity.lambda", float(np.max(np.abs(force)) / np.max(np.abs(direct.lam)))
    )
    report.text(
        "Scaling E and rho together leaves a motion under gravity alone unchanged and scales "
        "the reactions, exactly so in the discrete scheme: E q_E + rho q_rho = 0 holds to "
        f"{first:.1g}, E lambda_E + rho lambda_rho = lambda to {second:.1g} (largest entry, "
        "relative)."
    )


def _order(report: Report, extent: _Extent) -> None:
    report.heading("Observed order of HHT-I3")
    rows = []
    for name, modulus, first, t_end in _ORDER_CASES:
        for spin in (0.0, 3.0):
            start = (RigidMotion("pendulum", spin, (0.0, 0.0)),) if spin else ()
            scene = pendulum(youngs_modulus=modulus, start=start)
            exponents = range(first, first + (4 if extent.repeats > 1 else 3))
            runs = [simulate(scene, t_end, HHT(2.0**-k)) for k in exponents]
            orders = [_observed_order([read(run) for run in runs]) for read in _UNKNOWNS.values()]
            kind = "moving" if spin else "rest"
            for unknown, order in zip(_UNKNOWNS, orders, strict=True):
                report.figure(f"order.{name}.{kind}.{unknown}", order)
            rows.append([f"{name}, E = {modulus:.0e}", kind, *orders])
    report.text(
        "From successive halvings in the maximum norm over all instants, the first steps "
        "included, at steps that resolve the fastest wave of the section. *moving*: starts with "
        "a rigid rotation of 3 rad/s."
    )
    report.table(["pendulum", "start", *_UNKNOWNS], rows)


def _observed_order(values: Sequence[Array]) -> float:
    """Order between the last two halvings."""
    changes = [np.max(np.abs(coarse - fine[::2])) for coarse, fine in itertools.pairwise(values)]
    return float(np.log2(changes[-2] / changes[-1]))


def _step_halving(report: Report, coarse: _Curves, extent: _Extent) -> None:
    report.heading("What the paper does not show: the time step")
    runs = {_STEP: coarse}
    for k in range(extent.halvings):
        step = _STEP / 2 ** (k + 1)
        runs[step] = _scaled(differentiate(pendulum(), extent.t_end, HHT(step), design=_DESIGN))
    steps = list(runs)
    _table_at_one_second(report, runs)
    changes = np.array([_changes(runs[a], runs[b]) for a, b in itertools.pairwise(steps)])
    names = ("deflection", *(f"{symbol}-sensitivity" for symbol in _SYMBOLS))
    for row_changes, step in zip(changes, steps[:-1], strict=True):
        for name, value in zip(names, row_changes, strict=True):
            report.figure(f"halving.2{int(np.log2(step))}.{name}", value)
    _plot_halving(report, runs, changes, names)
    last = changes[-1]
    report.text(
        f"From step {steps[-2]:.3g} s to {steps[-1]:.3g} s the deflection still changes by "
        f"{last[0]:.1g}, its sensitivities by "
        + ", ".join(f"{last[i + 1]:.1g} ({s})" for i, s in enumerate(_SYMBOLS))
        + " (relative, norm over time). Gravity sets in suddenly and excites axial and thickness "
        "waves that no such step resolves; a wave of amplitude A and frequency omega contributes "
        "A omega t/2 to a sensitivity, so waves too small to be seen in the motion dominate it."
    )
    report.claim(
        "The curves of Figs. 4 to 6 are the sensitivities of the pendulum",
        "implied; one step (2^-7 s) is shown",
        f"one halving of that step changes the E-sensitivity by {changes[0][3]:.2g} of its norm",
        Agreement.DISAGREES if changes[0][3] > 0.2 else Agreement.PARTLY,
    )


def _table_at_one_second(report: Report, runs: dict[float, _Curves]) -> None:
    """Add a table of values at t = 1 s, a row a step."""
    rows: list[list[object]] = []
    for step, curves in runs.items():
        name = f"2^{int(np.log2(step))}"
        row: list[object] = [name]
        at = _at_one_second(curves, step)
        if at is not None:
            report.figure(f"step.{name.replace('^', '')}.deflection_1s", at[0])
            report.figure(f"step.{name.replace('^', '')}.h_1s", at[1])
            report.figure(f"step.{name.replace('^', '')}.E_1s", at[2])
            row += list(at)
        else:
            row += ["-"] * 3
        rows.append(row)
    rows.append(["continuous", *(_CONTINUOUS[k] for k in ("deflection", "h", "E"))])
    report.text(
        "Values at t = 1 s. The last row solves the equations of motion themselves (IDA on an "
        "index-reduced form, an independent code)."
    )
    report.table(["step [s]", "deflection [m]", "h · d/dh [m]", "E · d/dE [m]"], rows)


def _plot_halving(
    report: Report, runs: dict[float, _Curves], changes: Array, names: Sequence[str]
) -> None:
    """Plot the curves of the first and last step, and the changes by halving."""
    steps = list(runs)
    report.plot(
        "step-halving",
        [
            Panel(
                "Sensitivity to E over time",
                "time t [s]",
                "E · d(deflection)/dE [m]",
                [
                    Series(f"step 2^{int(np.log2(step))} s", runs[step].t, runs[step].y_b[:, 2])
                    for step in (steps[0], steps[-1])
                ],
            ),
            Panel(
                "Change when the step is halved",
                "step [s]",
                "relative change, norm over time [-]",
                [
                    Series(name, steps[:-1], changes[:, i], marker=True)
                    for i, name in enumerate(names)
                ],
                x_scale="log",
                y_scale="log",
            ),
        ],
        columns=2,
        title="Planar pendulum, E = 1e7 N/m²: what halving the step changes",
        caption="Left: the printed step against the smallest one. Right: relative change of the "
        "whole curve from one step to half of it.",
    )


def _at_one_second(curves: _Curves, step: float) -> tuple[float, float, float] | None:
    row = round(1.0 / step)
    if row >= len(curves.t):
        return None
    return float(curves.y[row]), float(curves.y_b[row, 0]), float(curves.y_b[row, 2])


def _changes(coarse: _Curves, fine: _Curves) -> list[float]:
    """Relative change of the deflection and of its three sensitivities, on the coarse grid."""
    stride = (len(fine.t) - 1) // (len(coarse.t) - 1)
    changes = [_relative(coarse.y, fine.y[::stride])]
    changes += [_relative(coarse.y_b[:, i], fine.y_b[::stride, i]) for i in range(3)]
    return changes


def _valley(report: Report, direct: _Curves, extent: _Extent) -> None:
    report.heading("Where finite differences stop being useful")
    variants: dict[str, Callable[[float], Method]] = {
        "forward": lambda size: FiniteDifference(size),
        "central": lambda size: FiniteDifference(size, central=True),
    }
    panels, best = [], []
    errors = {
        kind: np.array([_difference_errors(make(s), direct, extent) for s in extent.perturbations])
        for kind, make in variants.items()
    }
    for i, symbol in enumerate(_SYMBOLS):
        series = [
            Series(f"{kind} difference", extent.perturbations, table[:, i], marker=True)
            for kind, table in errors.items()
        ]
        panels.append(
            Panel(
                f"Error in the sensitivity to {symbol}",
                "relative perturbation [-]",
                "relative error [-]",
                series,
                x_scale="log",
                y_scale="log",
            )
        )
        row: list[object] = [symbol]
        for kind, table in errors.items():
            k = int(np.argmin(table[:, i]))
            report.figure(f"valley.{kind}.{symbol}.error", table[k, i])
            report.figure(f"valley.{kind}.{symbol}.perturbation", extent.perturbations[k])
            row += [extent.perturbations[k], table[k, i]]
        best.append(row)
    report.plot(
        "valley",
        panels,
        columns=3,
        title="Finite differences against the exact derivative of the same discrete run",
        caption="To the right truncation, to the left round-off.",
    )
    report.table(
        ["variable", "best forward", "error", "best central", "error "],
        best,
    )


def _difference_errors(method: Method, direct: _Curves, extent: _Extent) -> list[float]:
    check = _scaled(
        differentiate(pendulum(), extent.t_end, HHT(_STEP), design=_DESIGN, method=method)
    )
    return [_relative(check.y_b[:, i], direct.y_b[:, i]) for i in range(3)]


def _cost(report: Report, extent: _Extent) -> None:
    report.heading("Cost")
    rows = []
    for dimension, name in ((2, "planar"), (3, "spatial")):
        plain, full = assemble(pendulum(dimension)), assemble(pendulum(dimension), _DESIGN)
        alone, along = [], []
        for _ in range(extent.repeats):
            alone.append(_microseconds(simulate(plain, extent.t_end, HHT(_STEP))))
            along.append(_microseconds(differentiate(full, extent.t_end, HHT(_STEP))))
        base = report.figure(f"cost.{name}.microseconds_per_step", float(np.median(alone)))
        ratio = float(np.median(np.divide(along, alone)))
        report.figure(f"cost.{name}.ratio_three_variables", ratio)
        rows.append([name, plain.n_q, base, float(np.median(along)), ratio])
    report.text(
        "Wall time per step, medians of alternating runs in this process. Set "
        "`OPENBLAS_NUM_THREADS=1` to repeat it."
    )
    report.table(
        ["element", "coordinates", "dynamics [µs]", "with three variables [µs]", "ratio"], rows
    )


def _microseconds(solution: Solution) -> float:
    return 1e6 * solution.statistics.wall_seconds / solution.statistics.steps


_METHOD = """
Straight beam, L = 1.2 m, h = w = 0.05 m, rho = 4000 kg/m³, nu = 0.3, five elements, pinned at its
left end, horizontal and at rest at t = 0, then free under 9.81 m/s². HHT-I3 at the paper's step
2⁻⁷ s with hht_alpha = -0.3 (the paper does not say which value it uses) and exact Jacobian.
*Deflection* is the y component of the free end in the frame that sits at the pin with its x axis
along the tangent there. Sensitivities come by direct differentiation and are shown as
b · d(deflection)/db, in metres: a hundred times what one per cent of b changes.
The paper's figures are curves without printed values; *agrees* below refers to what its text says
of them.
"""

_LIMITS = """
- Five elements are a demonstration, not a converged mesh, and both elements show Poisson locking.
- Undamped material: unresolved waves never die out physically; only HHT-I3 damps them.
- Curves are compared as wholes (norm over time); single instants can differ by more.
"""
