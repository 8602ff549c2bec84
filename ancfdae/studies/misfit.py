"""Misfit of a run to measured data: residuals and their Jacobian, for least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors import (
    InvalidInput,
    require_array,
    require_each,
    require_finite,
    require_positive,
    require_sequence,
)
from ancfdae.integrators import Integrator
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.sensitivity.method import Run, finished
from ancfdae.sensitivity.objectives import NonFiniteObjective
from ancfdae.sensitivity.observables import Observable, States, states_of
from ancfdae.studies.calls import design_bounds, differentiable
from ancfdae.studies.evaluations import Evaluation, Evaluations, Ran


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

    Raises
    ------
    InvalidInput
        If shapes disagree, numbers are missing, or nothing was measured.
    """

    observables: Sequence[Observable]
    times: Numbers
    data: Array
    weights: Array | float = 1.0

    def __post_init__(self) -> None:
        """Validate and freeze."""
        where, repair = "Misfit.observables", "Use position(...), say."
        observables = require_each(where, self.observables, (Observable,), repair)
        times = require_sequence("Misfit.times", self.times)
        for time in times:
            require_finite("Misfit.times", time)
        if not times or min(times) < 0:
            raise InvalidInput(
                "Misfit.times", "must be one or more times from 0 on", times, "Give such times."
            )
        shape = (len(observables), len(times))
        try:
            data = np.asarray(self.data, dtype=float)
        except (TypeError, ValueError, OverflowError):
            rule, repair = "must be an array of numbers", "Give one row per observable."
            raise InvalidInput("Misfit.data", rule, repr(self.data), repair) from None
        if data.shape != shape or np.all(np.isnan(data)) or np.any(np.isinf(data)):
            raise InvalidInput(
                "Misfit.data",
                f"must have the shape {shape}, observables by times, and some finite values",
                f"shape {data.shape}",
                "Give one row per observable, NaN where nothing was measured.",
            )
        weights = require_array("Misfit.weights", self.weights)
        try:
            weights = np.broadcast_to(weights, shape)
        except ValueError:
            rule, repair = f"must spread to the shape {shape}", "Give one each, or one for all."
            raise InvalidInput("Misfit.weights", rule, weights.shape, repair) from None
        object.__setattr__(self, "observables", observables)
        object.__setattr__(self, "times", tuple(map(float, times)))
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "weights", weights)

    def fit(
        self,
        model: Scene | MechanicalSystem,
        t_end: float,
        integrator: Integrator,
        *,
        design: Sequence[str | DesignVariable] | None = None,
    ) -> Fit:
        """Return residuals and Jacobian as functions of the design values.

        Parameters
        ----------
        model : Scene or MechanicalSystem
        t_end : float
            End time, not before the last measurement; s.
        integrator : Integrator
        design : sequence of str or DesignVariable
            What is to be found, as in `differentiate`; bounds of variables are those of the fit.

        Raises
        ------
        InvalidInput, UnknownName
            If the model does not have what was measured, or the run ends before.
        """
        require_positive("t_end", t_end)
        if max(self.times) > t_end * (1 + 1e-12):
            rule, repair = f"must not exceed {t_end:.6g}", "The run ends before; let it go on."
            raise InvalidInput("Misfit.times", rule, max(self.times), repair)
        system = differentiable(model, design)
        for observable in self.observables:
            observable.check(system)
        return Fit(self, Run(system, float(t_end), integrator), design_bounds(system, design))


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """Residuals of a model and their Jacobian, for ``scipy.optimize.least_squares``.

    ``least_squares(fit.residuals, fit.start, fit.jacobian, bounds=fit.bounds, x_scale="jac",
    gtol=None)`` finds the design values. Without ``gtol=None`` it may stop at the start and report
    success: SciPy compares J^T r with 1e-8 in any units, and in moduli in Pa that is small.
    Both functions come from one run with direct differentiation per design, which is kept for the
    other. A later design than the first whose run ends early, or which cannot be put together, is
    warned about (`FailedDesign`); its residuals are infinite, so that SciPy steps back.

    Attributes
    ----------
    misfit : Misfit
    run : Run
        The system, the end time and the integrator.
    bounds : pair of arrays, shape (n_b,)
        Lower and upper bounds of the design values; infinite where there are none.
    design_names : tuple of str
        Of the design values, in their order.
    """

    misfit: Misfit
    run: Run
    bounds: tuple[Array, Array]

    @property
    def design_names(self) -> tuple[str, ...]:
        """Names of the design values."""
        return tuple(self.run.system.design_names)

    @property
    def start(self) -> Array:
        """Design values of the model, shape (n_b,)."""
        return np.asarray(self.run.system.b, dtype=float)

    def residuals(self, b: Array) -> Array:
        """Return weight times (observable - data) of every measurement, row by row of the data.

        Raises
        ------
        InvalidInput
            If the first design cannot be put together.
        UnfinishedRun
            If its run ends early; the error carries what was computed.
        NonFiniteObjective
            If an observable is not finite in it.
        """
        return self._at(b).values.copy()

    def jacobian(self, b: Array) -> Array:
        """Return the derivative of the residuals, shape (n_measurements, n_b).

        NaN where the design has no residuals; see there.
        """
        jacobian = self._at(b).jacobian
        assert jacobian is not None  # always computed
        return jacobian.copy()

    def solution(self, b: Array) -> Solution:
        """Return the run at these design values; raises the error of a design that has none."""
        return self._designs.solution(b)

    def covariance(self, b: Array) -> Array:
        """Return the covariance of the design values, shape (n_b, n_b), inverse of J^T J.

        In first order, if the weights are one over the standard deviations of independent errors
        of the data and b is the best fit. Infinite where the data do not tell the variables apart.
        Raises the error of a design that has no residuals.
        """
        self.solution(b)
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

    def intervals(self, b: Array, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the confidence interval of every design value, by name.

        In first order, of errors that are normally distributed; as `covariance`.
        """
        require_positive("level", level)
        if level >= 1:
            raise InvalidInput("level", "must be below 1", level, "0.95 is the usual one.")
        half = scipy.special.ndtri(0.5 * (1 + level)) * np.sqrt(np.diag(self.covariance(b)))
        limits = zip((b - half).tolist(), (b + half).tolist(), strict=True)
        return dict(zip(self.design_names, limits, strict=True))

    @cached_property
    def _designs(self) -> Evaluations:
        measured = int(np.count_nonzero(~np.isnan(self.misfit.data)))
        return Evaluations(self.design_names, measured, self._computed)

    def _at(self, b: Array) -> Evaluation:
        return self._designs.at(b)

    def _computed(self, b: Array, derivatives: bool, ran: Ran | None) -> tuple[Array, Array, Ran]:
        """Return residuals and Jacobian, whatever is wanted: they come from one run."""
        run, solution = ran or (self.run.at(b), None)
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
        raise NonFiniteObjective("Misfit", "an observable", float(states.t[np.argmax(bad)]))
    return p.value, total


def _interpolation(states: States, times: Numbers) -> Array:
    """Weights of the instants in the values at some times, shape (m, k)."""
    W = np.zeros((len(times), len(states.t)))
    for row, time in zip(W, times, strict=True):
        around, share = states.grid.interpolation(time)
        row[around] = share
    return W
