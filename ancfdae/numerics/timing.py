"""Clocks and progress bars of long calls; the only module that reads a clock for measurements.

The package tqdm is loaded only when a bar is shown.
"""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from typing import Any, TypeVar, final

_Answer = TypeVar("_Answer")


def stopwatch(wall: bool = False) -> Callable[[], float]:
    """Return a function that returns the processor time, s, of this process since now.

    If `wall`, it returns the wall-clock time since now.
    """
    clock = time.perf_counter if wall else time.process_time
    begin = clock()
    return lambda: clock() - begin


def timed(
    call: Callable[[], _Answer], repeats: int = 1, *, long: float = math.inf, wall: bool = False
) -> tuple[float, _Answer]:
    """Return the least time of `repeats` calls, s, and the last result.

    A call that takes longer than `long` is not repeated: there the clock's resolution and
    interruptions are a small part of the time.
    """
    seconds = math.inf
    while True:
        told = stopwatch(wall)
        answer = call()
        seconds, repeats = min(seconds, told()), repeats - 1
        if repeats < 1 or seconds > long:
            return seconds, answer


def medians(calls: Sequence[Callable[[], object]], repeats: int, wall: bool = False) -> list[float]:
    """Return median times, s, of calls that alternate; the first round is not counted."""
    turns = [[timed(call, wall=wall)[0] for call in calls] for _ in range(repeats + 1)]
    import statistics

    return [statistics.median(column) for column in zip(*turns[1:], strict=True)]


@final
class _Hidden(ExitStack):
    """A progress bar that displays nothing."""

    def update(self, count: float = 1) -> None:
        """Do nothing: this progress bar is hidden."""


def progress_bar(shown: bool, items: Iterable[Any] | None = None, **settings: Any) -> Any:
    """Return a tqdm bar over items, or with a `total`; if not shown, the items or a dummy bar."""
    if not shown:
        return _Hidden() if items is None else items
    from tqdm import tqdm

    return tqdm(items, **settings)
