"""Many runs: a design of a sweep, and how much sooner it ends with two workers than with none."""

import multiprocessing
import statistics
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np

from ancfdae import HHT, DesignVariable, Evaluator, Scene, Terminal, sweep
from ancfdae.extend import MaterialPoint
from ancfdae.numerics.timing import medians, stopwatch
from ancfdae.observables import position
from validation.peers.cables import CablePendulum, FlexibleSlider
from validation.performance.mechanisms import rigid_slider_crank
from validation.performance.row import Row
from validation.scenes import crank_slider

__all__ = ["measure"]

_WORKERS = 2
_DESIGNS = 100
# Runs of a few milliseconds that go to a worker together.
_CHUNK = 8


def measure(runs: int = 200, repeats: int = 5) -> list[Row]:
    """Return times of a design, and the speed-up by two processes and by Dask with two workers.

    Runs in this process and in the workers alternate; the median of the ratios counts.
    """
    rows = [_design(*mechanism, repeats) for mechanism in _mechanisms()]
    for name, workers in (("processes", _processes), ("Dask", _dask)):
        with workers() as executor:
            ratios = [_ratio(runs, executor) for _ in range(repeats + 1)]
        speed_up = statistics.median(ratios[1:])
        rows.append(Row(f"speed-up of {runs} runs by {name}", speed_up, "-", "at least 1.8"))
    return rows


def _mechanisms() -> Iterator[tuple[str, Scene, str, MaterialPoint, float]]:
    """Yield small mechanisms, with what varies, what is observed, and the step; s."""
    crank, rope = FlexibleSlider(4), CablePendulum(4)
    yield "the flexible crank", crank.scene(), "rod.youngs_modulus", crank.point, 2.0**-10
    rigid = rigid_slider_crank()
    yield "the rigid slider-crank", rigid, "rod.mass", rigid.members[1].at(0.5, 0), 2.0**-10
    yield "four cables", rope.scene(), "rope.youngs_modulus", rope.point, 2.0**-8


def _design(
    name: str, scene: Scene, target: str, point: MaterialPoint, step: float, repeats: int
) -> Row:
    """Return the processor time of a design: 64 steps of HHT, of a scene as it is declared."""
    value = scene.value(DesignVariable("x", [target]))
    values = value * np.linspace(1.0, 1.2, _DESIGNS)[:, None]
    what = Evaluator(Terminal(position(point, 0)), 64 * step, HHT(step))
    (time,) = medians([lambda: sweep(scene, values, what, design=[target])], repeats)
    return Row(f"a design of a sweep of {name}", 1e3 * time / _DESIGNS, "ms", "at most 1")


def _ratio(runs: int, executor: Executor) -> float:
    return _seconds(runs, None) / _seconds(runs, executor)


def _seconds(runs: int, executor: Executor | None) -> float:
    scene = crank_slider()
    rod = scene.beams[1]
    what = Evaluator(Terminal(position(rod.at_end, 0)), 2.0**-6, HHT(2.0**-10))
    heights = np.linspace(0.04, 0.06, runs)[:, None]
    clock = stopwatch(wall=True)
    sweep(scene, heights, what, design=[f"{rod.name}.height"], executor=executor, chunk=_CHUNK)
    return clock()


@contextmanager
def _processes() -> Iterator[Executor]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(_WORKERS, mp_context=context) as executor:
        yield executor


@contextmanager
def _dask() -> Iterator[Executor]:
    from distributed import Client, LocalCluster

    settings: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": None}
    with (
        LocalCluster(n_workers=_WORKERS, **settings) as cluster,  # type: ignore[no-untyped-call]
        Client(cluster) as client,  # type: ignore[no-untyped-call]
        client.get_executor() as executor,
    ):
        yield executor
