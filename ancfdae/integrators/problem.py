"""What a run begins with: a system, its consistent start and the sizes of its unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self, final

from ancfdae.errors import InvalidInput, require_positive
from ancfdae.integrators.characteristic_sizes import Scales
from ancfdae.integrators.index_1 import Accelerations
from ancfdae.integrators.start import (
    InitialSensitivity,
    InitialState,
    consistent_start,
    saddle_point,
    start_sensitivity,
)
from ancfdae.numerics.arrays import is_finite
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.protocol import MechanicalSystem


@final
@dataclass(frozen=True)
class Problem:
    """A system at its consistent start, with derivatives where sensitivities are asked for."""

    system: MechanicalSystem
    matrices: SaddlePoint
    initial: InitialState
    scales: Scales
    accelerations: Accelerations
    derivative: InitialSensitivity | None = None

    @classmethod
    def of(cls, system: MechanicalSystem, t_end: float) -> Self:
        """Find the consistent start."""
        require_positive("t_end", t_end)
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        scales = Scales.of(system, initial, t_end)
        return cls(system, matrices, initial, scales, Accelerations(system, matrices))

    def differentiated(self) -> Self:
        """Add the design derivatives of the start."""
        derivative = start_sensitivity(self.system, self.matrices, self.initial)
        return replace(self, derivative=derivative)

    def require_finite(self) -> None:
        """Refuse a start at which accelerations, multipliers or derivatives are not finite."""
        accelerations = (self.initial.a, self.initial.lam)
        for what, arrays in (
            ("accelerations", accelerations),
            ("design derivatives", self.derivative or ()),
        ):
            if not all(is_finite(x) for x in arrays):
                rule, got = "must be finite", "NaN or infinity"
                raise InvalidInput(f"{what} at the start", rule, got, "Check forces and start.")
