"""One figure of a subject, and how a time is measured."""

import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

__all__ = ["Row", "seconds"]


class Row(NamedTuple):
    """A measured figure beside what is asked of it."""

    what: str
    value: float
    unit: str
    asked: str = "-"


def seconds(call: Callable[[], object], repeats: int) -> float:
    """Return the median time of a call by the clock; one more call before is not counted."""
    call()
    times = []
    for _ in range(repeats):
        clock = time.perf_counter()
        call()
        times.append(time.perf_counter() - clock)
    return statistics.median(times)
