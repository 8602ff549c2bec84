"""The one place that imports sundials4py, which has no wheel for Python 3.11.

Callbacks run inside C code, through which no exception may pass: `Guard` keeps the first one and
answers with a return code.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors import AncfdaeError, MissingPackage, Verdict
from ancfdae.integrators.high_order import NotFinite

_RECOVERABLE, _FATAL = 1, -1
# Return codes of IDA and IDAS, see their manuals.
_FAILURES = {
    -1: Verdict.STEP_LIMIT,
    -2: Verdict.TOO_ACCURATE,
    -3: Verdict.ERROR_TEST,
    -4: Verdict.NO_CONVERGENCE,
    **dict.fromkeys((-6, -7), Verdict.SINGULAR),
    **dict.fromkeys((-8, -9, -12, -41, -42), Verdict.NOT_FINITE),
}


@final
@dataclass(frozen=True)
class Bindings:
    """Modules of sundials4py."""

    core: Any
    idas: Any

    @staticmethod
    def load() -> Bindings:
        """Import sundials4py, or raise MissingPackage."""
        try:
            core = importlib.import_module("sundials4py.core")
            idas = importlib.import_module("sundials4py.idas")
        except ImportError as error:
            version = ".".join(str(part) for part in sys.version_info[:2])
            raise MissingPackage(
                f"IDAS: needs the package sundials4py; got Python {version} without it. Its wheels "
                "need Python 3.12 or newer: python3.12 -m pip install sundials4py. IDA, Explicit "
                "and HHT work without it."
            ) from error
        return Bindings(core, idas)

    def vector(self, context: Any, values: Any) -> Any:
        """Return a new N_Vector with these values."""
        vector = self.core.N_VNew_Serial(len(values), context)
        self.core.N_VGetNumpyArray(vector)[:] = values
        return vector

    def array(self, vector: Any) -> Any:
        """Return a view; it is invalid once the vector is freed."""
        return self.core.N_VGetNumpyArray(vector)

    def check(self, flag: int) -> None:
        """Refuse a return code of a set-up call that is an error."""
        if flag < 0:
            name = self.idas.IDAGetReturnFlagName(flag)
            raise AncfdaeError(f"IDAS: a call to set it up failed with {name}. Please report this.")


def verdict(flag: int) -> Verdict:
    """Translate the return code of a failed step."""
    return _FAILURES.get(flag, Verdict.NO_CONVERGENCE)


@final
class Guard:
    """Runs callbacks and keeps what they raise."""

    def __init__(self) -> None:
        self._error: BaseException | None = None
        self._not_finite = False

    def callback(self, evaluate: Callable[..., None]) -> Callable[..., int]:
        """Wrap a function for C code; not finite is a recoverable failure."""

        def run(*arguments: Any) -> int:
            try:
                evaluate(*arguments)
            except NotFinite:
                self._not_finite = True
                return _RECOVERABLE
            except BaseException as error:  # noqa: BLE001  # raised again outside the C code
                self._error = error
                return _FATAL
            return 0

        return run

    def raise_kept(self) -> bool:
        """Raise what a callback raised since the last call; return whether one was not finite."""
        error, self._error = self._error, None
        not_finite, self._not_finite = self._not_finite, False
        if error is not None:
            raise error
        return not_finite
