"""Many calls of one function, here or in the workers of an executor, answers as they arrive."""

from __future__ import annotations

import ctypes
import pickle
import threading
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, as_completed
from typing import Any, TypeVar, final

from ancfdae.errors import InvalidInput

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")
# What the ways to send a task raise if it does not pickle.
_UNSENT = (pickle.PicklingError, AttributeError, TypeError)


def answers(
    function: Callable[[_Task], _Answer], tasks: Mapping[int, _Task], executor: Executor | None
) -> Generator[tuple[int, _Answer | Exception], None, None]:
    """Yield the key of a task and its answer, as answers arrive.

    In this process one after the other without an executor. The answer of a worker that was lost
    is the exception that tells so. What has not begun when the loop ends early is cancelled; close
    the iterator for that.

    Raises
    ------
    KeyboardInterrupt
        Also if a worker was interrupted.
    """
    if executor is None:
        for key, task in tasks.items():
            yield key, function(task)
        return
    futures: dict[Future[_Answer], int] = {}
    try:
        for key, task in tasks.items():
            try:
                futures[executor.submit(function, task)] = key
            except (BrokenExecutor, *_UNSENT) as error:
                yield key, error
        for future in as_completed(futures):
            yield futures[future], _answer(future)
    finally:
        for future in futures:
            future.cancel()


def _answer(future: Future[Any]) -> Any:
    try:
        error = future.exception()
    except CancelledError as cancelled:
        return cancelled
    if error is None:
        return future.result()
    if isinstance(error, Exception):
        return error
    raise error


def require_pickles(lost: Exception, parts: Mapping[str, object]) -> None:
    """Name the part that does not pickle, if that is why an answer was lost.

    Raises
    ------
    InvalidInput
    """
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
        self.seconds, self.expired, self._left = seconds, False, False
        self._lock = threading.Lock()
        self._thread = 0
        self._timer = threading.Timer(seconds or 0.0, self._strike)
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
