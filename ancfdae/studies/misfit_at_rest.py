"""Misfit to what is measured at rest: deflections under loads, natural frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors import InvalidInput, require_array, require_each, require_flag
from ancfdae.integrators import Static
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.modes import Modes, MotionKind
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.sensitivity.method import Run
from ancfdae.sensitivity.observables import Observable
from ancfdae.statics import NoEquilibrium, find_equilibrium
from ancfdae.studies.calls import design_bounds, differentiable
from ancfdae.studies.fit import MeasuredFit
from ancfdae.studies.misfit import Misfit, RunFit
from ancfdae.studies.modes import modes


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

    Raises
    ------
    InvalidInput
    """

    observables: Sequence[Observable]
    data: Numbers
    weights: Array | float = 1.0

    def __post_init__(self) -> None:
        """Validate."""
        require_each(
            "StaticMisfit.observables", self.observables, (Observable,), "Use position(...), say."
        )
        data = require_measured("StaticMisfit", self.data, len(self.observables))
        object.__setattr__(self, "data", data)
        weights = require_weights("StaticMisfit", self.weights, len(data))
        object.__setattr__(self, "weights", weights)

    def fit(
        self,
        model: Scene | MechanicalSystem,
        *,
        design: Sequence[str | DesignVariable] | None = None,
    ) -> RunFit:
        """Return residuals and Jacobian as functions of the design values; as `Misfit.fit`."""
        data, weights = np.asarray(self.data), np.asarray(self.weights)
        misfit = Misfit(self.observables, (0.0,), data[:, None], weights[:, None])
        system = differentiable(model, design)
        for observable in self.observables:
            observable.check(system)
        run = Run(system, 0.0, Static())
        return RunFit(system, design_bounds(system, design), misfit, run)


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

    Raises
    ------
    InvalidInput
    """

    data: Numbers
    weights: Array | float = 1.0
    under_load: bool = False

    def __post_init__(self) -> None:
        """Validate."""
        require_flag("FrequencyMisfit.under_load", self.under_load)
        data = require_measured("FrequencyMisfit", self.data, None)
        object.__setattr__(self, "data", data)
        weights = require_weights("FrequencyMisfit", self.weights, len(data))
        object.__setattr__(self, "weights", weights)

    def fit(
        self,
        model: Scene | MechanicalSystem,
        *,
        design: Sequence[str | DesignVariable] | None = None,
    ) -> FrequencyFit:
        """Return residuals and Jacobian as functions of the design values; as `Misfit.fit`.

        Raises
        ------
        InvalidInput, UnknownName
        """
        system = differentiable(model, design)
        return FrequencyFit(system, design_bounds(system, design), self)


@final
@dataclass(frozen=True, eq=False)
class FrequencyFit(MeasuredFit[Modes]):
    """Residuals of natural frequencies; modes that change places are compared by their order."""

    misfit: FrequencyMisfit

    @property
    def count(self) -> int:
        """Number of measurements."""
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
                raise NoEquilibrium(at)
        wanted = count
        while True:
            lowest = modes(system, wanted, at=at)
            missing = count - len(_vibrations(lowest))
            if missing <= 0:
                return lowest
            if len(lowest.exponents) < wanted:
                raise InvalidInput(
                    "FrequencyMisfit.data",
                    f"must be at most the {count - missing} vibrations that the model has",
                    count,
                    "Measure fewer or use more elements.",
                )
            wanted += missing


def _vibrations(computed: Modes) -> Array:
    """Return which modes vibrate."""
    return np.flatnonzero([kind is MotionKind.VIBRATION for kind in computed.kinds])


def require_measured(where: str, data: object, count: int | None) -> Array:
    """Return measured values; refuse what are none."""
    rule = "must be a sequence of numbers, some of them finite"
    repair = "Give one each, NaN where nothing was measured."
    try:
        values = np.asarray(data, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInput(f"{where}.data", rule, repr(data), repair) from None
    if values.ndim != 1 or np.all(np.isnan(values)) or np.any(np.isinf(values)):
        raise InvalidInput(f"{where}.data", rule, repr(data), repair)
    if count is not None and len(values) != count:
        rule = f"must be {count}, one per observable"
        raise InvalidInput(f"{where}.data", rule, len(values), repair)
    return values


def require_weights(where: str, weights: object, count: int) -> Array:
    """Return one weight for each measured value; refuse what does not spread to that."""
    given = require_array(f"{where}.weights", weights)
    try:
        return np.broadcast_to(given, (count,))
    except ValueError:
        rule, repair = f"must spread to {count} values", "Give one each, or one for all."
        raise InvalidInput(f"{where}.weights", rule, given.shape, repair) from None
