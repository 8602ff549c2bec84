"""A long run of which little is kept: its steps, its memory, its file, and an interrupt."""

import _thread
import signal
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from ancfdae import HHT, Interrupted, observations, position
from ancfdae.numerics.timing import stopwatch
from validation.performance.row import Row, in_a_process, largest_memory
from validation.scenes import pendulum

__all__ = ["measure"]

_STEP = 2.0**-10
_EVERY = 100


def measure(steps: int = 80_000) -> list[Row]:
    """Return figures of a run of the pendulum and of one with half of its steps.

    Rows go to a file, which a second run leaves behind when it is interrupted half way.
    """
    _, fewer, _ = in_a_process(_run, steps // 2, False)
    taken, more, rows = in_a_process(_run, steps, False)
    _, _, kept = in_a_process(_run, steps, True)
    all_rows = steps // _EVERY + 1
    return [
        Row(f"a step of {steps}, written to a file", 1e6 * taken / steps, "us"),
        Row(f"memory beyond that of {steps // 2} steps", 1e-6 * (more - fewer), "MB"),
        Row("rows in the file, of those asked for", rows / all_rows, "-"),
        Row("the same, interrupted half way", kept / all_rows, "-"),
    ]


def _run(steps: int, interrupted: bool) -> tuple[float, float, int]:
    """Return seconds, the largest memory in bytes, and the rows in the file."""
    scene = pendulum()
    tip = [position(scene.beams[0].at_end, i) for i in range(2)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tip.npy"
        half_way = threading.Thread(target=_interrupt, args=(file, steps // _EVERY // 2))
        if interrupted:
            # A shell's background jobs start deaf to it.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            half_way.start()
        clock = stopwatch(wall=True)
        with suppress(Interrupted):
            observations(scene, tip, steps * _STEP, HHT(_STEP), keep=_EVERY, file=file)
        taken = clock()
        written = int(np.sum(np.isfinite(np.load(file)).all(axis=1)))
    return taken, largest_memory(), written


def _interrupt(file: Path, row: int) -> None:
    """Press Ctrl-C when a row is in the file."""
    found = False
    while not found:
        time.sleep(0.02)
        # Until the file has its full size it cannot be read.
        with suppress(OSError, ValueError, EOFError):
            found = bool(np.isfinite(np.load(file, mmap_mode="r")[row]).all())
    _thread.interrupt_main()
