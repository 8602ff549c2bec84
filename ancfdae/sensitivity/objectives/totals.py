"""Integrals of objectives that an integrator takes beside the motion."""

from collections.abc import Sequence
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.integrators.integrand import Density, Integrand, PartialIntegral, Points
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.objectives.objective import (
    Integrated,
    NonFiniteObjectiveError,
    Objective,
    ObjectivePartials,
)
from ancfdae.sensitivity.objectives.reductions import AtInstants, OverTime
from ancfdae.sensitivity.observables.expression import leaves
from ancfdae.sensitivity.observables.states import States

# Relative size of the value below which errors of its derivatives in ln b do not count.
_SMALL = 1e-2


@final
class Total(Integrand, Integrated):
    """Collects one objective over time part by part.

    A part adds its reduction m, that of the values as a mean, and, if `differentiated`, dm/db: the
    total one where sensitivities are integrated, else that with the states held. The parts are
    reduced with their durations: nothing overflows, and memory does not grow with the points.
    """

    def __init__(self, system: MechanicalSystem, reduction: OverTime, differentiated: bool) -> None:
        self._system, self._reduction, self._differentiated = system, reduction, differentiated
        self._parts: list[PartialIntegral] = []
        self._duration, self._size = 0.0, np.zeros(1 + system.n_b if differentiated else 1)
        self._b = np.where(system.b == 0, 1.0, np.abs(system.b))

    def part(self, points: Points) -> PartialIntegral:
        """Reduce the observable over the points."""
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
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1) | ~np.isfinite(x))
        not_finite = float(points.t[bad[0]]) if len(bad) else None
        size = points.weights_size @ np.abs(rows)
        error = self._error(points.errors(rows), size, duration)
        return PartialIntegral(duration, value, slopes, size, error, not_finite)

    def add(self, part: PartialIntegral) -> None:
        """Add the integral over a part of the run."""
        self._parts.append(part)
        self._duration, self._size = self._duration + part.duration, self._size + part.size

    def value(self) -> float:
        """Return the objective from the integrals of the parts of the run."""
        self._require_finite()
        return float(self._reduction.reduce(*self._means()))

    def partials(self) -> ObjectivePartials:
        """Value and derivative of the reduced parts."""
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
        """Largest error relative to the integral of this part, or to that of a usual one."""
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
    """Partials of the integrand of a reduction near its value."""

    def __init__(self, system: MechanicalSystem, reduction: OverTime, value: float) -> None:
        self._system, self._reduction, self._value = system, reduction, value

    def partials(self, t: Array, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Chain rule at every state."""
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
    """Return a collector for each integral that the objectives are made of.

    Not for one of an observable that remembers: points between the instants are visited in no
    order, and full turns are not part of a state.
    """
    all_leaves = [leaf for objective in objectives for leaf in leaves(objective)]
    integrals = (
        x for x in all_leaves if isinstance(x, OverTime) and not x.observable.remembers_any
    )
    return {x: Total(system, x, differentiated) for x in integrals}


def read_at_end(system: MechanicalSystem, objectives: Sequence[Objective], t_end: float) -> bool:
    """Tell whether objectives are functions of integrals and of the last instant alone."""
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
