"""Residuals of measurements as functions of the design, for ``scipy.optimize.least_squares``.

They come, with their Jacobian, from misfits to measured data of a run or of an equilibrium.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar, final

import numpy as np
import scipy

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.event_solution import EventSolution
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import (
    require_array,
    require_each,
    require_finite,
    require_flag,
    require_kind,
    require_positive,
    require_sequence,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import Integrator
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.modes.result import ModeKind, Modes
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.sensitivity.method import Run, finished
from ancfdae.sensitivity.objectives import NonFiniteObjectiveError
from ancfdae.sensitivity.observables.observable import Observable, States, states_of
from ancfdae.statics.equilibrium import NoEquilibriumError, find_equilibrium
from ancfdae.studies.calls import design_bounds, differentiable
from ancfdae.studies.modes import modes as vibrations
from ancfdae.studies.responses import Evaluations
from ancfdae.studies.statics import Static

if TYPE_CHECKING:
    from ancfdae.events.calls import EventRun
    from ancfdae.events.kinds import Event, Mode

R = TypeVar("R")
# A run at a design, and its solution.
_Ran: TypeAlias = "tuple[Run | EventRun, Solution | EventSolution]"


class ResidualFunction(abc.ABC):
    """Residuals of a model and their Jacobian, for ``scipy.optimize.least_squares``.

    ``least_squares(fit.residuals, fit.start, fit.jacobian, bounds=fit.bounds, x_scale="jac",
    gtol=None)`` finds the design values. Without ``gtol=None`` it may stop at the start and report
    success: SciPy compares J^T r with 1e-8 in any units, and in moduli in Pa that is small.
    Residuals and Jacobian of a design come from one computation, which is cached. A later design
    than the first that cannot be computed, or assembled, raises a `FailedDesignWarning`; its
    residuals are infinite, so that SciPy steps back.

    ``one + another`` are the residuals of two experiments with the same design variables.

    Attributes
    ----------
    design_names : tuple of str
        Names of the design variables, in the order of the design values.
    start : array, shape (n_b,)
        Design values of the model, each in its own unit.
    bounds : pair of arrays, shape (n_b,)
        Lower and upper bounds of the design values: from `DesignVariable`, and limits of admissible
        values of a part, such as zero for a modulus; else infinite.
    """

    bounds: tuple[Array, Array]

    @property
    @abc.abstractmethod
    def design_names(self) -> tuple[str, ...]:
        """Names of the design variables that are fitted."""

    @property
    @abc.abstractmethod
    def start(self) -> Array:
        """Design values of the model, shape (n_b,)."""

    @abc.abstractmethod
    def residuals(self, b: Array) -> Array:
        """Return weight times (computed - measured) of every measurement, (n_measurements,).

        Raises
        ------
        InvalidInputError
            If the first design cannot be assembled.
        UnfinishedRunError
            If the run of the first design ends early; the error carries its solution.
        NonFiniteObjectiveError
            If an observable is not finite at the first design.
        """

    @abc.abstractmethod
    def jacobian(self, b: Array) -> Array:
        """Return the derivatives of the residuals, shape (n_measurements, n_b).

        NaN if the design has no residuals; see `residuals`.
        """

    @abc.abstractmethod
    def require(self, b: Array) -> None:
        """Raise the error of the design b if it has no residuals."""

    def __add__(self, other: ResidualFunction) -> ResidualFunction:
        """Return the residuals of both experiments, one after the other."""
        require_kind("fit", other, (ResidualFunction,), "For example misfit.fit(...).")
        same = self.design_names == other.design_names and np.array_equal(self.start, other.start)
        if not same:
            raise InvalidInputError(
                "fit",
                f"must have the design variables {self.design_names} at the same start",
                f"{other.design_names}, {other.start} beside {self.start}",
                "Give both fits one design and models with the same values.",
            )
        return JointFit(self, other)

    @final
    def covariance(self, b: Array) -> Array:
        """Return the covariance of the design values, shape (n_b, n_b), the inverse of J^T J.

        It holds in first order, if the weights are one over the standard deviations of independent
        errors of the data and b is the best fit. Infinite if the data do not determine all
        variables. Raises the error of a design that has no residuals.
        """
        self.require(b)
        J = self.jacobian(b)
        # Scaled to columns of length one, so that units do not matter.
        lengths = np.sqrt(np.sum(J * J, axis=0))
        if np.any(lengths == 0):
            return np.full((len(lengths), len(lengths)), np.inf)
        _, values, V = np.linalg.svd(J / lengths, full_matrices=False)
        if len(J) < len(lengths) or values[-1] <= np.finfo(float).eps * len(J) * values[0]:
            return np.full((len(lengths), len(lengths)), np.inf)
        half = V.T / values / lengths[:, None]
        return np.asarray(half @ half.T)

    @final
    def intervals(self, b: Array, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the confidence interval of every design value, by name, in its unit.

        It follows from `covariance`, in first order, for normally distributed errors.
        """
        require_positive("level", level)
        if level >= 1:
            raise InvalidInputError("level", "must be below 1", level, "0.95 is the usual one.")
        half = scipy.special.ndtri(0.5 * (1 + level)) * np.sqrt(np.diag(self.covariance(b)))
        limits = zip((b - half).tolist(), (b + half).tolist(), strict=True)
        return dict(zip(self.design_names, limits, strict=True))


