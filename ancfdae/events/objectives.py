"""Objectives of runs with events: values over all phases, and partials in each phase.

An integral is the sum of the integrals over the phases. A value at a given time T is interpolated
in the phase that contains T; at the end of a phase in the one that ends there, before the event.
The derivative with respect to the time matters there, because phases shift with the design: steps
are interpolated by a cubic through four time points. Time points depend on the design through the
starts and durations of phases, and so do the weights of quadrature and interpolation, and
observables that depend on time explicitly.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple, cast, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.kinds import InvalidInputError, UnlikelyValueWarning
from ancfdae.events.functions import in_time
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.time_grid import TimeGrid
from ancfdae.sensitivity.objectives.objective import NonFiniteObjectiveError, Objective
from ancfdae.sensitivity.objectives.reductions import (
    AtInstants,
    AtTimes,
    OverTime,
    Reduction,
    Terminal,
)
from ancfdae.sensitivity.observables.expression import evaluated, leaf_weights, leaves
from ancfdae.sensitivity.observables.observable import Observable, States, followed, remembered

#: A time after the end of a phase, by at most this fraction of the run, counts as that end.
SAME = 1e-12


class PhaseTimes(NamedTuple):
    """Times t_0 + tau of a phase, and t_0 and D with their imaginary parts."""

    t: Array
    degree: int
    start: complex
    duration: complex

    @property
    def grid(self) -> TimeGrid:
        """The time points of the phase, counted from its start."""
        return TimeGrid(self.t - np.real(self.start), self.degree)


@final
@dataclass(frozen=True)
class PhaseStates:
    """States of a phase: its system, times t_0 + tau, and t_0 and D with their imaginary parts."""

    system: MechanicalSystem
    states: States
    start: complex
    duration: complex

    @property
    def times(self) -> PhaseTimes:
        """The times of the states."""
        return PhaseTimes(self.states.t, self.states.degree, self.start, self.duration)

    def late(self) -> Array:
        """Return the imaginary parts of the times, (k,), s."""
        rate = np.imag(self.duration) / np.real(self.duration)
        return np.imag(self.start) + self.times.grid.t * rate


@final
@dataclass(frozen=True)
class PhasePartials:
    """Partials of an objective in a phase: in its states, in b, and in the times t_0 and D."""

    q: Array | None
    v: Array | None
    lam: Array | None
    b: Array
    start: float
    duration: float

    def times(self, factor: float) -> PhasePartials:
        """Return the partials of the objective multiplied by a factor."""
        q, v, lam = (None if x is None else factor * x for x in (self.q, self.v, self.lam))
        return PhasePartials(
            q, v, lam, factor * self.b, factor * self.start, factor * self.duration
        )

    def along(self, states: tuple[Array, Array, Array] | None) -> float:
        """Return the derivative along changes of q, v, lam and a unit change of D; or 0."""
        if states is None:
            return 0.0
        pairs = zip((self.q, self.v, self.lam), states, strict=True)
        through = sum(float(np.sum(p * x)) for p, x in pairs if p is not None)
        return self.duration + through

    def plus(self, other: PhasePartials) -> PhasePartials:
        """Return the sum with `other`, partials of an objective in the same phase."""
        pairs = zip((self.q, self.v, self.lam), (other.q, other.v, other.lam), strict=True)
        q, v, lam = (x if y is None else y if x is None else x + y for x, y in pairs)
        start, duration = self.start + other.start, self.duration + other.duration
        return PhasePartials(q, v, lam, self.b + other.b, start, duration)


def value_of(objective: Objective, phases: Sequence[PhaseStates]) -> complex:
    """Return the value of an objective over all phases, complex if states or times are complex."""
    return FollowedObjective.along(objective, phases).value()


def require_reductions(objectives: Sequence[Objective]) -> None:
    """Raise InvalidInputError for objectives that are not functions of observables over time."""
    for objective in objectives:
        for leaf in leaves(objective):
            if not isinstance(leaf, Reduction):
                rule = "must be made of Integral, Terminal, AtTimes and smooth maxima"
                where = "objective with events, or with t_end in the design"
                raise InvalidInputError(where, rule, repr(leaf))


def at_times(observable: Observable, phases: Sequence[PhaseStates], times: Array) -> Array:
    """Return an observable at times of a run, shape (n,), interpolated in the phases."""
    parts = [(phase.system, phase.states) for phase in phases]
    values = [list(nodes.values())[-1] for nodes in followed(observable, parts)]
    spans = [phase.times for phase in phases]
    read = (_Reduced(AtTimes(observable, [time]), spans, values) for time in times.tolist())
    return np.array([each.value().real for each in read])


@final
class FollowedObjective:
    """An objective whose observables are evaluated in one phase after the other.

    It holds their values, but no states. `close` comes after the last phase, before `partials`.
    """

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self._times = list[PhaseTimes]()
        self._values: dict[Reduction, list[Array]] = {
            leaf: [] for leaf in cast("list[Reduction]", leaves(objective))
        }
        # Values that observables remember (counts of turns), at the start of each phase.
        self._pasts: list[dict[object, float]] = [{}]
        # Of each reduction its weight, slopes in its values, and slopes in times of phases.
        self._slopes: dict[Reduction, tuple[float, list[Array], Array]] = {}

    @staticmethod
    def along(objective: Objective, phases: Sequence[PhaseStates]) -> FollowedObjective:
        """Return the followed objective after all given phases of a run."""
        followed = FollowedObjective(objective)
        for phase in phases:
            followed.follow(phase)
        return followed

    @property
    def count(self) -> int:
        """Number of observables whose values are held."""
        return len(self._values)

    def follow(self, phase: PhaseStates) -> None:
        """Evaluate and store the observables of the objective along the next phase."""
        states, later = replace(phase.states, past=self._pasts[-1]), dict[object, float]()
        self._times.append(phase.times)
        for leaf, values in self._values.items():
            nodes = leaf.observable.node_values(phase.system, states)
            values.append(_at_late_times(leaf.observable, phase, list(nodes.values())[-1]))
            later |= remembered(nodes)
        self._pasts.append(later)

    def value(self) -> complex:
        """Return the objective's value over all phases; complex if states or times are complex.

        Warns of values at the time of an event.
        """
        self._warn_of_events()
        nodes = evaluated(self._objective, lambda leaf: np.asarray(self._reduced(leaf).value()))
        value = list(nodes.values())[-1]
        if not np.isfinite(value):
            raise NonFiniteObjectiveError("function of objectives", "the value", None)
        return complex(value.item())

    def close(self) -> float:
        """Differentiate in values of observables and times of phases; return the value."""
        value = float(np.real(self.value()))
        reduced = {leaf: self._reduced(leaf) for leaf in self._values}
        nodes = evaluated(
            self._objective,
            lambda leaf: np.asarray(reduced[cast(Reduction, leaf)].value().real),
        )
        for leaf, weight in leaf_weights(nodes, np.ones(())).items():
            own = cast(Reduction, leaf)
            of_times = reduced[own].through_weights()
            self._slopes[own] = float(weight), reduced[own].slopes(), of_times
        return value

    def partials(self, k: int, phase: PhaseStates) -> PhasePartials:
        """Return the objective's partials in states, design, start and duration of phase k."""
        states, total = replace(phase.states, past=self._pasts[k]), list[PhasePartials]()
        shares = phase.times.grid.t / np.real(phase.duration)
        for leaf, (weight, slopes, through) in self._slopes.items():
            nodes = leaf.observable.node_values(phase.system, states)
            p = leaf.pulled_back(phase.system, states, nodes, slopes[k])
            on_t = slopes[k] * in_time(phase.system, leaf.observable, states)
            start, duration = through[k] + [np.sum(on_t), on_t @ shares]
            b = p.b.sum(axis=0)
            found = PhasePartials(p.q, p.v, p.lam, b, float(start), float(duration))
            total.append(found.times(weight))
        return functools.reduce(PhasePartials.plus, total)

    def _warn_of_events(self) -> None:
        """Warn of times of `AtTimes` at which an event ends a phase that another one follows."""
        ends = np.array([phase.t[-1] for phase in self._times])
        for leaf in self._values:
            if not isinstance(leaf, AtTimes):
                continue
            away = np.abs(np.subtract.outer(leaf.instants(ends[-1]), ends[:-1]))
            for time in ends[:-1][np.any(away <= SAME * ends[-1], axis=0)]:
                warnings.warn(
                    f"AtTimes: an event happens at the time {time:.9g} s: the value is that before "
                    "the event, and value or derivative may jump there. Take a time beside it; "
                    "`observe` gives both values.",
                    UnlikelyValueWarning,
                    stacklevel=2,
                )

    def _reduced(self, leaf: object) -> _Reduced:
        own = cast(Reduction, leaf)
        return _Reduced(own, self._times, self._values[own])


