"""Many calls of one function, in this process or in workers; answers as they arrive."""

from __future__ import annotations

import ctypes
import pickle
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, as_completed
from contextlib import closing, suppress
from typing import TypeVar, final

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.timing import progress_bar

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")
# Exceptions raised on sending a task to a worker if it does not pickle.
_UNSENT = (pickle.PicklingError, AttributeError, TypeError)


def answers(
    function: Callable[[_Task], _Answer],
    tasks: Mapping[int, _Task],
    executor: Executor | None,
    parts: Mapping[str, object],
    *,
    progress: bool,
    done: int = 0,
    chunk: int = 1,
) -> Generator[tuple[int, _Answer | str], None, None]:
    """Yield the key of a task and its answer, as answers arrive.

    Without an executor the tasks are done in this process, one after the other; with one they are
    sent in chunks of `chunk`. If a worker was lost the answer is the reason, a text. Tasks that
    have not begun when the loop ends early are cancelled; close the iterator for that. A progress
    bar counts the tasks, including `done` tasks completed before.

    Raises
    ------
    InvalidInputError
        If one of the `parts`, of which tasks and function consist, does not pickle.
    KeyboardInterrupt
        Also if a worker was interrupted.
    """
    here = ((key, function(task)) for key, task in tasks.items())
    arriving = here if executor is None else _from_workers(function, tasks, executor, chunk)
    bar = progress_bar(progress, total=done + len(tasks), initial=done, unit="run")
    with bar, closing(arriving):
        for key, answer in arriving:
            bar.update()
            if isinstance(answer, Exception):
                _require_pickles(answer, parts)
                yield key, f"{type(answer).__name__} in a worker: {answer}"
            else:
                yield key, answer


def _from_workers(
    function: Callable[[_Task], _Answer],
    tasks: Mapping[int, _Task],
    executor: Executor,
    chunk: int,
) -> Generator[tuple[int, _Answer | Exception], None, None]:
    """Yield task keys with answers, or with the exception by which a worker was lost."""
    parts = [list(tasks)[k : k + chunk] for k in range(0, len(tasks), chunk)]
    futures = {_sent(executor, function, [tasks[key] for key in part]): part for part in parts}
    try:
        for future in as_completed(list(futures)):
            yield from _arrived(future, futures.pop(future))
    except KeyboardInterrupt:
        for future in [x for x in futures if x.done() and not x.exception()]:
            yield from zip(futures.pop(future), future.result(), strict=False)
        raise
    finally:
        for future in futures:
            future.cancel()


def _together(function: Callable[[_Task], _Answer], tasks: Sequence[_Task]) -> list[_Answer]:
    """Return answers to tasks, in a worker; fewer than tasks after an interrupt."""
    answered = list[_Answer]()
    with suppress(KeyboardInterrupt):
        answered.extend(map(function, tasks))
    return answered


def _sent(
    executor: Executor, function: Callable[[_Task], _Answer], tasks: Sequence[_Task]
) -> Future[list[_Answer]]:
    """Return the future of tasks sent to an executor; it holds the exception if that failed."""
    try:
        return executor.submit(_together, function, tasks)
    except (BrokenExecutor, *_UNSENT) as error:
        future = Future[list[_Answer]]()
        future.set_exception(error)
        return future


def _arrived(
    future: Future[list[_Answer]], keys: Sequence[int]
) -> Iterator[tuple[int, _Answer | Exception]]:
    """Yield keys and answers of tasks that were sent to a worker together."""
    error = CancelledError() if future.cancelled() else future.exception()
    if error is None:
        yield from zip(keys, future.result(), strict=False)
        if len(future.result()) < len(keys):
            raise KeyboardInterrupt
    elif isinstance(error, Exception):
        yield from ((key, error) for key in keys)
    else:
        raise error


def _require_pickles(lost: Exception, parts: Mapping[str, object]) -> None:
    """Raise InvalidInputError naming the part that does not pickle, if this lost an answer."""
    for name, part in parts.items() if isinstance(lost, _UNSENT) else ():
        try:
            pickle.dumps(part)
        except _UNSENT as error:
            raise InvalidInputError(
                f"{name}, executor",
                "must pickle to be sent to a worker",
                str(error),
                "Define functions at the top of a module, or leave the executor out.",
            ) from error


@final
class TimeLimit:
    """Context that raises KeyboardInterrupt in its thread after `seconds`, if not None.

    Integrators stop at a KeyboardInterrupt at any time; `expired` distinguishes it from one of the
    user. Unlike a signal it works in threads, in which the workers of Dask compute.
    """

    def __init__(self, seconds: float | None) -> None:
        # Waits longer than a timer can count are treated as no limit.
        self.seconds = None if seconds is not None and seconds > threading.TIMEOUT_MAX else seconds
        self.expired = self._left = False
        self._lock = threading.Lock()
        self._thread = 0
        self._timer = threading.Timer(self.seconds or 0.0, self._strike)
        self._timer.daemon = True

    def __enter__(self) -> TimeLimit:
        self._thread = threading.get_ident()
        if self.seconds is not None:
            self._timer.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Stop the timer; an interrupt already raised arrives here, at the call of `cancel`."""
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
