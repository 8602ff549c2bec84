"""Report on other codes: first that both sides agree, then what each costs."""

import importlib.metadata
import importlib.util
import os
from collections.abc import Callable, Sequence

import numpy as np

from ancfdae import HHT, assemble, simulate
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import medians
from ancfdae.plotting import Panel, Series
from validation.drawing import dots
from validation.peers import designs, gradients, jax_runs, loops, own_systems, rest, trees
from validation.peers.cables import CablePendulum, FlexibleSlider
from validation.peers.exudyn import Exudyn, require_peers
from validation.peers.pair import Pair
from validation.peers.rigid import Chain, RigidSlider
from validation.report import Report

_STEP = 2.0**-10
# End of the runs that are compared, s: chains of many bodies have not become chaotic by then.
_COMPARED = 0.125


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `peers`; add its text, tables and figures."""
    require_peers()
    before = os.getloadavg()
    report.say("method", version=importlib.metadata.version("exudyn"), packages=_packages())
    _motion(report, _pairs(quick), 32 if quick else 512, 1 if quick else 5)
    trees.fill(report, (2,) if quick else (5, 10, 20), 1 if quick else 5)
    nets = [(3, 4), (4, 4)] if quick else [(8, 128), (16, 128), (32, 128), (60, 64)]
    loops.fill(report, nets, (2, 3) if quick else (4, 8, 16, 31), 1 if quick else 3)
    rest.fill(report, (8,) if quick else (8, 64, 256), 1 if quick else 7)
    designs.fill(report, (5,) if quick else (5, 20, 100), 2 if quick else 100, 1 if quick else 5)
    gradients.fill(report, quick)
    own_systems.fill(report, 1 if quick else 3, 1 if quick else 5)
    jax_runs.fill(report, 8 if quick else 512, 1 if quick else 5)
    report.heading("Limits")
    loads = report.figure("load.before", before[0]), report.figure("load.after", os.getloadavg()[0])
    report.say("limits", cores=os.cpu_count(), before=loads[0], after=loads[1])


def _packages() -> str:
    """Return the versions of the other codes."""
    names = ["casadi", "jax", "diffrax", "qdldl"]
    names += ["pypardiso"] * (importlib.util.find_spec("pypardiso") is not None)
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)


def _pairs(quick: bool) -> list[Pair]:
    if quick:
        return [Chain(1, revolute=False), RigidSlider(), FlexibleSlider(4), CablePendulum(4)]
    return [
        Chain(1, revolute=False),
        Chain(1, revolute=True),
        RigidSlider(),
        *(Chain(n, revolute) for revolute in (False, True) for n in (5, 20, 100)),
        *(FlexibleSlider(n) for n in (4, 8, 32)),
        *(CablePendulum(n) for n in (4, 10, 30, 100, 1000)),
    ]


def _motion(report: Report, pairs: Sequence[Pair], steps: int, repeats: int) -> None:
    report.heading("Motion")
    rows, ratios = [], []
    for i, pair in enumerate(pairs):
        here, there, way = _times(pair, steps, repeats)
        apart = report.figure(f"motion.{i}.apart", _apart(pair))
        ratios.append(report.figure(f"motion.{i}.ratio", here / there))
        us = [
            report.figure(f"motion.{i}.{side}_us", 1e6 * x / steps)
            for side, x in (("here", here), ("exudyn", there))
        ]
        rows.append(
            [pair.title, f"{apart:.1e}", *(f"{x:.3g}" for x in us), way, f"{ratios[-1]:.2f}"]
        )
    report.table(
        ["scene", "apart, m", "here, us a step", "Exudyn, us a step", "its setting", "ratio"], rows
    )
    worst = max(ratios)
    report.judge("motion", worst <= 1, worst=worst, scene=pairs[int(np.argmax(ratios))].title)
    number = np.arange(1.0, len(ratios) + 1)
    series = [
        dots("measured", number, np.array(ratios)),
        Series("equal", number, np.ones(len(ratios)), dashed=True),
    ]
    panel = Panel(
        "Time of a step, here / Exudyn",
        "row of the table [-]",
        "ratio [-]",
        series,
        "linear",
        "log",
    )
    report.plot("motion", [panel])


def _times(pair: Pair, steps: int, repeats: int) -> tuple[float, float, str]:
    """Return median processor seconds of runs that take turns, and Exudyn's best setting."""
    exudyn, system = Exudyn(pair), assemble(pair.scene())
    way = exudyn.fastest(_STEP, min(steps, 32), pair.newton)
    hht = HHT(step=_STEP, newton_tolerance=pair.newton)
    calls: list[Callable[[], object]] = [
        lambda: simulate(system, steps * _STEP, hht),
        lambda: exudyn.end(_STEP, steps, pair.newton, way),
    ]
    here, there = medians(calls, repeats)
    return here, there, way.title


def _apart(pair: Pair) -> float:
    """Return how far apart both codes are, each extrapolated from two steps; m."""
    exudyn = Exudyn(pair)
    way = exudyn.fastest(_STEP, 8, pair.newton)
    limits = []

    def ours(h: float) -> Array:
        return pair.end(_COMPARED, HHT(step=h, newton_tolerance=1e-12))

    def theirs(h: float) -> Array:
        return exudyn.end(h, round(_COMPARED / h), pair.newton, way)

    for end in (ours, theirs):
        coarse, fine = end(_STEP / 2), end(_STEP / 4)
        limits.append(fine + (fine - coarse) / 3)
    here, there = limits
    return float(np.linalg.norm(here - there[: len(here)]))