def _at_late_times(observable: Observable, phase: PhaseStates, x: Array) -> Array:
    """Return values of an observable along a phase, (k,), with the change by imaginary times."""
    late = phase.late()
    if not np.any(late):
        return x
    states = phase.states
    real = States(states.t, states.q.real, states.v.real, states.lam.real, states.degree)
    system = phase.system.with_values(phase.system.b.real)
    return x + 1j * late * in_time(system, observable, real)


class _Reduced:
    """One `Reduction` of an observable's values over all phases of a run."""

    def __init__(
        self, objective: Reduction, phases: Sequence[PhaseTimes], values: Sequence[Array]
    ) -> None:
        self._objective, self._phases, self._x = objective, phases, values

    @property
    def _spans(self) -> list[tuple[complex, complex]]:
        """Starts t_0 and durations D of the phases."""
        return [(phase.start, phase.duration) for phase in self._phases]

    def value(self) -> complex:
        """Return the reduction over all phases; complex if states or times are complex."""
        x_all, w_all = np.concatenate(self._x), np.concatenate(self._weights(self._spans))
        used = w_all != 0
        if not np.all(np.isfinite(x_all[used])):
            times = np.concatenate([phase.t for phase in self._phases])[used]
            bad = float(times[np.argmin(np.isfinite(x_all[used]))])
            name = type(self._objective).__name__
            raise NonFiniteObjectiveError(name, "the observable", bad)
        return complex(self._objective.reduce(x_all[used], w_all[used]))

    def _weights(self, spans: Sequence[tuple[complex, complex]]) -> list[Array]:
        """Return the weights of all time points of each phase from its start and its duration."""
        objective, grids = self._objective, [phase.grid for phase in self._phases]
        if isinstance(objective, AtInstants):
            return self._shares(objective, spans)
        if not isinstance(objective, OverTime):
            return [objective.weights(grid) for grid in grids]
        length = sum(D for _, D in spans)
        factor = objective.factor(length)  # type: ignore[arg-type]  # also of complex numbers
        return [
            grid.weights() * (D / grid.t[-1]) * factor
            for grid, (_, D) in zip(grids, spans, strict=True)
        ]

    def _shares(
        self, objective: AtInstants, spans: Sequence[tuple[complex, complex]]
    ) -> list[Array]:
        """Return the weights of the time points of each phase in values at given times."""
        weights = [np.zeros(len(phase.t), dtype=complex) for phase in self._phases]
        if isinstance(objective, Terminal):
            # The end of the run, which an event may move.
            weights[-1][-1] = 1.0
            return [w.real for w in weights]
        end = float(self._phases[-1].t[-1])
        ends = np.array([phase.t[-1] for phase in self._phases])
        for time in objective.instants(end):
            k = min(int(np.searchsorted(ends, time - SAME * end)), len(ends) - 1)
            grid, (start, D) = self._phases[k].grid, spans[k]
            share = (time - start) / D
            place = min(max(float(np.real(share)), 0.0), 1.0) * grid.t[-1]
            around = grid.around(place)
            shares, slopes = _lagrange(grid.t[around], place)
            weights[k][around] += shares + 1j * np.imag(share) * grid.t[-1] * slopes
        if any(np.any(w.imag) for w in weights):
            return weights
        return [w.real for w in weights]

    def slopes(self) -> list[Array]:
        """Return the derivatives in the values of each phase, shape (k,)."""
        w = self._weights(self._spans)
        x_all, w_all = np.concatenate(self._x), np.concatenate(w)
        used, slopes = w_all != 0, np.zeros(len(w_all))
        slopes[used] = self._objective.slopes(x_all[used].real, w_all[used])
        return np.split(slopes, np.cumsum([len(each) for each in w])[:-1])

    def through_weights(self) -> Array:
        """Return the derivatives in start and duration of each phase through weights, (k, 2)."""
        objective, phases, spans = self._objective, self._phases, self._spans
        w, x = self._weights(spans), np.concatenate(self._x)
        total, all_w = np.zeros((len(phases), 2)), np.concatenate(w)

        def slope(change: Array) -> float:
            used = (all_w != 0) | (change != 0)
            moved = (all_w + 1j * STEP * change)[used]
            return float(np.imag(objective.reduce(x[used], moved)) / STEP)

        if isinstance(objective, OverTime):
            length = float(np.sum(np.real([D for _, D in spans])))
            late: Any = length + 1j * STEP
            grown = np.imag(objective.factor(late)) / STEP / objective.factor(length)
            total[:, 1] = slope(grown * all_w)
            ends = np.cumsum([len(each) for each in w])
            for k, end in enumerate(ends.tolist()):
                own, change = slice(end - len(w[k]), end), np.zeros(len(all_w))
                change[own] = all_w[own] / np.real(spans[k][1])
                total[k, 1] += slope(change)
        elif isinstance(objective, AtInstants) and not isinstance(objective, Terminal):
            read = [k for k, each in enumerate(w) if np.any(each)]
            for k, which in product(read, (0, 1)):
                moved = [list(span) for span in spans]
                moved[k][which] += 1j * STEP
                shares = np.concatenate(self._shares(objective, [(t, D) for t, D in moved]))
                total[k, which] = slope(np.imag(shares) / STEP)
        return total


def _lagrange(nodes: Array, time: float) -> tuple[Array, Array]:
    """Return values and slopes of the Lagrange polynomials of nodes at `time`, (k,) each."""
    values, slopes = np.zeros((2, len(nodes)))
    for i, own in enumerate(nodes):
        others = np.delete(nodes, i)
        values[i] = np.prod((time - others) / (own - others))
        for j in range(len(others)):
            rest = np.delete(others, j)
            slopes[i] += np.prod((time - rest) / (own - rest)) / (own - others[j])
    return values, slopes
