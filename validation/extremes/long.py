"""Runs of 100 s: energy and constraints of the pendulum, with numerical damping and without."""

import warnings
from dataclasses import dataclass

import numpy as np

from ancfdae import HHT, assemble, simulate
from ancfdae.errors import StabilityWarning
from ancfdae.numerics.arrays import Array
from ancfdae.plotting import Panel, Series
from ancfdae.results import Solution
from validation.external.rods import cartesian_pendulum
from validation.report import Report
from validation.scenes import pendulum

_ALPHAS = (-0.3, -0.05, 0.0)
_PART = 2.0  # s, of a run of 100 s; one point of a curve


@dataclass(frozen=True)
class Long:
    """A run and its balance.

    `energy` is the change of the total energy relative to the energy that a fall to the lowest
    point sets free; `drift` is the largest violation of the constraints in lengths of the
    pendulum.
    """

    label: str
    alpha: float
    run: Solution
    energy: Array
    drift: float
    warning: str

    @property
    def key(self) -> str:
        """Name of its figures."""
        return f"long.{self.label.replace(' ', '_')}.alpha{self.alpha:g}"

    def multipliers(self) -> Array:
        """Return the size of the multipliers at every instant."""
        return np.linalg.norm(self.run.lam, axis=1)

    @property
    def size(self) -> float:
        """Largest change of the energy."""
        return float(np.max(np.abs(self.energy)))


def long_runs(report: Report, quick: bool) -> list[Long]:
    """Add the section; return what was found."""
    t_end = 1.0 if quick else 100.0
    report.say("long", t_end=t_end)
    runs = [_flexible(E, alpha, t_end) for E in (1e7, 1e9) for alpha in _ALPHAS]
    runs += [_rigid(alpha, t_end) for alpha in _ALPHAS]
    report.table(
        ["pendulum", "hht_alpha", "outcome", "energy", "constraints", "multipliers", "iterations"],
        [_row(report, long) for long in runs],
    )
    report.say(
        "long.warnings",
        warnings=" ".join(sorted({f"*{long.warning}*" for long in runs if long.warning})),
    )
    _plot(report, runs)
    return runs


def _flexible(modulus: float, alpha: float, t_end: float) -> Long:
    system = assemble(pendulum(youngs_modulus=modulus))
    integrator, warning = _integrator(2.0**-7, alpha)
    run = simulate(system, t_end, integrator)
    total = system.energies.total(run.q, run.v)
    fall = 4000 * 0.05**2 * 1.2 * 9.81 * 0.6
    drift = max(
        float(np.max(np.abs(system.constraint(t, q)))) for q, t in zip(run.q, run.t, strict=True)
    )
    label = f"E = {modulus:.0e}".replace("+0", "")
    return Long(label, alpha, run, (total - total[0]) / fall, drift / 1.2, warning)


def _rigid(alpha: float, t_end: float) -> Long:
    integrator, warning = _integrator(0.01, alpha)
    run = simulate(cartesian_pendulum(), t_end, integrator)
    total = 0.5 * np.sum(run.v**2, axis=1) + 9.81 * run.q[:, 1]
    drift = float(np.max(np.abs(np.linalg.norm(run.q, axis=1) - 1.0)))
    return Long("rigid", alpha, run, (total - total[0]) / 9.81, drift, warning)


def _integrator(step: float, alpha: float) -> tuple[HHT, str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StabilityWarning)
        integrator = HHT(step, hht_alpha=alpha)
    return integrator, "; ".join(str(w.message) for w in caught)


def _row(report: Report, long: Long) -> list[object]:
    size = long.multipliers()
    tenth = max(1, len(size) // 10)
    growth = float(np.max(size[-tenth:]) / np.max(size[:tenth]))
    name = long.key.replace("=_", "")
    report.figure(f"{name}.energy", long.size)
    report.figure(f"{name}.constraints", long.drift)
    report.figure(f"{name}.multipliers", growth)
    statistics = long.run.statistics
    return [
        long.label,
        f"{long.alpha:g}",
        str(long.run.outcome),
        f"{long.size:.1e}",
        f"{long.drift:.0e}",
        f"{growth:.2g}",
        f"{statistics.iterations / max(statistics.steps, 1):.1f}",
    ]


def _plot(report: Report, runs: list[Long]) -> None:
    labels = list(dict.fromkeys(long.label for long in runs))
    panels = []
    for label in labels:
        series = []
        for long in (x for x in runs if x.label == label):
            t, energy = _thinned(long)
            series.append(Series(f"hht_alpha = {long.alpha:g}", t, np.maximum(energy, 1e-9)))
        panels.append(
            Panel(
                label if label == "rigid" else f"{label} Pa",
                "time t [s]",
                "change of energy [-]",
                series,
                y_scale="log",
            )
        )
    report.plot("long", panels, 3)


def _thinned(long: Long) -> tuple[Array, Array]:
    """Return the largest change in each part of the run."""
    t = long.run.t
    edges = np.unique(np.searchsorted(t, np.arange(0.0, t[-1], _PART if t[-1] > _PART else 0.1)))
    return t[edges], np.maximum.reduceat(np.abs(long.energy), edges)
