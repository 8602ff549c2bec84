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

from ancfdae.errors import AncfdaeError, Verdict
from ancfdae.integrators.high_order import NotFinite

_RECOVERABLE, _FATAL = 1, -1


@final
class MissingPackage(AncfdaeError, ImportError):
    """An optional package that is not installed; the message says how to install it."""


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

    def verdict(self, flag: int) -> Verdict:
        """Translate the return code of a failed step."""
        idas = self.idas
        known = {
            idas.IDA_TOO_MUCH_WORK: Verdict.STEP_LIMIT,
            idas.IDA_TOO_MUCH_ACC: Verdict.TOO_ACCURATE,
            idas.IDA_ERR_FAIL: Verdict.ERROR_TEST,
            idas.IDA_LSETUP_FAIL: Verdict.SINGULAR,
            idas.IDA_LSOLVE_FAIL: Verdict.SINGULAR,
            idas.IDA_REP_RES_ERR: Verdict.NOT_FINITE,
            idas.IDA_RES_FAIL: Verdict.NOT_FINITE,
            idas.IDA_SRES_FAIL: Verdict.NOT_FINITE,
            idas.IDA_REP_SRES_ERR: Verdict.NOT_FINITE,
            idas.IDA_FIRST_RES_FAIL: Verdict.NOT_FINITE,
        }
        return known.get(flag, Verdict.NO_CONVERGENCE)


@final
class Guard:
    """Runs callbacks and keeps what they raise."""

    def __init__(self) -> None:
        self._error: BaseException | None = None
        self._not_finite = False

    def run(self, callback: Callable[[], None]) -> int:
        """Return zero, or the code that stops the solver; not finite is recoverable."""
        try:
            callback()
        except NotFinite:
            self._not_finite = True
            return _RECOVERABLE
        except BaseException as error:  # noqa: BLE001  # raised again outside the C code
            self._error = error
            return _FATAL
        return 0

    def raise_kept(self) -> bool:
        """Raise what a callback raised since the last call; return whether one was not finite."""
        error, self._error = self._error, None
        not_finite, self._not_finite = self._not_finite, False
        if error is not None:
            raise error
        return not_finite
