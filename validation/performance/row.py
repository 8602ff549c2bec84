"""One figure of a subject, and how times and memory are measured."""

import multiprocessing
import resource
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

from ancfdae.numerics.timing import medians


class Row(NamedTuple):
    """A measured figure beside what is asked of it."""

    what: str
    value: float
    unit: str
    asked: str = "-"


def seconds(call: Callable[[], object], repeats: int) -> float:
    """Return the median time of a call by the clock; one more call before is not counted."""
    return medians([call], repeats, wall=True)[0]


def in_a_process(function: Callable[..., Any], *arguments: object) -> Any:
    """Call in a process of its own, so that its largest memory is that of the call."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(function, *arguments).result()


def largest_memory() -> float:
    """Return the largest resident set of this process so far, bytes."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # kilobytes, on Linux
