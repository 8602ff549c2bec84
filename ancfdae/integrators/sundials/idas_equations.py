"""Memory of IDAS for an index-reduced form, and the callbacks that it calls."""

from typing import Any, final

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.integrators.high_order import NotFinite
from ancfdae.integrators.sundials.bindings import Bindings, Guard
from ancfdae.integrators.sundials.index_reduced import IndexReduced
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array

# The bindings offer dense matrices only; this many unknowns take 200 MB.
_MOST_UNKNOWNS = 5000
# Safety factor of the Newton test against the error test. With the 0.33 of IDAS what the iteration
# leaves behind upsets the error estimate: a Cartesian pendulum takes 1.5 to 2 times the steps and
# ends 10 to 50 times further off, at every tolerance from 1e-6 to 1e-12.
_NEWTON = 0.01


@final
class IdasEquations:
    """Memory of IDAS for a form started at y and y', and the callbacks that it calls.

    The functions of IDAS take `memory` as first argument and write their results to y and yp;
    `last` is the largest entry of the last finite residual.
    """

    def __init__(
        self, bindings: Bindings, form: IndexReduced, rtol: float, start: tuple[Array, Array]
    ) -> None:
        core, idas, check = bindings.core, bindings.idas, bindings.check
        self._bindings, self._form, self.guard, self.last = bindings, form, Guard(), 0.0
        if form.n > _MOST_UNKNOWNS:
            raise InvalidInput(
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
