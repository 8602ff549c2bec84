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
from validation.peers import designs, gradients, jax_runs, loops, own_systems, rest, trees
from validation.peers.cables import CablePendulum, FlexibleSlider
from validation.peers.exudyn import Exudyn, require_peers
from validation.peers.pair import Pair
from validation.peers.rigid import Chain, RigidSlider
from validation.report import Agreement, Report

__all__ = ["run"]

_STEP = 2.0**-10
# End of the runs that are compared, s: chains of many bodies have not become chaotic by then.
_COMPARED = 0.125


def run(report: Report, quick: bool) -> None:
    """Run the cases of report `peers`; add its text, tables and figures."""
    require_peers()
    before = os.getloadavg()
    report.heading("Method")
    report.text(_METHOD.format(version=importlib.metadata.version("exudyn"), packages=_packages()))
    _motion(report, _quick_pairs() if quick else _pairs(), 32 if quick else 512, 1 if quick else 5)
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
    report.text(_LIMITS.format(cores=os.cpu_count(), before=loads[0], after=loads[1]))


def _packages() -> str:
    """Return the versions of the other codes."""
    names = ["casadi", "jax", "diffrax", "qdldl"]
    names += ["pypardiso"] * (importlib.util.find_spec("pypardiso") is not None)
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)


def _quick_pairs() -> list[Pair]:
    return [Chain(1, revolute=False), RigidSlider(), FlexibleSlider(4), CablePendulum(4)]


def _pairs() -> list[Pair]:
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
    report.claim(
        "A step of chains, slider-cranks and cables, of Exudyn's time in its best setting: "
        "largest ratio",
        "at most 1",
        f"{worst:.2f} ({pairs[int(np.argmax(ratios))].title})",
        Agreement.AGREES if worst <= 1 else Agreement.DISAGREES,
    )
    number = np.arange(1.0, len(ratios) + 1)
    series = [
        Series("measured", number, np.array(ratios), line=False, marker=True),
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
    report.plot("motion", [panel], caption="Below the line this package is faster.")


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


_METHOD = """\
The same scenes are written for this package and for Exudyn {version}, a multibody code in C++
(`validation/peers/`). Each row first compares where a point is at t = 0.125 s, both codes
extrapolated to steps of length zero: what is left are differences of the models (the curvature of
cables is measured in ways that differ by the axial strain) and of their meshes. Then runs take
turns, one thread, steps of 2^-10 s, Newton's method to 1e-8 (1e-7 for 1000
cables: Exudyn does not converge to 1e-8 there); the medians of processor time count.
Exudyn integrates by generalised-alpha with the numerical damping of HHT at alpha = -0.3, in its
version without checks of ranges, without files, with the fastest of its linear solvers (dense,
sparse, sparse and symmetric where the matrix is) and of full and modified Newton iteration.
Modified Newton keeps factors from step to step; here every step has its own. Natural frequencies
come from the faster of Exudyn's dense and sparse solver. Gradients of the height of the end are
taken in the logarithms of variables: here direct and adjoint, there central differences at the
best change. Other codes: {packages}.
"""

_LIMITS = """\
- One thread, one machine with {cores} processors; ratios of small scenes move by a fifth from run
  to run. Its load average was {before:.1f} when the report began and {after:.1f} at its end: beyond
  the number of processors times are longer than on a quiet machine, and ratios less certain.
- Exudyn's models are ours: an expert of it may find a faster one.
- The pendulum in JAX is the plainest way, quadrature at every point in every iteration: constant
  invariants, which this package is built on, make it faster and longer.
"""
