"""The floor of round-off as the step goes to zero."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from ancfdae import DOP853, HHT, differentiate, simulate
from ancfdae.equations import reaction
from ancfdae.extend import MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Series
from validation.drawing import log_log
from validation.external.rods import cartesian_pendulum
from validation.extremes.scenes import SI, Crank, Rod
from validation.report import Report

_ALPHAS = (-0.05, -0.3)
# Start of the rigid pendulum: neither along an axis nor at rest.
_ANGLE, _SPIN = -2.6, 2.0
_QUANTITIES = ("q_b", "v_b", "a_b", "lam_b")
_PHI_NOISE = float(np.finfo(float).eps)


@dataclass(frozen=True)
class _Errors:
    """Largest relative errors of one run; NaN where it did not finish."""

    a: float
    lam: float


def round_off(report: Report, quick: bool) -> float:
    """Add the section; return the largest error at 1e-6 s."""
    steps = 40 if quick else 1000
    exponents = (3, 6) if quick else (2, 3, 4, 5, 6, 7, 8)
    report.say("floor")
    makers: tuple[tuple[str, str, Callable[[float, float, int], _Errors]], ...] = (
        ("rigid", "rigid Cartesian pendulum", _rigid),
        ("pendulum", "flexible pendulum, E = 2e11 Pa", _pendulum),
        ("stiff", "crank-slider, E = 2e11 Pa", _stiff),
    )
    panels, rows, at_aim = [], [], 0.0
    h = 10.0 ** -np.array(exponents, dtype=float)
    for key, title, make in makers:
        series = []
        for alpha in _ALPHAS:
            errors = [make(float(x), alpha, steps) for x in h]
            for name in ("a", "lam"):
                values = np.array([getattr(e, name) for e in errors])
                report.figures(f"floor.{key}.alpha{alpha:g}.{name}.1e-{{}}", exponents, values)
                at_aim = max(at_aim, float(values[list(exponents).index(6)]))
                symbol = "accelerations" if name == "a" else "multipliers"
                label = f"{symbol}, hht_alpha = {alpha:g}"
                series.append(Series(label, h, np.maximum(values, 1e-17), marker=True))
                rows.append([title, label, *(f"{value:.0e}" for value in values)])
        beta = (1 + 0.3) ** 2 / 4
        old = _PHI_NOISE / (beta * h**2) / 9.81
        series.append(Series(r"$\varepsilon L/(\beta h^2 g)$", h, old))
        panels.append(log_log(title, "step [s]", "relative error [-]", series))
    report.table(["system", "quantity", *(f"1e-{k} s" for k in exponents)], rows)
    report.plot("floor", panels, 3, steps=steps, flexible=min(steps, 200))
    _add_derivatives(report, exponents, steps)
    return report.figure("floor.worst_at_1e-6", at_aim)


def _add_derivatives(report: Report, exponents: Sequence[int], steps: int) -> None:
    """Add the errors of the derivatives of the rigid pendulum at the end, per step."""
    report.say("floor.derivatives")
    rows: list[list[object]] = []
    for alpha in _ALPHAS:
        by_step = [_derivatives(10.0**-k, alpha, steps) for k in exponents]
        for name in _QUANTITIES:
            values = [errors[name] for errors in by_step]
            report.figures(f"floor.derivatives.alpha{alpha:g}.{name}.1e-{{}}", exponents, values)
            rows.append([f"{name}, hht_alpha = {alpha:g}", *(f"{value:.0e}" for value in values)])
    report.table(["derivative", *(f"1e-{k} s" for k in exponents)], rows)


def _derivatives(h: float, alpha: float, steps: int) -> dict[str, float]:
    """Errors of the derivatives in L and g against an integrator of high order."""
    system = cartesian_pendulum(angle=_ANGLE, spin=_SPIN)
    runs = [
        differentiate(system, h * steps, integrator).sensitivities
        for integrator in (HHT(h, hht_alpha=alpha), DOP853(1e-12))
    ]
    return {name: _largest(*(getattr(run, name)[-1] for run in runs)) for name in _QUANTITIES}


def _rigid(h: float, alpha: float, steps: int) -> _Errors:
    """Errors of the Cartesian pendulum against its angle, from an integrator of high order."""
    system = cartesian_pendulum(angle=_ANGLE, spin=_SPIN)
    run = simulate(system, h * steps, HHT(h, hht_alpha=alpha))
    if not run.outcome.success:
        return _Errors(np.nan, np.nan)
    g = 9.81

    def rate(t: float, y: Sequence[float]) -> list[float]:
        return [y[1], -g * np.cos(y[0])]

    exact = solve_ivp(
        rate, (0, run.t[-1]), [_ANGLE, _SPIN], "DOP853", t_eval=run.t, rtol=3e-14, atol=1e-15
    ).y
    e, e_t = np.array([np.cos(exact[0]), np.sin(exact[0])]), [-np.sin(exact[0]), np.cos(exact[0])]
    a = (-g * np.cos(exact[0]) * np.array(e_t) - exact[1] ** 2 * e).T
    # The rod's force, whatever the scale of its constraint. The two errors are relative to gravity.
    force = np.array([reaction(system, 0.0, q, x) for q, x in zip(run.q, run.lam, strict=True)])
    pull = ((exact[1] ** 2 - g * np.sin(exact[0])) * e).T
    return _Errors(*(float(np.max(np.abs(x))) / g for x in (run.a - a, force - pull)))


def _pendulum(h: float, alpha: float, steps: int) -> _Errors:
    """Difference of the paper's pendulum, rigid-like, to the same one in natural units."""
    count, rod = min(steps, 200), Rod(modulus=2e11)
    parts = []
    for units in (SI, rod.natural()):
        step = h * units.time
        run = simulate(rod.scene(units), step * count, HHT(step, hht_alpha=alpha))
        if not run.outcome.success:
            return _Errors(np.nan, np.nan)
        a = run.acceleration(MaterialPoint("rod", 1.0)) * units.time**2 / units.length
        parts.append((a, run.lam / units.force))
    return _Errors(*(_largest(x, y) for x, y in zip(*parts, strict=True)))


def _stiff(h: float, alpha: float, steps: int) -> _Errors:
    """Difference of a crank-slider to the same one turned; all of it is round-off."""
    count = min(steps, 200)
    crank, turned = Crank(angle=0.5, modulus=2e11), Crank(angle=0.5, modulus=2e11, turned=1.0)
    runs = [simulate(x.scene(), h * count, HHT(h, hht_alpha=alpha)) for x in (crank, turned)]
    if not all(run.outcome.success for run in runs):
        return _Errors(np.nan, np.nan)
    sizes = [np.linalg.norm(run.reaction("elbow"), axis=1) for run in runs]
    elbow = MaterialPoint("crank", 1.0)
    lengths = [np.linalg.norm(run.acceleration(elbow), axis=1) for run in runs]
    return _Errors(_largest(lengths[1], lengths[0]), _largest(sizes[1], sizes[0]))


def _largest(x: Array, exact: Array) -> float:
    return float(np.max(np.abs(x - exact)) / np.max(np.abs(exact)))
