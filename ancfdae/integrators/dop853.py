"""Steps of DOP853 (Hairer, Norsett & Wanner, II.10) for y'' = a(t, y, y').

The method is that for (y, u)' = (u, a) with coefficients A, B, C, E3, E5 and D of SciPy. As its
stages have Y_i' = U_i, those of y are linear in the accelerations K_j of the stages as well,

    U_i = u + h sum_j A_ij K_j,    Y_i = y + c_i h u + h^2 sum_j (A A)_ij K_j,

so that a stage is one product of a matrix, 2 x (2 + i), with the rows y, u, K_1, ..., K_i. A kernel
takes the steps and chooses their lengths (`kernels/explicit.h`).
"""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, final

import numpy as np
import scipy

from ancfdae.integrators.index_1 import Accelerations
from ancfdae.kernels import explicit_march, explicit_stages
from ancfdae.numerics.arrays import Array

# Stages of a step, the state after it (which is the first stage of the next), and those that only
# its dense output needs.
STAGES, _AFTER, _ALL = 12, 12, 16
# Exponent of the error estimate, which has order 7, in the step that follows from it.
EXPONENT = -1 / 8
# Which factors of the terms x, x (1 - x), x^2 (1 - x), ... of the dense output are 1 - x.
_TURNED = np.arange(7) % 2 == 1
# Places in the control of a step; its last numbers are of evaluations and projections.
_T, _END, _H, _ERROR = range(4)
# An error that counts as no less, in tolerances.
_NO_ERROR_BEFORE = 1e-4


class Tables(NamedTuple):
    """Coefficients of y, h u and h^2 K in Y, and of y, u and h K in U; of errors; and nodes."""

    stages: Array
    errors: Array
    nodes: Array


@cache
def tables() -> Tables:
    """Return the coefficients of the method for equations of second order."""
    method = scipy.integrate.DOP853
    A = np.zeros((_ALL, _ALL))
    A[:STAGES, :STAGES], A[_AFTER, :STAGES], A[_AFTER + 1 :] = method.A, method.B, method.A_EXTRA
    c = np.concatenate([method.C, [1.0], method.C_EXTRA])
    stages = np.zeros((_ALL, 2, 2 + _ALL))
    stages[:, 0, 0] = stages[:, 1, 1] = 1.0
    stages[:, 0, 1], stages[:, 0, 2:], stages[:, 1, 2:] = c, A @ A, A
    E = np.stack([method.E5, method.E3])[:, :STAGES]
    return Tables(stages, np.stack([E @ A[:STAGES, :STAGES], E], axis=1), c)


@final
@dataclass(frozen=True)
class Between:
    """Dense output of a step from t to t + h, of order 7: y, u as (2, ...) at any time in it."""

    t: float
    h: float
    start: Array
    terms: Array

    def __call__(self, t: Array | float) -> Array:
        """Return the states at times, shape (*t.shape, 2, ...)."""
        x = (np.asarray(t)[..., None] - self.t) / self.h
        weights = np.cumprod(np.where(_TURNED, 1 - x, x), axis=-1)
        moved = np.dot(weights, self.terms.reshape(len(_TURNED), -1))
        state: Array = self.start + moved.reshape(*weights.shape[:-1], *self.start.shape)
        return state


class Tolerances(NamedTuple):
    """Tolerances of a step, relative to the size of each vector, and absolute as (2, rows, n).

    Sizes of positions count from the `place` of the system, (n,); `vector` coordinates in a row are
    the components of one vector.
    """

    rtol: float
    floor: Array
    place: Array
    vector: int


