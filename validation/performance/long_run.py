"""A long run of which little is kept: its steps, its memory, its file, and an interrupt."""

import _thread
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, final

import numpy as np

from ancfdae import HHT, PointMass, Scene, record_observables
from ancfdae.errors import Interrupted
from ancfdae.numerics.timing import stopwatch
from ancfdae.observables import position
from ancfdae.sensitivity.observables.observable import Observable
from validation.performance.mechanisms import rigid_slider_crank
from validation.performance.row import Row, in_a_process, largest_memory
from validation.scenes import pendulum

_STEP = 2.0**-10


@final
@dataclass(frozen=True)
class _Long:
    """Steps of a mechanism, by name, of which one of `every` is kept."""

    mechanism: Literal["pendulum", "rigid slider-crank"]
    steps: int
    every: int

    @property
    def scene(self) -> Scene:
        """The mechanism."""
        return pendulum() if self.mechanism == "pendulum" else rigid_slider_crank()

    @property
    def observed(self) -> list[Observable]:
        """Where a point is."""
        beams, bodies = self.scene.beams, self.scene.bodies
        rod = beams[0] if beams else bodies[1]
        assert not isinstance(rod, PointMass)
        point = rod.at(1.0) if beams else rod.at(0.5, 0)
        return [position(point, i) for i in range(2)]


@final
@dataclass(frozen=True)
class _Taken:
    """Seconds of a run, and from Ctrl-C to its end; its largest memory in bytes; rows kept."""

    seconds: float
    answer: float
    memory: float
    rows: int


def measure(steps: int = 80_000, many: int = 10_000_000) -> list[Row]:
    """Return figures of long runs, and of shorter ones.

    Rows go to a file, which a second run leaves behind when it is interrupted half way.
    """
    return [
        *_figures(_Long("pendulum", steps, 100)),
        *_figures(_Long("rigid slider-crank", many, 1000)),
    ]


def _figures(run: _Long) -> list[Row]:
    part = replace(run, steps=run.steps // (2 if run.mechanism == "pendulum" else 10))
    fewer, more = (in_a_process(_run, each, False) for each in (part, run))
    broken = in_a_process(_run, run, True)
    all_rows, asked = run.steps // run.every + 1, "at most 0.2"
    return [
        Row(
            f"{run.mechanism}: a step of {run.steps}, written to a file",
            1e6 * more.seconds / run.steps,
            "us",
        ),
        Row(
            f"{run.mechanism}: memory beyond that of {part.steps} steps",
            1e-6 * (more.memory - fewer.memory),
            "MB",
        ),
        Row(f"{run.mechanism}: rows in the file, of those asked for", more.rows / all_rows, "-"),
        Row(f"{run.mechanism}: the same, interrupted half way", broken.rows / all_rows, "-"),
        Row(f"{run.mechanism}: from Ctrl-C to the end of the call", broken.answer, "s", asked),
    ]


def _run(run: _Long, interrupted: bool) -> _Taken:
    clock, pressed = stopwatch(wall=True), list[float]()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tip.npy"
        half_way = run.steps // run.every // 2
        ctrl_c = threading.Thread(target=_interrupt, args=(file, half_way, clock, pressed))
        if interrupted:
            # A shell's background jobs start deaf to it.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            ctrl_c.start()
        begin = clock()
        with suppress(Interrupted):
            end, kept = run.steps * _STEP, run.every
            record_observables(run.scene, run.observed, end, HHT(_STEP), keep=kept, file=file)
        end_of_call = clock()
        written = int(np.sum(np.isfinite(np.load(file)).all(axis=1)))
    answer = end_of_call - pressed[0] if pressed else 0.0
    return _Taken(end_of_call - begin, answer, largest_memory(), written)


def _interrupt(file: Path, row: int, clock: Callable[[], float], pressed: list[float]) -> None:
    """Press Ctrl-C when a row is in the file, and note when."""
    found = False
    while not found:
        time.sleep(0.02)
        # Until the file has its full size it cannot be read.
        with suppress(OSError, ValueError, EOFError):
            found = bool(np.isfinite(np.load(file, mmap_mode="r")[row]).all())
    pressed.append(clock())
    _thread.interrupt_main()
