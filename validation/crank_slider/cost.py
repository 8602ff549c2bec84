"""Processor time of all methods."""

import itertools
from collections.abc import Callable

import numpy as np

from ancfdae import (
    HHT,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    FiniteDifference,
    assemble,
    gradient,
    simulate,
)
from ancfdae.numerics.timing import timed
from ancfdae.sensitivity.method import GradientMethod
from validation.crank_slider.case import DESIGN, STEP, Extent, paper_objective
from validation.report import Report
from validation.scenes import crank_slider

_PAPER_SECONDS = {"finite difference": 2922.2, "direct": 700.3, "adjoint": 794.5}


def cost(report: Report, extent: Extent) -> None:
    """Time all methods in turn."""
    report.heading("CPU time (paper, section 4.2)")
    plain, full = assemble(crank_slider()), assemble(crank_slider(), DESIGN)
    integrator, objective, t_end = HHT(STEP), paper_objective(), extent.t_end

    def by(method: GradientMethod) -> Callable[[], object]:
        return lambda: gradient(full, objective, t_end, integrator, method=method)

    tasks: dict[str, Callable[[], object]] = {
        "dynamics alone": lambda: simulate(plain, t_end, integrator),
        "direct": by(DirectDifferentiation()),
        "adjoint": by(Adjoint()),
        "continuous adjoint": by(ContinuousAdjoint()),
        "complex step": by(ComplexStep()),
        "finite difference": by(FiniteDifference(0.01)),
    }
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for _, (name, task) in itertools.product(range(extent.repeats), tasks.items()):
        seconds[name].append(timed(task)[0])
    rows: list[list[object]] = []
    for name, values in seconds.items():
        ratio = float(np.median(np.divide(values, seconds["dynamics alone"])))
        key = name.replace(" ", "_")
        report.figure(f"cost.{key}.seconds", float(np.median(values)))
        report.figure(f"cost.{key}.ratio", ratio)
        rows.append([name, float(np.median(values)), ratio, _PAPER_SECONDS.get(name, "-")])
    report.table(["method", "median [s]", "ratio to dynamics alone", "paper [s]"], rows)
    steps = t_end / STEP
    per_step = report.figure(
        "cost.microseconds_per_step", 1e6 * float(np.median(seconds["dynamics alone"])) / steps
    )
    report.say("cost", t_end=t_end, extent=extent, per_step=per_step)
    direct, adjoint = (float(np.median(seconds[name])) for name in ("direct", "adjoint"))
    finite = float(np.median(seconds["finite difference"]))
    report.judge(
        "cost", finite > 2 * max(direct, adjoint), adjoint=adjoint / direct, finite=finite / direct
    )
