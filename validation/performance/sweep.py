"""Many runs on two cores: how much sooner `sweep` ends with two workers than with none."""

import multiprocessing
import statistics
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np

from ancfdae import HHT, Evaluate, Terminal, position, sweep
from ancfdae.numerics.timing import stopwatch
from validation.performance.row import Row
from validation.scenes import crank_slider

__all__ = ["measure"]

_WORKERS = 2
# Runs of a few milliseconds that go to a worker together.
_CHUNK = 8


def measure(runs: int = 200, repeats: int = 5) -> list[Row]:
    """Return the speed-up by two processes and by a local Dask cluster of two workers.

    Runs in this process and in the workers alternate; the median of the ratios counts.
    """
    rows = []
    for name, workers in (("processes", _processes), ("Dask", _dask)):
        with workers() as executor:
            ratios = [_ratio(runs, executor) for _ in range(repeats + 1)]
        speed_up = statistics.median(ratios[1:])
        rows.append(Row(f"speed-up of {runs} runs by {name}", speed_up, "-", "at least 1.8"))
    return rows


def _ratio(runs: int, executor: Executor) -> float:
    return _seconds(runs, None) / _seconds(runs, executor)


def _seconds(runs: int, executor: Executor | None) -> float:
    scene = crank_slider()
    rod = scene.beams[1]
    what = Evaluate(Terminal(position(rod.at_end, 0)), 2.0**-6, HHT(2.0**-10))
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
