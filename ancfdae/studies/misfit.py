"""Misfit of a run to measured data: residuals and their Jacobian, for least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

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
from ancfdae.studies.fit import MeasuredFit


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
    ) -> RunFit:
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
        run = Run(system, float(t_end), integrator)
        return RunFit(system, design_bounds(system, design), self, run)


@final
@dataclass(frozen=True, eq=False)
class RunFit(MeasuredFit[tuple[Run, Solution]]):
    """Residuals of a run, from one run with direct differentiation per design.

    Attributes
    ----------
    misfit : Misfit
    run : Run
        The system, the end time and the integrator.
    """

    misfit: Misfit
    run: Run

    def solution(self, b: Array) -> Solution:
        """Return the run at these design values; raises the error of a design that has none."""
        return self.result(b)[1]

    @property
    def count(self) -> int:
        """Number of measurements."""
        return int(np.count_nonzero(~np.isnan(self.misfit.data)))

    def computed(
        self, b: Array, derivatives: bool, result: tuple[Run, Solution] | None
    ) -> tuple[Array, Array, tuple[Run, Solution]]:
        """Return residuals and Jacobian, whatever is wanted: they come from one run."""
        run, solution = result or (self.run.at(b), None)
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
