"""Error of a step against its tolerance.

With delta what the positions miss in a step, the rates delta / h add up to the error of the run, so
that is what the tolerance bounds (error per unit step):

    e^2 = mean over i of (T delta_i / h / (rtol |r_i| + atol Q_i))^2

with T the length of the run, |r_i| the root mean square of the vector to which coordinate i
belongs, positions from the place of the system, and Q_i the size of coordinate i (`Problem`,
`Scales`). A step is accepted if e <= 1.

Where derivatives are integrated too, each design variable j has its own e, from the derivative of
delta in the design, with

    rtol |r_b,ij| + atol S_j Q_i

below the fraction and twice the value, because errors of the motion feed into those of its
derivatives as much again; the largest e is that of the step. S_j is the largest size of
derivative j in the run, relative to the coordinates (`derivative_sizes`).
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import ErrorEstimates, Sensitivities
from ancfdae.integrators.problem import Scales
from ancfdae.integrators.step_control.derivative_sizes import derivative_sizes, mean_squares
from ancfdae.numerics.arrays import Array

# Errors of the motion add as much to the derivatives' errors as their own:
# docs/theory/13-errors.md.
_FED = 2.0


@final
@dataclass(frozen=True)
class Tolerance:
    """Measure of the error of a step: sizes Q_i, and sizes_b S_j, zero without influence."""

    rtol: float
    atol: float
    t_end: float
    sizes: Array
    sizes_b: Array

    def of_motion(self, h: float, delta: Array, size: Array, blur: Array | float = 0.0) -> float:
        """Return e of the motion; `size` is |r|, and delta below `blur` is round-off."""
        return self._of(h, delta, self.rtol * size + self.atol * self.sizes + blur)

    def of_derivatives(
        self, h: float, delta_b: Array, size_b: Array, blur_b: Array | float = 0.0
    ) -> float:
        """Return the largest e of the derivatives; `size_b` is |r_b|."""
        seen = self.sizes_b > 0
        least = self.sizes[:, None] * self.sizes_b
        allowed = self.rtol * size_b + self.atol * least + blur_b
        return _FED * self._of(h, delta_b[:, seen], allowed[:, seen])

    def _of(self, h: float, delta: Array, allowed: Array) -> float:
        ratio = delta * (self.t_end / h) / allowed
        return float(np.sqrt(np.max(np.mean(ratio * ratio, axis=0), initial=0.0)))


def estimated_errors(
    scales: Scales, scale: Array, rise: Array, sensitivities: Sensitivities | None
) -> ErrorEstimates:
    """Add up the errors of all n steps of a run, relative to Q_i and Q_i S_j.

    They are the scale, (n,), times the rises of the accelerations, (n, n_q), and of a_b of the
    derivatives.
    """
    # A run that diverged overflows; its error counts as infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        motion = float(_added_up(scale, rise, scales.q))
        if sensitivities is None:
            return ErrorEstimates(motion)
        sums = _FED * _added_up(scale, np.diff(sensitivities.a_b, axis=0), scales.q)
        sizes_b = derivative_sizes(scales, sensitivities.q_b)
        relative = np.divide(sums, sizes_b, out=np.full_like(sums, np.nan), where=sizes_b > 0)
    relative = np.where(np.isfinite(sizes_b), relative, np.inf)
    return ErrorEstimates(motion, tuple(float(x) for x in relative))


def _added_up(scale: Array, rises: Array, sizes: Array) -> Array:
    """Add up, over steps, root mean squares over coordinates; infinite where that is no number."""
    total = np.abs(scale) @ np.sqrt(mean_squares(rises, sizes))
    return np.where(np.isfinite(total), total, np.inf)
