"""From nothing to a run: the import, and the paper's crank-slider assembled."""

import os
import statistics
import subprocess
import sys
import tempfile

from ancfdae import assemble
from validation.performance.mechanisms import chain
from validation.performance.row import Row, seconds
from validation.scenes import crank_slider

# The names of README's program, and `simulate`: what a user waits for, other packages included.
_IMPORT = """
import time
t = time.perf_counter()
from ancfdae import HHT, Beam, Integral, Material, Pin, Scene, gradient, simulate
from ancfdae.observables import deflection
from ancfdae.sections import Rectangle
print(time.perf_counter() - t)
"""
_FIRST = """
import time
from ancfdae import *
from validation.scenes import pendulum
scene, t = pendulum(), time.perf_counter()
simulate(assemble(scene), 2**-10, HHT(2**-10))
print(time.perf_counter() - t)
"""


def measure(repeats: int = 5) -> list[Row]:
    """Return the time of an import, of a first run in a new process, and of an assembly."""
    assembly = seconds(lambda: assemble(crank_slider()), repeats)
    # Exudyn took 1.8, 7 and 32 ms; at most 1.5 times that is asked.
    chains = [
        Row(f"chain of {n} bodies assembled", 1e3 * _chain(n, repeats), "ms", f"at most {most}")
        for n, most in ((5, 2.7), (20, 10.5), (100, 48))
    ]
    return [
        Row("import of ten names", _fresh(_IMPORT, repeats), "s", "at most 0.25"),
        Row("first assembly and step, pendulum", _fresh(_FIRST, repeats), "s", "at most 0.05"),
        Row("crank-slider assembled", 1e3 * assembly, "ms", "at most 10"),
        *chains,
    ]


def _chain(bodies: int, repeats: int) -> float:
    """Return the time in which a chain on revolute joints is declared and assembled."""
    return seconds(lambda: assemble(chain(bodies)), repeats)


def _fresh(program: str, repeats: int) -> float:
    """Return the median of what a new process prints; modules are compiled, as by `pip install`."""
    with tempfile.TemporaryDirectory() as folder:
        own = {name: x for name, x in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        call = [sys.executable, "-c", program]
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
