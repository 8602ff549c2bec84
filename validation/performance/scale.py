"""From ten to ten thousand spatial elements: assembly, steps and memory of a chain."""

import statistics
from functools import partial

import numpy as np

from ancfdae import HHT, Beam, Clamp, Material, Scene, assemble, simulate
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.numerics.timing import timed
from ancfdae.results import Solution
from ancfdae.sections import Rectangle
from validation.performance.row import Row, in_a_process, largest_memory, seconds

_STEP = 2.0**-9
_MOST = 10_000


def cantilever(elements: int) -> Scene:
    """Return a clamped beam of spatial elements, 0.1 m each, under gravity."""
    end = (0.1 * elements, 0, 0)
    section, material = Rectangle(height=0.05, width=0.05), Material(2770, 1e9, 0.3)
    beam = Beam("beam", (0, 0, 0), end, elements, section, material)
    return Scene([beam], [Clamp(beam.at_start)], gravity=(0, -9.81, 0))


def variables(elements: int) -> list[str]:
    """Return the heights of all elements as design variables."""
    return [f"beam.height[{k}]" for k in range(elements)]


def measure(repeats: int = 3) -> list[Row]:
    """Return times of assemblies and steps, and memory; each size in a process of its own."""
    rows, per_element, memory = [], dict[int, float](), dict[int, float]()
    streamed = 0.0
    for n in (10, 100, 1_000, _MOST):
        assembly, step, memory[n], streamed = in_a_process(_measured, n, repeats)
        per_element[n] = step / n
        asked = ("at most 2", "at most 150") if n == _MOST else ("-", "-")
        rows.append(Row(f"{n} elements assembled", assembly, "s", asked[0]))
        rows.append(Row(f"step of {n} elements", 1e3 * step, "ms", asked[1]))
    growth = per_element[_MOST] / per_element[100]
    rows.append(Row("step per element, 10,000 against 100", growth, "-", "at most 1.5"))
    # What a step of 100 elements finds in the cache, one of 10,000 streams through memory.
    more = 1e6 * (per_element[_MOST] - per_element[100])
    rows.append(Row("an element of 10,000 costs more than one of 100 by", more, "us"))
    rows.append(Row("matrix and factors of an element, streamed", 1e6 * streamed / _MOST, "us"))
    more = (memory[_MOST] - memory[1_000]) / (_MOST - 1_000)
    rows.append(Row("memory of an element, assembled and run", 1e-3 * more, "kB", "at most 40"))
    design = seconds(lambda: assemble(cantilever(1_000), variables(1_000)), repeats)
    rows.append(Row("1,000 elements assembled with their heights", design, "s", "at most 1"))
    return rows


def _measured(n: int, repeats: int) -> tuple[float, float, float, float]:
    """Return seconds of an assembly and of a step, the largest memory in bytes, and `_streamed`."""
    assembly, steps = seconds(lambda: assemble(cantilever(n)), repeats), max(4, 2_000 // n)
    system, times = assemble(cantilever(n)), []
    for _ in range(repeats):
        runs = (partial(simulate, system, k * _STEP, HHT(_STEP)) for k in (2, 2 + steps))
        short, long = (timed(run, wall=True)[0] for run in runs)
        times.append((long - short) / steps)
    most = largest_memory()
    return (
        assembly,
        statistics.median(times),
        most,
        _streamed(system, simulate(system, 8 * _STEP, HHT(_STEP))),
    )


# Each iteration writes the values of f_q and reads them and those of M; fills the envelope, reads
# and writes it to factorise, and reads it twice to solve.
_PASSES_OF_VALUES, _PASSES_OF_ENVELOPE = 3, 5


def _streamed(system: MechanicalSystem, run: Solution) -> float:
    """Return the seconds in which a step's matrices pass through memory, at the speed of a copy."""
    layout = saddle_point(system, 0.0).layout(band=False)
    assert layout is not None
    assert layout.envelope is not None
    numbers = _PASSES_OF_VALUES * system.pattern.size + _PASSES_OF_ENVELOPE * layout.envelope.size()
    from_here, to_there = np.ones(2**24), np.zeros(2**24)
    copied = seconds(lambda: np.copyto(to_there, from_here), 5) / (2 * len(to_there))
    return float(numbers * copied * run.statistics.iterations / run.statistics.steps)
