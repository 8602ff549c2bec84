"""Set-up of chains, and sweeps of small mechanisms, beside Exudyn."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from ancfdae import HHT, DesignVariable, Evaluator, Terminal, assemble, sweep
from ancfdae.numerics.timing import medians
from ancfdae.observables import position
from validation.peers.cables import CablePendulum, FlexibleSlider
from validation.peers.exudyn import Exudyn
from validation.peers.pair import Pair
from validation.peers.rigid import Chain, RigidSlider
from validation.report import Report

_STEPS, _STEP = 64, 2.0**-10


def fill(report: Report, bodies: Sequence[int], designs: int, repeats: int) -> None:
    """Add a table of set-up, a row for each number of bodies, and one of sweeps."""
    report.say("designs", designs=designs)
    _set_up(report, bodies, repeats)
    _sweeps(report, designs, repeats)


def _set_up(report: Report, bodies: Sequence[int], repeats: int) -> None:
    rows, ratios = list[list[object]](), list[float]()
    for n in bodies:
        pair = Chain(n, revolute=True)
        here, there = medians([partial(_assembled, pair), partial(Exudyn, pair)], repeats)
        ratios.append(report.figure(f"set_up.{n}.ratio", here / there))
        rows.append([pair.title, 1e3 * here, 1e3 * there, f"{ratios[-1]:.2f}"])
    report.table(["set-up", "here, ms", "Exudyn, ms", "ratio"], rows)
    report.judge("set-up", max(ratios) <= 1.5, largest=max(ratios))


def _assembled(pair: Pair) -> object:
    return assemble(pair.scene())


def _sweeps(report: Report, designs: int, repeats: int) -> None:
    mechanisms: list[tuple[Pair, str]] = [
        (FlexibleSlider(4), "rod.youngs_modulus"),
        (RigidSlider(), "rod.mass"),
        (CablePendulum(4), "rope.youngs_modulus"),
    ]
    rows, ratios = list[list[object]](), list[float]()
    for pair, target in mechanisms:
        times = [1e3 * x / designs for x in _sweep(pair, target, designs, repeats)]
        name = f"sweep.{len(rows)}"
        ratios.append(report.figure(f"{name}.ratio", times[0] / times[1]))
        report.figure(f"{name}.here_ms", times[0])
        rows.append([pair.title, *times, f"{ratios[-1]:.2f}"])
    report.table(
        ["sweep", "a design here, ms", "Exudyn, rebuilt, ms", "its motion alone, ms", "ratio"], rows
    )
    report.judge("sweeps", max(ratios) < 1, largest=max(ratios))


def _sweep(pair: Pair, target: str, designs: int, repeats: int) -> list[float]:
    """Return times of a sweep here, by models built anew, and of their motions alone; s."""
    scene, hht = pair.scene(), HHT(_STEP, newton_tolerance=pair.newton)
    value = scene.value(DesignVariable("x", [target]))
    values = value * np.linspace(1.0, 1.2, designs)[:, None]
    what = Evaluator(Terminal(position(pair.point, 0)), _STEPS * _STEP, hht)
    kept = Exudyn(pair)
    way = kept.fastest(_STEP, _STEPS, pair.newton)

    def rebuilt() -> None:
        for _ in range(designs):
            Exudyn(pair).end(_STEP, _STEPS, pair.newton, way)

    def motions() -> None:
        for _ in range(designs):
            kept.end(_STEP, _STEPS, pair.newton, way)

    ours = partial(sweep, scene, values, what, design=[target])
    return medians([ours, rebuilt, motions], repeats)
