"""Integrals along a motion: functions of the states, on panels of quadrature points.

The integrator says where the points lie and which weights they have; what is made of the values
there is the integrand's.
"""

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.numerics.arrays import Array

# How the errors of two rules make that of the better one (DOP853: Hairer, Norsett & Wanner, II.10).
_COARSE = 0.1


@final
@dataclass(frozen=True)
class Rule:
    """Quadrature on a panel of length one.

    `error` is the weights minus those of a rule of lower order, `coarse` the same for a rule of
    lower order yet; zero without one.
    """

    weights: Array
    error: Array
    coarse: Array


@final
@dataclass(frozen=True)
class Points:
    """States at k points of some panels, panel after panel; h are the lengths of the panels.

    q, v and lam have the shape (k, n), q_b, v_b and lam_b (k, n, n_b). What is not asked for is
    None.
    """

    rule: Rule
    h: Array
    t: Array
    q: Array
    v: Array
    q_b: Array | None = None
    v_b: Array | None = None
    lam: Array | None = None
    lam_b: Array | None = None

    @property
    def weights(self) -> Array:
        """Weights of the points, shape (k,); they sum to the duration."""
        return np.outer(self.h, self.rule.weights).ravel()

    @property
    def weights_size(self) -> Array:
        """Positive weights of the same duration, for sizes."""
        size = np.abs(self.rule.weights)
        return np.outer(self.h, size / np.sum(size)).ravel()

    def errors(self, x: Array) -> Array:
        """Estimate the errors of the integrals of the columns of x, shape (k, n) to (n,)."""
        panels = x.reshape(len(self.h), -1, x.shape[1])
        fine, coarse = (
            np.abs(np.einsum("p,kpn->kn", e, panels)) for e in (self.rule.error, self.rule.coarse)
        )
        size = np.hypot(fine, _COARSE * coarse)
        share = np.divide(fine, size, out=np.zeros_like(size), where=size != 0)
        total: Array = self.h @ (fine * share)
        return total


@final
@dataclass(frozen=True)
class PartialIntegral:
    """Integral of an integrand over a part of the run.

    `slopes` has the shape (n_b,); `size`, (n,), are integrals without signs. The error is
    estimated, relative to the size of the integral, nan if anything is not finite; `not_finite` is
    the time of the first such point.
    """

    duration: float
    value: float
    slopes: Array
    size: Array
    error: float
    not_finite: float | None


class Integrand(abc.ABC):
    """A function of the states that is summed up along a run."""

    @abc.abstractmethod
    def part(self, points: Points) -> PartialIntegral:
        """Evaluate it on the next part of the run; without multipliers as if they were NaN."""

    @abc.abstractmethod
    def add(self, part: PartialIntegral) -> None:
        """Add the next part of the run, in the order of time."""


class Density(abc.ABC):
    """Partials of an integrand, for adjoint equations."""

    @abc.abstractmethod
    def partials(self, t: Array, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Return H_q, H_v and H_lam at states, one row each."""
