"""Many runs: a design of a sweep, and how much sooner it ends with two workers than with none."""

import multiprocessing
import statistics
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
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

_WORKERS = 2
_DESIGNS = 100
# Runs of a few milliseconds that go to a worker together: sending a packet costs 0.2 ms of
# processor time by processes, 4 ms by Dask. Threads compute side by side in kernels alone, so their
# runs are long.
_PACKETS = {"processes": 8, "Dask": 25, "threads": 1}
_STEP, _SHORT, _LONG = 2.0**-10, 2.0**-6, 1.0


def measure(runs: int = 200, repeats: int = 5) -> list[Row]:
    """Return times of a design, and the speed-up by two processes, workers of Dask or threads.

    Runs in this process and in the workers alternate; the median of the ratios counts.
    """
    rows = [_design(*mechanism, repeats) for mechanism in _mechanisms()]
    pools: dict[str, Callable[[], AbstractContextManager[Executor]]]
    pools = {
        "processes": _processes,
        "Dask": _dask,
        "threads": partial(ThreadPoolExecutor, _WORKERS),
    }
    for name, workers in pools.items():
        count, t_end = (runs // 10, _LONG) if name == "threads" else (runs, _SHORT)
        with workers() as executor:
            packet = executor, _PACKETS[name]
            ratios = [
                _seconds(count, t_end, None, 1) / _seconds(count, t_end, *packet)
                for _ in range(repeats + 1)
            ]
        speed_up, asked = statistics.median(ratios[1:]), "at least 1.8"
        what = f"speed-up of {count} runs of {t_end / _STEP:g} steps by {name}"
        rows.append(Row(what, speed_up, "-", asked))
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


def _seconds(runs: int, t_end: float, executor: Executor | None, chunk: int) -> float:
    scene = crank_slider()
    rod = scene.beams[1]
    what = Evaluator(Terminal(position(rod.at_end, 0)), t_end, HHT(_STEP))
    heights = np.linspace(0.04, 0.06, runs)[:, None]
    clock = stopwatch(wall=True)
    sweep(scene, heights, what, design=[f"{rod.name}.height"], executor=executor, chunk=chunk)
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