class Kept(NamedTuple):
    """Accepted steps: begin and end, states and multipliers of the stages `used`.

    Shapes (k, 2), (k, used, 2, rows, n) and (k, used, rows, m).
    """

    spans: Array
    states: Array
    lam: Array
    used: Array

    @staticmethod
    def room(count: int, used: Array, rows: int, n: int, m: int) -> "Kept":
        """Return room for a number of steps."""
        shape = (count, len(used), rows)
        states = np.empty((count, len(used), 2, rows, n))
        return Kept(np.empty((count, 2)), states, np.empty((*shape, m)), used)

    def part(self, which: slice) -> "Kept":
        """Return the part of some steps."""
        return Kept(self.spans[which], self.states[which], self.lam[which], self.used)


@final
class Dop853:
    """One step after the other, of lengths that keep their errors within tolerances.

    Parameters
    ----------
    accelerations : Accelerations
        Equations whose (a, lam) and projections a step takes.
    t : float
        Time of the start; s.
    state : array, shape (2, rows, n)
        y and u at the start, above their derivatives; units of the equations.
    found : array, shape (rows, n + m)
        a and lam of that state.
    h : float
        Length of the first step that is tried; s.

    Attributes
    ----------
    states : array, shape (16, 2, rows, n)
        States (units of the equations) at the stages: before the step, within and after it, and at
        the points that only `between` needs.
    """

    def __init__(
        self, accelerations: Accelerations, t: float, state: Array, found: Array, h: float
    ) -> None:
        self._accelerations = accelerations
        self._equations = accelerations.for_kernel(state.shape[1])
        _, rows, n = state.shape
        self._rows, self.states = np.zeros((2 + _ALL, rows * n)), np.zeros((_ALL, *state.shape))
        self._found = np.zeros((_ALL, *found.shape))
        self.states[0], self._found[0] = state, found
        self._rows[:2], self._rows[2] = state.reshape(2, -1), found[:, :n].ravel()
        self._control = np.array([t, t, h, _NO_ERROR_BEFORE, 0.0, 0.0])
        self._step = self._rows, self.states, self._found, self._control

    @property
    def t(self) -> float:
        """Time at which the last step begins; s."""
        return float(self._control[_T])

    @property
    def end(self) -> float:
        """Time at which the last step ends; s."""
        return float(self._control[_END])

    @property
    def error(self) -> float:
        """Error of the last step, in tolerances, at least 1e-4."""
        return float(self._control[_ERROR])

    @property
    def after(self) -> Array:
        """State (positions, velocities) after the step, shape (2, rows, n)."""
        state: Array = self.states[_AFTER]
        return state

    @property
    def evaluations(self) -> int:
        """Number of evaluations of accelerations."""
        return int(self._control[-2])

    def march(
        self, tolerances: Tolerances, target: float, stop: float, kept: Kept
    ) -> tuple[int, int]:
        """Take steps until one reaches the target or the stop, at most those there is room for.

        Return why there are no more, zero where there may be, and how many were taken.
        """
        before, at_once = self._control[-2:].copy(), self._accelerations.steps_at_once
        count = min(len(kept.spans), at_once)
        fixed = self._equations, tables(), self._step, tolerances
        found = explicit_march(*fixed, target, stop, count, kept)
        self._accelerations.count(*(self._control[-2:] - before).astype(int).tolist())
        return found

    def between(self) -> Between | None:
        """Return the dense output of the accepted step; None where its equations fail."""
        before = self.evaluations
        failed = explicit_stages(self._equations, tables(), self._step, _AFTER + 1, _ALL)
        self._accelerations.count(self.evaluations - before, 0)
        if failed:
            return None
        flat = self.states.reshape(_ALL, 2, -1)
        h, start, end = self.end - self.t, flat[0], flat[_AFTER]
        terms = np.empty((len(_TURNED), *start.shape))
        # Rates of y and of u at the stages.
        for k, rates in enumerate((flat[:, 1], self._rows[2:])):
            rise, first, last = end[k] - start[k], h * rates[0], h * rates[_AFTER]
            terms[:3, k] = rise, first - rise, 2 * rise - first - last
            terms[3:, k] = h * np.dot(scipy.integrate.DOP853.D, rates)
        return Between(self.t, h, self.states[0].copy(), terms)
