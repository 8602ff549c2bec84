"""Misfit to measured data, of a run or at rest: residuals and their Jacobian, for least squares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.event_solution import EventSolution
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import (
    require_array,
    require_each,
    require_finite,
    require_flag,
    require_positive,
    require_sequence,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.static import Static
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.modes.result import ModeKind, Modes
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.sensitivity.method import Run, finished
from ancfdae.sensitivity.objectives import NonFiniteObjectiveError
from ancfdae.sensitivity.observables.observable import Observable
from ancfdae.sensitivity.observables.states import States, states_of
from ancfdae.statics.equilibrium import NoEquilibriumError, find_equilibrium
from ancfdae.studies.calls import design_bounds, differentiable
from ancfdae.studies.fit import MeasuredFit
from ancfdae.studies.modes import modes as vibrations

if TYPE_CHECKING:
    from ancfdae.events.calls import EventRun
    from ancfdae.events.kinds import Event, Mode

# A run at a design, and what it computed.
_Ran: TypeAlias = "tuple[Run | EventRun, Solution | EventSolution]"


@final
@dataclass(frozen=True, eq=False)
class Misfit:
    """Measured values of observables at given instants.

    Parameters
    ----------
    observables : sequence of Observable
        What was measured, n of them.
    times : sequence of float
        Instants of the measurements, m of them, none negative; s. Between the steps of a run values
        are interpolated as by `AtTimes`.
    data : array, shape (n, m)
        Measured values; NaN where there is none.
    weights : float or array, optional
        What residuals are multiplied by, of a shape that spreads to (n, m): one over the standard
        deviation of the noise. One by default.
    """

    observables: Sequence[Observable]
    times: Numbers
    data: Array
    weights: Array | float = 1.0

    def __post_init__(self) -> None:
        """Check the fields, and store them as tuples and arrays."""
        where, repair = "Misfit.observables", "For example position(rod.at_end, 1)."
        observables = require_each(where, self.observables, (Observable,), repair)
        times = require_sequence("Misfit.times", self.times)
        for time in times:
            require_finite("Misfit.times", time)
        if not times or min(times) < 0:
            raise InvalidInputError(
                "Misfit.times",
                "must contain at least one time, none below 0",
                times,
                "For example times=np.linspace(0, t_end, 101).",
            )
        object.__setattr__(self, "observables", observables)
        object.__setattr__(self, "times", tuple(map(float, times)))
        _measured(self, (len(observables), len(times)))

    def fit(
        self,
        model: Scene | MechanicalSystem,
        t_end: float,
        integrator: Integrator,
        *,
        design: Sequence[str | DesignVariable] | None = None,
        events: Sequence[Event] | None = None,
        modes: Mapping[str, Mode] | None = None,
    ) -> RunResidualFunction:
        """Return residuals and Jacobian as functions of the design values.

        Parameters
        ----------
        model : Scene or MechanicalSystem
        t_end : float
            End time, not before the last measurement; s.
        integrator : Integrator
        design : sequence of str or DesignVariable
            What is to be found, as in `differentiate`; bounds of variables are those of the fit.
        events : sequence of Event, optional
        modes : mapping of str to Mode, optional
            Events of every run, and the models that it continues with, as in `simulate`.
        """
        require_positive("t_end", t_end)
        if max(self.times) > t_end * (1 + 1e-12):
            rule, repair = f"must not exceed {t_end:.6g}", "The run ends before; let it go on."
            raise InvalidInputError("Misfit.times", rule, max(self.times), repair)
        system = differentiable(model, design)
        for observable in self.observables:
            observable.check(system)
        run: Run | EventRun = Run(system, float(t_end), integrator)
        if events is not None or modes is not None:
            from ancfdae.events.calls import EventRun

            run = EventRun.of(system, t_end, integrator, events or (), modes, design, False)
        return RunResidualFunction(system, design_bounds(system, design), self, run)


@final
@dataclass(frozen=True, eq=False)
class RunResidualFunction(MeasuredFit["_Ran"]):
    """Residuals of a run, from one run with direct differentiation per design.

    Attributes
    ----------
    misfit : Misfit
    run : Run or EventRun
        The system, the end time and the integrator; with events these, too.
    """

    misfit: Misfit
    run: Run | EventRun

    def solution(self, b: Array) -> Solution | EventSolution:
        """Return the run at these design values; raises the error of a design that has none."""
        return self.result(b)[1]

    @property
    def count(self) -> int:
        """Number of measurements, which is that of residuals."""
        return int(np.count_nonzero(~np.isnan(self.misfit.data)))

    def computed(
        self, b: Array, derivatives: bool, result: _Ran | None
    ) -> tuple[Array, Array, _Ran]:
        """Return residuals and Jacobian, whatever is wanted: they come from one run."""
        run, solution = result or (self.run.at(b), None)
        if not isinstance(run, Run):
            return self._with_events(run)
        assert solution is None or isinstance(solution, Solution)
        misfit, solution = self.misfit, solution or finished(run.solution(sensitivities=True))
        values, slopes = [], []
        for observable in misfit.observables:
            x, x_b = _along(observable, run.system, solution)
            values.append(x)
            slopes.append(x_b)
        W = _interpolation(states_of(solution), misfit.times)
        measured = ~np.isnan(misfit.data)
        weights = np.asarray(misfit.weights)[measured]
        residuals = weights * ((np.array(values) @ W.T) - misfit.data)[measured]
        jacobian = weights[:, None] * np.einsum("mk,nkb->nmb", W, np.array(slopes))[measured]
        return residuals, jacobian, (run, solution)

    def _with_events(self, run: EventRun) -> tuple[Array, Array, _Ran]:
        """Return residuals and Jacobian from a run with events."""
        from ancfdae.studies.events import measured

        misfit = self.misfit
        solution, values, slopes = measured(run, misfit.observables, misfit.times)
        there = ~np.isnan(misfit.data)
        weights = np.asarray(misfit.weights)[there]
        residuals = weights * (values - misfit.data)[there]
        return residuals, weights[:, None] * slopes[there], (run, solution)


def _along(
    observable: Observable, system: MechanicalSystem, solution: Solution
) -> tuple[Array, Array]:
    """Values of an observable and their total derivatives, shape (k,) and (k, n_b)."""
    states, sensitivities = states_of(solution), solution.sensitivities
    assert sensitivities is not None  # asked for
    p = observable.partials(system, states)
    total = p.total(sensitivities.q_b, sensitivities.v_b, sensitivities.lam_b)
    bad = ~np.isfinite(p.value) | ~np.isfinite(total).all(axis=1)
    if np.any(bad):
        raise NonFiniteObjectiveError("Misfit", "an observable", float(states.t[np.argmax(bad)]))
    return p.value, total


def _interpolation(states: States, times: Numbers) -> Array:
    """Weights of the instants in the values at some times, shape (m, k)."""
    W = np.zeros((len(times), len(states.t)))
    for row, time in zip(W, times, strict=True):
        around, share = states.grid.interpolation(time)
        row[around] = share
    return W


@final
@dataclass(frozen=True, eq=False)
class StaticMisfit:
    """Measured values of observables at the equilibrium under all loads.

    Parameters
    ----------
    observables : sequence of Observable
        What was measured, n of them.
    data : array, shape (n,)
        Measured values; NaN where there is none.
    weights : float or array, shape (n,), optional
        What residuals are multiplied by; one over the standard deviation of the noise.
    """

    observables: Sequence[Observable]
    data: Numbers
    weights: Array | float = 1.0

    def __post_init__(self) -> None:
        """Check the fields; store data and weights as arrays."""
        repair = "For example position(rod.at_end, 1)."
        require_each("StaticMisfit.observables", self.observables, (Observable,), repair)
        _measured(self, (len(self.observables),))

    def fit(
        self,
        model: Scene | MechanicalSystem,
        *,
        design: Sequence[str | DesignVariable] | None = None,
    ) -> RunResidualFunction:
        """Return residuals and Jacobian as functions of the design values; as `Misfit.fit`."""
        data, weights = np.asarray(self.data), np.asarray(self.weights)
        misfit = Misfit(self.observables, (0.0,), data[:, None], weights[:, None])
        system = differentiable(model, design)
        for observable in self.observables:
            observable.check(system)
        run = Run(system, 0.0, Static())
        return RunResidualFunction(system, design_bounds(system, design), misfit, run)


@final
@dataclass(frozen=True, eq=False)
class FrequencyMisfit:
    """Measured natural frequencies, the lowest first.

    Parameters
    ----------
    data : sequence of float
        Circular frequencies of the lowest vibrations, rigid motions not counted; NaN where one was
        not measured; rad/s.
    weights : float or array, optional
        What residuals are multiplied by; one over the standard deviation of the noise.
    under_load : bool, optional
        Whether the vibrations are those about the equilibrium under all loads; otherwise about the
        start of the model.
    """

    data: Numbers
    weights: Array | float = 1.0
    under_load: bool = False

    def __post_init__(self) -> None:
        """Check the fields; store data and weights as arrays."""
        require_flag("FrequencyMisfit.under_load", self.under_load)
        _measured(self, (-1,))

    def fit(
        self,
        model: Scene | MechanicalSystem,
        *,
        design: Sequence[str | DesignVariable] | None = None,
    ) -> FrequencyFit:
        """Return residuals and Jacobian as functions of the design values; as `Misfit.fit`."""
        system = differentiable(model, design)
        return FrequencyFit(system, design_bounds(system, design), self)


@final
@dataclass(frozen=True, eq=False)
class FrequencyFit(MeasuredFit[Modes]):
    """Residuals of natural frequencies; modes that change places are compared by their order."""

    misfit: FrequencyMisfit

    @property
    def count(self) -> int:
        """Number of measured frequencies, without NaN."""
        return int(np.count_nonzero(~np.isnan(self.misfit.data)))

    def computed(
        self, b: Array, derivatives: bool, result: Modes | None
    ) -> tuple[Array, Array, Modes]:
        """Return residuals and Jacobian from the modes and their derivatives."""
        data, weights = np.asarray(self.misfit.data), np.asarray(self.misfit.weights)
        computed = result or self._modes(self.system.with_values(b), len(data))
        vibrations = _vibrations(computed)[: len(data)]
        measured = ~np.isnan(data)
        rows = vibrations[measured]
        residuals = weights[measured] * (computed.natural_frequencies[rows] - data[measured])
        return residuals, weights[measured, None] * computed.natural_frequencies_b[rows], computed

    def _modes(self, system: MechanicalSystem, count: int) -> Modes:
        """Return modes with that many vibrations among them."""
        at = None
        if self.misfit.under_load:
            at = find_equilibrium(system, sensitivities=True)
            if not at.outcome.success:
                raise NoEquilibriumError(at)
        wanted = count
        while True:
            lowest = vibrations(system, wanted, at=at)
            missing = count - len(_vibrations(lowest))
            if missing <= 0:
                return lowest
            if len(lowest.exponents) < wanted:
                raise InvalidInputError(
                    "FrequencyMisfit.data",
                    f"must be at most the {count - missing} vibrations that the model has",
                    count,
                    "Measure fewer or use more elements.",
                )
            wanted += missing


def _vibrations(computed: Modes) -> Array:
    """Return which modes vibrate."""
    return np.flatnonzero([kind is ModeKind.VIBRATION for kind in computed.kinds])


def _measured(misfit: Misfit | StaticMisfit | FrequencyMisfit, shape: tuple[int, ...]) -> None:
    """Store data and weights as arrays of a shape, in which -1 stands for any number.

    Raises InvalidInputError for other shapes, infinite data, or data that are all NaN.
    """
    where, data = type(misfit).__name__, np.zeros(0)
    of_shape = "a sequence" if -1 in shape else f"of the shape {shape}"
    rule = f"must be numbers, {of_shape}, some of them finite"
    repair = "Give one per observable, or one row, NaN where nothing was measured."
    try:
        data = np.asarray(misfit.data, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError(f"{where}.data", rule, repr(misfit.data), repair) from None
    fits = data.ndim == len(shape) and all(
        n in (m, -1) for n, m in zip(shape, data.shape, strict=True)
    )
    if not fits or np.all(np.isnan(data)) or np.any(np.isinf(data)):
        raise InvalidInputError(
            f"{where}.data", rule, f"shape {data.shape}: {data.tolist()}", repair
        )
    weights = require_array(f"{where}.weights", misfit.weights)
    try:
        weights = np.broadcast_to(weights, data.shape)
    except ValueError:
        rule, repair = f"must spread to the shape {data.shape}", "Give one each, or one for all."
        raise InvalidInputError(f"{where}.weights", rule, weights.shape, repair) from None
    object.__setattr__(misfit, "data", data)
    object.__setattr__(misfit, "weights", weights)
