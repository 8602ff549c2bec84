"""The integrator IDA of SUNDIALS (package scikit-sundae) on index-reduced equations.

Sensitivities are appended to the system and error-controlled with it. The iteration matrix is exact
for the states; the blocks that couple the sensitivities to them are one-sided differences of that
matrix along the sensitivities, which affects the convergence of Newton's method only.

Guards that the wrapper lacks: steps are taken one by one and counted, a solver that has not
factorised is never freed, views are copied, residuals that are not finite end the run.

scikit-sundae prints error messages and has no switch for it; they are kept off the terminal: the
outcome of a run reports the same.
"""

import ctypes
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TextIO, final

import numpy as np
import scipy

from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.high_order import March, NotFinite
from ancfdae.integrators.problem import InitialValueProblem, stacked
from ancfdae.integrators.quadrature import Quadrature
from ancfdae.integrators.sundials.bindings import verdict
from ancfdae.integrators.sundials.index_reduced import ColumnStorage, StepPoints, SundialsIntegrator
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array

# Start of every message that scikit-sundae prints.
_MESSAGE = "\n[IDA"


@contextmanager
def without_messages() -> Iterator[None]:
    """Suppress messages that SUNDIALS prints inside the block; other output is printed."""
    stream = sys.stdout
    if isinstance(stream, _Unmessaged):  # Another thread suppresses messages already.
        stream = stream.stream
    if stream is not None:
        sys.stdout = _Unmessaged(stream)
    try:
        yield
    finally:
        sys.stdout = stream


@final
class _Unmessaged:
    """An output stream that drops messages of SUNDIALS."""

    def __init__(self, stream: TextIO) -> None:
        self.stream, self._dropped = stream, False

    def write(self, text: str) -> int:
        """Write the text, unless it is a message of SUNDIALS or the line end after one."""
        message = text.startswith(_MESSAGE)
        if message or (self._dropped and text == "\n"):
            self._dropped = message
            return len(text)
        self._dropped = False
        return self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


# Relative change of a design variable in the differences that give the coupling blocks.
_CHANGE = 1e-6
# Unknowns up to which the matrix is dense: a factorisation of SuperLU_MT starts a thread, which
# takes a millisecond however small the matrix.
_MOST_DENSE = 100
# Corrector iterations per step: the sensitivities are linear in themselves, so they need one more
# than the states.
_ITERATIONS = 6


@final
@dataclass(frozen=True, repr=False)
class IDA(SundialsIntegrator):
    """Variable-order BDF of SUNDIALS with error control.

    The error of a run is 10 to 200 times `rtol`: 1e-8 is good for a cross-check, 1e-10 for a
    reference. A small system takes 10,000 steps in a second. Parameters: see `HighOrder`, and
    `IndexReduction` for `form`.
    """

    def start(self, problem: InitialValueProblem, t_end: float, quadrature: Quadrature) -> March:
        """Set up a run by IDA from the consistent start of the system."""
        return _IdaMarch(self, problem, t_end, quadrature)