def fit_bounds(
    system: MechanicalSystem, design: Sequence[str | DesignVariable] | None
) -> tuple[Array, Array]:
    """Return bounds of the design values: declared ones, and limits that parts of a scene set."""
    lower, upper = design_bounds(system, design)
    if isinstance(system, AncfSystem):
        least, largest = system.value_limits()
        lower, upper = np.maximum(lower, least), np.minimum(upper, largest)
    return lower, upper


@final
class JointFit(ResidualFunction):
    """Residuals of two fits of the same design variables, one after the other."""

    def __init__(self, one: ResidualFunction, other: ResidualFunction) -> None:
        self._fits = one, other
        lower, upper = zip(one.bounds, other.bounds, strict=True)
        self.bounds = np.maximum(*lower), np.minimum(*upper)

    @property
    def design_names(self) -> tuple[str, ...]:
        """Names of the design variables, which the two fits share."""
        return self._fits[0].design_names

    @property
    def start(self) -> Array:
        """Declared values of the design variables, shape (n_b,)."""
        return self._fits[0].start

    def residuals(self, b: Array) -> Array:
        """Return the residuals of the first fit, then those of the second, at design values b."""
        return np.concatenate([fit.residuals(b) for fit in self._fits])

    def jacobian(self, b: Array) -> Array:
        """Return the derivatives of `residuals` in b, shape (n_residuals, n_b)."""
        return np.concatenate([fit.jacobian(b) for fit in self._fits])

    def require(self, b: Array) -> None:
        """Raise the error of the first fit that has no residuals at b."""
        for fit in self._fits:
            fit.require(b)


@dataclass(frozen=True, eq=False)
class MeasuredFit(ResidualFunction, Generic[R]):
    """Residuals of one experiment; `R` is the type of its result at a design.

    Attributes
    ----------
    system : MechanicalSystem
    bounds : pair of arrays
    progress : bool
        Whether a progress bar counts the designs that were computed.
    """

    system: MechanicalSystem
    bounds: tuple[Array, Array]
    progress: bool = field(default=False, kw_only=True)

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """Number of measurements, equal to the number of residuals."""

    @abc.abstractmethod
    def computed(self, b: Array, derivatives: bool, result: R | None) -> tuple[Array, Array, R]:
        """Return residuals, (count,), Jacobian, (count, n_b), and the result they come from.

        A cached `result` is reused. All are computed whatever is asked for.
        """

    @property
    def design_names(self) -> tuple[str, ...]:
        """Names of the design variables of the system."""
        return tuple(self.system.design_names)

    @property
    def start(self) -> Array:
        """Design values of the model, shape (n_b,)."""
        return np.asarray(self.system.b, dtype=float)

    @final
    def residuals(self, b: Array) -> Array:
        """Return weight times (computed - measured), row by row of the data, shape (count,)."""
        return self._designs.at(b).values.copy()

    @final
    def jacobian(self, b: Array) -> Array:
        """Return the derivatives of the residuals in the design variables, shape (count, n_b)."""
        jacobian = self._designs.at(b).jacobian
        assert jacobian is not None  # always computed
        return jacobian.copy()

    @final
    def require(self, b: Array) -> None:
        """Raise the error of the design b if it has no residuals."""
        self._designs.result(b)

    @final
    def result(self, b: Array) -> R:
        """Return the result computed at design values b; raise its error if it failed."""
        return self._designs.result(require_array("design values", b, (len(self.design_names),)))

    @cached_property
    def _designs(self) -> Evaluations[R]:
        names, shown = self.design_names, self.progress
        return Evaluations(names, self.count, self.computed, progress=shown)


# -- misfits -----------------------------------------------------------------------------------


