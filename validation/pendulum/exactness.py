"""Whether the derivative is exact, and of which order the motion is."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from ancfdae import HHT, ComplexStep, FiniteDifference, InitialVelocity, differentiate, simulate
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Series
from ancfdae.results import Solution
from ancfdae.sensitivity.method import Method
from validation.drawing import log_log
from validation.pendulum.case import DESIGN, STEP, SYMBOLS, Curves, Extent, relative, scaled
from validation.report import Report
from validation.scenes import pendulum

# Name, Young's modulus, exponent of the first step, end time: long enough for a wave to cross the
# beam a few times, at steps that resolve it.
_ORDER_CASES = (("flexible", 1e7, 15, 2.0**-6), ("rigid-like", 1e9, 18, 2.0**-9))
_UNKNOWNS: dict[str, Callable[[Solution], Array]] = {
    "q": lambda run: run.q,
    "v": lambda run: run.v,
    "lambda": lambda run: run.lam,
}


def against_complex_step(report: Report, direct: Solution, extent: Extent) -> None:
    """Compare direct differentiation with the complex step, and with an identity."""
    report.heading("Is the derivative exact?")
    check = differentiate(pendulum(), extent.t_end, HHT(STEP), design=DESIGN, method=ComplexStep())
    ours, other = direct.sensitivities, check.sensitivities
    assert ours is not None
    assert other is not None
    pairs = {
        "q": (ours.q_b, other.q_b),
        "v": (ours.v_b, other.v_b),
        "lambda": (ours.lam_b, other.lam_b),
    }
    rows = []
    for i, symbol in enumerate(SYMBOLS):
        errors = [relative(x[..., i], y[..., i]) for x, y in pairs.values()]
        report.figures(f"complex_step.{{}}.{symbol}", pairs, errors)
        rows.append([symbol, *errors])
    report.say("complex-step")
    report.table(["variable", *pairs], rows)
    E, rho = ours.values[2], ours.values[1]
    stress = E * ours.q_b[..., 2]
    motion = np.max(np.abs(stress + rho * ours.q_b[..., 1])) / np.max(np.abs(stress))
    first = report.figure("identity.q", float(motion))
    force = E * ours.lam_b[..., 2] + rho * ours.lam_b[..., 1] - direct.lam
    second = report.figure(
        "identity.lambda", float(np.max(np.abs(force)) / np.max(np.abs(direct.lam)))
    )
    report.say("identity", first=first, second=second)


def order(report: Report, extent: Extent) -> None:
    """Add the observed orders of HHT-I3."""
    report.heading("Observed order of HHT-I3")
    rows = []
    for name, modulus, first, t_end in _ORDER_CASES:
        for spin in (0.0, 3.0):
            start = (InitialVelocity("pendulum", spin, (0.0, 0.0)),) if spin else ()
            scene = pendulum(youngs_modulus=modulus, start=start)
            exponents = range(first, first + (4 if extent.repeats > 1 else 3))
            runs = [simulate(scene, t_end, HHT(2.0**-k)) for k in exponents]
            orders = [_observed_order([read(run) for run in runs]) for read in _UNKNOWNS.values()]
            kind = "moving" if spin else "rest"
            report.figures(f"order.{name}.{kind}.{{}}", _UNKNOWNS, orders)
            rows.append([f"{name}, E = {modulus:.0e}", kind, *orders])
    report.say("order")
    report.table(["pendulum", "start", *_UNKNOWNS], rows)


def _observed_order(values: Sequence[Array]) -> float:
    """Order between the last two halvings."""
    changes = [np.max(np.abs(coarse - fine[::2])) for coarse, fine in itertools.pairwise(values)]
    return float(np.log2(changes[-2] / changes[-1]))


def valley(report: Report, direct: Curves, extent: Extent) -> None:
    """Add the errors of finite differences over their perturbation."""
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
    for i, symbol in enumerate(SYMBOLS):
        series = [
            Series(f"{kind} difference", extent.perturbations, table[:, i], marker=True)
            for kind, table in errors.items()
        ]
        panels.append(
            log_log(
                f"Error in the sensitivity to {symbol}",
                "relative perturbation [-]",
                "relative error [-]",
                series,
            )
        )
        row: list[object] = [symbol]
        for kind, table in errors.items():
            k = int(np.argmin(table[:, i]))
            report.figure(f"valley.{kind}.{symbol}.error", table[k, i])
            report.figure(f"valley.{kind}.{symbol}.perturbation", extent.perturbations[k])
            row += [extent.perturbations[k], table[k, i]]
        best.append(row)
    report.plot("valley", panels, 3)
    report.table(["variable", "best forward", "error", "best central", "error "], best)


def _difference_errors(method: Method, direct: Curves, extent: Extent) -> list[float]:
    check = scaled(differentiate(pendulum(), extent.t_end, HHT(STEP), design=DESIGN, method=method))
    return [relative(check.y_b[:, i], direct.y_b[:, i]) for i in range(3)]
