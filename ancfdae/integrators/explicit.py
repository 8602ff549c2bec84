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
from typing import final

import numpy as np
import scipy

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.dop853 import EXPONENT, Between, Dop853, Kept, Tolerances, tables
from ancfdae.integrators.high_order import HighOrder, March, NotFinite
from ancfdae.integrators.index_1 import stacked
from ancfdae.integrators.integrand import Points, Rule
from ancfdae.integrators.problem import InitialValueProblem, vector_sizes
from ancfdae.integrators.quadrature import KRONROD, SHARES, Quadrature
from ancfdae.kernels import ERROR_TEST, NOT_FINITE, SINGULAR, finite
from ancfdae.numerics.arrays import Array

# Below this, the round-off of a step is as large as its error.
_LEAST_RTOL = 3e-14
# Absolute tolerance relative to the scales, per unit of rtol.
_SMALL = 1e-2
# Panels of a step whose stages are too few.
_PANELS = (1, 4, 16)
# Steps that are taken into the integrals together, at least and at most, and the numbers that their
# states may be: an evaluation of observables costs several steps of a small system. There are twice
# as many each time. Where stages are too few, these steps are repeated, and the next ones keep
# their dense output.
_LEAST_TOGETHER, _MOST_TOGETHER, _NUMBERS = 8, 64, 200_000
_NONE = np.zeros(0, dtype=np.int32)
_VERDICTS = {
    NOT_FINITE: Verdict.NOT_FINITE,
    SINGULAR: Verdict.SINGULAR,
    ERROR_TEST: Verdict.ERROR_TEST,
}


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
    used = np.flatnonzero(method.B).astype(np.int32)
    return used, Rule(method.B[used], method.E5[used], method.E3[used])