@final
@dataclass(frozen=True, eq=False)
class Misfit:
    """Measured values of observables at given times, to be fitted.

    Parameters
    ----------
    observables : sequence of Observable
        The n observables that were measured.
    times : sequence of float
        The m times of the measurements, none negative; s. Between the steps of a run values are
        interpolated as by `AtTimes`.
    data : array, shape (n, m)
        Measured values in the units of the observables; NaN where nothing was measured.
    weights : float or array, optional
        Factors of the residuals, broadcast to (n, m); one over the standard deviation of the noise.
        One by default.
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
        progress: bool = False,
    ) -> RunResidualFunction:
        """Return residuals and Jacobian as functions of the design values.

        Parameters
        ----------
        model : Scene or MechanicalSystem
        t_end : float
            End time, not before the last measurement; s.
        integrator : Integrator
        design : sequence of str or DesignVariable
            Design variables to be found, as in `differentiate`; see `bounds` of the result.
        events : sequence of Event, optional
        modes : mapping of str to Mode, optional
            Events of every run, and the models that it continues with, as in `simulate`.
        progress : bool
            Whether to show a progress bar, which counts the designs that were computed.
        """
        require_positive("t_end", t_end)
        require_flag("progress", progress)
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
        bounds = fit_bounds(system, design)
        return RunResidualFunction(system, bounds, self, run, progress=progress)


@final
@dataclass(frozen=True, eq=False)
class RunResidualFunction(MeasuredFit["_Ran"]):
    """Residuals of a run, from one run with direct differentiation per design.

    Attributes
    ----------
    misfit : Misfit
    run : Run or EventRun
        The system, the end time, the integrator and, if any, the events.
    """

    misfit: Misfit
    run: Run | EventRun

    def solution(self, b: Array) -> Solution | EventSolution:
        """Return the solution at design values b; raise the error of a design without one."""
        return self.result(b)[1]

    @property
    def count(self) -> int:
        """Number of measurements, without NaN, equal to the number of residuals."""
        return int(np.count_nonzero(~np.isnan(self.misfit.data)))

    def computed(
        self, b: Array, derivatives: bool, result: _Ran | None
    ) -> tuple[Array, Array, _Ran]:
        """Return residuals and Jacobian, always both, with the run and solution they come from."""
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
    """Return an observable along a run, (k,), and its total design derivatives, (k, n_b)."""
    states, sensitivities = states_of(solution), solution.sensitivities
    assert sensitivities is not None  # asked for
    p = observable.partials(system, states)
    total = p.total(sensitivities.q_b, sensitivities.v_b, sensitivities.lam_b)
    bad = ~np.isfinite(p.value) | ~np.isfinite(total).all(axis=1)
    if np.any(bad):
        raise NonFiniteObjectiveError("Misfit", "an observable", float(states.t[np.argmax(bad)]))
    return p.value, total


def _interpolation(states: States, times: Numbers) -> Array:
    """Return the weights of k states in values interpolated at m times, shape (m, k)."""
    W = np.zeros((len(times), len(states.t)))
    for row, time in zip(W, times, strict=True):
        around, share = states.grid.interpolation(time)
        row[around] = share
    return W


@final
@dataclass(frozen=True, eq=False)
class StaticMisfit:
    """Measured values of observables in static equilibrium under all loads, to be fitted.

    Parameters
    ----------
    observables : sequence of Observable
        The n observables that were measured.
    data : array, shape (n,)
        Measured values in the units of the observables; NaN where nothing was measured.
    weights : float or array, shape (n,), optional
        Factors of the residuals; one over the standard deviation of the noise.
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
        progress: bool = False,
    ) -> RunResidualFunction:
        """Return residuals and Jacobian as functions of the design values; see `Misfit.fit`."""
        require_flag("progress", progress)
        data, weights = np.asarray(self.data), np.asarray(self.weights)
        misfit = Misfit(self.observables, (0.0,), data[:, None], weights[:, None])
        system = differentiable(model, design)
        for observable in self.observables:
            observable.check(system)
        run = Run(system, 0.0, Static())
        bounds = fit_bounds(system, design)
        return RunResidualFunction(system, bounds, misfit, run, progress=progress)


@final
@dataclass(frozen=True, eq=False)
class FrequencyMisfit:
    """Measured natural frequencies, the lowest first, to be fitted.

    Parameters
    ----------
    data : sequence of float
        Circular frequencies of the lowest vibrations, without rigid motions; rad/s. NaN for a
        frequency that was not measured.
    weights : float or array, optional
        Factors of the residuals, in s/rad; one over the standard deviation of the noise.
    under_load : bool, optional
        Whether the vibrations are about the equilibrium under all loads; otherwise about the start
        of the model.
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
        progress: bool = False,
    ) -> FrequencyFit:
        """Return residuals and Jacobian as functions of the design values; see `Misfit.fit`."""
        require_flag("progress", progress)
        system = differentiable(model, design)
        return FrequencyFit(system, fit_bounds(system, design), self, progress=progress)


@final
@dataclass(frozen=True, eq=False)
class FrequencyFit(MeasuredFit[Modes]):
    """Residuals of natural frequencies; modes are compared by their order, also after crossings."""

    misfit: FrequencyMisfit

    @property
    def count(self) -> int:
        """Number of measured frequencies, without NaN."""
        return int(np.count_nonzero(~np.isnan(self.misfit.data)))

    def computed(
        self, b: Array, derivatives: bool, result: Modes | None
    ) -> tuple[Array, Array, Modes]:
        """Return residuals and Jacobian of frequencies, with the modes that they come from."""
        data, weights = np.asarray(self.misfit.data), np.asarray(self.misfit.weights)
        computed = result or self._modes(self.system.with_values(b), len(data))
        vibrations = _vibrations(computed)[: len(data)]
        measured = ~np.isnan(data)
        rows = vibrations[measured]
        residuals = weights[measured] * (computed.natural_frequencies[rows] - data[measured])
        return residuals, weights[measured, None] * computed.natural_frequencies_b[rows], computed

    def _modes(self, system: MechanicalSystem, count: int) -> Modes:
        """Return the lowest modes of a system, of which `count` are vibrations."""
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
    """Return the indices of the modes that are vibrations."""
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
