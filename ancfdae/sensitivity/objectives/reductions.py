"""Objectives of one observable: integral, values at times, smooth maximum.

Each is a function of the observable's values at the time points of the run, combined with
quadrature weights; all methods of differentiation use the same weights, so that they differentiate
the same number. Integrals over time are taken from the integrator if it computed them during its
steps (`Total`).
"""

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_finite, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import Density, Integrand, PartialIntegral, Points
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import STEP, Array, Numbers
from ancfdae.numerics.time_grid import TimeGrid
from ancfdae.sensitivity.objectives.objective import (
    NO_TOTALS,
    NonFiniteObjectiveError,
    Objective,
    ObjectivePartials,
    Totals,
)
from ancfdae.sensitivity.observables.expression import leaves
from ancfdae.sensitivity.observables.observable import Observable, ObservablePartials, States


class Reduction(Objective):
    """An objective computed from the values of one observable at the time points of a run."""

    observable: Observable

    def __post_init__(self) -> None:
        require_kind(
            "objective, observable",
            self.observable,
            (Observable,),
            "Build one from position(...), strain_energy(...) and so on.",
        )

    @abc.abstractmethod
    def check_times(self, t_end: float) -> None:
        """Raise InvalidInputError if the objective reads times outside the run."""

    @abc.abstractmethod
    def weights(self, grid: TimeGrid) -> Array:
        """Return the weight of every time point, (k,); zero where the value does not matter."""

    @abc.abstractmethod
    def reduce(self, x: Array, w: Array) -> Array:
        """Return the objective from the observable's values x, (k,), and nonzero weights w."""

    @abc.abstractmethod
    def slopes(self, x: Array, w: Array) -> Array:
        """Return the derivatives of `reduce` in real values x of the observable, shape of x."""

    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Raise if the system lacks the observable, or the run the times of the objective."""
        self.observable.check(system)
        self.check_times(t_end)

    def value(self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS) -> Any:
        """Return the objective from the observable's values, or from its integral in `totals`."""
        if self in totals:
            return totals[self].value()
        return self.of_values(self.observable.value(system, states), states.grid).item()

    def of_values(self, x: Array, grid: TimeGrid) -> Array:
        """Return the objective from the observable's values x, (k,), at the times of `grid`."""
        w = self.weights(grid)
        used = w != 0
        self._require_finite("the observable", x[used], grid.t[used])
        return self.reduce(x[used], w[used])

    def slopes_of_values(self, x: Array, grid: TimeGrid) -> Array:
        """Return the derivatives of `of_values` in the values x, shape (k,), at their real part."""
        w = self.weights(grid)
        used, slopes = w != 0, np.zeros(len(w))
        slopes[used] = self.slopes(x[used].real, w[used])
        return slopes

    def pulled_back(
        self, system: MechanicalSystem, states: States, nodes: dict[object, Array], slopes: Array
    ) -> ObservablePartials:
        """Return `slopes`, one per time point, times the partials of the observable.

        `nodes` are the observable's values at the states, `Observable.node_values`.
        """
        p = self.observable.weighted_partials(system, states, nodes, slopes)
        sums = sum(part.sum(axis=1) for part in (p.q, p.v, p.lam, p.b) if part is not None)
        self._require_finite("the derivative of the observable", np.asarray(sums), states.t)
        return p

    def partials(
        self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS
    ) -> ObjectivePartials:
        """Return value and partials of the objective in the states and the design variables."""
        if self in totals:
            return totals[self].partials()
        nodes = self.observable.node_values(system, states)
        x = list(nodes.values())[-1]
        value = float(self.of_values(x, states.grid))
        p = self.pulled_back(system, states, nodes, self.slopes_of_values(x, states.grid))
        return ObjectivePartials(value, p.q, p.v, p.lam, p.b.sum(axis=0))

    def _require_finite(self, what: str, x: Array, t: Array) -> None:
        bad = np.flatnonzero(~np.isfinite(x))
        if len(bad):
            raise NonFiniteObjectiveError(type(self).__name__, what, float(t[bad[0]].real))


