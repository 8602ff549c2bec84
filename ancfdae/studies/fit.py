"""Residuals of measurements as functions of the design, for ``scipy.optimize.least_squares``."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, TypeVar, final

import numpy as np
import scipy

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_array, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import DesignVariable
from ancfdae.numerics.arrays import Array
from ancfdae.studies.calls import design_bounds
from ancfdae.studies.responses import Evaluations

R = TypeVar("R")


class ResidualFunction(abc.ABC):
    """Residuals of a model and their Jacobian, for ``scipy.optimize.least_squares``.

    ``least_squares(fit.residuals, fit.start, fit.jacobian, bounds=fit.bounds, x_scale="jac",
    gtol=None)`` finds the design values. Without ``gtol=None`` it may stop at the start and report
    success: SciPy compares J^T r with 1e-8 in any units, and in moduli in Pa that is small.
    Both functions come from one computation per design, which is kept for the other. A later design
    than the first that cannot be computed, or cannot be put together, is warned about
    (`FailedDesignWarning`); its residuals are infinite, so that SciPy steps back.

    ``one + another`` are the residuals of two experiments with the same design variables.

    Attributes
    ----------
    design_names : tuple of str
        Of the design values, in their order.
    start : array, shape (n_b,)
        Design values of the model, each in its own unit.
    bounds : pair of arrays, shape (n_b,)
        Lower and upper bounds of the design values: of `DesignVariable`, and those beyond which a
        part of a scene cannot take a value, such as zero for a modulus; else infinite.
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
        """Return weight times (computed - measured) of every measurement.

        Raises
        ------
        InvalidInputError
            If the first design cannot be put together.
        UnfinishedRunError
            If its run ends early; the error carries what was computed.
        NonFiniteObjectiveError
            If an observable is not finite in it.
        """

    @abc.abstractmethod
    def jacobian(self, b: Array) -> Array:
        """Return the derivative of the residuals, shape (n_measurements, n_b).

        NaN where the design has no residuals; see there.
        """

    @abc.abstractmethod
    def require(self, b: Array) -> None:
        """Raise the error of a design that has no residuals."""

    def __add__(self, other: ResidualFunction) -> ResidualFunction:
        """Return the fit to both experiments."""
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
        """Return the covariance of the design values, shape (n_b, n_b), inverse of J^T J.

        In first order, if the weights are one over the standard deviations of independent errors
        of the data and b is the best fit. Infinite where the data do not tell the variables apart.
        Raises the error of a design that has no residuals.
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
        """Return the confidence interval of every design value, by name.

        In first order, for normally distributed errors, from `covariance`; unit of the variable.
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
    """Residuals of one experiment; `R` is what it computes at a design.

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
        """Number of measurements, which is that of residuals."""

    @abc.abstractmethod
    def computed(self, b: Array, derivatives: bool, result: R | None) -> tuple[Array, Array, R]:
        """Return residuals, Jacobian and what they come from, which is given if it is kept.

        Both are computed whatever is wanted: they come from one result.
        """

    @property
    def design_names(self) -> tuple[str, ...]:
        """Names of the design values."""
        return tuple(self.system.design_names)

    @property
    def start(self) -> Array:
        """Design values of the model, shape (n_b,)."""
        return np.asarray(self.system.b, dtype=float)

    @final
    def residuals(self, b: Array) -> Array:
        """Return weight times (computed - measured), row by row of the data."""
        return self._designs.at(b).values.copy()

    @final
    def jacobian(self, b: Array) -> Array:
        """Return the derivative of the residuals."""
        jacobian = self._designs.at(b).jacobian
        assert jacobian is not None  # always computed
        return jacobian.copy()

    @final
    def require(self, b: Array) -> None:
        """Raise the error of a design that has no residuals."""
        self._designs.result(b)

    @final
    def result(self, b: Array) -> R:
        """Return the result computed at a design; raise the error of a design without one."""
        return self._designs.result(require_array("design values", b, (len(self.design_names),)))

    @cached_property
    def _designs(self) -> Evaluations[R]:
        names, shown = self.design_names, self.progress
        return Evaluations(names, self.count, self.computed, progress=shown)
