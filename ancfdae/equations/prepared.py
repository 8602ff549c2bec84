"""A system and its matrices as kernels take them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np

from ancfdae.equations.system import MechanicalSystem, planned
from ancfdae.kernels import ComplexModel, March, MatrixLayout, Model, real_part
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint


@final
class Prepared:
    """The model of a system for states of a type, real or complex; the rules are `MarchRules`.

    `real` is the model of the real parts, which has the matrices: the same for a real type.
    """

    real: Model
    model: Model | ComplexModel

    def __init__(
        self, system: MechanicalSystem, matrices: SaddlePoint, rules: Array, dtype: np.dtype[Any]
    ) -> None:
        self.plan, self._matrices, self._rules = planned(system), matrices, rules
        self.dtype = dtype
        self._prepare(matrices.layout(band=False) or matrices.layout_out_of_band())

    def add_band(self) -> None:
        """Prepare for matrices that are not positive definite, too."""
        layout = self._matrices.layout(band=True)
        assert layout is not None
        self._prepare(layout)

    def go(self, passed: Callable[[Model, int], tuple[int, int]], done: int) -> int:
        """Run a pass of the kernel from step `done` on; return the step that it ends before.

        `passed` takes the model of the real parts and a step, and returns the step that it ends
        before and why, as `March`. The pass goes on in a band where a matrix is not positive
        definite.
        """
        done, end = passed(self.real, done)
        if end == March.INDEFINITE:
            self.add_band()
            done, _ = passed(self.real, done)
        return done

    def _prepare(self, layout: MatrixLayout) -> None:
        is_complex = self.dtype.kind == "c"
        plan = real_part(self.plan) if is_complex else self.plan
        self.real = Model(plan, layout, self._rules, self._matrices.exchanging(layout))
        self.model = self.real
        if is_complex:
            self.model = ComplexModel(self.plan, self.real, self._rules)