class AtInstants(Reduction):
    """Sum of the observable at given times, interpolated with the order of the integrator."""

    @abc.abstractmethod
    def instants(self, t_end: float) -> tuple[float, ...]:
        """Return the times of the objective, s; InvalidInputError if the run ends before."""

    def check_times(self, t_end: float) -> None:
        """Raise InvalidInputError if the run ends before a time of the objective."""
        self.instants(t_end)

    def weights(self, grid: TimeGrid) -> Array:
        """Return the interpolation weights of the time points, (k,), summed over the times."""
        w = np.zeros(len(grid.t))
        for time in self.instants(float(grid.t[-1])):
            around, share = grid.interpolation(time)
            w[around] += share
        return w

    def reduce(self, x: Array, w: Array) -> Array:
        """Return the objective: the sum of the observable's values x, (k,), with weights w."""
        return np.asarray(w @ x)

    def slopes(self, x: Array, w: Array) -> Array:
        """Return the derivatives of the sum in the values x, (k,): the interpolation weights w."""
        return w


class OverTime(Reduction):
    """An objective that is a mean over time of a function of the observable, times a factor.

    The factor depends on the duration. Reducing the reductions of the parts of a run, weighted with
    their durations, gives the reduction of the whole run.
    """

    def check_times(self, t_end: float) -> None:
        """Accept every run: an integral over time reads no given times."""

    def weights(self, grid: TimeGrid) -> Array:
        """Return quadrature weights times the factor, (k,); one for a single time point."""
        w = grid.weights()
        return w * self.factor(float(np.sum(w))) if len(w) > 1 else np.ones(1)

    @abc.abstractmethod
    def factor(self, duration: float) -> float:
        """Return the factor of the quadrature weights of a run of this duration, s."""

    @abc.abstractmethod
    def integrand(self, x: Array, near: float) -> Array:
        """Return the integrand, shape of x: the reduction about its value `near`."""

    def integrand_slope(self, x: Array, near: float) -> Array:
        """Return the derivative of the integrand in the observable's value x, shape of x."""
        return np.asarray(self.integrand(x + 1j * STEP, near).imag / STEP)

    def slopes(self, x: Array, w: Array) -> Array:
        """Return derivatives of the objective in x: weights times slopes of the integrand, (k,)."""
        return w * self.integrand_slope(x, float(self.reduce(x, w)))


@final
@dataclass(frozen=True)
class Integral(OverTime):
    """Integral of an observable over the run; unit of the observable times s.

    `IDA`, `IDAS` and `DOP853` take it during their steps, to their tolerance, except of a
    `slope_angle`, whose turns are counted from one time point to the next. On the time points of a
    solution the quadrature has the order of the integrator: the trapezoidal rule on the steps of
    HHT, Gauss-Lobatto rules on the output times of the others.
    """

    observable: Observable

    def reduce(self, x: Array, w: Array) -> Array:
        """Return the integral over time, a scalar: the sum of quadrature weights times values."""
        return np.asarray(w @ x)

    def factor(self, duration: float) -> float:
        """Return one: the quadrature weights of a plain integral need no factor."""
        return 1.0

    def integrand(self, x: Array, near: float) -> Array:
        """Return the integrand of the objective, the observable's values x, in their shape."""
        return x


@final
@dataclass(frozen=True)
class Terminal(AtInstants):
    """Value of an observable at the end of the run."""

    observable: Observable

    def instants(self, t_end: float) -> tuple[float, ...]:
        """Return the only time that this objective reads, the end time, s."""
        return (t_end,)


@final
@dataclass(frozen=True)
class AtTimes(AtInstants):
    """Sum of the values of an observable at given times.

    Between the time points the observable is interpolated with the order of the integrator, for
    HHT by the cubic through four of them (docs/theory/07-objectives.md). At the time of an event,
    to 1e-12 of the run, the value is that before the event, with a warning
    (`UnlikelyValueWarning`): the value or its derivative may jump there.

    Parameters
    ----------
    observable : Observable
    times : float or sequence of float
        One time or several, none negative; s.
    """

    observable: Observable
    times: float | Numbers

    def __post_init__(self) -> None:
        super().__post_init__()
        given = cast(Any, self.times)
        times = tuple(given) if np.ndim(given) else (given,)
        for time in times:
            require_finite("AtTimes, times", time)
        if not times or min(times) < 0:
            raise InvalidInputError(
                "AtTimes, times",
                "must contain at least one time, none below 0",
                times,
                "For example times=np.linspace(0, t_end, 101).",
            )
        object.__setattr__(self, "times", tuple(float(time) for time in times))

    def instants(self, t_end: float) -> tuple[float, ...]:
        """Return the times of the objective, s; InvalidInputError if the run ends before."""
        times = cast("tuple[float, ...]", self.times)
        if max(times) > t_end * (1 + 1e-12):
            rule, repair = f"must not exceed {t_end:.6g}", "The run ends before; let it go on."
            raise InvalidInputError("AtTimes, times", rule, max(times), repair)
        return times


