"""Error of a step of HHT-I3 against its tolerance.

**Motion** (Negrut, Rampalli, Ottarsson & Sajdak 2007, section 3). Inserting the smooth solution in
eq. (2), with a_n standing for q'' at t_n + alpha h, the position update misses

    delta = C h^3 q''' = C h^2 (a_{n+1} - a_n),     C = -(1 + 3 alpha^2)/12,

so the increment of the acceleration estimates it at no cost. The rates delta / h add up to the
error of the run, so that is what the tolerance bounds (error per unit step; the original bounds
delta, and its runs then err by the tolerance to the power 2/3):

    e^2 = mean over i of (T delta_i / h / (rtol |q_i| + atol Q_i))^2

with T the length of the run and Q_i the size of coordinate i (`Scales`). A step is accepted if
e <= 1.

**Derivatives.** At frozen steps the derivative of delta in the design is C h^2 (a_b,n+1 - a_b,n).
Where they go along, each design variable j has its own e, with

    rtol |q_b,ij| + atol S_j Q_i

below the fraction and twice the value, because errors of the motion feed into those of its
derivatives as much again; the largest e is that of the step. S_j is the largest size of
derivative j in the run, relative to the coordinates. Derivatives in parameters start from zero,
so that the start does not tell it, but a run before does (`HHT`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.integrators.characteristic_sizes import Scales
from ancfdae.integrators.hht.equations import Coefficients, constraint_error
from ancfdae.integrators.hht.step import Instant
from ancfdae.integrators.start import InitialSensitivity, InitialState
from ancfdae.numerics.arrays import Array
from ancfdae.protocol.solution import Solution
from ancfdae.protocol.solution_parts import EstimatedErrors

# Errors of the motion feed into those of the derivatives as much again (docs/theory.md, 5).
_FED = 2.0
_TWICE = 2.0
# A change of the design by its own size that moves the coordinates by less than this part of
# theirs is none (measured where the influence is zero, E = 1e7 to 1e13 Pa: 1e-15 at most).
_ROUND_OFF = 1e-12


@final
@dataclass(frozen=True)
class StepError:
    """The e of the module description.

    Attributes
    ----------
    rtol, atol : float
    t_end : float
    sizes : array, shape (n_q,)
        Q_i.
    sizes_b : array, shape (n_b,)
        S_j; zero where the design variable has no influence.
    """

    rtol: float
    atol: float
    t_end: float
    sizes: Array
    sizes_b: Array

    def of_step(self, c: Coefficients, before: Instant, after: Instant) -> float:
        """Return e of a step."""
        old, new = before.node, after.node
        size = np.maximum(np.abs(old.q.real), np.abs(new.q.real))
        error = self._of(c, (new.a - old.a).real, size, self.sizes)
        if before.node_b is None or after.node_b is None:
            return error
        increments = after.node_b.a_b - before.node_b.a_b
        return _larger(error, self._of_derivatives(c, increments, np.abs(after.node_b.q_b)))

    def of_start(
        self, c: Coefficients, initial: InitialState, derivative: InitialSensitivity | None
    ) -> float:
        """Return e of the first step, estimated from the third derivative at the start."""
        size = np.abs(initial.q.real)
        error = self._of(c, c.h * initial.jerk.real, size, self.sizes)
        if derivative is None:
            return error
        size = np.abs(derivative.q_b)
        return _larger(error, self._of_derivatives(c, c.h * derivative.jerk_b, size))

    def _of_derivatives(self, c: Coefficients, increments: Array, size: Array) -> float:
        seen = self.sizes_b > 0
        least = self.sizes[:, None] * self.sizes_b[seen]
        return _FED * self._of(c, increments[:, seen], size[:, seen], least)

    def _of(self, c: Coefficients, increment: Array, size: Array, least: Array) -> float:
        delta = constraint_error(c) * increment * (self.t_end / c.h)
        ratio = delta / (self.rtol * size + self.atol * least)
        return float(np.sqrt(np.max(np.mean(ratio * ratio, axis=0), initial=0.0)))


def _larger(motion: float, derivatives: float) -> float:
    """Return the larger error; of one that is not a number nothing is known, and no step passes."""
    return float(np.maximum(motion, derivatives))


def estimated_errors(scales: Scales, alpha: float, solution: Solution) -> EstimatedErrors:
    """Add up the errors of all steps of a run, relative to Q_i and Q_i S_j.

    The accelerations at the instants serve as those of the recurrence.
    """
    sizes, own = scales.q, solution.sensitivities
    constants = constraint_error(Coefficients.of(1.0, alpha)) * np.diff(solution.t) ** 2
    # What blew up overflows, and its error is infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        motion = float(_added_up(constants[:, None] * np.diff(solution.a.real, axis=0) / sizes))
        if own is None:
            return EstimatedErrors(motion)
        sums = _FED * _added_up(
            constants[:, None, None] * np.diff(own.a_b, axis=0) / sizes[:, None]
        )
        sizes_b = derivative_sizes(scales, own.q_b)
        relative = np.divide(sums, sizes_b, out=np.full_like(sums, np.nan), where=sizes_b > 0)
    relative = np.where(np.isfinite(sizes_b), relative, np.inf)
    return EstimatedErrors(motion, tuple(float(x) for x in relative))


def _added_up(errors: Array) -> Array:
    """Add up, over steps, root mean squares over coordinates; infinite where that is no number."""
    total = np.sum(np.sqrt(np.mean(errors * errors, axis=1)), axis=0)
    return np.where(np.isfinite(total), total, np.inf)


def derivative_sizes(scales: Scales, q_b: Array) -> Array:
    """Return S_j of the derivatives of a run, shape (n_t, n_q, n_b).

    Infinite if they are not finite, and zero if they are round-off.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        relative = q_b / scales.q[:, None]
        sizes = np.sqrt(np.max(np.mean(relative * relative, axis=1), axis=0, initial=0.0))
    sizes = np.where(np.isfinite(sizes), sizes, np.inf)
    return np.where(sizes * scales.b > _ROUND_OFF, sizes, 0.0)


def sizes_hold(assumed: Array, found: Array) -> bool:
    """Whether sizes under which a run was controlled are at most twice those it shows.

    A derivative that turns out to be round-off has no size to compare with, and no error either.
    """
    return bool(np.all((found == 0) | ((assumed > 0) & (assumed <= _TWICE * found))))


def smaller_sizes(assumed: Array, found: Array) -> Array:
    """Return the smaller ones; zero, which bounds nothing, counts as none.

    Where `sizes_hold` is false one of them at least falls to half or stops being zero, which none
    becomes again, so that repeating a run ends.
    """
    smaller = np.where(assumed > 0, np.minimum(assumed, found), found)
    return np.where(found > 0, smaller, assumed)
