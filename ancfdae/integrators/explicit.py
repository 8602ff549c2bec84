"""DOP853, an explicit Runge-Kutta method of order 8, on the index-1 form.

    q' = v,   v' = a(t, q, v),   q_b' = v_b,   v_b' = a_b(t, q, v, q_b, v_b)

with (a, lam) and (a_b, lam_b) from one factorised matrix per stage, which is one for the whole run
where M and Phi_q are constant. The drift of positions, velocities and their design derivatives from
the constraints is removed after each step and at the output times (`Accelerations.projected`).

The method for y'' = a(t, y, y') is that for (y, u)' = (u, a) (Hairer, Norsett & Wanner, II.10) with
coefficients A, B, C, E3, E5 and D of SciPy. As its stages have Y_i' = U_i, the positions Y are
linear in the accelerations K_j of the stages as well,

    U_i = u + h sum_j A_ij K_j,    Y_i = y + c_i h u + h^2 sum_j (A A)_ij K_j,

so that a stage is one product of a matrix, 2 x (2 + i), with the rows y, u, K_1, ..., K_i. A kernel
takes the steps and chooses their lengths (`kernels/explicit.h`).

The stages of a step make a quadrature of order 8 for functions of the states, with the error
estimate of the method. If the stages are too few for an integrand by that estimate, quadrature
points within the step come from its dense output.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, final

import numpy as np
import scipy

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.high_order import HighOrder, March, NotFinite
from ancfdae.integrators.integrator import Points, Rule
from ancfdae.integrators.problem import Accelerations, InitialValueProblem, stacked, vector_sizes
from ancfdae.integrators.quadrature import KRONROD, SHARES, Quadrature
from ancfdae.kernels import ERROR_TEST, NOT_FINITE, SINGULAR, ExplicitRun, finite
from ancfdae.numerics.arrays import Array

# Number of stages of a step, index of the state after it (the first stage of the next step), and
# number of stages with the three that only the dense output needs.
STAGES, _AFTER, _ALL = 12, 12, 16
# Exponent of the error estimate, which has order 7, in the step that follows from it.
EXPONENT = -1 / 8
# Which factors of the terms x, x (1 - x), x^2 (1 - x), ... of the dense output are 1 - x.
_TURNED = np.arange(7) % 2 == 1
# Indices into the control array of a step; its last two entries count evaluations and projections.
_T, _END, _H, _ERROR = range(4)
# Output times that one call of the kernel reports at most.
_TIMES = 64
# Least error of a step, in tolerances, in the choice of the next step size.
_NO_ERROR_BEFORE = 1e-4


class Tables(NamedTuple):
    """Coefficients of DOP853 for equations of second order.

    `stages` are coefficients of y, h u and h^2 K in Y, and of y, u and h K in U. `errors` are
    coefficients of the two error estimates, `nodes` the c_i, `within` coefficients of the rates in
    the last terms of the dense output.
    """

    stages: Array
    errors: Array
    nodes: Array
    within: Array


@cache
def tables() -> Tables:
    """Return the coefficients of DOP853 for equations of second order."""
    method = scipy.integrate.DOP853
    A = np.zeros((_ALL, _ALL))
    A[:STAGES, :STAGES], A[_AFTER, :STAGES], A[_AFTER + 1 :] = method.A, method.B, method.A_EXTRA
    c = np.concatenate([method.C, [1.0], method.C_EXTRA])
    stages = np.zeros((_ALL, 2, 2 + _ALL))
    stages[:, 0, 0] = stages[:, 1, 1] = 1.0
    stages[:, 0, 1], stages[:, 0, 2:], stages[:, 1, 2:] = c, A @ A, A
    E = np.stack([method.E5, method.E3])[:, :STAGES]
    return Tables(stages, np.stack([E @ A[:STAGES, :STAGES], E], axis=1), c, method.D)


@final
@dataclass(frozen=True)
class Between:
    """Dense output of a step from t to t + h, of order 7: y and u, (2, ...), at times within it."""

    t: float
    h: float
    start: Array
    terms: Array

    def __call__(self, t: Array | float) -> Array:
        """Return the states y and u at times t (s), shape (*t.shape, 2, ...)."""
        x = (np.asarray(t)[..., None] - self.t) / self.h
        weights = np.cumprod(np.where(_TURNED, 1 - x, x), axis=-1)
        moved = np.dot(weights, self.terms.reshape(len(_TURNED), -1))
        state: Array = self.start + moved.reshape(*weights.shape[:-1], *self.start.shape)
        return state


class Tolerances(NamedTuple):
    """Error tolerances of a step: `rtol` times the size of each vector, plus `floor`, (2, rows, n).

    Sizes of positions count from `place`, (n,), the mean position of the start; `vector`
    consecutive coordinates are the components of one vector.
    """

    rtol: float
    floor: Array
    place: Array
    vector: int


class Kept(NamedTuple):
    """Accepted steps that are stored for quadrature: `spans`, (k, 2), holds start and end time; s.

    `states`, (k, used, 2, rows, n), and `lam`, (k, used, rows, m), are states and multipliers at
    the stages with indices `used`.
    """

    spans: Array
    states: Array
    lam: Array
    used: Array

    @staticmethod
    def room(count: int, used: Array, rows: int, n: int, m: int) -> "Kept":
        """Return an empty store for the states of `count` steps."""
        shape = (count, len(used), rows)
        states = np.empty((count, len(used), 2, rows, n))
        return Kept(np.empty((count, 2)), states, np.empty((*shape, m)), used)

    def part(self, which: slice) -> "Kept":
        """Return the stored steps with indices `which`, as a view."""
        return Kept(self.spans[which], self.states[which], self.lam[which], self.used)


@final
class Dop853:
    """Steps of DOP853, one after another, of sizes that keep their errors within tolerances.

    Parameters
    ----------
    accelerations : Accelerations
        Equations that a step evaluates: (a, lam), and projections onto the constraints.
    t : float
        Time of the start; s.
    state : array, shape (2, rows, n)
        y and u at the start, above their design derivatives; units of the equations.
    found : array, shape (rows, n + m)
        a and lam of that state.
    h : float
        Size of the first step that is tried; s.

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
        _, rows, n = state.shape
        self._rows, self.states = np.zeros((2 + _ALL, rows * n)), np.zeros((_ALL, *state.shape))
        self._found = np.zeros((_ALL, *found.shape))
        self.states[0], self._found[0] = state, found
        self._rows[:2], self._rows[2] = state.reshape(2, -1), found[:, :n].ravel()
        self._control = np.array([t, t, h, _NO_ERROR_BEFORE, np.nan, 0.0, 0.0])
        step = self._rows, self.states, self._found, self._control
        self._run = ExplicitRun(accelerations.for_kernel(state.shape[1]), tables(), step)

    @property
    def t(self) -> float:
        """Time at which the last step of DOP853 starts; s."""
        return float(self._control[_T])

    @property
    def end(self) -> float:
        """Time at which the last step of DOP853 ends; s."""
        return float(self._control[_END])

    @property
    def error(self) -> float:
        """Estimated error of the last step over its tolerance; at least 1e-4."""
        return float(self._control[_ERROR])

    @property
    def after(self) -> Array:
        """State (positions, velocities) after the last step, shape (2, rows, n)."""
        state: Array = self.states[_AFTER]
        return state

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the accelerations so far."""
        return int(self._control[-2])

    def march(
        self, tolerances: Tolerances, times: Array, stop: float, kept: Kept
    ) -> tuple[int, int, Array]:
        """Take steps until one reaches the last time or `stop`, at most as many as `kept` holds.

        Return the kernel's code of a failure (zero without one), the number of steps taken, and the
        states at the passed `times`, (k, 2, rows, n).
        """
        count = min(len(kept.spans), self._accelerations.steps_at_once)
        found = self._run.march(tolerances, times, stop, count, kept)
        self._accelerations.count()
        return found

    def between(self) -> Between | None:
        """Return the dense output of the accepted step; None if its accelerations fail."""
        terms = self._run.terms()
        self._accelerations.count()
        if isinstance(terms, int):
            return None
        return Between(self.t, self.end - self.t, self.states[0].copy(), terms)


# Least relative tolerance: below it, the round-off of a step is as large as its error.
_LEAST_RTOL = 3e-14
# Absolute tolerance relative to the scales, per unit of rtol.
_SMALL = 1e-2
# Numbers of quadrature panels that are tried in a step whose stages are too few for an integrand.
_PANELS = (1, 4, 16)
# Steps that are added to the integrals in one batch, at least and at most, the growth from batch to
# batch, and the most numbers that their states may hold: an evaluation of observables costs several
# steps of a small system. Where stages are too few for an integrand, the steps of the batch are
# repeated for their dense output, which later steps store.
_LEAST_TOGETHER, _MOST_TOGETHER, _GROWTH, _NUMBERS = 8, 64, 4, 200_000
_NONE = np.zeros(0, dtype=np.int32)
_VERDICTS = {
    NOT_FINITE: Verdict.NOT_FINITE,
    SINGULAR: Verdict.SINGULAR,
    ERROR_TEST: Verdict.ERROR_TEST,
}


@final
@dataclass(frozen=True, repr=False)
class DOP853(HighOrder):
    """Explicit Runge-Kutta integration of order 8 with error control, for non-stiff scenes.

    The step is bounded by the highest frequency, so stiff scenes need many steps; a small system
    takes 5,000 in a second. Parameters: see `HighOrder`.
    """

    def __post_init__(self) -> None:
        self.require_settings(_LEAST_RTOL)

    def start(self, problem: InitialValueProblem, t_end: float, quadrature: Quadrature) -> March:
        """Set up a run by DOP853 from the consistent start of the system."""
        return _ExplicitMarch(self, problem, t_end, quadrature)


@cache
def _weighted() -> tuple[Array, Rule]:
    """Return the indices of the stages with quadrature weights, and their rule on a unit panel."""
    method = scipy.integrate.DOP853
    used = np.flatnonzero(method.B).astype(np.int32)
    return used, Rule(method.B[used], method.E5[used], method.E3[used])


@final
class _ExplicitMarch(March):
    """One run of DOP853; states are rows q and q_b, then v and v_b, shape (2, 1 + n_b, n_q)."""

    # Steps are long compared with steps of a low order, so contacts are checked within them.
    parts = (0.25, 0.5, 0.75, 1.0)

    def __init__(
        self, settings: DOP853, problem: InitialValueProblem, t_end: float, quadrature: Quadrature
    ) -> None:
        super().__init__(problem, t_end, settings.max_steps)
        self._quadrature, self._problem, self._wanted = quadrature, problem, quadrature.wanted
        first, b, s = problem.initial, problem.derivative, problem.scales
        state = stacked(first.q, first.v, *(b or ())[:2])
        _, rows, n = state.shape
        variables = np.concatenate([[1.0], s.b])[:rows, None]
        rtol, floor = settings.rtol, _SMALL * settings.rtol * stacked(s.q, s.v)
        vector = problem.system.vector_size
        self._tolerances = Tolerances(rtol, floor / variables, s.place, vector)
        found = self._accelerations(0.0, state)
        h = self._first_step(state, found[:, :n])
        self._method = Dop853(problem.accelerations, 0.0, state, found, h)
        used = _weighted()[0] if self._wanted else _NONE
        per_step = max(1, len(used)) * state.size
        count = max(_LEAST_TOGETHER, min(_MOST_TOGETHER, _NUMBERS // per_step))
        self._kept = Kept.room(count, used, rows, n, problem.system.n_lam)
        # Number of steps not yet added to the integrals, and their dense output where it is stored.
        self._together = _LEAST_TOGETHER
        self._waiting, self._dense, self._between = 0, False, list[Between | None]()
        self._failed, self._recorded = 0, np.zeros((0, *state.shape))

    def _first_step(self, state: Array, acceleration: Array) -> float:
        """Guess the first step, s (Hairer, Norsett & Wanner, II.4), with t_end as unit of time."""
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

    def _steps(self, times: Array) -> list[float] | Verdict:
        if self._failed:
            return _VERDICTS[self._failed]
        first = self._waiting if self._wanted else 0
        count = 1 if self._dense or self.contacts else self._max_steps - self.steps
        count = min(count, self._together - first) if self._wanted else count
        kept = self._kept.part(slice(first, first + count))
        self._failed, taken, self._recorded = self._march(times, kept)
        self.steps += taken
        if not taken:
            return _VERDICTS[self._failed]
        if self._wanted:
            self._waiting += taken
            self._between += [self._dense_output() if self._dense else None] * taken
            if self._waiting == self._together:
                self.finish()
        ends: list[float] = kept.spans[:taken, 1].tolist()
        return ends

    def _march(self, times: Array, kept: Kept) -> tuple[int, int, Array]:
        """Take steps towards `times`, at most as many as `kept` can store; see `Dop853.march`."""
        method = self._method
        evaluations = method.evaluations
        found = method.march(self._tolerances, times[:_TIMES], self._stop, kept)
        self.residuals += method.evaluations - evaluations
        return found

    def _dense_output(self) -> Between:
        before = self._method.evaluations
        between = self._method.between()
        self.residuals += self._method.evaluations - before
        if between is None:
            raise NotFinite
        return between

    def _states(self, times: Array) -> Array:
        failed, _, states = self._march(times, self._kept.part(slice(0, 0)))
        if failed:
            raise SingularMatrix if failed == SINGULAR else NotFinite
        return states

    def _reported(self, times: Array) -> Array:
        states, self._recorded = self._recorded, self._recorded[:0]
        return states if len(states) else self._states(times)

    def finish(self) -> None:
        self._dense = False
        if self._waiting:
            steps = self._kept.part(slice(0, self._waiting))
            self._quadrature.add(self._choices(steps, self._between))
            self._waiting, self._between = 0, []
            most = _LEAST_TOGETHER if self._dense else len(self._kept.spans)
            self._together = min(_GROWTH * self._together, most)

    def _choices(self, steps: Kept, dense: list[Between | None]) -> Iterator[Points]:
        """Yield quadrature points of steps: their stages, then dense output on ever more panels."""
        used, rule = _weighted()
        left, h = steps.spans[:, 0], np.diff(steps.spans, axis=1)[:, 0]
        t = left[:, None] + h[:, None] * tables().nodes[used]
        states, lam = (x.reshape(t.size, *x.shape[2:]) for x in (steps.states, steps.lam))
        yield _points(rule, h, t.ravel(), states, lam)
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
        """Return the dense output of stored step k, which is taken again without error control."""
        (left, right), state = steps.spans[k].tolist(), steps.states[k, 0]
        found = self._accelerations(left, state)
        method = Dop853(self._problem.accelerations, left, state, found, 2 * (right - left))
        any_error = self._tolerances._replace(floor=np.full_like(self._tolerances.floor, np.inf))
        nothing = Kept.room(1, _NONE, state.shape[1], state.shape[2], steps.lam.shape[-1])
        method.march(any_error, np.array([right]), right, nothing)
        self.residuals += method.evaluations
        between = method.between()
        if between is None:
            raise NotFinite
        return between

    def _accelerations(self, t: float, state: Array) -> Array:
        """Return a and lam, above their design derivatives, of a state; shape (rows, n + m)."""
        self.residuals += 1
        found = self._problem.accelerations.rows(t, *state) if finite(state) else state
        if not finite(found):
            raise NotFinite
        return found


def _mean(x: Array) -> float:
    """Return the root mean square of the entries of x."""
    return math.sqrt(np.vdot(x, x) / x.size)


def _points(rule: Rule, h: Array, t: Array, states: Array, lam: Array | None = None) -> Points:
    q, v, derivatives = states[:, 0], states[:, 1], states.shape[2] > 1
    q_b, v_b, lam_b = (
        x[:, 1:].swapaxes(1, 2) if derivatives and x is not None else None for x in (q, v, lam)
    )
    return Points(rule, h, t, q[:, 0], v[:, 0], q_b, v_b, None if lam is None else lam[:, 0], lam_b)