@dataclass(frozen=True)
class _Maximum(Reduction):
    """(1/k) log(sum of w exp(k x)) of an observable, with a sharpness k."""

    observable: Observable
    sharpness: float

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(f"{type(self).__name__}, sharpness", self.sharpness)

    def reduce(self, x: Array, w: Array) -> Array:
        """Return the scalar (1/k) log(sum of w exp(k x)), stable for large k x."""
        # SciPy's logsumexp takes 15 times as long, and integrators ask at every step.
        largest, k = np.max(x.real), self.sharpness
        return np.asarray(largest + np.log(w @ np.exp(k * (x - largest))) / k)


@final
@dataclass(frozen=True)
class SmoothMaximum(_Maximum, OverTime):
    """Smooth maximum over time, (1/k) log((1/T) int exp(k x) dt) (Kreisselmeier-Steinhauser).

    It lies below the maximum and tends to it as the sharpness k grows, with an error of the order
    of log(k)/k. The integral is taken as in `Integral`. The smooth minimum of x is
    ``-SmoothMaximum(-x, k)``.

    Parameters
    ----------
    observable : Observable
    sharpness : float
        k, in the inverse unit of the observable; positive.
    """

    def factor(self, duration: float) -> float:
        """Return one over the duration, which makes the integral a mean over time."""
        return 1.0 / duration

    def integrand(self, x: Array, near: float) -> Array:
        """Return exp(k (x - near)) / k, in the shape of the observable's values x."""
        return np.asarray(np.exp(self.sharpness * (x - near)) / self.sharpness)


@final
@dataclass(frozen=True)
class SmoothUpperBound(_Maximum):
    """Smooth upper bound of the values at all time points, (1/k) log(sum of exp(k x_n)).

    It lies above the largest by log(n)/k at most, n the number of time points: an observable whose
    bound is below a limit is below it at every time point of the run. Applied to
    `maximum_von_mises` it bounds the stress over place and time. It grows with the number of time
    points, so runs with other steps have another value, and `error_bars` says nothing about it;
    `SmoothMaximum`, which lies below the maximum, does not.

    Parameters
    ----------
    observable : Observable
    sharpness : float
        k, in the inverse unit of the observable; positive.
    """

    def check_times(self, t_end: float) -> None:
        """Accept every run: the bound reads no given times."""

    def weights(self, grid: TimeGrid) -> Array:
        """Weight one for every time point, shape (n_t,): the bound is a plain sum."""
        return np.ones(len(grid.t))

    def slopes(self, x: Array, w: Array) -> Array:
        """Return the share of each value in the sum of exponentials, shape of x."""
        return np.asarray(scipy.special.softmax(self.sharpness * x))


# -- integrals taken during the steps ----------------------------------------------------------


# Errors of derivatives in ln b are compared with at least _SMALL times the size of the value.
_SMALL = 1e-2


