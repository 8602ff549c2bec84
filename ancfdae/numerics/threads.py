"""One thread for the libraries of linear algebra while a computation of this package runs.

The matrices of a mechanism are small: a factorisation takes microseconds. The threads of a BLAS
library then spend more time in waiting for each other than in the factorisation. (A step of `Radau`
on a spatial beam of ten elements takes twenty to eighty times as long with two threads.)

The limit of OpenBLAS holds for the whole process. Computations that need it are therefore counted:
the first one sets it, the last one restores the user's setting, in whatever Python thread it ends.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from functools import cache, wraps
from threading import RLock
from typing import Any, ParamSpec, TypeVar, final

# Packages whose import loads a linear algebra library of their own.
_BRINGERS = ("numpy.linalg", "scipy.linalg", "sksundae", "sundials4py")


@final
class _Pools:
    """Thread pools of BLAS libraries: computations that need one thread, and former settings."""

    def __init__(self) -> None:
        # Reentrant: a signal handler may compute while its own thread holds the lock.
        self._lock = RLock()
        self._holders: set[object] = set()
        self._before: dict[str, tuple[Any, int]] = {}

    def hold(self, holder: object) -> None:
        """Limit all loaded BLAS libraries to one thread until `release` of the same holder."""
        controller = _controller(tuple(name in sys.modules for name in _BRINGERS))
        with self._lock:
            first = not self._holders
            self._holders.add(holder)
            wide = [x for x in controller.lib_controllers if (x.num_threads or 1) > 1]
            for library in wide:
                # A formula of the user may have changed the limit that another holder set.
                if first or library.filepath not in self._before:
                    self._before[library.filepath] = library, library.num_threads
                library.set_num_threads(1)
            if wide:
                _disown(controller)

    def hold_loaded(self) -> None:
        """Limit the libraries that a running computation has just loaded to one thread, too."""
        with self._lock:
            for holder in list(self._holders)[:1]:
                self.hold(holder)

    def release(self, holder: object) -> None:
        """Restore all limits if no other holder needs them; calling it again does no harm."""
        with self._lock:
            self._holders.discard(holder)
            if self._before and not self._holders:
                for library, count in self._before.values():
                    library.set_num_threads(count)
                _disown(_controller(tuple(name in sys.modules for name in _BRINGERS)))
                # Where another thread of the user has a block of threadpoolctl, only that thread
                # can restore a limit: it does so after its next computation, or its block does.
                kept = {path: x for path, x in self._before.items() if x[0].num_threads != x[1]}
                self._before = kept


@cache
def _controller(_loaded: tuple[bool, ...]) -> Any:
    """Return the controller of BLAS libraries, a new one after another library was loaded."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


def _disown(controller: Any) -> None:
    """Let any thread change the limits next.

    From version 3.7 of threadpoolctl on, the thread that set a limit of OpenBLAS is the only one
    that can change it, until it leaves a block of its own.
    """
    with controller.limit():
        pass


_POOLS = _Pools()


@final
class _Block:
    """A `with` block that needs one BLAS thread; entered and left twice (`in_one_thread`)."""

    _holds = False

    def __enter__(self) -> None:
        if self._holds:
            return
        try:
            _POOLS.hold(self)
            self._holds = True
        except BaseException:
            # Ctrl-C may have interrupted `hold` half way.
            _POOLS.release(self)
            raise

    def __exit__(self, *_: object) -> None:
        _POOLS.release(self)


def lapack() -> Any:
    """Return the capsules of SciPy's LAPACK routines by name, for the kernels.

    The kernels load them at the first wide band. SciPy then loads a library of its own, which is
    limited to one thread like those loaded before.
    """
    capsules = importlib.import_module("scipy.linalg.cython_lapack").__pyx_capi__
    _POOLS.hold_loaded()
    return capsules


_P = ParamSpec("_P")
_R = TypeVar("_R")


def in_one_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the function with BLAS libraries limited to one thread during every call.

    Calls may be nested and may run in several Python threads; the user's limits are restored when
    the last one ends, be it by an exception or by Ctrl-C.
    """

    @wraps(function)
    def limited(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        block = _Block()
        # Ctrl-C may arrive as the block is left, before its first line; then it is left once more.
        with block, block:
            return function(*args, **kwargs)

    return limited