@final
class _IdaMarch(March):
    """One run of IDA; the vector y holds the scaled states, then a block per design variable."""

    def __init__(
        self, settings: IDA, problem: InitialValueProblem, t_end: float, quadrature: Quadrature
    ) -> None:
        super().__init__(problem, t_end, settings.max_steps, without_messages)
        self._form = settings.form.form(problem.system, problem.scales)
        system, b = problem.system, problem.derivative
        self._m = 0 if b is None else system.n_b
        scale = problem.scales.b
        self._moved = [
            system.with_values(system.b + _CHANGE * scale * unit)
            for unit in np.eye(system.n_b)[: self._m]
        ]
        self._storage = ColumnStorage(self._form, self._m)
        Y, Yp = self._form.start(problem.initial)
        if b is not None:
            blocks, rates = self._form.start_b(b)
            Y, Yp = np.append(Y, blocks.T), np.append(Yp, rates.T)
        self._y = Y
        self._points = StepPoints(self._form, quadrature, self._m)
        self._points.add(0.0, Y, Yp)
        self._solver = self._set_up(settings)
        _keep(self._solver)
        self._solver.init_step(0.0, Y, Yp)

    def _steps(self, times: Array) -> list[float] | Verdict:
        result = self._solver.step(self._t_end, "onestep", self._stop)
        if not result.success:
            return verdict(result.status)
        if self.steps == 0:
            _release(self._solver)
        # After an interpolation IDA returns its last step once more before it goes on.
        if result.t > self._t:
            self.steps += 1
            self._y = result.y.copy()
            if self._points.wanted:
                self._points.add(result.t, self._y, result.yp.copy())
        return [result.t]

    def _states(self, times: Array) -> Array:
        return np.array([self._state(t) for t in times.tolist()])

    def _state(self, t: float) -> Array:
        y = self._y
        if self._t != t:
            y = self._solver.step(t, "normal", self._t_end).y.copy()
        if not finite(y):
            raise NotFinite
        states, blocks = self._split(y)
        derivatives = self._form.coordinates_b(blocks) if self._m else ()
        return stacked(*self._form.coordinates(states), *derivatives)

    def finish(self) -> None:
        self._points.finish()

    def _set_up(self, settings: IDA) -> Any:
        import sksundae

        tolerances = np.tile(self._form.tolerances(settings.rtol), self._m + 1)
        size = len(self._y)
        rows, columns = self._storage.sparsity()
        options: dict[str, Any] = {"linsolver": "dense"}
        if size > _MOST_DENSE:
            pattern = scipy.sparse.csc_matrix((np.ones(len(rows)), (rows, columns)), (size, size))
            options = {"linsolver": "sparse", "sparsity": pattern}
        with warnings.catch_warnings():
            # The warning says that the pattern is not used for difference quotients, rightly.
            warnings.filterwarnings("ignore", message="Custom sparse Jacobian")
            return sksundae.ida.IDA(
                self._fill_residual,
                jacfn=self._fill_jacobian,
                **options,
                rtol=settings.rtol,
                atol=tolerances,
                max_nonlin_iters=_ITERATIONS,
            )

    def _split(self, y: Array) -> tuple[Array, Array]:
        n = self._form.n
        return y[:n], y[n:].reshape(self._m, n).T

    def _fill_residual(self, t: float, y: Array, yp: Array, R: Array) -> None:
        self.residuals += 1
        self.iterations += 1  # One residual each; the wrapper has no other count.
        (x, Y), (xp, Yp) = self._split(y), self._split(yp)
        n = self._form.n
        R[:n] = self._form.residual(t, x, xp)
        if self._m:
            R[n:] = self._form.residual_b(t, x, xp, Y, Yp).T.ravel()
        if not finite(R):
            raise NotFinite
        self.residual = float(np.max(np.abs(R[:n])))

    def _fill_jacobian(self, t: float, y: Array, yp: Array, R: Array, c_j: float, J: Array) -> None:
        self.factorisations += 1
        (x, Y), (xp, Yp) = self._split(y), self._split(yp)
        jacobian = self._form.jacobian(t, x, xp, c_j)
        below = [
            (
                self._form.jacobian(
                    t, x + _CHANGE * Y[:, i], xp + _CHANGE * Yp[:, i], c_j, self._moved[i]
                )
                - jacobian
            )
            / _CHANGE
            for i in range(self._m)
        ]
        values = self._storage.values(jacobian, below)
        if not finite(values):
            raise NotFinite
        if J.ndim == 1:
            J[:] = values
        else:
            J[self._storage.sparsity()] = values  # The other entries stay zero.


def _keep(solver: Any) -> None:
    """Add a reference to a solver, so that it is never freed, not even at exit.

    Freed before its first factorisation, it ends the process (its linear solver then frees memory
    that it never got). A solver whose first step fails is therefore left in memory.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(solver))


def _release(solver: Any) -> None:
    """Remove the extra reference to a solver after its first successful step."""
    ctypes.pythonapi.Py_DecRef(ctypes.py_object(solver))
