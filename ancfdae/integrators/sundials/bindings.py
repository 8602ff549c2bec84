"""Memory and callbacks of the solver IDAS; the only module that imports sundials4py.

The package has no wheel for Python 3.11. Callbacks run inside C code, through which no exception
may pass: `Guard` stores the first one and returns an error code.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.errors.kinds import AncfdaeError, InvalidInputError, MissingPackageError
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.high_order import NotFinite
from ancfdae.integrators.sundials.index_reduced import IndexReduced
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array

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
    """The modules `core` and `idas` of the package sundials4py."""

    core: Any
    idas: Any

    @staticmethod
    def load() -> Bindings:
        """Return the modules of sundials4py; raise MissingPackageError if it is not installed."""
        try:
            core = importlib.import_module("sundials4py.core")
            idas = importlib.import_module("sundials4py.idas")
        except ImportError as error:
            version = ".".join(str(part) for part in sys.version_info[:2])
            raise MissingPackageError(
                f"IDAS: needs the package sundials4py; got Python {version} without it. Its wheels "
                "need Python 3.12 or newer: python3.12 -m pip install sundials4py. IDA, DOP853 "
                "and HHT work without it."
            ) from error
        return Bindings(core, idas)

    def vector(self, context: Any, values: Any) -> Any:
        """Return a new N_Vector that holds `values`."""
        vector = self.core.N_VNew_Serial(len(values), context)
        self.core.N_VGetNumpyArray(vector)[:] = values
        return vector

    def array(self, vector: Any) -> Any:
        """Return a view of an N_Vector as an array; it is invalid once the vector is freed."""
        return self.core.N_VGetNumpyArray(vector)

    def check(self, flag: int) -> None:
        """Raise AncfdaeError if the return code of a set-up call of IDAS is an error."""
        if flag < 0:
            name = self.idas.IDAGetReturnFlagName(flag)
            raise AncfdaeError(f"IDAS: a call to set it up failed with {name}. Please report this.")


def verdict(flag: int) -> Verdict:
    """Return why a step failed, from the return code of IDA or IDAS."""
    return _FAILURES.get(flag, Verdict.NO_CONVERGENCE)


@final
class Guard:
    """Runs Python callbacks inside C code and stores the exceptions that they raise."""

    def __init__(self) -> None:
        self._error: BaseException | None = None
        self._not_finite = False

    def callback(self, evaluate: Callable[..., None]) -> Callable[..., int]:
        """Wrap a function for C code; NotFinite is a recoverable failure, others are fatal."""

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
        """Raise the exception of a callback since the last call; return whether one met NaN."""
        error, self._error = self._error, None
        not_finite, self._not_finite = self._not_finite, False
        if error is not None:
            raise error
        return not_finite


# The bindings offer dense matrices only; this many unknowns take 200 MB.
_MOST_UNKNOWNS = 5000
# Safety factor of the Newton test against the error test. With the 0.33 of IDAS the remaining
# residual disturbs the error estimate: a Cartesian pendulum takes 1.5 to 2 times the steps and its
# error is 10 to 50 times larger, at every tolerance from 1e-6 to 1e-12.
_NEWTON = 0.01


@final
class IdasEquations:
    """Memory of IDAS for an index-reduced form started at y and y', and the callbacks it calls.

    The functions of IDAS take `memory` as first argument and write their results to y and yp;
    `last` is the largest entry of the last finite scaled residual (dimensionless).
    """

    def __init__(
        self, bindings: Bindings, form: IndexReduced, rtol: float, start: tuple[Array, Array]
    ) -> None:
        core, idas, check = bindings.core, bindings.idas, bindings.check
        self._bindings, self._form, self.guard, self.last = bindings, form, Guard(), 0.0
        if form.n > _MOST_UNKNOWNS:
            raise InvalidInputError(
                "IDAS",
                f"solves densely, up to {_MOST_UNKNOWNS} unknowns",
                form.n,
                "Use IDA, or fewer elements.",
            )
        call = self.guard.callback
        flag, self.context = core.SUNContext_Create(0)
        check(flag)
        # Outcomes report failures, so messages of the C code are kept off the terminal.
        check(core.SUNContext_ClearErrHandlers(self.context))
        # The view owns the memory: it must live as long as the memory is used.
        self._view = idas.IDACreate(self.context)
        self.memory = self._view.get()
        self.y = bindings.vector(self.context, start[0])
        self.yp = bindings.vector(self.context, start[1])
        check(idas.IDAInit(self.memory, call(self._residual), 0.0, self.y, self.yp))
        self._tolerances = bindings.vector(self.context, form.tolerances(rtol))
        check(idas.IDASVtolerances(self.memory, rtol, self._tolerances))
        self._matrix = core.SUNDenseMatrix(form.n, form.n, self.context)
        self._solver = core.SUNLinSol_Dense(self.y, self._matrix, self.context)
        check(idas.IDASetLinearSolver(self.memory, self._solver, self._matrix))
        check(idas.IDASetJacFn(self.memory, call(self._jacobian)))
        check(idas.IDASetNonlinConvCoef(self.memory, _NEWTON))

    def _residual(self, t: float, y: Any, yp: Any, R: Any, _: Any) -> None:
        array = self._bindings.array
        value = self._form.residual(t, array(y), array(yp))
        if not finite(value):
            raise NotFinite
        self.last = float(np.max(np.abs(value)))
        array(R)[:] = value

    def _jacobian(self, t: float, c_j: float, y: Any, yp: Any, R: Any, J: Any, *_: Any) -> None:
        array, form = self._bindings.array, self._form
        values = form.jacobian(t, array(y), array(yp), c_j)
        if not finite(values):
            raise NotFinite
        dense = self._bindings.core.SUNDenseMatrix_Data(J)
        flat = np.bincount(form.columns * form.n + form.rows, values, minlength=form.n**2)
        dense[:] = flat.reshape(form.n, form.n).T
