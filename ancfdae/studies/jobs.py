"""Many calls of one function, here or in the workers of an executor, answers as they arrive."""

from __future__ import annotations

import ctypes
import pickle
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, as_completed
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple, TypeVar, final
from uuid import uuid4

import numpy as np

from ancfdae.errors import InvalidInput

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")
# What the ways to send a task raise if it does not pickle.
_UNSENT = (pickle.PicklingError, AttributeError, TypeError)
# Tasks that are sent one by one, and how many answers of these tell what one takes; how long to
# wait for them; s. Short tasks travel together, for this long at most; s.
_FIRST, _ENOUGH, _PATIENCE, _TOGETHER = 6, 3, 2.0, 0.2


def answers(
    function: Callable[[_Task], _Answer],
    tasks: Mapping[int, _Task],
    executor: Executor | None,
    parts: Mapping[str, object],
    *,
    progress: bool,
    done: int = 0,
) -> Generator[tuple[int, _Answer | str], None, None]:
    """Yield the key of a task and its answer, as answers arrive.

    In this process one after the other without an executor. Where a worker was lost the answer is
    why, in words. What has not begun when the loop ends early is cancelled; close the iterator for
    that. A progress bar counts the tasks, and those that are `done` already.

    Raises
    ------
    InvalidInput
        If one of the `parts`, which tasks and function are made of, does not pickle.
    KeyboardInterrupt
        Also if a worker was interrupted.
    """
    from tqdm import tqdm

    here = ((key, function(task)) for key, task in tasks.items())
    arriving = here if executor is None else _from_workers(function, tasks, executor)
    bar = tqdm(total=done + len(tasks), initial=done, disable=not progress, unit="run")
    with bar, closing(arriving):
        for key, answer in arriving:
            bar.update()
            if isinstance(answer, Exception):
                _require_pickles(answer, parts)
                yield key, f"{type(answer).__name__} in a worker: {answer}"
            else:
                yield key, answer


def _from_workers(
    function: Callable[[_Task], _Answer], tasks: Mapping[int, _Task], executor: Executor
) -> Generator[tuple[int, _Answer | Exception], None, None]:
    """Yield answers, or what a worker was lost by.

    Short tasks travel together: sending one to a Dask cluster costs 4 ms.
    """
    keys, least = list(tasks), _TOGETHER
    futures = _sent(function, tasks, [[key] for key in keys[:_FIRST]], executor)
    try:
        with suppress(TimeoutError):
            # The others keep the workers busy until the rest arrives.
            for future in islice(as_completed(list(futures), _PATIENCE), _ENOUGH):
                yield from _arrived(future, futures.pop(future))
                least = min(least, _seconds(future))
        packets = _packets(keys[_FIRST:], int(_TOGETHER / least))
        futures |= _sent(function, tasks, packets, executor)
        for future in as_completed(list(futures)):
            yield from _arrived(future, futures.pop(future))
    except KeyboardInterrupt:
        for future in [x for x in futures if x.done() and not x.exception()]:
            yield from zip(futures.pop(future), future.result().answers, strict=False)
        raise
    finally:
        for future in futures:
            future.cancel()


@final
@dataclass(frozen=True)
class _Packet:
    """Tasks that travel together."""

    function: Callable[[Any], Any]
    tasks: Sequence[Any]

    def __dask_tokenize__(self) -> str:
        """Return a name for Dask, which takes 2 ms a task to make one up from what it holds."""
        return uuid4().hex


class _Done(NamedTuple):
    """What a worker answers: fewer answers than tasks if it was interrupted, and their time."""

    answers: list[Any]
    interrupted: bool
    seconds: float


def _together(packet: _Packet) -> _Done:
    """Work on tasks in a worker; an interrupt keeps what is done."""
    found, clock, interrupted = list[Any](), time.perf_counter(), False
    try:
        found.extend(packet.function(task) for task in packet.tasks)
    except KeyboardInterrupt:
        interrupted = True
    return _Done(found, interrupted, time.perf_counter() - clock)


def _packets(keys: Sequence[int], most: int) -> list[Sequence[int]]:
    """Return keys that travel together: fewer and fewer, so that all workers end at one time."""
    packets = []
    while keys:
        size = max(1, min(most, len(keys) // _FIRST))
        packets.append(keys[:size])
        keys = keys[size:]
    return packets


def _sent(
    function: Callable[[_Task], Any],
    tasks: Mapping[int, _Task],
    packets: Sequence[Sequence[int]],
    executor: Executor,
) -> dict[Future[_Done], Sequence[int]]:
    """Send tasks; what cannot be sent is an answer that says so."""
    futures = {}
    for part in packets:
        try:
            future = executor.submit(_together, _Packet(function, [tasks[key] for key in part]))
        except (BrokenExecutor, *_UNSENT) as error:
            future = Future()
            future.set_exception(error)
        futures[future] = part
    return futures


def _arrived(future: Future[_Done], keys: Sequence[int]) -> Iterator[tuple[int, Any]]:
    """Yield keys and answers of tasks that travelled together."""
    try:
        error = future.exception()
    except CancelledError as cancelled:
        error = cancelled
    if error is None:
        yield from zip(keys, future.result().answers, strict=False)
        if future.result().interrupted:
            raise KeyboardInterrupt
    elif isinstance(error, Exception):
        for key in keys:
            yield key, error
    else:
        raise error


def _seconds(future: Future[_Done]) -> float:
    return np.inf if future.cancelled() or future.exception() else future.result().seconds


def _require_pickles(lost: Exception, parts: Mapping[str, object]) -> None:
    """Name the part that does not pickle, if that is why an answer was lost."""
    for name, part in parts.items() if isinstance(lost, _UNSENT) else ():
        try:
            pickle.dumps(part)
        except _UNSENT as error:
            raise InvalidInput(
                f"{name}, executor",
                "must pickle to be sent to a worker",
                str(error),
                "Define functions at the top of a module, or leave the executor out.",
            ) from error


@final
class TimeLimit:
    """Raises KeyboardInterrupt in the thread of its `with` block after `seconds`, if not None.

    Integrators end at a KeyboardInterrupt as at any instant; `expired` tells it from the user's.
    Unlike a signal it reaches threads, in which the workers of Dask compute.
    """

    def __init__(self, seconds: float | None) -> None:
        # Longer waits than a clock can count are none.
        self.seconds = None if seconds is not None and seconds > threading.TIMEOUT_MAX else seconds
        self.expired = self._left = False
        self._lock = threading.Lock()
        self._thread = 0
        self._timer = threading.Timer(self.seconds or 0.0, self._strike)
        self._timer.daemon = True

    def __enter__(self) -> TimeLimit:
        """Start the clock."""
        self._thread = threading.get_ident()
        if self.seconds is not None:
            self._timer.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Stop the clock; an interrupt on its way arrives here, at the call of `cancel`."""
        with self._lock:
            self._left = True
        self._timer.cancel()

    def _strike(self) -> None:
        with self._lock:
            if not self._left:
                self.expired = True
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    ctypes.c_ulong(self._thread), ctypes.py_object(KeyboardInterrupt)
                )
