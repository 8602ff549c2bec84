"""A long run of which little is kept: its steps, its memory, its file, and an interrupt."""

import _thread
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from ancfdae import HHT, Interrupted, observations, position
from validation.performance.row import Row, in_a_process, largest_memory
from validation.scenes import pendulum

__all__ = ["measure"]

_STEP = 2.0**-10
_EVERY = 100


def measure(steps: int = 60_000) -> list[Row]:
    """Return figures of a run of the pendulum and of one with a third of its steps.

    Rows go to a file, which a second run leaves behind when it is interrupted half way.
    """
    _, fewer, _ = in_a_process(_run, steps // 3, None)
    taken, more, rows = in_a_process(_run, steps, None)
    _, _, kept = in_a_process(_run, steps, taken / 2)
    return [
        Row(f"a step of {steps}, written to a file", 1e6 * taken / steps, "us"),
        Row(f"memory beyond that of {steps // 3} steps", 1e-6 * (more - fewer), "MB"),
        Row("rows in the file, of those asked for", rows / (steps // _EVERY + 1), "-"),
        Row("the same, interrupted after half of the time", kept / (steps // _EVERY + 1), "-"),
    ]


def _run(steps: int, interrupt: float | None) -> tuple[float, float, int]:
    """Return seconds, the largest memory in bytes, and the rows in the file."""
    scene = pendulum()
    tip = [position(scene.beams[0].at_end, i) for i in range(2)]
    ctrl_c = threading.Timer(interrupt or 0.0, _thread.interrupt_main)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tip.npy"
        clock = time.perf_counter()
        if interrupt is not None:
            ctrl_c.start()
        try:
            observations(scene, tip, steps * _STEP, HHT(_STEP), every=_EVERY, file=file)
        except Interrupted:
            pass
        finally:
            ctrl_c.cancel()
        taken = time.perf_counter() - clock
        written = int(np.sum(np.isfinite(np.load(file)).all(axis=1)))
    return taken, largest_memory(), written