@final
class Total(Integrand):
    """Integrates one objective over time, part by part of a run.

    A part adds its reduction m, a mean of its values, and, if `differentiated`, dm/db: the total
    derivative where sensitivities are integrated, else the partial one at fixed states. At the end
    the parts are reduced with their durations: nothing overflows, and memory does not grow with the
    points.
    """

    def __init__(self, system: MechanicalSystem, reduction: OverTime, differentiated: bool) -> None:
        self._system, self._reduction, self._differentiated = system, reduction, differentiated
        self._parts: list[PartialIntegral] = []
        self._duration, self._size = 0.0, np.zeros(1 + system.n_b if differentiated else 1)
        self._b = np.where(system.b == 0, 1.0, np.abs(system.b))

    def part(self, points: Points) -> PartialIntegral:
        """Return the reduction of the observable over the points of a part, with its error."""
        reduction, observable, w = self._reduction, self._reduction.observable, points.weights
        states = _states(self._system, points)
        values = observable.node_values(self._system, states)
        x = list(values.values())[-1]
        duration = float(np.sum(w))
        w = w / duration
        value = float(reduction.reduce(x, w))
        rows = reduction.integrand(x, value)[:, None]
        slopes = np.zeros(self._system.n_b)
        if self._differentiated:
            weight = reduction.integrand_slope(x, value)
            partials = observable.weighted_partials(self._system, states, values, weight)
            x_b = partials.total(points.q_b, points.v_b, points.lam_b)
            slopes, rows = w @ x_b, np.concatenate([rows, x_b * self._b], axis=1)
        not_finite = None
        if not (finite(rows) and finite(x)):
            bad = ~np.isfinite(rows).all(axis=1) | ~np.isfinite(x)
            not_finite = float(points.t[np.argmax(bad)])
        size = points.weights_size @ np.abs(rows)
        error = self._error(points.errors(rows), size, duration)
        return PartialIntegral(duration, value, slopes, size, error, not_finite)

    def add(self, part: PartialIntegral) -> None:
        """Add the integral of the objective over a part of the run."""
        self._parts.append(part)
        self._duration, self._size = self._duration + part.duration, self._size + part.size

    def value(self) -> float:
        """Return the objective from the integrals of the parts of the run."""
        self._require_finite()
        return float(self._reduction.reduce(*self._means()))

    def partials(self) -> ObjectivePartials:
        """Return value and partials; b is the total derivative if sensitivities were integrated."""
        value, (x, w) = self.value(), self._means()
        b = self._reduction.slopes(x, w) @ np.array([part.slopes for part in self._parts])
        duration = sum(part.duration for part in self._parts)
        density = _OverTimeDensity(self._system, self._reduction, value)
        return ObjectivePartials(
            value, None, None, None, b, ((self._reduction.factor(duration), density),)
        )

    def _means(self) -> tuple[Array, Array]:
        x, w = np.array([(part.value, part.duration) for part in self._parts]).T
        return x, w * self._reduction.factor(float(np.sum(w)))

    def _error(self, errors: Array, size: Array, duration: float) -> float:
        """Return the largest error relative to the integral over this part or an average one."""
        usual = self._size * (duration / self._duration) if self._duration else 0.0
        scale = np.maximum(size, usual)
        scale = np.maximum(scale, _SMALL * scale[0])
        return float(np.max(np.divide(errors, scale, out=errors.copy(), where=scale != 0)))

    def _require_finite(self) -> None:
        for part in self._parts:
            if part.not_finite is not None:
                what = "the observable" if np.isnan(part.value) else "its derivative"
                raise NonFiniteObjectiveError(type(self._reduction).__name__, what, part.not_finite)


@final
class _OverTimeDensity(Density):
    """Partial derivatives of the integrand of a reduction about its value."""

    def __init__(self, system: MechanicalSystem, reduction: OverTime, value: float) -> None:
        self._system, self._reduction, self._value = system, reduction, value

    def partials(self, t: Array, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Return H_q and H_v, (k, n_q), and H_lam, (k, n_lam), by the chain rule."""
        states, observable = States(t, q, v, lam), self._reduction.observable
        values = observable.node_values(self._system, states)
        weight = self._reduction.integrand_slope(list(values.values())[-1], self._value)
        p = observable.weighted_partials(self._system, states, values, weight)
        on_q, on_v, on_lam = (
            np.zeros_like(x) if rows is None else rows
            for rows, x in ((p.q, q), (p.v, v), (p.lam, lam))
        )
        return on_q, on_v, on_lam


def totals_of(
    system: MechanicalSystem, objectives: Sequence[Objective], differentiated: bool
) -> dict[object, Total]:
    """Return a `Total` for each integral over time in the objectives.

    Integrals of observables with a memory, such as counts of turns, are left out: quadrature points
    within steps are visited in no order, and full turns are not part of a state.
    """
    all_leaves = [leaf for objective in objectives for leaf in leaves(objective)]
    integrals = (
        x for x in all_leaves if isinstance(x, OverTime) and not x.observable.remembers_any
    )
    return {x: Total(system, x, differentiated) for x in integrals}


def read_at_end(system: MechanicalSystem, objectives: Sequence[Objective], t_end: float) -> bool:
    """Return whether objectives depend on integrals during the steps and the last state alone."""
    integrated = totals_of(system, objectives, False)
    read = (x for each in objectives for x in leaves(each) if x not in integrated)
    return all(
        isinstance(x, AtInstants)
        and {*x.instants(t_end)} <= {t_end}
        and not x.observable.remembers_any
        for x in read
    )


def _states(system: MechanicalSystem, points: Points) -> States:
    lam = points.lam
    if lam is None:
        lam = np.full((len(points.t), system.n_lam), np.nan)
    return States(points.t, points.q, points.v, lam)