@final
class _ExplicitMarch(March):
    """One run; states are rows q and q_b, then v and v_b, shape (2, 1 + n_b, n_q)."""

    def __init__(
        self, settings: DOP853, problem: InitialValueProblem, t_end: float, quadrature: Quadrature
    ) -> None:
        super().__init__(problem, t_end, settings.max_steps)
        self._quadrature, self._problem, self._wanted = quadrature, problem, quadrature.wanted
        first, b, s = problem.initial, problem.derivative, problem.scales
        state = stacked(first.q, first.v, *(b or ())[:2])
        _, rows, n = state.shape
        variables = np.concatenate([[1.0], s.b])[:rows, None]
        rtol, floor = settings.rtol, _SMALL * settings.rtol * np.stack([s.q, s.v])[:, None]
        place = np.broadcast_to(s.place, n)
        self._tolerances = Tolerances(rtol, floor / variables, place, problem.system.vector_size)
        found = self._accelerations(0.0, state)
        h = self._first_step(state, found[:, :n])
        self._method = Dop853(problem.accelerations, 0.0, state, found, h)
        used = _weighted()[0] if self._wanted else _NONE
        per_step = max(1, len(used)) * state.size
        count = max(_LEAST_TOGETHER, min(_MOST_TOGETHER, _NUMBERS // per_step))
        self._kept = Kept.room(count, used, rows, n, problem.system.n_lam)
        # Steps that wait for their integrals, and their dense output where that is kept.
        self._together = _LEAST_TOGETHER
        self._waiting, self._dense, self._between = 0, False, list[Between | None]()
        self._last: Between | None = None
        self._failed = 0

    def _first_step(self, state: Array, acceleration: Array) -> float:
        """Guess the first step (Hairer, Norsett & Wanner, II.4); the unit of time is t_end."""
        T, (rtol, floor, place, vector) = self._t_end, self._tolerances
        rate = T * np.stack([state[1], acceleration])
        centred = state.copy()
        centred[0, 0] -= place
        sizes = vector_sizes(centred, vector)
        scale = floor + rtol * sizes
        size, speed = _mean(sizes / scale), _mean(rate / scale)
        share = 1e-6 if min(size, speed) < 1e-5 else min(0.01 * size / speed, 1.0)
        moved = state + share * rate
        try:
            found = self._accelerations(share * T, moved)
        except (NotFinite, SingularMatrix):
            return share * T
        later = T * np.stack([moved[1], found[:, : state.shape[2]]])
        fastest = max(_mean((later - rate) / scale) / share, speed)
        if not math.isfinite(fastest):
            return share * T
        longest = (0.01 / fastest) ** -EXPONENT if fastest > 0 else 1.0
        return T * min(100 * share, longest, 1.0)

    def _steps(self, target: float) -> list[float] | Verdict:
        if self._failed:
            return _VERDICTS[self._failed]
        method, first = self._method, self._waiting if self._wanted else 0
        count = 1 if self._dense else self._max_steps - self.steps
        count = min(count, self._together - first) if self._wanted else count
        kept = self._kept.part(slice(first, first + count))
        evaluations = method.evaluations
        self._failed, taken = method.march(self._tolerances, target, self._stop, kept)
        self.residuals += method.evaluations - evaluations
        self.steps += taken
        if not taken:
            return _VERDICTS[self._failed]
        self._last = None
        if self._wanted:
            self._waiting += taken
            self._between += [self._dense_output() if self._dense else None] * taken
            if self._waiting == self._together:
                self.finish()
        ends: list[float] = kept.spans[:taken, 1].tolist()
        return ends

    def _dense_output(self) -> Between:
        if self._last is None:
            before = self._method.evaluations
            self._last = self._method.between()
            self.residuals += self._method.evaluations - before
        if self._last is None:
            raise NotFinite
        return self._last

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
        if self._waiting:
            steps = self._kept.part(slice(0, self._waiting))
            self._quadrature.add(self._choices(steps, self._between))
            self._waiting, self._between = 0, []
            most = _LEAST_TOGETHER if self._dense else len(self._kept.spans)
            self._together = min(2 * self._together, most)

    def _choices(self, steps: Kept, dense: list[Between | None]) -> Iterator[Points]:
        """Points within steps: their stages, then their dense output on ever more panels."""
        used, rule = _weighted()
        left, h = steps.spans[:, 0], np.diff(steps.spans, axis=1)[:, 0]
        t = left[:, None] + h[:, None] * tables().nodes[used]
        states, lam = (x.reshape(t.size, *x.shape[2:]) for x in (steps.states, steps.lam))
        points, lam_b = _points(rule, h, t.ravel(), states), lam[:, 1:].swapaxes(1, 2)
        yield replace(points, lam=lam[:, 0], lam_b=None if points.q_b is None else lam_b)
        self._dense = True
        between = [x or self._repeated(steps, k) for k, x in enumerate(dense)]
        for n in _PANELS:
            shares = (np.arange(n)[:, None] + SHARES).ravel() / n
            within = [np.minimum(a + shares * (b - a), b) for a, b in steps.spans]
            rows = [x(times) for x, times in zip(between, within, strict=True)]
            yield _points(
                KRONROD, np.repeat(h / n, n), np.concatenate(within), np.concatenate(rows)
            )

    def _repeated(self, steps: Kept, k: int) -> Between:
        """Return the dense output of a step that was accepted before."""
        (left, right), state = steps.spans[k].tolist(), steps.states[k, 0]
        found = self._accelerations(left, state)
        method = Dop853(self._problem.accelerations, left, state, found, 2 * (right - left))
        any_error = self._tolerances._replace(floor=np.full_like(self._tolerances.floor, np.inf))
        nothing = Kept.room(1, _NONE, state.shape[1], state.shape[2], steps.lam.shape[-1])
        method.march(any_error, right, right, nothing)
        self.residuals += method.evaluations
        between = method.between()
        if between is None:
            raise NotFinite
        return between

    def _accelerations(self, t: float, state: Array) -> Array:
        """Return (a, lam) above its derivatives, shape (rows, n + m)."""
        self.residuals += 1
        found = self._problem.accelerations.rows(t, *state) if finite(state) else state
        if not finite(found):
            raise NotFinite
        return found


def _mean(x: Array) -> float:
    """Return the root mean square of the entries of x."""
    return math.sqrt(np.vdot(x, x) / x.size)


def _points(rule: Rule, h: Array, t: Array, states: Array) -> Points:
    q, v = states[:, 0], states[:, 1]
    derivatives = (q[:, 1:].swapaxes(1, 2), v[:, 1:].swapaxes(1, 2)) if q.shape[1] > 1 else ()
    return Points(rule, h, t, q[:, 0], v[:, 0], *derivatives)
