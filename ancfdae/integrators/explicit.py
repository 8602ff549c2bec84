"""Explicit Runge-Kutta of order 8 (DOP853, Hairer, Norsett & Wanner) on the index-1 form.

    q' = v,   v' = a(t, q, v),   q_b' = v_b,   v_b' = a_b(t, q, v, q_b, v_b)

with (a, lam) and (a_b, lam_b) from one factorised matrix per stage, which is one for the whole run
where M and Phi_q are constant. What positions, velocities and their derivatives drift from the
constraints is removed after each step and from the instants (`Accelerations.projected`).

The stages of a step make a quadrature of order 8 for functions of the states, with the error
estimate of the method; where that says that they are too few for an integrand, points within the
step come from its dense output.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, final

import numpy as np
import scipy

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.dop853 import EXPONENT, Between, Dop853
from ancfdae.integrators.high_order import HighOrder, March, NotFinite
from ancfdae.integrators.index_1 import ListedAccelerations, stacked
from ancfdae.integrators.integrand import Points, Rule
from ancfdae.integrators.problem import InitialValueProblem, vector_sizes
from ancfdae.integrators.quadrature import KRONROD, SHARES, Quadrature
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array

# Below this, the round-off of a step is as large as its error.
_LEAST_RTOL = 3e-14
# Absolute tolerance relative to the scales, per unit of rtol.
_SMALL = 1e-2
# Change of the step: part of what the error estimate asks for, least and largest. The error before
# takes part (Soderlind's PI.4.2): near the stability limit, or where the error estimate oscillates,
# the step then settles below the limit instead of being rejected repeatedly.
_SAFETY, _LEAST, _LARGEST = 0.95, 0.2, 10.0
_NOW, _BEFORE = 0.6, -0.2
# Errors that count as no less, now and before.
_NO_ERROR, _NO_ERROR_BEFORE = 1e-10, 1e-4
# Shortest step, in gaps between floating-point numbers at its begin.
_SHORTEST = 10
# Panels of a step whose stages are too few.
_PANELS = (1, 4, 16)
# Steps that are taken into the integrals together: an evaluation of observables costs half a step.
# Where stages are too few, these steps are repeated, and the next ones keep their dense output.
_TOGETHER = 8


@final
@dataclass(frozen=True, repr=False)
class DOP853(HighOrder):
    """Explicit integration of order 8 with error control; for soft scenes.

    The step is bounded by the highest frequency, so stiff scenes need many steps; a small system
    takes 5,000 in a second. Parameters: see `HighOrder`.
    """

    def __post_init__(self) -> None:
        self.require_settings(_LEAST_RTOL)

    def start(self, problem: InitialValueProblem, t_end: float, quadrature: Quadrature) -> March:
        """Set up a run by DOP853 from the start of the system."""
        return _ExplicitMarch(self, problem, t_end, quadrature)


@cache
def _weighted() -> tuple[Array, Rule]:
    """Return which stages carry weight, the first is the state before, and their quadrature."""
    method = scipy.integrate.DOP853
    used = np.flatnonzero(method.B)
    return used, Rule(method.B[used], method.E5[used], method.E3[used])


class _Step(NamedTuple):
    """A step from left to right, the state before it, and its stages that carry weight.

    Multipliers and their derivatives are rows, (k, 1 + n_b, n_lam).
    """

    left: float
    right: float
    t: Array
    states: Array
    multipliers: Array
    between: Between | None


@final
class _ExplicitMarch(March):
    """One run; states are rows q and q_b, then v and v_b, shape (2, 1 + n_b, n_q)."""

    def __init__(
        self, settings: DOP853, problem: InitialValueProblem, t_end: float, quadrature: Quadrature
    ) -> None:
        super().__init__(problem, t_end, settings.max_steps)
        self._quadrature, self._problem, self._rtol = quadrature, problem, settings.rtol
        self._trouble, self._multipliers = Verdict.ERROR_TEST, list[Array]()
        self._wanted = quadrature.wanted
        self._steps, self._dense, self._between = list[_Step](), False, list[Between]()
        first, b, s = problem.initial, problem.derivative, problem.scales
        rows = stacked(first.q, first.v, *(b or ())[:2])
        variables = np.concatenate([[1.0], s.b])[: rows.shape[1], None]
        self._floor = _SMALL * self._rtol * np.stack([s.q, s.v])[:, None] / variables
        self._method = self._dop853(0.0, rows)
        self._before = self._multipliers[:1]
        self._h, self._error = self._first_step(), _NO_ERROR_BEFORE

    def _dop853(self, t: float, rows: Array) -> Dop853:
        together = isinstance(self._problem.accelerations, ListedAccelerations)
        return Dop853(self._accelerations, t, rows, self._stages if together else None)

    def _first_step(self) -> float:
        """Guess the first step (Hairer, Norsett & Wanner, II.4); the unit of time is t_end."""
        method, T = self._method, self._t_end
        state = method.states[0]
        rate = T * np.stack([state[1], method.accelerations[0]])
        sizes = self._sizes(state)
        scale = self._floor + self._rtol * sizes
        size, speed = _mean(sizes / scale), _mean(rate / scale)
        share = 1e-6 if min(size, speed) < 1e-5 else min(0.01 * size / speed, 1.0)
        moved = state + share * rate
        try:
            later = T * np.stack([moved[1], self._accelerations(share * T, moved)])
        except (NotFinite, SingularMatrix):
            return share * T
        fastest = max(_mean((later - rate) / scale) / share, speed)
        if not math.isfinite(fastest):
            return share * T
        longest = (0.01 / fastest) ** -EXPONENT if fastest > 0 else 1.0
        return T * min(100 * share, longest, 1.0)

    def _step(self) -> Verdict | None:
        method, largest = self._method, _LARGEST
        self._trouble = Verdict.ERROR_TEST
        if self.steps:
            method.advance()
        stop = self._stop
        while self._h >= _SHORTEST * math.ulp(method.t):
            error = self._attempt(min(method.t + self._h, stop))
            h = method.end - method.t
            if error < 1:
                ratio = max(error, _NO_ERROR) ** _NOW * self._error**_BEFORE
                self._h = h * min(largest, _SAFETY * ratio**EXPONENT)
                self._error = max(error, _NO_ERROR_BEFORE)
                self._accept()
                return None
            self._h, largest = h * max(_LEAST, _SAFETY * error**EXPONENT), 1.0
        return self._trouble

    def _attempt(self, end: float) -> float:
        """Try a step and return its error, in tolerances; infinite where the equations fail."""
        method = self._method
        self._multipliers.clear()
        try:
            after = method.attempt(end)
            scale = np.maximum(self._sizes(method.states[0]), self._sizes(after))
            scale *= self._rtol
            scale += self._floor
            fine, coarse = map(_mean, method.errors() / scale)
            error = fine * (fine / (math.hypot(fine, 0.1 * coarse) or 1.0))
            if error < 1 and not finite(method.accept(self._projected(end, after))):
                raise NotFinite
        except NotFinite:
            self._trouble = Verdict.NOT_FINITE
        except SingularMatrix:
            self._trouble = Verdict.SINGULAR
        else:
            return error
        return np.inf

    def _sizes(self, rows: Array) -> Array:
        """Return the sizes of vectors of a state, of positions from the place of the system."""
        rows = rows.copy()
        rows[0, 0] -= self._problem.scales.place
        return vector_sizes(rows, self._problem.system.vector_size)

    def _accept(self) -> None:
        """Accept the step; store its stages for the dense output if integrals are wanted."""
        method = self._method
        self.steps += 1
        self._t, self._between = method.end, []
        if not self._wanted:
            return
        used, t = _weighted()[0], method.times()
        multipliers = np.array([*self._before, *self._multipliers])
        self._before = self._multipliers[-1:]
        between = self._dense_output() if self._dense else None
        kept = t[used], method.states[used], multipliers[used], between
        self._steps.append(_Step(method.t, method.end, *kept))
        if len(self._steps) == _TOGETHER:
            self.finish()

    def _dense_output(self) -> Between:
        if not self._between:
            self._between = [self._method.between()]
        return self._between[0]

    def _states(self, times: Array) -> Array:
        method = self._method
        within = times[times < method.end]
        if not len(within):
            return np.array([method.after for _ in times])
        states = self._dense_output()(within)
        if not finite(states):
            raise NotFinite
        if self._problem.system.n_lam:
            states = self._problem.accelerations.projected_of(within, states)
        return np.concatenate([states, *([method.after[None]] * (len(times) - len(within)))])

    def finish(self) -> None:
        self._dense = False
        if self._steps:
            self._quadrature.add(self._choices(self._steps))
            self._steps = []

    def _choices(self, steps: list[_Step]) -> Iterator[Points]:
        """Points within steps: their stages, then their dense output on ever more panels."""
        h = np.array([x.right - x.left for x in steps])
        t, states, multipliers = (
            np.concatenate(parts)
            for parts in zip(*((x.t, x.states, x.multipliers) for x in steps), strict=True)
        )
        points = _points(_weighted()[1], h, t, states)
        lam, lam_b = multipliers[:, 0], multipliers[:, 1:].swapaxes(1, 2)
        yield replace(points, lam=lam, lam_b=None if points.q_b is None else lam_b)
        self._dense = True
        dense = [x.between or self._repeated(x) for x in steps]
        for n in _PANELS:
            shares = (np.arange(n)[:, None] + SHARES).ravel() / n
            within = [np.minimum(x.left + shares * (x.right - x.left), x.right) for x in steps]
            rows = [between(times) for between, times in zip(dense, within, strict=True)]
            yield _points(
                KRONROD, np.repeat(h / n, n), np.concatenate(within), np.concatenate(rows)
            )

    def _repeated(self, step: _Step) -> Between:
        """Return the dense output of a step that was accepted before."""
        method = self._dop853(step.left, step.states[0])
        method.accept(self._projected(step.right, method.attempt(step.right)))
        return method.between()

    def _projected(self, t: float, rows: Array) -> Array:
        if not finite(rows):
            raise NotFinite
        problem = self._problem
        return problem.accelerations.projected(t, rows) if problem.system.n_lam else rows

    def _accelerations(self, t: float, rows: Array) -> Array:
        """Return a above a_b, and keep the multipliers."""
        self.residuals += 1
        if not finite(rows):
            raise NotFinite
        problem = self._problem
        x, n = problem.accelerations.rows(t, rows[0], rows[1]), rows.shape[2]
        if self._wanted:
            self._multipliers.append(x[:, n:])
        return x[:, :n]

    def _stages(self, times: Array, step: tuple[Array, ...], first: int, last: int) -> None:
        """Compute stages together, and keep the multipliers."""
        accelerations, n = self._problem.accelerations, step[2].shape[3]
        assert isinstance(accelerations, ListedAccelerations)
        self.residuals += last - first
        x = accelerations.stages(times, step, first, last)[first:last]
        if not finite(x):
            raise NotFinite
        if self._wanted:
            self._multipliers.extend(x[:, :, n:])


def _mean(x: Array) -> float:
    """Return the root mean square of the entries of x."""
    return math.sqrt(np.vdot(x, x) / x.size)


def _points(rule: Rule, h: Array, t: Array, states: Array) -> Points:
    q, v = states[:, 0], states[:, 1]
    derivatives = (q[:, 1:].swapaxes(1, 2), v[:, 1:].swapaxes(1, 2)) if q.shape[1] > 1 else ()
    return Points(rule, h, t, q[:, 0], v[:, 0], *derivatives)
