"""From nothing to a run: the import, and the paper's crank-slider assembled."""

import os
import statistics
import subprocess
import sys
import tempfile

from ancfdae import assemble
from validation.performance.row import Row, seconds
from validation.scenes import crank_slider

__all__ = ["measure"]

_PROGRAM = "import time; t = time.perf_counter(); import ancfdae; print(time.perf_counter() - t)"


def measure(repeats: int = 5) -> list[Row]:
    """Return the time of `import ancfdae` in a new process, and that of an assembly."""
    assembly = seconds(lambda: assemble(crank_slider()), repeats)
    return [
        Row("import ancfdae", _import(repeats), "s", "at most 0.3"),
        Row("crank-slider assembled", 1e3 * assembly, "ms", "at most 10"),
    ]


def _import(repeats: int) -> float:
    """Return the median time of the import; modules are compiled, as by `pip install`."""
    with tempfile.TemporaryDirectory() as folder:
        own = {name: x for name, x in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        call = [sys.executable, "-c", _PROGRAM]
        times = [
            float(
                subprocess.run(
                    call,
                    env={**own, "PYTHONPYCACHEPREFIX": folder},
                    capture_output=True,
                    text=True,
                    check=True,
                ).stdout
            )
            for _ in range(repeats + 1)
        ]
    return statistics.median(times[1:])
