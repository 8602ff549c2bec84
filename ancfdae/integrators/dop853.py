"""Steps of DOP853 (Hairer, Norsett & Wanner, II.10) for y'' = a(t, y, y').

The method is that for (y, u)' = (u, a) with coefficients A, B, C, E3, E5 and D of SciPy. As its
stages have Y_i' = U_i, those of y are linear in the accelerations K_j of the stages as well,

    U_i = u + h sum_j A_ij K_j,    Y_i = y + c_i h u + h^2 sum_j (A A)_ij K_j,

so that a stage is one product of a matrix, 2 x (2 + i), with the rows y, u, K_1, ..., K_i.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, TypeAlias, final

import numpy as np
import scipy

from ancfdae.numerics.arrays import Array

# Stages of a step, the state after it (which is the first stage of the next), and those that only
# its dense output needs.
STAGES, _AFTER, _ALL = 12, 12, 16
# Exponent of the error estimate, which has order 7, in the step that follows from it.
EXPONENT = -1 / 8
# Which factors of the terms x, x (1 - x), x^2 (1 - x), ... of the dense output are 1 - x.
_TURNED = np.arange(7) % 2 == 1


#: Computes stages together; see `Dop853`.
Stages: TypeAlias = Callable[[Array, tuple[Array, ...], int, int], None]


class _Tableau(NamedTuple):
    """Coefficients of y, h u and h^2 K in Y, and of y, u and h K in U; of errors likewise."""

    c: Array
    stages: Array
    errors: Array
    between: Array


@cache
def _tableau() -> _Tableau:
    method = scipy.integrate.DOP853
    A = np.zeros((_ALL, _ALL))
    A[:STAGES, :STAGES], A[_AFTER, :STAGES], A[_AFTER + 1 :] = method.A, method.B, method.A_EXTRA
    c = np.concatenate([method.C, [1.0], method.C_EXTRA])
    stages = np.zeros((_ALL, 2, 2 + _ALL))
    stages[:, 0, 0] = stages[:, 1, 1] = 1.0
    stages[:, 0, 1], stages[:, 0, 2:], stages[:, 1, 2:] = c, A @ A, A
    E = np.stack([method.E5, method.E3])[:, :STAGES]
    errors = np.stack([E @ A[:STAGES, :STAGES], E], axis=1)
    return _Tableau(c, stages, errors, method.D)


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


@final
class Dop853:
    """One step after the other; who calls it chooses their lengths.

    Parameters
    ----------
    accelerations : callable
        Return a, shape (...), at a time and a state (y, u) of shape (2, ...). What it raises
        leaves the state before the step as it was.
    t : float
        Time of the start; s.
    state : array, shape (2, ...)
        y and u at t = 0; units of the equations.
    stages : callable, optional
        Compute stages from a first to a last one together: the accelerations and the states, from
        their times, and from factors, rows and states as above; state shape (2, rows, n).

    Attributes
    ----------
    t, end : float
        Times at which the step begins and ends; s.
    states, accelerations : array, shape (16, 2, ...) and (16, ...)
        States and accelerations at the stages, in units of the coordinates: before the step, within
        and after it, and at the points that only `between` needs.
    """

    def __init__(
        self,
        accelerations: Callable[[float, Array], Array],
        t: float,
        state: Array,
        stages: Stages | None = None,
    ) -> None:
        self._evaluated, self._together = accelerations, stages
        n = state[0].size
        self._rows = np.empty((2 + _ALL, n))
        self.states = np.empty((_ALL, *state.shape))
        self._flat = self.states.reshape(_ALL, 2, n)
        self.accelerations = self._rows[2:].reshape(_ALL, *state.shape[1:])
        self._powers, self._factors = np.ones((2, 2 + _ALL)), _tableau().stages.copy()
        # Of each: factors, the rows they multiply, and where the state and its acceleration go.
        self._stages = [
            (self._factors[i, :, : 2 + i], self._rows[: 2 + i], self._flat[i], *kept)
            for i, kept in enumerate(zip(self.states, self.accelerations, strict=True))
        ]
        self.t, self.end = t, t
        self._enter(state, accelerations(t, state))

    def _enter(self, state: Array, acceleration: Array) -> None:
        self.states[0], self.accelerations[0] = state, acceleration
        self._rows[:2] = self._flat[0]

    @property
    def after(self) -> Array:
        """State (positions, velocities) after the step, shape (2, ...)."""
        state: Array = self.states[_AFTER]
        return state

    def times(self) -> Array:
        """Return the times of the states."""
        return self.t + (self.end - self.t) * _tableau().c

    def attempt(self, end: float) -> Array:
        """Compute the stages of a step; return the state after it."""
        self.end, h = end, end - self.t
        self._powers[0, 1], self._powers[0, 2:], self._powers[1, 2:] = h, h * h, h
        np.multiply(_tableau().stages, self._powers, out=self._factors)
        self._evaluate(1, STAGES)
        factors, rows, flat, *_ = self._stages[_AFTER]
        np.dot(factors, rows, out=flat)
        return self.after

    def _evaluate(self, first: int, last: int) -> None:
        if self._together is not None:
            self._together(self.times(), (self._factors, self._rows, self.states), first, last)
            return
        times = self.times().tolist()
        for i in range(first, last):
            factors, rows, flat, state, acceleration = self._stages[i]
            np.dot(factors, rows, out=flat)
            acceleration[:] = self._evaluated(times[i], state)

    def errors(self) -> Array:
        """Return the two error estimates, of order 5 and 3, each of the shape of a state."""
        E = _tableau().errors * self._powers[:, 2:3]
        return (E @ self._rows[2 : 2 + STAGES]).reshape(2, *self.states.shape[1:])

    def accept(self, state: Array) -> Array:
        """Set the state after the step, corrected by projection; return its accelerations."""
        self.states[_AFTER] = state
        after: Array = self.accelerations[_AFTER]
        after[:] = self._evaluated(self.end, self.after)
        return after

    def advance(self) -> None:
        """Begin the next step where the accepted one ends."""
        self.t = self.end
        self._enter(self.after, self.accelerations[_AFTER])

    def between(self) -> Between:
        """Return the dense output of the accepted step."""
        self._evaluate(_AFTER + 1, _ALL)
        h, start, end = self.end - self.t, self._flat[0], self._flat[_AFTER]
        terms = np.empty((len(_TURNED), *start.shape))
        # Rates of y and of u at the stages.
        for k, rates in enumerate((self._flat[:, 1], self._rows[2:])):
            rise, first, last = end[k] - start[k], h * rates[0], h * rates[_AFTER]
            terms[:3, k] = rise, first - rise, 2 * rise - first - last
            terms[3:, k] = h * np.dot(_tableau().between, rates)
        return Between(self.t, h, self.states[0].copy(), terms)
