"""Statics and modes of a cantilever of cables."""

from collections.abc import Callable, Sequence

import numpy as np

from ancfdae import Clamp, Scene, assemble, equilibrium, modes
from ancfdae.numerics.timing import medians
from validation.peers.cables import Elastica
from validation.peers.exudyn import Exudyn
from validation.report import Report

_MODES = 4


def fill(report: Report, sizes: Sequence[int], repeats: int) -> None:
    """Add the tables of equilibrium and of natural frequencies."""
    report.heading("Equilibrium and natural frequencies")
    rows = []
    ratios = []
    for cables in sizes:
        for what, apart, (here, there) in (
            ("equilibrium", *_equilibrium(cables, repeats)),
            ("modes", *_modes(cables, repeats)),
        ):
            name = f"{what}.{cables}"
            report.figure(f"{name}.apart", apart)
            ratios.append(report.figure(f"{name}.ratio", here / there))
            ms = [1e3 * here, 1e3 * there]
            rows.append([f"{what}, {cables} cables", f"{apart:.1e}", *ms, f"{ratios[-1]:.2f}"])
    report.table(["task", "apart, relative", "here, ms", "Exudyn, ms", "ratio"], rows)
    small, large = max(ratios[:2]), max(ratios[2:], default=0.0)
    report.judge("rest", small <= 2 and large <= 1, small=small, large=large)


def _equilibrium(cables: int, repeats: int) -> tuple[float, list[float]]:
    pair = Elastica(cables)
    system, exudyn = assemble(pair.scene()), Exudyn(pair)
    steps = next(n for n in (1, 2, 4, 8, 16) if np.all(np.isfinite(exudyn.at_rest(n))))
    calls: list[Callable[[], object]] = [lambda: equilibrium(system), lambda: exudyn.at_rest(steps)]
    here = equilibrium(system).solution.position(pair.point)[-1]
    apart = np.linalg.norm(here - exudyn.at_rest(steps)[:2]) / np.linalg.norm(here)
    return float(apart), medians(calls, repeats)


def _modes(cables: int, repeats: int) -> tuple[float, list[float]]:
    pair = Elastica(cables)
    (rod,) = pair.scene().beams
    system, exudyn = assemble(Scene([rod], [Clamp(rod.at_start)])), Exudyn(pair)
    held = (0, 1, 3)
    calls: list[Callable[[], object]] = [
        lambda: modes(system, _MODES),
        lambda: exudyn.frequencies(_MODES, held, sparse=True),
        lambda: exudyn.frequencies(_MODES, held, sparse=False),
    ]
    here = modes(system, _MODES).natural_frequencies
    apart = np.max(np.abs(here / exudyn.frequencies(_MODES, held, sparse=True) - 1))
    own, *others = medians(calls, repeats)
    return float(apart), [own, min(others)]
